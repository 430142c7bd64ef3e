use super::*;
use crate::control::request::PanelEvent;
use crate::control::temperature::TemperatureCodes;
use crate::drive::pwm;
use crate::drive::sequencer::PotProbe;
use crate::retained::control::RetainedControl;
use crate::sampling::half_cycle::CurrentCrest;
use ihd_shared::board;
use ihd_shared::lookup::prior::prior;
use ihd_shared::units::{MicroOhm, PicoHenry};
use std::boxed::Box;

mod burst_moments;
mod pulses;
mod sheet;
mod soft_limit;

/// R in ohm, L in µH and crest current in ampere at 80 kHz: R carries √(80/45) = 1.33.
type Load = (f64, f64, f64);

const POT: Load = (5.9, 22.0, 16.0);
const AIR: Load = (0.13, 70.0, 6.0);
const ALUMINIUM: Load = (0.3, 17.0, 30.0);

/// A bridge that follows its request at the next half-cycle of 10 ms.
struct Bench {
    control: Box<Control>,
    drive: Drive,
    wanted: Drive,
    fault: Fault,
    ms: u32,
    load: Load,
    off_at_crossing: bool,
    half_cycle_ns: u32,
    probe_requested: Option<PotProbe>,
    probes: u32,
}

impl Bench {
    fn new(load: Load) -> Self {
        Self {
            control: Box::default(),
            drive: Drive::OFF,
            wanted: Drive::OFF,
            fault: Fault::NONE,
            ms: 0,
            load,
            off_at_crossing: false,
            half_cycle_ns: 10_000_000,
            probe_requested: None,
            probes: 0,
        }
    }

    fn status(&self) -> SamplingStatus {
        SamplingStatus {
            now_ms: self.ms,
            fault: self.fault,
            requested: self.wanted,
            switching: self.drive.is_switching(),
            replaying: false,
        }
    }

    fn act(&mut self, action: Action) {
        match action {
            Action::Keep => {}
            Action::Drive(drive) => (self.wanted, self.off_at_crossing) = (drive, false),
            Action::OffAtCrossing => (self.wanted, self.off_at_crossing) = (Drive::OFF, true),
            Action::ProbePot(probe) => {
                self.probe_requested = Some(probe);
                self.probes += 1;
            }
            Action::Fault(fault) => self.fault = fault,
            Action::ClearFault => {
                self.fault = Fault::NONE;
                self.wanted = Drive::OFF;
            }
        }
        if self.fault != Fault::NONE {
            self.wanted = Drive::OFF;
        }
        if !self.wanted.is_switching() && !self.off_at_crossing {
            self.drive = Drive::OFF;
        }
    }

    fn half_cycle(&mut self) {
        let ends = self.off_at_crossing;
        for _ in 0..10 {
            self.ms += 1;
            let action = self.control.tick(&self.status());
            self.act(action);
        }
        if let Some(probe) = self.probe_requested.take() {
            let mut probe = HalfCycle {
                is_pot_probe: true,
                f_sw_hz: probe.f_sw_hz(),
                ..self.summary(true)
            };
            // As in a pot's skin.
            let share = (f64::from(probe.f_sw_hz) / f64::from(pwm::MAX_HZ)).sqrt();
            probe.crest.r.0 = (f64::from(probe.crest.r.0) * share * 0.95) as i32;
            let action = self.control.on_half_cycle(&probe, &self.status());
            self.act(action);
        }
        let summary = self.summary(self.drive.is_switching());
        let action = self.control.on_half_cycle(&summary, &self.status());
        self.act(action);
        for _ in 0..crate::control::power::STEPS_PER_SEARCH {
            let action = self.control.advance(&prior(), &self.status());
            self.act(action);
        }
        self.off_at_crossing &= !ends;
        if !self.off_at_crossing {
            self.drive = self.wanted;
        }
        self.control.plausibility.reset();
    }

    fn summary(&self, on: bool) -> HalfCycle {
        let (r, l, i) = self.load;
        HalfCycle {
            f_sw_hz: if on { self.drive.f_sw_hz } else { 0 },
            duration_ns: self.half_cycle_ns,
            crest: CurrentCrest {
                r: MicroOhm((r * 1e6) as i32),
                l: PicoHenry((l * 1e6) as i32),
                i_ma: if on { (i * 1e3) as u32 } else { 0 },
                ..CurrentCrest::default()
            },
            power_mw: if on { 400_000 } else { 0 },
            bus_peak_dv: 3_253,
            ..HalfCycle::default()
        }
    }

    fn run(&mut self, half_cycles: u32) {
        for _ in 0..half_cycles {
            self.half_cycle();
        }
    }

    fn ask(&mut self, power_w: u16) {
        let action = self.control.host(power_w).expect("no panel");
        self.act(action);
    }

    fn pass_minutes(&mut self, minutes: u16) {
        let action = self.control.pass_minutes(minutes);
        self.act(action);
    }

    fn trip(&mut self, fault: Fault) {
        self.act(Action::Fault(fault));
    }
}

fn heating() -> Bench {
    let mut bench = Bench::new(POT);
    bench.ask(1_500);
    bench.run(5);
    assert_eq!(bench.control.state(), State::Heating);
    bench
}

#[test]
fn a_pot_is_looked_at_then_heated() {
    let bench = heating();
    assert_eq!(bench.control.pot(), Pot::Ferromagnetic);
    assert!(bench.drive.is_switching() && bench.drive.f_sw_hz < pwm::MAX_HZ);
}

#[test]
fn what_cannot_be_heated_is_waited_for() {
    for (load, pot) in [(AIR, Pot::Absent), (ALUMINIUM, Pot::Unsuitable)] {
        let mut bench = Bench::new(load);
        bench.ask(1_500);
        bench.run(5);
        assert_eq!(
            (bench.control.state(), bench.control.pot(), bench.fault),
            (State::WaitingForPot, pot, Fault::NONE)
        );
        assert!(!bench.drive.is_switching());
        // A pot comes; a look finds it within 0.7 s.
        bench.load = POT;
        bench.run(72);
        assert_eq!(bench.control.state(), State::Heating);
    }
}

#[test]
fn a_pot_taken_away_is_waited_for_and_given_up() {
    let mut bench = heating();
    bench.load = AIR;
    bench.run(1);
    assert_eq!(bench.control.state(), State::Heating, "one may err");
    bench.run(1);
    assert_eq!(bench.control.state(), State::WaitingForPot);
    bench.run(5_990);
    assert_eq!(bench.control.state(), State::WaitingForPot);
    bench.run(20);
    assert_eq!(
        (bench.control.state(), bench.control.asked_w()),
        (State::Idle, 0)
    );
    bench.load = POT;
    bench.run(200);
    assert_eq!(bench.control.state(), State::Idle);
}

#[test]
fn switched_off_means_off() {
    for load in [POT, AIR] {
        let mut bench = Bench::new(load);
        bench.ask(1_500);
        bench.run(5);
        bench.ask(0);
        assert_eq!(
            (bench.control.state(), bench.wanted),
            (State::Idle, Drive::OFF)
        );
        bench.run(1);
        assert!(!bench.drive.is_switching());
        bench.run(200);
        assert!(!bench.drive.is_switching());
    }
}

/// A person who switches off may put another pot on.
#[test]
fn switched_off_after_a_trip_the_next_search_begins_anew() {
    let mut bench = heating();
    bench.trip(Fault::OVER_CURRENT);
    bench.run(1);
    assert!(bench.control.resumes);
    bench.ask(0);
    bench.run(1);
    bench.ask(1_500);
    assert!(!bench.control.resumes);
}

#[test]
fn a_trip_is_followed_by_four_tries_and_only_a_person_ends_the_lock_out() {
    let mut bench = heating();
    for tries_left in [3, 2, 1, 0] {
        bench.trip(Fault::OVER_CURRENT);
        bench.run(10);
        assert_eq!(bench.control.state(), State::Pausing);
        assert_eq!(bench.control.restart().tries_left(), tries_left);
        bench.run(420);
        assert_eq!(
            (bench.control.state(), bench.fault),
            (State::Heating, Fault::NONE)
        );
    }
    bench.trip(Fault::OVER_CURRENT);
    bench.run(2_000);
    assert_eq!(bench.control.state(), State::LockedOut);
    for _ in 0..20 {
        let action = bench.control.clear_fault();
        bench.act(action);
        bench.ask(0);
        bench.ask(2_000);
        bench.run(20);
        assert_eq!(bench.control.state(), State::LockedOut);
    }
    for level in [0, 6] {
        let action = bench.control.panel(PanelEvent::Level(level));
        bench.act(action);
        bench.run(10);
    }
    assert_eq!(
        (bench.control.state(), bench.fault),
        (State::Heating, Fault::NONE)
    );
}

#[test]
fn a_fault_of_the_mains_passes_with_it() {
    let mut bench = heating();
    for _ in 0..10 {
        bench.trip(Fault::MAINS_LOST);
        bench.run(45);
        assert_eq!(bench.control.state(), State::Heating);
    }
}

/// A mains of 40 Hz, and a host that clears its fault again and again.
#[test]
fn a_fault_of_the_mains_that_is_cleared_passes_no_sooner() {
    let mut bench = heating();
    bench.half_cycle_ns = 12_500_000;
    bench.trip(Fault::MAINS_IRREGULAR);
    bench.run(1);
    let probes = bench.probes;
    for _ in 0..20 {
        let action = bench.control.clear_fault();
        bench.act(action);
        bench.ask(1_500);
        bench.run(25);
        assert_eq!((bench.control.state(), bench.probes), (State::Idle, probes));
    }
    bench.half_cycle_ns = 10_000_000;
    bench.run(8);
    assert_eq!(bench.control.state(), State::Heating);
}

#[test]
fn a_fault_that_comes_again_at_once_is_seen_again() {
    let mut bench = heating();
    for _ in 0..60 {
        bench.trip(Fault::SENSOR_SATURATED);
        bench.run(100);
    }
    assert_eq!(bench.control.state(), State::LockedOut);
}

/// However a host toggles, the bridge is not on for long without a pot.
#[test]
fn a_host_that_repeats_itself_gets_no_more_looks() {
    let mut bench = Bench::new(AIR);
    for k in 0..2_000 {
        bench.ask(if k % 2 == 0 { 2_500 } else { 0 });
        let action = bench.control.clear_fault();
        bench.act(action);
        bench.ask(2_500);
        bench.half_cycle();
    }
    // One in 200 ms.
    assert!(
        (90..=101).contains(&bench.probes),
        "{} in 20 s",
        bench.probes
    );
}

#[test]
fn little_power_comes_in_bursts_of_whole_cycles() {
    let mut bench = Bench::new(POT);
    bench.ask(200);
    bench.run(5);
    // From the end of the first burst on.
    while bench.drive.is_switching() {
        bench.half_cycle();
    }
    let (mut on, mut length) = (0, 0);
    for _ in 0..1_000 {
        bench.half_cycle();
        let switching = bench.drive.is_switching();
        on += u32::from(switching);
        if !switching {
            assert_eq!(length % 2, 0);
        }
        length = if switching { length + 1 } else { 0 };
    }
    // 400 W, half of the time.
    assert!((450..=550).contains(&on), "{on}");
    assert_eq!(bench.control.state(), State::Heating);
}

/// No power is granted while the bridge is about to switch.
#[test]
fn keeping_warm_what_is_too_hot_takes_one_whole_cycle() {
    let mut bench = Bench::new(POT);
    let at_90_c = (90 - board::NTC_FROM_C) / board::NTC_STEP_C;
    bench.control.set_temperatures(TemperatureCodes {
        glass: Some(board::NTC_CODES[1][at_90_c as usize]),
        ..TemperatureCodes::default()
    });
    bench.run(110);
    let action = bench.control.panel(PanelEvent::KeepWarm);
    bench.act(action);
    let mut on = 0;
    for _ in 0..300 {
        bench.half_cycle();
        on += u32::from(bench.drive.is_switching());
    }
    assert_eq!((bench.control.state(), on), (State::Heating, 2));
    assert_eq!(bench.control.limit(), Limit::KeepWarm);
}

/// Heating, waiting for a pot, pausing: the time ends whatever becomes of the request, and a reset does not give it back.
#[test]
fn what_nobody_watches_ends_and_a_host_is_refused() {
    for (load, fault) in [
        (POT, Fault::NONE),
        (AIR, Fault::NONE),
        (POT, Fault::MAINS_LOST),
    ] {
        let mut bench = Bench::new(load);
        bench.ask(2_500);
        bench.run(5);
        bench.pass_minutes(59);
        bench.run(99);
        assert_eq!(bench.control.off_reason(), OffReason::None);
        bench.trip(fault);
        bench.pass_minutes(1);
        bench.run(200);
        assert_eq!(bench.control.off_reason(), OffReason::Unattended);
        assert_eq!(bench.control.state(), State::Idle, "{fault}");
        assert!(!bench.drive.is_switching());
        let mut after = Control::default();
        after.restore(bench.control.retained(), &bench.status());
        for control in [&mut *bench.control, &mut after] {
            assert_eq!(control.host(100), None);
            control.clear_fault();
            assert_eq!(control.host(100), None);
            control.panel(PanelEvent::Level(1));
            assert_eq!(control.asked_w(), 100);
        }
        bench.load = POT;
        bench.run(100);
        assert_eq!(bench.control.state(), State::Heating);
        assert_eq!(bench.control.off_reason(), OffReason::None);
    }
}

#[test]
fn a_wait_that_was_given_up_is_told_until_the_next_request() {
    let mut bench = Bench::new(AIR);
    bench.ask(1_000);
    bench.run(6_100);
    assert_eq!(bench.control.off_reason(), OffReason::NoPot);
    bench.ask(1_000);
    bench.run(1);
    assert_eq!(bench.control.off_reason(), OffReason::None);
}

/// The used share goes with the crash record.
#[test]
fn a_restart_is_no_touch() {
    let mut bench = heating();
    bench.ask(2_500);
    bench.pass_minutes(40);
    let mut after = Control::default();
    after.restore(bench.control.retained(), &bench.status());
    after.host(2_500);
    after.pass_minutes(20);
    after.tick(&bench.status());
    assert_eq!(after.off_reason(), OffReason::Unattended);
}

#[test]
fn a_boost_of_the_panel_falls_to_the_level_below_and_a_hosts_is_capped() {
    let mut bench = Bench::new(POT);
    bench.control.panel(PanelEvent::Level(9));
    bench.run(50);
    assert_eq!(bench.control.asked_w(), 2_500);
    bench.pass_minutes(10);
    bench.run(2);
    assert_eq!(bench.control.request().level(), Some(8));
    let mut bench = heating();
    bench.ask(2_500);
    bench.pass_minutes(10);
    bench.run(2);
    // Its lease has the power that it asked for.
    assert_eq!(
        (bench.control.asked_w(), bench.control.limit()),
        (2_500, Limit::Boost)
    );
    bench.pass_minutes(20);
    bench.ask(2_500);
    bench.run(2);
    assert_eq!(bench.control.limit(), Limit::Boost, "it stands");
    bench.ask(1_000);
    bench.run(100);
    bench.ask(2_500);
    bench.run(2);
    assert_ne!(bench.control.limit(), Limit::Boost);
}

#[test]
fn the_timer_switches_off_for_good() {
    let mut bench = heating();
    bench.control.panel(PanelEvent::Timer(20));
    bench.pass_minutes(19);
    assert_eq!(
        (bench.control.timer_min(), bench.control.asked_w()),
        (1, 1_500)
    );
    bench.pass_minutes(1);
    bench.run(2);
    assert_eq!(bench.control.off_reason(), OffReason::Timer);
    assert!(!bench.drive.is_switching());
    assert_eq!(bench.control.host(1_500), None);
}

/// Its link is lost for some seconds, or another host takes over.
#[test]
fn the_timer_outlasts_a_host_that_asks_again() {
    let mut bench = heating();
    bench.control.panel(PanelEvent::Timer(10));
    bench.control.host_lost();
    bench.pass_minutes(1);
    bench.ask(1_500);
    bench.pass_minutes(8);
    assert_eq!(
        (bench.control.timer_min(), bench.control.asked_w()),
        (1, 1_500)
    );
    bench.pass_minutes(1);
    assert_eq!(bench.control.off_reason(), OffReason::Timer);
    assert_eq!(bench.control.host(1_500), None);
    bench.control.panel(PanelEvent::Level(5));
    bench.control.panel(PanelEvent::Timer(10));
    bench.control.panel(PanelEvent::Level(0));
    assert_eq!(bench.control.timer_min(), 0, "off at the panel ends it");
}

/// A restart, which a host may ask for, takes nothing back that a person has set.
#[test]
fn the_panels_limit_and_timer_outlast_a_restart() {
    let limited_w = crate::limits::LEVELS[3].power_w;
    for (events, power_w) in [
        (&[PanelEvent::Level(4)][..], Some(limited_w)),
        (&[PanelEvent::KeepWarm], Some(crate::limits::KEEP_WARM_W)),
        (&[PanelEvent::Level(4), PanelEvent::Timer(10)], None),
        (&[PanelEvent::Level(0)], None),
        (&[], Some(1_500)),
    ] {
        let mut bench = heating();
        for event in events {
            bench.control.panel(*event);
        }
        bench.control.host(0);
        let kept = bench.control.retained();
        let mut control = Box::<Control>::default();
        let bytes = RetainedControl::from_bytes(kept.to_bytes());
        control.restore(bytes, &bench.status());
        assert_eq!(control.asked_w(), 0, "nothing heats unasked: {events:?}");
        assert_eq!(
            control.host(1_500).is_some(),
            power_w.is_some(),
            "{events:?}"
        );
        assert_eq!(control.asked_w(), power_w.unwrap_or(0), "{events:?}");
    }
}

/// The clock wraps after 49.7 days: the pause after a probe must not seem to lie ahead.
#[test]
fn a_hob_that_was_off_for_weeks_heats() {
    let mut bench = heating();
    bench.ask(0);
    bench.run(10);
    for _ in 0..28 * 24 * 60 {
        bench.ms = bench.ms.wrapping_add(60_000);
        assert_eq!(bench.control.tick(&bench.status()), Action::Keep);
    }
    bench.control.panel(PanelEvent::Level(6));
    bench.run(50);
    assert_eq!(bench.control.state(), State::Heating);
}
