//! Significance of a change of the lookup: a board writes each pushed lookup to its flash, so that only a real change is worth it.

use ihd_map::CurrentCurve;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES, current_a};

/// Relative change of R or L from which a lookup is worth pushing: noise at an SNR of 30 dB stays below.
const MIN_CHANGE: f64 = 2e-2;

/// Lowest current at which a change counts, in ampere: below, noise causes changes and no power depends on them.
const FROM_A: f64 = 5.0;

/// Returns `true` if a curve differs from a lookup by more than noise.
pub fn curve_changed(curve: &CurrentCurve, active: &RlLookup) -> bool {
    let f_sw_hz = curve.f_sw_hz.round() as u32;
    curve.means().filter(|m| m.i_a >= FROM_A).any(|m| {
        let (r, l) = active.interpolate(f_sw_hz, (m.i_a * 1e3) as u32);
        let off = |ln: f64, known: f64| (ln - known.ln()).abs() > MIN_CHANGE;
        off(m.ln[0], r.ohm()) || off(m.ln[1], l.henry())
    })
}

/// Relative difference of R or L from which a lookup contradicts the windows: a lookup's own errors at currents and frequencies without
/// observation are up to 2.7 % (docs/map.md).
const MAX_DIFFERENCE: f64 = 5e-2;

/// Contradiction between a lookup and the windows of a device.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "at {:.1} kHz and {i_a:.0} A the hob shows {r_ohm:.3} Ω and {:.2} µH, the lookup says {lookup_r_ohm:.3} Ω and {:.2} µH",
    f_sw_hz * 1e-3, l_h * 1e6, lookup_l_h * 1e6
)]
pub struct Contradiction {
    f_sw_hz: f64,
    i_a: f64,
    r_ohm: f64,
    l_h: f64,
    lookup_r_ohm: f64,
    lookup_l_h: f64,
}

/// Returns the first place at which a lookup contradicts a curve.
pub fn contradiction(curve: &CurrentCurve, lookup: &RlLookup) -> Option<Contradiction> {
    let f_sw_hz = curve.f_sw_hz.round() as u32;
    let seen = curve.means().filter(|m| m.i_a >= FROM_A);
    let mut seen = seen.map(|m| {
        let (r, l) = lookup.interpolate(f_sw_hz, (m.i_a * 1e3) as u32);
        Contradiction {
            f_sw_hz: curve.f_sw_hz,
            i_a: m.i_a,
            r_ohm: m.ln[0].exp(),
            l_h: m.ln[1].exp(),
            lookup_r_ohm: r.ohm(),
            lookup_l_h: l.henry(),
        }
    });
    let off = |a: f64, b: f64| (a / b).ln().abs() > MAX_DIFFERENCE;
    seen.find(|c| off(c.lookup_r_ohm, c.r_ohm) || off(c.lookup_l_h, c.l_h))
}

/// Returns `true` if a known cell of the new lookup is unknown in the active one, which the device ignores there, or differs from it by
/// more than noise.
pub fn cells_changed(new: &RlLookup, active: &RlLookup) -> bool {
    let off = |a: u16, b: u16| (f64::from(a) / f64::from(b.max(1)) - 1.0).abs() > MIN_CHANGE;
    let mut cells = (0..FREQUENCIES).flat_map(|f| (0..CURRENTS).map(move |i| (f, i)));
    cells.any(|(f, i)| {
        let known = new.is_observed(f, i) && current_a(i) >= FROM_A;
        let differs = off(new.r[f][i], active.r[f][i]) || off(new.l[f][i], active.l[f][i]);
        known && (differs || !active.is_observed(f, i))
    })
}

#[cfg(test)]
mod tests {
    use ihd_map::MeasuredPoint;
    use ihd_shared::lookup::prior::prior;

    use super::*;

    #[test]
    fn a_change_counts_beyond_noise_and_from_a_current_on() {
        let active = prior();
        let like_the_prior = |factor: f64, counts: fn(f64) -> bool| {
            let points = (1..40).map(|k| {
                let i_a = f64::from(k);
                let (r, l) = active.interpolate(45_000, (i_a * 1e3) as u32);
                MeasuredPoint {
                    i_a,
                    r_ohm: r.ohm() * if counts(i_a) { factor } else { 1.0 },
                    l_h: l.henry(),
                    r_sigma_ohm: 0.01,
                    l_sigma_h: 1e-7,
                }
            });
            CurrentCurve::new(45e3, 0.0, points)
        };
        assert!(!curve_changed(&like_the_prior(1.0, |_| true), &active));
        assert!(!curve_changed(&like_the_prior(1.01, |_| true), &active));
        assert!(curve_changed(&like_the_prior(1.04, |i| i >= 30.0), &active));
        assert!(!curve_changed(&like_the_prior(1.04, |i| i < 4.0), &active));
        assert!(contradiction(&like_the_prior(1.04, |_| true), &active).is_none());
        let found = contradiction(&like_the_prior(1.06, |i| i >= 30.0), &active).unwrap();
        assert!(found.i_a > 28.0, "{found}");
    }

    #[test]
    fn only_what_the_new_one_knows_counts() {
        let active = prior();
        let mut new = active.clone();
        new.r[3][9] += new.r[3][9] / 20;
        assert!(!cells_changed(&new, &active));
        new.mark_observed(3, 9);
        assert!(cells_changed(&new, &active));
        assert!(!cells_changed(&new, &new));
    }

    #[test]
    fn a_cell_that_becomes_known_counts_and_one_that_is_forgotten_does_not() {
        let unknown = prior();
        let mut known = unknown.clone();
        known.mark_observed(3, 9);
        assert!(cells_changed(&known, &unknown));
        assert!(!cells_changed(&unknown, &known));
    }
}
