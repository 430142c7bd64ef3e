//! Pot detection: the estimate at the crest against what the built-in prior expects there. A lookup
//! that was pushed has no say: whatever it holds, a pot is the same pot.
//!
//! At 45 kHz (R, L): ferromagnetic 21 cm 6.6-3.7 ohm / 37-24 µH, 12 cm 2.4-1.7 / 33-32, aluminium
//! 0.22 / 17, stainless 304 0.76 / 18, none 0.1 / 50. All scale alike with frequency, so ratios
//! to the prior at the same frequency and current separate them: R below half of the expected is
//! no full pot, and below 30 % L separates air (above) from a non-magnetic plate (below). A steel that
//! covers half of the coil lies between.
//!
//! By the field model a ferritic or cast-iron disc has, of the prior's R from 80 to 34 kHz: 13-15 % with 5 cm, 24-26 % with
//! 7 cm, 30-33 % with 8 cm, 48-63 % with 12 cm, 28-29 % with 10 cm lifted by 10 mm. Less than 8 cm is cutlery, a ring or a lid's
//! knob, and is not heated.
//!
//! A sheet thinner than its skin depth may have the R of a pot, but its surface adds no reactance: R and L together are less than any
//! pot's. Of the prior's, at 80 kHz and 180 to 265 V: household foil of 14 to 26 cm 50/96 to 48/57 %, a lid of 0.6 mm of 304 of 12 to
//! 26 cm 33/114 to 32/57 %; ferritic pots of 12 to 26 cm 49/133 to 85/91 %, sandwich bases of 12, 15, 26 cm 32/122, 49/102, 85/91 %.
//!
//! Smaller sheets are betrayed by a second frequency. In the skin of a pot R grows with √f, in a small one with f up to 0.9; in a sheet the
//! current fills all of the thickness at any. From 80 to 50 kHz, by the field model at 180 to 265 V: ferritic pots, cast iron and sandwich
//! bases of 8 to 26 cm, at the centre and 60 mm off it, lifted, cold and hot, 66 to 73 %; foil of 8 to 14 cm 81 to 90 %, lids of 6 to 20 cm
//! 82 to 98 %.

use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::units::MicroOhm;
use ihd_shared::wire::messages::Pot;

use crate::limits::BUS_MIN_DV;
use crate::sampling::half_cycle::HalfCycle;

/// R and L of a full-size pot before any was measured.
pub static PRIOR: RlLookup = prior();

/// R of a full-size pot, at least this percentage of the prior's.
const FULL_R_PERCENT: i64 = 50;

/// The same for a pot that was small before, so that one at the border does not change its class with
/// its power.
const FULL_AFTER_SMALL_R_PERCENT: i64 = 56;

/// R of steel that covers a part of the coil; a non-magnetic plate has at most 20 %.
const PART_R_PERCENT: i64 = 30;

/// R of the smallest pot that is heated, at least this percentage of the prior's: a disc of 7.7 cm.
const SMALL_R_PERCENT: i64 = 29;

/// The same for a pot that is being heated, so that one at the border is not switched on and off: 7.4 cm.
const STILL_SMALL_R_PERCENT: i64 = 27;

/// L above this percentage of the prior's means an empty coil.
const AIR_L_PERCENT: i64 = 125;

/// R and L of a pot together, at least this percentage of the prior's.
const POT_R_AND_L_PERCENT: i64 = 145;

/// The same for a pot that is being heated, whose steel saturates: 142 % at least, a sandwich base of 18 cm at 73 A. A voltage that
/// reads four fifths leaves 125 % of a ferritic pot, and is the balance's to find.
const STILL_POT_R_AND_L_PERCENT: i64 = 120;

/// R of a sheet is less than this percentage of the prior's.
const SHEET_R_PERCENT: i64 = 70;

/// R at the second probe over that at the first, from which on what stands there is a sheet.
const SHEET_R_LEFT_PERCENT: i64 = 77;

/// A first probe that found a pot, or a sheet.
#[derive(Clone, Copy, Debug)]
pub struct FirstProbe {
    /// Pot that it found.
    pub pot: Pot,
    r: MicroOhm,
}

impl FirstProbe {
    /// The probe, if a sheet may have the R that it found.
    pub fn doubtful(summary: &HalfCycle, pot: Pot) -> Option<Self> {
        let is_pot = matches!(pot, Pot::Ferromagnetic | Pot::Small);
        let r = summary.crest.r;
        let (of_r, _) = of_prior(summary);
        (is_pot && of_r < 100 * SHEET_R_PERCENT).then_some(Self { pot, r })
    }

    /// Returns `true` if R at the second probe is that of a sheet.
    pub fn shows_sheet(&self, second: &HalfCycle) -> bool {
        100 * i64::from(second.crest.r.0) >= SHEET_R_LEFT_PERCENT * i64::from(self.r.0)
    }
}

/// R and L over the prior's, in 1e-4.
pub fn of_prior(summary: &HalfCycle) -> (i64, i64) {
    let (r, l) = PRIOR.interpolate(summary.f_sw_hz, summary.crest.i_ma);
    let share = |is: i32, of: i32| i64::from(is) * 10_000 / i64::from(of.max(1));
    (share(summary.crest.r.0, r.0), share(summary.crest.l.0, l.0))
}

/// Judges the pot by a half-cycle; `before` is the pot that was judged before. [`Pot::Unknown`] if current or mains is too
/// low.
pub fn classify(summary: &HalfCycle, before: Pot) -> Pot {
    if summary.f_sw_hz == 0 || !summary.has_coil_current() || summary.bus_peak_dv < BUS_MIN_DV {
        return Pot::Unknown;
    }
    let (r, l) = of_prior(summary);
    let (r, l) = (r / 100, l / 100);
    let full = if before == Pot::Small {
        FULL_AFTER_SMALL_R_PERCENT
    } else {
        FULL_R_PERCENT
    };
    let (small, both) = match before {
        Pot::Small | Pot::Ferromagnetic => (STILL_SMALL_R_PERCENT, STILL_POT_R_AND_L_PERCENT),
        Pot::Unknown | Pot::Absent | Pot::Unsuitable => (SMALL_R_PERCENT, POT_R_AND_L_PERCENT),
    };
    if r + l < both {
        Pot::Unsuitable
    } else if r >= full {
        Pot::Ferromagnetic
    } else if r >= PART_R_PERCENT || (l >= AIR_L_PERCENT && r >= small) {
        Pot::Small
    } else if l < AIR_L_PERCENT {
        Pot::Unsuitable
    } else {
        Pot::Absent
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::sampling::half_cycle::CurrentCrest;
    use ihd_shared::units::{MicroOhm, PicoHenry};

    /// Frequency in hertz, R in ohm, L in µH and crest current in ampere.
    pub type Load = (u32, f64, f64, f64);

    /// Half-cycle of a load at 230 V.
    pub fn half_cycle((f_sw_hz, r, l, i): Load) -> HalfCycle {
        HalfCycle {
            f_sw_hz,
            crest: CurrentCrest {
                r: MicroOhm((r * 1e6) as i32),
                l: PicoHenry((l * 1e6) as i32),
                i_ma: (i * 1e3) as u32,
                ..CurrentCrest::default()
            },
            bus_peak_dv: 3_253,
            ..HalfCycle::default()
        }
    }

    fn judged(load: Load, before: Pot) -> Pot {
        classify(&half_cycle(load), before)
    }

    /// R at 45 kHz, of which R ∝ √f follows.
    fn seen(f_sw_hz: u32, r: f64, l: f64, i: f64) -> Pot {
        let r = r * (f64::from(f_sw_hz) / 45e3).sqrt();
        judged((f_sw_hz, r, l, i), Pot::Unknown)
    }

    #[test]
    fn loads_of_the_design_are_distinguished() {
        for f in [36_000, 45_000, 60_000, 80_000] {
            assert_eq!(seen(f, 3.7, 24.0, 40.0), Pot::Ferromagnetic);
            assert_eq!(seen(f, 5.0, 30.0, 10.0), Pot::Ferromagnetic);
            assert_eq!(seen(f, 3.1, 19.6, 54.0), Pot::Ferromagnetic);
            assert_eq!(seen(f, 2.1, 36.0, 8.0), Pot::Small);
            assert_eq!(seen(f, 0.22, 17.0, 30.0), Pot::Unsuitable);
            assert_eq!(seen(f, 0.76, 18.0, 25.0), Pot::Unsuitable);
            assert_eq!(seen(f, 0.1, 55.0, 8.0), Pot::Absent);
            assert_eq!(seen(f, 0.1, 90.0, 5.0), Pot::Absent);
        }
    }

    /// R and L of discs by the field model at 77.4 and 34.0 kHz, the hob asked for 1,500 W (docs/control.md names the command).
    #[test]
    fn discs_below_8_cm_are_no_pots() {
        let refused = [
            (77_413, 0.906, 48.8, 10.8),
            (34_038, 0.475, 48.8, 41.1),
            (77_413, 1.601, 45.4, 11.6),
            (34_038, 0.794, 45.2, 46.2),
            (77_413, 1.605, 47.1, 11.1),
            (34_038, 0.773, 48.1, 41.6),
        ];
        let heated = [
            (77_413, 1.957, 43.2, 12.2),
            (34_038, 0.947, 42.9, 49.1),
            (77_413, 2.042, 45.3, 11.6),
            (34_038, 0.990, 46.6, 42.9),
            (77_413, 2.305, 40.4, 13.1),
        ];
        for before in [Pot::Unknown, Pot::Absent, Pot::Small, Pot::Ferromagnetic] {
            for disc in refused {
                assert_eq!(judged(disc, before), Pot::Absent, "{disc:?} {before:?}");
            }
            for disc in heated {
                assert_eq!(judged(disc, before), Pot::Small, "{disc:?} {before:?}");
            }
        }
        // At the border the one that is heated stays so, and the other is not begun.
        let border = (77_413, 1.75, 44.3, 12.0);
        assert_eq!(judged(border, Pot::Absent), Pot::Absent);
        assert_eq!(judged(border, Pot::Small), Pot::Small);
    }

    /// R and L by the field model at 79.9 kHz and the current of a probe at 230 V: household foil, lids of 304, and the pots nearest to
    /// them, sandwich bases of 15 and 12 cm.
    #[test]
    fn foil_and_lids_are_no_pots() {
        for sheet in [
            (79_911, 2.60, 16.7, 23.4),
            (79_911, 2.46, 13.6, 29.9),
            (79_911, 2.13, 11.6, 36.5),
            (79_911, 1.96, 19.9, 19.1),
            (79_911, 1.63, 11.9, 38.9),
        ] {
            for before in [Pot::Unknown, Pot::Absent, Pot::Unsuitable] {
                assert_eq!(judged(sheet, before), Pot::Unsuitable, "{sheet:?}");
            }
        }
        for (pot, size) in [
            ((79_911, 2.95, 22.9, 18.9), Pot::Ferromagnetic),
            ((79_911, 2.05, 28.4, 14.8), Pot::Small),
        ] {
            assert_eq!(judged(pot, Pot::Absent), size, "{pot:?}");
        }
    }

    /// R at 79.9 and 50 kHz by the field model, at 265 V.
    #[test]
    fn a_second_frequency_tells_a_small_sheet_from_a_small_pot() {
        let shows_sheet = |r_first: f64, l_uh: f64, r_second: f64| {
            let at = |f_sw_hz, r: f64| HalfCycle {
                f_sw_hz,
                crest: CurrentCrest {
                    r: MicroOhm((r * 1e6) as i32),
                    l: PicoHenry((l_uh * 1e6) as i32),
                    i_ma: 13_000,
                    ..CurrentCrest::default()
                },
                ..HalfCycle::default()
            };
            let first = FirstProbe::doubtful(&at(79_911, r_first), Pot::Small);
            first
                .expect("it may be one")
                .shows_sheet(&at(50_000, r_second))
        };
        // Foil of 8, 12, 14 cm, lids of 8 and 12 cm.
        for (first, l_uh, second) in [
            (2.08, 40.2, 1.69),
            (2.82, 27.7, 2.48),
            (2.94, 21.9, 2.65),
            (1.59, 39.3, 1.36),
            (2.04, 26.9, 1.83),
        ] {
            assert!(shows_sheet(first, l_uh, second), "{first}");
        }
        // Ferritic and cast iron of 8 cm, sandwich bases of 12 cm, and of 15 cm 60 mm off the centre.
        for (first, l_uh, second) in [
            (1.95, 43.2, 1.34),
            (2.04, 45.3, 1.35),
            (2.02, 29.9, 1.43),
            (2.25, 35.1, 1.63),
        ] {
            assert!(!shows_sheet(first, l_uh, second), "{first}");
        }
    }

    #[test]
    fn no_current_indicates_nothing() {
        assert_eq!(seen(45_000, 3.0, 20.0, 1.0), Pot::Unknown);
        assert_eq!(seen(0, 3.0, 20.0, 10.0), Pot::Unknown);
    }
}
