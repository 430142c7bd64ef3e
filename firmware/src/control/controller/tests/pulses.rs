//! A host that switches off and on within seconds.

use super::*;
use crate::limits::LEVELS;

/// Asks for the rating for so many milliseconds and for nothing for as many, by turns.
#[derive(Clone, Copy, Debug)]
struct Pulses {
    on_ms: u32,
    off_ms: u32,
    /// Time at which they begin.
    phase_ms: u32,
}

impl Pulses {
    fn follow(self, bench: &mut Bench) {
        match (bench.ms + self.phase_ms) % (self.on_ms + self.off_ms) {
            0 => bench.ask(2_500),
            at if at == self.on_ms => bench.ask(0),
            _ => {}
        }
    }
}

/// Whatever the rhythm, and wherever its seconds begin, the time for which it asks is used up: within one part of 255.
#[test]
fn a_host_that_pulses_uses_up_the_time_for_which_it_asks() {
    let [.., highest] = LEVELS;
    let minutes = 10;
    for (on_ms, off_ms) in [(500, 500), (950, 50), (50, 950), (1_900, 100), (30, 41)] {
        for phase_ms in [0, 200, 600, 970] {
            let pulses = Pulses {
                on_ms,
                off_ms,
                phase_ms,
            };
            let mut bench = Bench::new(POT);
            for _ in 0..minutes * 60_000 {
                pulses.follow(&mut bench);
                bench.ms += 1;
                bench.control.tick(&bench.status());
            }
            let used = f64::from(bench.control.parts.times.unattended.used_share());
            let share = f64::from(minutes) / f64::from(highest.unattended_min);
            let asked = 255.0 * share * f64::from(on_ms) / f64::from(on_ms + off_ms);
            // Rounded up.
            let fits = (asked - 0.2..asked + 1.3).contains(&used);
            assert!(fits, "{pulses:?}: {used} of {asked}");
        }
    }
}

/// 950 of 1,000 ms: of ten minutes of boost, of which nine are gone, the last one is over after 67 s.
#[test]
fn a_host_that_pulses_uses_up_its_boost() {
    for phase_ms in [0, 600, 970] {
        let pulses = Pulses {
            on_ms: 950,
            off_ms: 50,
            phase_ms,
        };
        let mut bench = heating();
        bench.ask(2_500);
        bench.pass_minutes(9);
        for (seconds, is_over) in [(58, false), (20, true)] {
            for _ in 0..seconds * 100 {
                pulses.follow(&mut bench);
                bench.half_cycle();
            }
            assert_eq!(bench.control.parts.times.boost.is_over(), is_over);
        }
    }
}
