//! Limits that no request of a host moves, at any time: the bridge is not on for long without a pot that was judged, and never while
//! locked out.

use ihd_firmware::limits::{QUICK_PROBE_MS, UNJUDGED_MS};
use ihd_shared::fault::Fault;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::hello::{ROLE_HOST, ours};
use ihd_shared::wire::messages::{
    ClearFault, Configure, GetStatus, Message, Program, PushLookup, Raw, ReplayEnd, ReplayStart,
    ResetLookup, Restart, SetPower, State, Stream, TestChannels,
};
use ihd_shared::wire::number::Number;
use ihd_sim::hob::{HobConfig, PanelEvent, SimHob};
use ihd_sim::injection::{Injection, InjectionKind};
use ihd_sim::recording::settings::LoadKind;
use proptest::prelude::*;

/// Request of a host.
#[derive(Clone, Debug)]
enum Sent {
    Hello,
    SetPower(u16),
    ClearFault,
    GetStatus,
    Stream,
    /// R and L of all cells over the prior's, in percent.
    PushLookup(u16, u16),
    ResetLookup,
    Configure,
    Replay,
    Restart,
    TestChannels,
}

fn sent() -> impl Strategy<Value = Sent> {
    prop_oneof![
        1 => Just(Sent::Hello),
        6 => (0u16..=2_600).prop_map(Sent::SetPower),
        4 => Just(Sent::SetPower(2_500)),
        3 => Just(Sent::SetPower(0)),
        4 => Just(Sent::ClearFault),
        1 => Just(Sent::GetStatus),
        1 => Just(Sent::Stream),
        2 => (2u16..150, 50u16..160).prop_map(|(r, l)| Sent::PushLookup(r, l)),
        1 => Just(Sent::ResetLookup),
        1 => Just(Sent::Configure),
        1 => Just(Sent::Replay),
        1 => Just(Sent::Restart),
        1 => Just(Sent::TestChannels),
    ]
}

/// A message and the milliseconds until the next.
fn conversation() -> impl Strategy<Value = Vec<(Sent, u16)>> {
    let pause = prop_oneof![3 => 0u16..40, 1 => 40u16..300];
    prop::collection::vec((sent(), pause), 20..60)
}

struct Bench {
    hob: SimHob,
    seq: u16,
    number: Number,
    version: u32,
    on_since_s: Option<f64>,
    longest_on_s: f64,
    on_s: f64,
}

impl Bench {
    fn new(pot: &str) -> Self {
        let config = HobConfig {
            pot: pot.parse().expect("a pot"),
            load: LoadKind::Behavioural,
            ..HobConfig::default()
        };
        let mut bench = Self {
            hob: SimHob::new(&config),
            seq: 0,
            number: Number::NONE,
            version: 0,
            on_since_s: None,
            longest_on_s: 0.0,
            on_s: 0.0,
        };
        bench.send(&Sent::Hello);
        bench
    }

    fn frame(&mut self, message: &impl Message) {
        self.number = self.number.next();
        let mut frame = [0; MAX_ENCODED];
        let length = encode_numbered(message, self.number, self.seq, &mut frame).expect("it fits");
        self.seq = self.seq.wrapping_add(1);
        self.hob.send(&frame[..length]);
    }

    fn send(&mut self, sent: &Sent) {
        match sent {
            Sent::Hello => self.frame(&ours(ROLE_HOST, 0, 1, "test", "host")),
            Sent::SetPower(power_w) => self.frame(&SetPower { power_w: *power_w }),
            Sent::ClearFault => self.frame(&ClearFault {}),
            Sent::GetStatus => self.frame(&GetStatus {}),
            Sent::Stream => self.frame(&Stream {
                telemetry_every: 1,
                windows_every: 7,
            }),
            Sent::PushLookup(r, l) => {
                self.version += 1;
                let mut lookup = RlLookup {
                    version: self.version,
                    ..prior()
                };
                let scale = |cells: &mut [[u16; 17]; 8], percent: u16| {
                    for cell in cells.iter_mut().flatten() {
                        *cell = (u32::from(*cell) * u32::from(percent) / 100) as u16;
                    }
                };
                scale(&mut lookup.r, *r);
                scale(&mut lookup.l, *l);
                lookup.observed.fill(0xFF);
                self.frame(&PushLookup {
                    blob: Raw(&lookup.to_bytes()),
                });
            }
            Sent::ResetLookup => self.frame(&ResetLookup {}),
            Sent::Configure => self.frame(&Configure {
                give_up_s: 60,
                dither_permille: 10,
            }),
            Sent::Replay => {
                self.frame(&ReplayStart {
                    f_sw_hz: 50_000,
                    r: MicroOhm(4_000_000),
                    l: PicoHenry(25_000_000),
                });
                self.frame(&ReplayEnd {});
            }
            Sent::Restart => self.frame(&Restart {
                into: Program::Firmware,
            }),
            Sent::TestChannels => self.frame(&TestChannels {}),
        }
    }

    /// A current sensor whose gain is wrong, which trips each try; returns its number.
    fn mistune(&mut self) -> u32 {
        let mut number = 0;
        self.hob.inject(|injections| {
            number = injections.start(Injection {
                kind: InjectionKind::CurrentGain,
                value: 0.7,
                channel: InjectionKind::CurrentGain.default_channel(),
            });
        });
        number
    }

    /// Runs for a time, with `check` after each block.
    fn run(&mut self, duration_s: f64, check: impl Fn(&SimHob)) {
        let end_s = self.hob.t_s() + duration_s;
        while self.hob.t_s() < end_s {
            let before_s = self.hob.t_s();
            self.hob.step();
            let now_s = self.hob.t_s();
            if self.hob.sampling_path().drive().is_switching() {
                let since_s = *self.on_since_s.get_or_insert(before_s);
                self.longest_on_s = self.longest_on_s.max(now_s - since_s);
                self.on_s += now_s - before_s;
            } else {
                self.on_since_s = None;
            }
            check(&self.hob);
        }
        // The host takes what comes.
        let mut bytes = [0; 4_096];
        while self.hob.receive(&mut bytes) > 0 {}
    }
}

/// A hob that locked out while it heated, with the cause gone and the power still requested.
fn locked_out() -> Bench {
    let mut bench = Bench::new("ferritic-21");
    let number = bench.mistune();
    bench.send(&Sent::SetPower(2_000));
    for _ in 0..200 {
        bench.run(0.1, |_| ());
        bench.send(&Sent::GetStatus);
        if bench.hob.housekeeping().control().state() == State::LockedOut {
            break;
        }
    }
    bench.hob.inject(|injections| injections.end(number));
    bench.on_s = 0.0;
    bench
}

fn assert_locked_out(hob: &SimHob) {
    assert_eq!(hob.housekeeping().control().state(), State::LockedOut);
    assert_ne!(hob.sampling_path().fault(), Fault::NONE);
}

/// Locked out, the board is off: service may restart it. What it was locked out for does not go with the reset.
#[test]
fn a_restart_over_the_link_is_carried_out_and_ends_no_lock_out() {
    let mut bench = locked_out();
    for _ in 0..2 {
        bench.send(&Sent::Restart);
        bench.run(0.3, assert_locked_out);
        let since_boot_ms = bench.hob.sampling_path().now_ms();
        assert!(since_boot_ms < 300, "not restarted for {since_boot_ms} ms");
        bench.send(&Sent::Hello);
        bench.send(&Sent::SetPower(2_000));
        bench.run(0.5, assert_locked_out);
    }
    assert_eq!(bench.on_s, 0.0);
    // A person at the panel.
    for level in [0, 7] {
        bench.hob.panel(PanelEvent::Level(level));
    }
    bench.run(0.5, |_| ());
    let control = bench.hob.housekeeping().control();
    assert_eq!(control.state(), State::Heating);
}

/// Neither a try nor the panel's refusal is forgotten by a reset.
#[test]
fn a_restart_brings_no_try_back_and_does_not_switch_the_panel_on() {
    let mut bench = Bench::new("ferritic-21");
    bench.hob.panel(PanelEvent::Level(0));
    bench.send(&Sent::Restart);
    bench.run(0.3, |_| ());
    bench.send(&Sent::Hello);
    bench.send(&Sent::SetPower(2_000));
    bench.run(0.3, |_| ());
    assert_eq!(bench.hob.housekeeping().control().asked_w(), 0);
    assert_eq!(bench.on_s, 0.0);
    bench.hob.panel(PanelEvent::Level(7));
    bench.mistune();
    let tries = |bench: &Bench| bench.hob.housekeeping().control().restart().tries_left();
    let full = tries(&bench);
    while tries(&bench) == full {
        bench.run(0.1, |_| ());
    }
    let left = tries(&bench);
    bench.hob.panel(PanelEvent::Level(0));
    bench.send(&Sent::Restart);
    bench.run(0.3, |_| ());
    assert!(bench.hob.sampling_path().now_ms() < 300);
    assert_eq!(tries(&bench), left);
}

/// Number of conversations, some seconds of a hob each: that of `PROPTEST_CASES`, which the full tier sets, or two.
fn conversations() -> ProptestConfig {
    match std::env::var_os("PROPTEST_CASES") {
        Some(_) => ProptestConfig::default(),
        None => ProptestConfig::with_cases(2),
    }
}

proptest! {
    #![proptest_config(conversations())]

    #[test]
    fn without_a_pot_the_bridge_only_looks(pot in prop_oneof![Just("none"), Just("aluminium-21")], all in conversation()) {
        let mut bench = Bench::new(pot);
        for (sent, pause_ms) in &all {
            bench.send(sent);
            bench.run(f64::from(*pause_ms) * 1e-3 + 1e-4, |_| ());
        }
        let limit_s = f64::from(UNJUDGED_MS) * 1e-3;
        prop_assert!(bench.longest_on_s <= limit_s, "on for {} s", bench.longest_on_s);
        // A look every so often, and no look lasts longer than a half-cycle.
        let looks = 1.0 + bench.hob.t_s() * 1e3 / f64::from(QUICK_PROBE_MS);
        prop_assert!(bench.on_s <= looks * 10e-3, "{} s in {} s", bench.on_s, bench.hob.t_s());
    }

    #[test]
    fn a_lock_out_outlasts_every_message(all in conversation()) {
        let mut bench = locked_out();
        for (sent, pause_ms) in &all {
            bench.send(sent);
            bench.run(f64::from(*pause_ms) * 1e-3 + 1e-4, assert_locked_out);
        }
        prop_assert!(bench.on_s == 0.0, "on for {} s", bench.on_s);
    }
}
