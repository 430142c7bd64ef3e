//! The controller's state machine.
//!
//! | state | entered by | left when |
//! |---|---|---|
//! | Idle | start; 0 W | power is asked for and a start is permitted: Probing |
//! | Probing | power asked for | a look, before the first crest: Heating with a pot, else WaitingForPot |
//! | Heating | a pot that can be heated | two half-cycles in a row without one: WaitingForPot |
//! | WaitingForPot | no pot, or one that cannot be heated | a look finds one: Heating; after a time without one: Idle |
//! | Pausing | a trip, or a mains that is not as it must be | its pause is over: Idle, and from there on |
//! | LockedOut | tries used up, or a fault of the controller | a person switches off and on |
//!
//! 0 W leads from Probing, Heating and WaitingForPot to Idle at once; it comes from panel and host
//! ([`crate::request`]), from a host that is not heard for 10 s, and from replay mode. A fault leads from
//! any state to Pausing or LockedOut, as [`crate::restart`] says, which every start passes too. In
//! Heating the bridge is off between bursts ([`crate::burst`]).
//!
//! It sees one summary per half-cycle and answers with a drive or a fault. The frequency of a new
//! drive is searched in steps, one after each block ([`Control::advance`]), and found within the
//! half-cycle. It takes effect at the next zero crossing, so a summary of another frequency is of the
//! past for power control, but shows the pot.

use ihd_shared::fault::Fault;
use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::{Limit, Pot, State};

use crate::burst::{Burst, Step};
use crate::half_cycle::Summary;
use crate::limits::{
    BURST_POWER_W, BUS_MIN_DV, BUS_TRIP_DV, COMPARED_FROM_DV, GIVE_UP_MS, HALF_CYCLE_MAX_NS,
    HALF_CYCLE_MIN_NS, LOOK_MS, POT_CURRENT_MIN_MA, POT_GONE_HALF_CYCLES, QUICK_LOOK_MS,
    QUICK_LOOKS_FOR_MS, SMALL_POT_PERCENT, UNJUDGED_MS,
};
use crate::plausibility::Plausibility;
use crate::pot::classify;
use crate::power::PowerControl;
use crate::pwm;
use crate::realtime::{Drive, RealTime};
use crate::request::{PanelEvent, Request, Touched};
use crate::restart::{Class, Restart, Verdict, class, is_reached};
use crate::temperature::{TemperatureCodes, Temperatures};

/// Half-cycles of a mains that is as it must be before a pause for its sake ends.
const GOOD_HALF_CYCLES: u8 = 3;

/// Looks in a row without any current that are a fault: even an empty coil carries 5 A.
const DARK_LOOKS: u8 = 2;

/// Half-cycles in a row at the highest frequency with too much power before bursts begin.
const FLOOR_HALF_CYCLES: u8 = 2;

/// How much is too much.
const TOO_MUCH_PERCENT: u64 = 1;

/// What the half-cycle asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Nothing changes.
    Keep,
    /// Drive the bridge so.
    Drive(Drive),
    /// Look what stands on the coil, with the next zero crossing.
    Look,
    /// Open both switches at the next zero crossing.
    OffAtCrossing,
    /// Enter the safe state.
    Fault(Fault),
    /// Leave it.
    ClearFault,
}

/// What the sampling path is at.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// Time since boot, in milliseconds.
    pub ms: u32,
    /// The active fault.
    pub fault: Fault,
    /// What the bridge is asked for.
    pub wanted: Drive,
    /// Whether the bridge switches.
    pub switching: bool,
    /// Whether samples come from a host.
    pub replaying: bool,
}

impl Now {
    /// Of the sampling path.
    pub fn of(realtime: &RealTime) -> Self {
        Self {
            ms: realtime.now_ms(),
            fault: realtime.fault(),
            wanted: realtime.wanted(),
            switching: realtime.drive().is_switching(),
            replaying: realtime.is_replaying(),
        }
    }
}

/// State, pot, requests and everything that control remembers.
#[derive(Clone, Debug)]
pub struct Control {
    state: State,
    pot: Pot,
    limit: Limit,
    request: Request,
    restart: Restart,
    plausibility: Plausibility,
    temperatures: Temperatures,
    power: PowerControl,
    burst: Burst,
    bursting: bool,
    /// At the highest frequency with more power than was asked for, in a row.
    at_floor: u8,
    /// Such a load, for as long as the same power is asked for.
    floor_w: u16,
    /// Half-cycles since the bridge switches.
    half_cycles_on: u32,
    without_pot: u8,
    good_half_cycles: u8,
    /// When a pot was judged last, or the bridge began to look for one.
    judged_ms: u32,
    waiting_since_ms: u32,
    next_look_ms: u32,
    /// A pot was heated before it went away: it may be on its way back.
    may_return: bool,
    /// Looks in a row that saw a mains and no current.
    dark_looks: u8,
    give_up_ms: u32,
    /// The frequency that a pot was heated at last, in hertz.
    heated_hz: u32,
    last: Summary,
    /// The fault that was taken note of.
    seen_fault: Fault,
}

impl Default for Control {
    fn default() -> Self {
        Self {
            state: State::Idle,
            pot: Pot::Unknown,
            limit: Limit::None,
            request: Request::default(),
            restart: Restart::default(),
            plausibility: Plausibility::default(),
            temperatures: Temperatures::default(),
            power: PowerControl::default(),
            burst: Burst::default(),
            bursting: false,
            at_floor: 0,
            floor_w: 0,
            half_cycles_on: 0,
            without_pot: 0,
            good_half_cycles: 0,
            judged_ms: 0,
            waiting_since_ms: 0,
            next_look_ms: 0,
            may_return: false,
            dark_looks: 0,
            give_up_ms: GIVE_UP_MS,
            heated_hz: pwm::HIGHEST_HZ,
            last: Summary::default(),
            seen_fault: Fault::NONE,
        }
    }
}

/// What panel, host and telemetry may ask.
impl Control {
    /// What the controller is doing.
    pub fn state(&self) -> State {
        self.state
    }

    /// What stands on the coil.
    pub fn pot(&self) -> Pot {
        self.pot
    }

    /// Power asked for, in watt.
    pub fn asked_w(&self) -> u16 {
        self.request.power_w()
    }

    /// What holds the power below what was asked for.
    pub fn limit(&self) -> Limit {
        if self.state != State::Heating {
            return Limit::None;
        }
        match self.limit {
            Limit::None if self.request.is_held_by_panel() => Limit::Panel,
            Limit::None => self.power.limit(),
            limit => limit,
        }
    }

    /// Panel and host.
    pub fn request(&self) -> &Request {
        &self.request
    }

    /// Tries and pauses.
    pub fn restart(&self) -> &Restart {
        &self.restart
    }

    /// Heat sink, glass, coil and fan.
    pub fn temperatures(&self) -> &Temperatures {
        &self.temperatures
    }

    /// How long a pot is waited for, in seconds.
    pub fn set_give_up_s(&mut self, give_up_s: u16) {
        self.give_up_ms = u32::from(give_up_s) * 1_000;
    }

    /// Takes the codes of the temperature sensors.
    pub fn set_temperatures(&mut self, codes: TemperatureCodes) {
        self.temperatures.update(codes);
    }

    /// Takes a touch of the panel.
    pub fn panel(&mut self, event: PanelEvent) -> Action {
        match self.request.panel(event) {
            Touched::SwitchedOn if self.restart.is_locked_out() => {
                self.restart.forgive();
                self.plausibility.reset();
                self.leave_fault()
            }
            _ => self.follow_request(),
        }
    }

    /// Takes what the host asks for, at most [`RATED_POWER_W`]; `None` when the panel is off.
    pub fn host(&mut self, power_w: u16) -> Option<Action> {
        let accepted = self.request.host(power_w);
        accepted.then(|| self.follow_request())
    }

    /// What the host asked for lapses.
    pub fn host_lost(&mut self) -> Action {
        self.request.host_lost();
        self.follow_request()
    }

    /// Off, for a reason of the hob's own.
    pub fn switch_off(&mut self) -> Action {
        self.request.switch_off();
        self.follow_request()
    }

    /// The host wants to hear no more of a fault: power must be asked for again. A lock-out stays, and
    /// no pause becomes shorter.
    pub fn clear_fault(&mut self) -> Action {
        let off = self.switch_off();
        if self.state == State::Pausing {
            self.leave_fault()
        } else {
            off
        }
    }

    fn leave_fault(&mut self) -> Action {
        self.enter(State::Idle);
        // One that stands, or comes again at once, counts anew.
        self.seen_fault = Fault::NONE;
        Action::ClearFault
    }

    fn follow_request(&mut self) -> Action {
        let asked_w = self.request.power_w();
        match (asked_w, self.state) {
            (0, State::Probing | State::Heating | State::WaitingForPot) => {
                self.enter(State::Idle);
                Action::Drive(Drive::OFF)
            }
            (1.., State::Heating) if !self.bursting && !self.power.is_searching() => {
                // The last half-cycle is as good as the next: 10 ms sooner.
                if self.last.f_sw_hz > 0 && !self.last.disturbed {
                    let granted_w = self.granted_w();
                    self.power.begin(&self.last, u64::from(granted_w) * 1_000);
                }
                Action::Keep
            }
            _ => Action::Keep,
        }
    }
}

/// What happens by itself.
impl Control {
    fn enter(&mut self, state: State) {
        if state != State::Heating {
            self.restart.stopped();
        }
        if matches!(state, State::Idle) {
            self.pot = Pot::Unknown;
        }
        self.state = state;
        self.limit = Limit::None;
        self.power.cancel();
        self.bursting = false;
        self.without_pot = 0;
        self.at_floor = 0;
        self.floor_w = 0;
    }

    /// To be called after each block: faults, pauses, looks.
    #[inline(never)]
    pub fn tick(&mut self, now: &Now) -> Action {
        if now.fault != self.seen_fault {
            self.seen_fault = now.fault;
            if now.fault != Fault::NONE {
                self.tripped(now);
                return Action::Keep;
            }
        }
        // A bare board has no sensors, and heats nothing; recordings can be replayed on it.
        let condition = self.temperatures.fault();
        let wants_heat = self.request.power_w() > 0 && !now.replaying;
        if condition != Fault::NONE && wants_heat && now.fault == Fault::NONE {
            return Action::Fault(condition);
        }
        match self.state {
            State::LockedOut => Action::Keep,
            State::Pausing => self.end_pause(now),
            State::Idle if self.request.power_w() > 0 => {
                if now.replaying || now.fault != Fault::NONE || !self.restart.permits(now.ms) {
                    return Action::Keep;
                }
                self.power.restart();
                self.enter(State::Probing);
                self.look(now)
            }
            State::Idle => Action::Keep,
            State::WaitingForPot if !now.wanted.is_switching() => self.wait(now),
            State::Probing | State::Heating | State::WaitingForPot => self.watch_judgement(now),
        }
    }

    fn tripped(&mut self, now: &Now) {
        self.good_half_cycles = 0;
        self.plausibility.reset();
        // A recording costs no try: no power flows.
        let locked_out =
            !now.replaying && self.restart.tripped(now.fault, now.ms) == Verdict::LockOut;
        self.enter(if locked_out {
            State::LockedOut
        } else {
            State::Pausing
        });
    }

    /// A pause ends when it is over and what led to it has passed.
    fn end_pause(&mut self, now: &Now) -> Action {
        let lasts = class(now.fault) == Class::Passing
            && (self.good_half_cycles < GOOD_HALF_CYCLES
                || (self.temperatures.fault() != Fault::NONE && self.request.power_w() > 0));
        // What a recording tripped stands until it is over.
        if lasts || now.replaying || !self.restart.permits(now.ms) {
            return Action::Keep;
        }
        self.leave_fault()
    }

    /// Begins to look what stands on the coil.
    fn look(&mut self, now: &Now) -> Action {
        self.restart.started(now.ms);
        self.judged_ms = now.ms;
        Action::Look
    }

    fn wait(&mut self, now: &Now) -> Action {
        if is_reached(now.ms, self.waiting_since_ms.wrapping_add(self.give_up_ms)) {
            self.request.switch_off();
            self.enter(State::Idle);
            return Action::Drive(Drive::OFF);
        }
        if is_reached(now.ms, self.next_look_ms) && self.restart.permits(now.ms) {
            return self.look(now);
        }
        Action::Keep
    }

    /// A bridge that switches without a pot that was judged is off in time, whatever the reason.
    fn watch_judgement(&mut self, now: &Now) -> Action {
        if !now.switching {
            // It charges the bootstrap capacitor, or waits for the mains.
            self.judged_ms = now.ms;
        } else if now.ms.wrapping_sub(self.judged_ms) >= UNJUDGED_MS - 1 {
            return self.lose_pot(Pot::Unknown, now);
        }
        Action::Keep
    }

    /// No pot to heat: off, and look again later.
    fn lose_pot(&mut self, pot: Pot, now: &Now) -> Action {
        if self.state != State::WaitingForPot {
            self.may_return = self.state == State::Heating;
            self.power.pause(self.heated_hz);
            self.enter(State::WaitingForPot);
            self.waiting_since_ms = now.ms;
        }
        self.pot = pot;
        let waited_ms = now.ms.wrapping_sub(self.waiting_since_ms);
        let pause_ms = if self.may_return && waited_ms < QUICK_LOOKS_FOR_MS {
            QUICK_LOOK_MS
        } else {
            LOOK_MS
        };
        self.next_look_ms = now.ms.wrapping_add(pause_ms);
        Action::Drive(Drive::OFF)
    }

    /// Takes a half-cycle's summary.
    #[inline(never)]
    pub fn on_half_cycle(&mut self, summary: &Summary, now: &Now) -> Action {
        if summary.glance {
            return self.judge(summary, now);
        }
        self.last = *summary;
        let in_time = (HALF_CYCLE_MIN_NS..=HALF_CYCLE_MAX_NS).contains(&summary.duration_ns);
        let in_range = (BUS_MIN_DV..BUS_TRIP_DV).contains(&summary.bus_peak_dv);
        self.good_half_cycles = if in_time && in_range {
            self.good_half_cycles.saturating_add(1)
        } else {
            0
        };
        if now.replaying {
            // A recording has no mains and no bridge of its own.
            self.plausibility.reset();
            return Action::Keep;
        }
        let implausible = self.plausibility.on_half_cycle(summary);
        if let Some(fault) = implausible.filter(|_| now.fault == Fault::NONE) {
            return Action::Fault(fault);
        }
        if summary.f_sw_hz == 0 {
            self.half_cycles_on = 0;
        } else {
            self.half_cycles_on = self.half_cycles_on.wrapping_add(1);
        }
        self.power.note(summary, now.ms);
        match self.state {
            State::Idle
            | State::LockedOut
            | State::Pausing
            | State::Probing
            | State::WaitingForPot => Action::Keep,
            State::Heating => self.heat(summary, now),
        }
    }

    /// Judges what a look has shown.
    fn judge(&mut self, summary: &Summary, now: &Now) -> Action {
        if !matches!(self.state, State::Probing | State::WaitingForPot) {
            return Action::Keep;
        }
        let dark =
            summary.i_crest_ma < POT_CURRENT_MIN_MA && summary.bus_peak_dv >= COMPARED_FROM_DV;
        self.dark_looks = if dark { self.dark_looks + 1 } else { 0 };
        if self.dark_looks >= DARK_LOOKS {
            self.dark_looks = 0;
            return Action::Fault(Fault::NO_COIL_CURRENT);
        }
        match classify(summary, self.pot) {
            pot @ (Pot::Ferromagnetic | Pot::Small) => {
                self.pot = pot;
                self.enter(State::Heating);
                self.judged_ms = now.ms;
                Action::Drive(Drive::switching(pwm::HIGHEST_HZ))
            }
            pot => self.lose_pot(pot, now),
        }
    }

    fn heat(&mut self, summary: &Summary, now: &Now) -> Action {
        if summary.f_sw_hz > 0 && !summary.disturbed {
            match classify(summary, self.pot) {
                pot @ (Pot::Ferromagnetic | Pot::Small) => {
                    self.pot = pot;
                    self.without_pot = 0;
                    self.judged_ms = now.ms;
                    self.heated_hz = summary.f_sw_hz;
                }
                // Too little mains to say.
                Pot::Unknown => return Action::Keep,
                pot => {
                    self.without_pot += 1;
                    if self.without_pot >= POT_GONE_HALF_CYCLES {
                        return self.lose_pot(pot, now);
                    }
                    return Action::Keep;
                }
            }
        }
        self.restart.heating(now.ms);
        let granted_w = self.granted_w();
        self.watch_floor(summary, granted_w);
        if granted_w == self.floor_w {
            return self.give_bursts(summary, granted_w, now);
        }
        if core::mem::take(&mut self.bursting) && !now.wanted.is_switching() {
            return Action::Drive(Drive::switching(self.heated_hz));
        }
        self.regulate(summary, granted_w, now);
        Action::Keep
    }

    /// Begins a search for the frequency, unless the summary is of another one.
    fn regulate(&mut self, summary: &Summary, power_w: u16, now: &Now) {
        // A thread too slow for one search a half-cycle ends the old one first.
        if summary.f_sw_hz == now.wanted.f_sw_hz
            && summary.f_sw_hz > 0
            && !summary.disturbed
            && !self.power.is_searching()
        {
            self.power.begin(summary, u64::from(power_w) * 1_000);
        }
    }

    /// More power than was asked for, and no higher frequency: bursts, as long as the same power is
    /// asked for.
    fn watch_floor(&mut self, summary: &Summary, granted_w: u16) {
        if granted_w == self.floor_w {
            return;
        }
        self.floor_w = 0;
        let too_much = summary.f_sw_hz == pwm::HIGHEST_HZ
            && u64::from(summary.power_mw) > u64::from(granted_w) * 10 * (100 + TOO_MUCH_PERCENT);
        self.at_floor = if too_much { self.at_floor + 1 } else { 0 };
        if self.at_floor >= FLOOR_HALF_CYCLES {
            self.at_floor = 0;
            self.floor_w = granted_w;
        }
    }

    fn give_bursts(&mut self, summary: &Summary, granted_w: u16, now: &Now) -> Action {
        if !self.bursting {
            self.bursting = true;
            // The half-cycle that is just over is counted below.
            let before = self.half_cycles_on.wrapping_sub(1);
            self.burst.begin(granted_w, now.ms, before);
        }
        match self.burst.on_half_cycle(summary, granted_w, now.ms) {
            Step::On if self.restart.permits(now.ms) => {
                self.power.cancel();
                Action::Drive(Drive::switching(self.heated_hz))
            }
            Step::On => Action::Keep,
            Step::OffAtCrossing => {
                self.power.cancel();
                Action::OffAtCrossing
            }
            Step::Keep => {
                if self.burst.is_on() {
                    self.regulate(summary, BURST_POWER_W.max(granted_w), now);
                }
                Action::Keep
            }
        }
    }

    /// What is given of what was asked for, in watt.
    fn granted_w(&mut self) -> u16 {
        let asked_w = self.request.power_w();
        let hot_w =
            (u32::from(RATED_POWER_W) * u32::from(self.temperatures.power_percent()) / 100) as u16;
        let pot_w = if self.pot == Pot::Small {
            (u32::from(RATED_POWER_W) * u32::from(SMALL_POT_PERCENT) / 100) as u16
        } else {
            RATED_POWER_W
        };
        self.limit = if asked_w > hot_w {
            Limit::Temperature
        } else if asked_w > pot_w {
            Limit::SmallPot
        } else {
            Limit::None
        };
        asked_w.min(pot_w).min(hot_w)
    }

    /// One step of the search for a frequency, after each block: at most
    /// [`crate::power::INSTRUCTIONS_PER_STEP`].
    #[inline(never)]
    pub fn advance(&mut self, lookup: &RlLookup, now: &Now) -> Action {
        match self.power.advance(lookup) {
            Some(f_sw_hz) if f_sw_hz != now.wanted.f_sw_hz && now.wanted.is_switching() => {
                Action::Drive(Drive::switching(f_sw_hz))
            }
            _ => Action::Keep,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ihd_shared::lookup::prior::prior;
    use ihd_shared::units::{MicroOhm, PicoHenry};
    use std::boxed::Box;

    /// R in ohm, L in µH and crest current in ampere at 80 kHz: R carries √(80/45) = 1.33.
    type Load = (f64, f64, f64);

    const POT: Load = (5.9, 22.0, 16.0);
    const AIR: Load = (0.13, 70.0, 6.0);
    const ALUMINIUM: Load = (0.3, 17.0, 30.0);

    /// A bridge that does what it is told at the next half-cycle of 10 ms.
    struct Bench {
        control: Box<Control>,
        drive: Drive,
        wanted: Drive,
        fault: Fault,
        ms: u32,
        load: Load,
        off_at_crossing: bool,
        look: bool,
        looks: u32,
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
                look: false,
                looks: 0,
            }
        }

        fn now(&self) -> Now {
            Now {
                ms: self.ms,
                fault: self.fault,
                wanted: self.wanted,
                switching: self.drive.is_switching(),
                replaying: false,
            }
        }

        fn act(&mut self, action: Action) {
            match action {
                Action::Keep => {}
                Action::Drive(drive) => self.wanted = drive,
                Action::OffAtCrossing => self.off_at_crossing = true,
                Action::Look => {
                    self.look = true;
                    self.looks += 1;
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
            if !self.wanted.is_switching() {
                self.drive = Drive::OFF;
            }
        }

        fn half_cycle(&mut self) {
            let ends = core::mem::take(&mut self.off_at_crossing);
            for _ in 0..10 {
                self.ms += 1;
                let action = self.control.tick(&self.now());
                self.act(action);
            }
            if core::mem::take(&mut self.look) {
                let glance = Summary {
                    glance: true,
                    ..self.summary(true)
                };
                let action = self.control.on_half_cycle(&glance, &self.now());
                self.act(action);
            }
            let summary = self.summary(self.drive.is_switching());
            let action = self.control.on_half_cycle(&summary, &self.now());
            self.act(action);
            for _ in 0..crate::power::STEPS_PER_SEARCH {
                let action = self.control.advance(&prior(), &self.now());
                self.act(action);
            }
            if ends {
                self.wanted = Drive::OFF;
            }
            self.drive = self.wanted;
            self.control.plausibility.reset();
        }

        fn summary(&self, on: bool) -> Summary {
            let (r, l, i) = self.load;
            Summary {
                f_sw_hz: if on { self.drive.f_sw_hz } else { 0 },
                duration_ns: 10_000_000,
                r: MicroOhm((r * 1e6) as i32),
                l: PicoHenry((l * 1e6) as i32),
                i_crest_ma: if on { (i * 1e3) as u32 } else { 0 },
                power_mw: if on { 400_000 } else { 0 },
                bus_peak_dv: 3_253,
                ..Summary::default()
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
        assert!(bench.drive.is_switching() && bench.drive.f_sw_hz < pwm::HIGHEST_HZ);
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
            bench.run(200);
            assert!(!bench.drive.is_switching());
        }
    }

    #[test]
    fn a_trip_is_followed_by_three_tries_and_only_a_person_ends_the_lock_out() {
        let mut bench = heating();
        for tries_left in [2, 1, 0] {
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
        assert!((90..=101).contains(&bench.looks), "{} in 20 s", bench.looks);
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
}
