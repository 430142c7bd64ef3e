use super::*;
use crate::control::pot::tests::{Load, half_cycle};

/// A ferritic pot of 21 cm at 700 to 2,500 W, by the field model at 230 V.
const POT: [Load; 8] = [
    (77_413, 4.602, 20.50, 22.1),
    (69_891, 4.213, 20.54, 25.3),
    (62_627, 3.807, 20.49, 29.8),
    (57_610, 3.497, 20.35, 34.6),
    (50_101, 3.010, 20.03, 44.9),
    (47_639, 2.848, 19.90, 49.3),
    (45_223, 2.660, 19.63, 56.1),
    (43_124, 2.491, 19.36, 63.9),
];

/// A watch of half-cycles of 10 ms.
struct Watched {
    watch: PotWatch,
    now_ms: u32,
}

impl Watched {
    fn new() -> Self {
        Self {
            watch: PotWatch::new(0),
            now_ms: 0,
        }
    }

    fn note(&mut self, summary: &HalfCycle) -> bool {
        self.now_ms += 10;
        self.watch.note(summary, self.now_ms);
        self.watch.is_probe_due()
    }

    /// Half-cycles of a load until a probe is due.
    fn due_after(&mut self, load: Load, most: u32) -> Option<u32> {
        (1..=most).find(|_| self.note(&half_cycle(load)))
    }

    /// A pot that has been heated for half a second.
    fn heating(load: Load) -> Self {
        let mut watched = Self::new();
        assert_eq!(watched.due_after(load, 50), None);
        watched
    }
}

#[test]
fn a_sheet_in_the_pots_place_is_probed_within_two_half_cycles() {
    let (foil, lid) = ("foil", "lid");
    for (what, pot, sheet, within) in [
        // At the pot's frequency, as it stood when the sheet came.
        (
            foil,
            (50_101, 3.01, 20.03, 44.9),
            (50_101, 2.69, 18.4, 54.0),
            2,
        ),
        (
            foil,
            (50_101, 3.01, 20.03, 44.9),
            (50_101, 2.48, 29.4, 32.0),
            1,
        ),
        (
            lid,
            (50_101, 3.01, 20.03, 44.9),
            (50_101, 1.90, 22.0, 49.0),
            1,
        ),
        // The least of all: 16 cm for 21 cm at 2,500 W.
        (
            foil,
            (43_041, 2.484, 19.34, 64.2),
            (43_208, 2.604, 19.12, 66.1),
            2,
        ),
        // A small pot, whose place foil takes with more R and L.
        (
            foil,
            (42_386, 2.06, 25.0, 54.0),
            (42_386, 2.34, 30.3, 41.0),
            1,
        ),
        (
            lid,
            (42_386, 2.06, 25.0, 54.0),
            (45_593, 1.87, 22.3, 58.0),
            1,
        ),
        // Soft limits have raised the frequency meanwhile.
        (
            foil,
            (38_046, 3.94, 30.7, 39.0),
            (48_786, 2.67, 18.5, 55.0),
            1,
        ),
        (
            foil,
            (50_101, 3.01, 20.03, 44.9),
            (58_060, 2.76, 15.9, 50.0),
            1,
        ),
    ] {
        let due = Watched::heating(pot).due_after(sheet, 10);
        assert!(
            due.is_some_and(|n| n <= within),
            "{what} {sheet:?}: {due:?}"
        );
    }
}

/// A hand draws the pot off a sheet within 2 s; power control follows.
#[test]
fn a_slow_exchange_is_summed_up() {
    let (pot, foil) = ((50_101, 3.01, 20.03, 44.9), (55_460, 2.74, 18.1, 47.0));
    let mut watched = Watched::heating(pot);
    let at = |share: f64| {
        let between = |a: f64, b: f64| a + (b - a) * share;
        // Two half-cycles each.
        let f_sw_hz = between(f64::from(pot.0), f64::from(foil.0)) as u32 / 300 * 300;
        let [r, l, i] =
            [(pot.1, foil.1), (pot.2, foil.2), (pot.3, foil.3)].map(|(a, b)| between(a, b));
        (f_sw_hz, r, l, i)
    };
    let due = (1..=200).find(|&k| watched.note(&half_cycle(at(f64::from(k) / 200.0))));
    assert!(due.is_some_and(|k| k < 150), "{due:?}");
}

/// Soft start, steps up and down between all powers.
#[test]
fn a_pot_that_stays_is_not_probed_for_another_power() {
    for (from, first) in POT.into_iter().enumerate() {
        for to in POT {
            let mut watched = Watched::new();
            for load in &POT[..from] {
                assert!(!watched.note(&half_cycle(*load)));
            }
            assert_eq!(watched.due_after(first, 50), None, "{first:?}");
            assert_eq!(watched.due_after(to, 50), None, "{first:?} to {to:?}");
            assert_eq!(watched.due_after(first, 50), None, "back from {to:?}");
        }
    }
}

/// Noise of 20 dB: R scatters by 0.9 %, as a sum of twelve even numbers does.
#[test]
fn noise_shows_no_other_load() {
    let mut state = 1_u32;
    let mut normal = || {
        let mut even = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state) / f64::from(u32::MAX)
        };
        (0..12).map(|_| even()).sum::<f64>() - 6.0
    };
    let mut watched = Watched::new();
    for k in 0..2_900 {
        let (f_sw_hz, r, l, i) = POT[4];
        // The dither's frequencies.
        let f_sw_hz = [f_sw_hz, f_sw_hz + 500, f_sw_hz, f_sw_hz - 500][k % 4];
        let load = (
            f_sw_hz,
            r * (1.0 + 0.009 * normal()),
            l * (1.0 + 0.005 * normal()),
            i,
        );
        assert!(!watched.note(&half_cycle(load)), "{k}");
    }
}

/// 138 V for 0.2 s, and back: less current saturates the steel less.
#[test]
fn a_mains_that_sags_is_no_other_load() {
    let mut watched = Watched::heating(POT[4]);
    let sag = HalfCycle {
        bus_peak_dv: 1_950,
        ..half_cycle((50_101, 3.42, 21.6, 26.0))
    };
    for _ in 0..20 {
        assert!(!watched.note(&sag));
    }
    assert_eq!(watched.due_after(POT[4], 50), None);
}

/// The coil that loses its pot charges the bus for one half-cycle.
#[test]
fn a_higher_bus_hides_no_sheet() {
    let mut watched = Watched::heating(POT[4]);
    let sheet = (50_101, 2.48, 29.4, 32.0);
    let charged = HalfCycle {
        bus_peak_dv: 4_071,
        ..half_cycle(sheet)
    };
    watched.note(&charged);
    assert_eq!(watched.due_after(sheet, 3), Some(1));
}

/// From 20 to 200 °C within two minutes: a fifth more R.
#[test]
fn a_pot_that_gets_warm_is_probed_now_and_then() {
    let mut watched = Watched::heating(POT[4]);
    let mut probes = 0;
    for k in 0..12_000 {
        let (f_sw_hz, r, l, i) = POT[4];
        if watched.note(&half_cycle((
            f_sw_hz,
            r * (1.0 + 0.2 * f64::from(k) / 12_000.0),
            l,
            i,
        ))) {
            probes += 1;
            watched.watch.probed(watched.now_ms);
        }
    }
    assert!((3..=8).contains(&probes), "{probes}");
}

/// No sheet has as much R as cast iron.
#[test]
fn cast_iron_that_is_moved_is_not_probed() {
    let mut watched = Watched::heating((38_046, 3.94, 30.7, 39.0));
    assert_eq!(watched.due_after((38_046, 3.6, 32.5, 38.0), 50), None);
}

#[test]
fn half_a_minute_without_a_probe_ends_with_one() {
    let mut watched = Watched::new();
    assert_eq!(watched.due_after(POT[4], 4_000), Some(3_000));
    watched.watch.probed(watched.now_ms);
    assert_eq!(watched.due_after(POT[4], 4_000), Some(3_000));
}

/// A load that came while the bridge was open for the probe is another one again.
#[test]
fn a_probe_keeps_the_reference() {
    let mut watched = Watched::heating(POT[4]);
    let moved = (50_101, 2.7, 21.5, 45.0);
    assert_eq!(watched.due_after(moved, 3), Some(1));
    watched.watch.probed(watched.now_ms);
    assert_eq!(watched.due_after(moved, 20), None);
    assert_eq!(watched.due_after((50_101, 2.48, 29.4, 32.0), 3), Some(1));
}
