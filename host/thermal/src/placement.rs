//! Identification of the pot that was put on: [`PotModel`] from the first operating points of heating.

use ihd_map::PotModel;
use ihd_shared::hob::F_SW_MAX_HZ;

use crate::batch::ThermalHalfCycle;
use crate::least_squares::{Prior, fit};
use crate::metal::MetalLaw;

/// Most operating points that are kept.
const MAX_POINTS: usize = 40;

/// Relative change of frequency or current that begins another point.
const MIN_POINT_CHANGE: f64 = 0.04;

/// Relative errors of the device's R and L at one half-cycle, noise and bias: docs/accuracy.md has .5 and .3 % in the
/// middle of a settled half-cycle; after a frequency step they are larger.
const SIGMA: (f64, f64) = (0.01, 0.006);

/// χ² by which the other class of metals must be worse for this one to be certain: 3 σ.
const CLASS_CHI2: f64 = 9.0;

/// Largest χ² per datum of a class that is certain. The errors that are assumed are larger than those of a pot of the class.
const MAX_MISFIT: f64 = 1.0;

/// Prior deviations of ln α and ln s within a class. Steels and irons have from 0.1 to 0.7 µΩm, in which s is a square root.
const ALLOYS: (f64, f64) = (0.2, 0.5);

/// Least frequency over the highest one at which heating has just begun.
const RAMP_START: f64 = 0.9;

/// Most steps of the fit.
const STEPS: usize = 30;

/// Resistance of winding and leads of the hob's coil in ohm, and its standard deviation.
const WINDING_OHM: (f64, f64) = (0.1, 0.02);

/// Mean of half-cycles at one operating point.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Point {
    f_hz: f64,
    i_a: f64,
    ln_r: f64,
    ln_l: f64,
    /// Number of half-cycles in the mean.
    weight: f64,
}

/// Collects operating points of a pot that was just put on.
#[derive(Clone, Debug, Default)]
pub struct Placement {
    points: Vec<Point>,
    /// Frequency of the first half-cycle that heats, in hertz.
    first_hz: Option<f64>,
}

/// Identified pot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedPot {
    /// Physics of the pot.
    pub pot: PotModel,
    /// Class of its metal.
    pub metal: MetalLaw,
    /// Set if it was heated before the first half-cycle: heating begins at the highest frequency.
    pub is_heated_already: bool,
    /// Excess of χ² of the other class over that of this one.
    pub margin: f64,
    /// χ² over the number of data: above some 1 no metal of this class explains R and L.
    pub misfit: f64,
}

impl PlacedPot {
    /// Returns `true` if the class of its metal is certain: this one explains R and L, and the other one does not.
    pub fn is_sure(&self) -> bool {
        self.margin > CLASS_CHI2 && self.misfit < MAX_MISFIT
    }
}

impl Placement {
    /// Adds a half-cycle that heats.
    pub fn push(&mut self, h: &ThermalHalfCycle) {
        if !h.shows_load() {
            return;
        }
        self.first_hz.get_or_insert(h.f_hz);
        let near = |p: &&mut Point| {
            (h.f_hz / p.f_hz - 1.0).abs() < MIN_POINT_CHANGE
                && (h.i_a / p.i_a - 1.0).abs() < MIN_POINT_CHANGE
        };
        let (ln_r, ln_l) = (h.r_ohm.ln(), h.l_h.ln());
        if let Some(p) = self.points.iter_mut().find(near) {
            // In the mean over all half-cycles noise falls, bias does not.
            p.weight += 1.0;
            for (mean, x) in [
                (&mut p.f_hz, h.f_hz),
                (&mut p.i_a, h.i_a),
                (&mut p.ln_r, ln_r),
                (&mut p.ln_l, ln_l),
            ] {
                *mean += (x - *mean) / p.weight;
            }
        } else if self.points.len() < MAX_POINTS {
            self.points.push(Point {
                f_hz: h.f_hz,
                i_a: h.i_a,
                ln_r,
                ln_l,
                weight: 1.0,
            });
        }
    }

    /// Fits the pot that explains the points best; `None` if there are none.
    pub fn place(&self) -> Option<PlacedPot> {
        if self.points.is_empty() {
            return None;
        }
        let mut fits = MetalLaw::ALL.map(|metal| {
            let fitted = self.fit(&metal);
            (metal, fitted)
        });
        fits.sort_by(|a, b| a.1.1.total_cmp(&b.1.1));
        let [(metal, (pot, chi2)), (_, (_, other))] = fits;
        chi2.is_finite().then_some(PlacedPot {
            pot,
            metal,
            is_heated_already: self
                .first_hz
                .is_some_and(|f_hz| f_hz < RAMP_START * f64::from(F_SW_MAX_HZ)),
            margin: other - chi2,
            misfit: chi2 / (2 * self.points.len()) as f64,
        })
    }

    fn fit(&self, metal: &MetalLaw) -> (PotModel, f64) {
        let prior = |mean, sigma| Prior { mean, sigma };
        let priors = [
            prior(metal.ln_alpha, ALLOYS.0),
            prior(metal.ln_s, ALLOYS.1),
            prior(0.09, 0.02),
            // Lift by a base that is not flat, or by feet of a pot.
            prior(0.5e-3, 0.7e-3),
            prior(WINDING_OHM.0, WINDING_OHM.1),
        ];
        let start = priors.map(|p| p.mean);
        let pot = |x: &[f64; 5]| PotModel {
            ln_alpha: x[0],
            ln_s: x[1],
            radius_m: x[2],
            lift_m: x[3],
            winding_r_ohm: x[4],
            ..PotModel::PAPER
        };
        let fitted = fit(&priors, start, STEPS, |x, out| {
            let model = pot(x);
            for p in &self.points {
                let z = model.impedance(p.f_hz, p.i_a);
                // The mean of many half-cycles at one point keeps their bias.
                let shrink = (1.0 / p.weight).sqrt().max(0.3);
                out.push((p.ln_r - z.r_ohm.ln()) / (SIGMA.0 * shrink));
                out.push((p.ln_l - z.l_h.ln()) / (SIGMA.1 * shrink));
            }
        });
        (pot(&fitted.x), fitted.chi2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pot identified from one operating point, as if heating had begun before.
    fn placed(ln_alpha: f64, ln_s: f64) -> PlacedPot {
        let pot = PotModel {
            ln_alpha,
            ln_s,
            radius_m: 0.09,
            winding_r_ohm: 0.1,
            ..PotModel::PAPER
        };
        let mut placement = Placement::default();
        for _ in 0..50 {
            let z = pot.impedance(45e3, 40.0);
            placement.push(&ThermalHalfCycle {
                t_s: 0.0,
                f_hz: 45e3,
                i_a: 40.0,
                r_ohm: z.r_ohm,
                l_h: z.l_h,
                power_w: 1500.0,
                heats: true,
            });
        }
        placement.place().unwrap()
    }

    #[test]
    fn the_class_is_known_where_the_metal_is_of_one_and_not_between() {
        for law in MetalLaw::ALL {
            let found = placed(law.ln_alpha, law.ln_s);
            println!("{found:?}");
            assert_eq!(found.metal, law);
            assert!((found.pot.radius_m - 0.09).abs() < 0.01, "{found:?}");
        }
        let [a, b] = MetalLaw::ALL;
        let sure = placed(a.ln_alpha, a.ln_s).margin;
        let between = placed(0.5 * (a.ln_alpha + b.ln_alpha), 0.5 * (a.ln_s + b.ln_s)).margin;
        println!("{sure} {between}");
        assert!(between < 0.5 * sure && between < 9.0, "{between} {sure}");
    }

    /// Pot identified from the ramp at which heating begins, with R multiplied by a power of the frequency.
    fn placed_by_ramp(law: &MetalLaw, resistivity: f64, r_exponent: f64) -> PlacedPot {
        let pot = PotModel {
            ln_alpha: law.ln_alpha,
            // s ∝ √ρ.
            ln_s: law.ln_s + 0.5 * resistivity.ln(),
            radius_m: 0.09,
            winding_r_ohm: 0.1,
            ..PotModel::PAPER
        };
        let mut placement = Placement::default();
        for k in 0..10 {
            let (f_hz, i_a) = (80e3 - 3.7e3 * f64::from(k), 12.0 + 3.0 * f64::from(k));
            let z = pot.impedance(f_hz, i_a);
            placement.push(&ThermalHalfCycle {
                t_s: 0.01 * f64::from(k),
                f_hz,
                i_a,
                r_ohm: z.r_ohm * (f_hz / 60e3).powf(r_exponent),
                l_h: z.l_h,
                power_w: 1500.0,
                heats: true,
            });
        }
        placement.place().unwrap()
    }

    #[test]
    fn the_class_does_not_depend_on_the_resistivity_and_is_unsure_where_neither_fits() {
        // 0.1 to 0.7 µΩm: the paper's ferritic metal has 0.125, 1.4016 has 0.60, cast iron 0.7.
        for (law, of_class) in [(MetalLaw::FERRITIC, 0.125), (MetalLaw::CAST_IRON, 0.7)] {
            for resistivity in [0.1, 0.2, 0.6, 0.7] {
                let found = placed_by_ramp(&law, resistivity / of_class, 0.0);
                assert_eq!(found.metal, law, "{resistivity} µΩm");
                assert!(found.is_sure() && !found.is_heated_already, "{found:?}");
            }
            let odd = placed_by_ramp(&law, 1.0, 0.7);
            println!("{odd:?}");
            assert!(!odd.is_sure(), "{odd:?}");
        }
    }
}
