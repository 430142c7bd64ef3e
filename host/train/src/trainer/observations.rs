//! What a run has observed of the load, and the lookup that rests on it.

use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::plausible;
use ihd_shared::lookup::prior::prior;

use super::TrainerError;
use crate::lookup::curve::LoadPoint;
use crate::lookup::{Built, LoadCurve, LookupBuilder};

/// Relative difference below which two switching frequencies count as the same.
const SAME_FREQUENCY: f64 = 0.01;

/// Curves that the lookup rests on at one frequency.
const CURVES_PER_FREQUENCY: usize = 4;

/// Relative change of R or L against the active lookup from which a new one is worth pushing: what
/// noise of 30 dB alone does not reach, because a board keeps every lookup in its flash.
const WORTH_PUSHING: f64 = 2e-2;

/// Currents, in ampere, from which a change counts: below, noise makes it and no power depends on it.
const WORTH_PUSHING_FROM_A: f64 = 5.0;

/// The load curves that the lookup rests on.
#[derive(Debug, Default)]
pub struct Observations {
    curves: Vec<LoadCurve>,
}

impl Observations {
    /// Keeps the last few curves of each frequency: enough to average noise, few enough to follow a
    /// load that changes, while what was seen at other frequencies stays.
    pub fn remember(&mut self, curve: LoadCurve) {
        let f_sw_hz = curve.f_sw_hz;
        let alike = |c: &LoadCurve| (c.f_sw_hz / f_sw_hz - 1.0).abs() < SAME_FREQUENCY;
        self.curves.push(curve);
        if self.curves.iter().filter(|c| alike(c)).count() > CURVES_PER_FREQUENCY
            && let Some(oldest) = self.curves.iter().position(alike)
        {
            self.curves.remove(oldest);
        }
    }

    /// The lookup of all curves.
    ///
    /// # Errors
    /// [`TrainerError::Lookup`] for one that a device would refuse.
    pub fn build(&self, version: u32) -> Result<Built, TrainerError> {
        // A run describes the pot that stands on the coil now, so it starts from the built-in
        // prior, whatever the device's lookup was before.
        let mut builder = LookupBuilder::new(prior());
        for curve in &self.curves {
            builder.observe(curve, 1.0);
        }
        let built = builder
            .build(version)
            .ok_or_else(|| TrainerError::Lookup("its least-squares problem is singular".into()))?;
        // The device would refuse it for the same reason, with less to say.
        plausible::check(&built.lookup).map_err(|why| {
            TrainerError::Lookup(format!(
                "{why}; a load this far from a full-size pot (a small or off-centre one?) is not \
                 taught"
            ))
        })?;
        Ok(built)
    }
}

/// Whether a curve differs from the active lookup by more than noise makes.
pub fn is_news(curve: &LoadCurve, active: &RlLookup) -> bool {
    let f_sw_hz = curve.f_sw_hz as u32;
    let differs = |p: &&LoadPoint| {
        let (r, l) = active.interpolate(f_sw_hz, (p.i_a * 1e3) as u32);
        (p.r_ohm / r.ohm() - 1.0).abs() > WORTH_PUSHING
            || (p.l_h / l.henry() - 1.0).abs() > WORTH_PUSHING
    };
    let mut points = curve.points.iter();
    points.any(|p| p.i_a >= WORTH_PUSHING_FROM_A && differs(&p))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(f_sw_hz: f64, r_ohm: f64) -> LoadCurve {
        let point = |k: u32| LoadPoint {
            i_a: f64::from(k),
            r_ohm,
            l_h: 22e-6,
        };
        LoadCurve {
            f_sw_hz,
            points: (1..40).map(point).collect(),
        }
    }

    #[test]
    fn the_last_curves_of_each_frequency_are_kept() {
        let mut observations = Observations::default();
        for k in 0..6 {
            observations.remember(curve(45e3 + f64::from(k), f64::from(k)));
            observations.remember(curve(60e3, 9.0));
        }
        let of = |f: f64| {
            let alike = move |c: &&LoadCurve| (c.f_sw_hz - f).abs() < 100.0;
            observations.curves.iter().filter(alike)
        };
        assert_eq!((of(45e3).count(), of(60e3).count()), (4, 4));
        let oldest = of(45e3).next().expect("four curves");
        assert_eq!(oldest.points[0].r_ohm, 2.0);
    }

    #[test]
    fn a_change_counts_beyond_noise_and_from_a_current_on() {
        let active = prior();
        let like_the_prior = |factor: f64, from_a: f64| {
            let points = (1..40).map(|k| {
                let i_a = f64::from(k);
                let (r, l) = active.interpolate(45_000, (i_a * 1e3) as u32);
                let factor = if i_a < from_a { 1.0 } else { factor };
                LoadPoint {
                    i_a,
                    r_ohm: r.ohm() * factor,
                    l_h: l.henry(),
                }
            });
            LoadCurve {
                f_sw_hz: 45e3,
                points: points.collect(),
            }
        };
        assert!(!is_news(&like_the_prior(1.0, 0.0), &active));
        assert!(!is_news(&like_the_prior(1.01, 0.0), &active));
        assert!(is_news(&like_the_prior(1.04, 30.0), &active));
        let mut low = like_the_prior(1.04, 0.0);
        low.points.retain(|p| p.i_a < WORTH_PUSHING_FROM_A);
        assert!(!is_news(&low, &active));
    }
}
