//! What was observed of the load, and the lookup that rests on it.

use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::grid::{CURRENTS, FREQUENCIES, frequency_coordinate, split};
use ihd_shared::lookup::plausible::{self, Implausible};
use ihd_shared::lookup::prior::prior;

use crate::lookup::curve::LoadPoint;
use crate::lookup::{Built, LoadCurve, LookupBuilder};

/// Relative difference below which two switching frequencies count as the same.
const SAME_FREQUENCY: f64 = 0.01;

/// Curves that the lookup rests on at one frequency.
const CURVES_PER_FREQUENCY: usize = 4;

/// Curves that are kept in all: more than a grid of eight frequencies can tell apart.
pub const MAX_CURVES: usize = 64;

/// Relative change of R or L against the active lookup from which a new one is worth pushing: what
/// noise of 30 dB alone does not reach, because a board keeps every lookup in its flash.
const WORTH_PUSHING: f64 = 2e-2;

/// Currents, in ampere, from which a change counts: below, noise makes it and no power depends on it.
const WORTH_PUSHING_FROM_A: f64 = 5.0;

/// Relative deviation of a lookup from the newest curve, R and L in the mean of the squares, from which the
/// older curves beside it are another load's, or the same one's when it was cooler. The grid's own
/// interpolation deviates by 0.3 %, noise of 30 dB by 0.3 %.
const CONTRADICTED: f64 = 1e-2;

/// Why no lookup rests on the newest curve.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotTeachable {
    /// The numbers are beyond a Cholesky factorisation.
    #[error("the lookup's least-squares problem is singular")]
    Singular,
    /// A device would refuse the lookup of the newest curve alone.
    #[error("{0}; a load this far from a full-size pot (a small or off-centre one?) is not taught")]
    Implausible(Implausible),
}

/// The load curves that the lookup rests on, in the order in which they came.
#[derive(Clone, Debug, Default)]
pub struct Observations {
    curves: Vec<LoadCurve>,
}

impl Observations {
    /// As kept before.
    pub fn from_curves(curves: Vec<LoadCurve>) -> Self {
        Self { curves }
    }

    /// The curves, the oldest first.
    pub fn curves(&self) -> &[LoadCurve] {
        &self.curves
    }

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
        if self.curves.len() > MAX_CURVES {
            self.curves.remove(0);
        }
    }

    /// The lookup of all curves that go with the newest one. Where a device would refuse it, or where it
    /// does not say what the newest curve says, the load has changed since the oldest ones: they are
    /// forgotten, one by one, until it passes.
    ///
    /// # Errors
    /// [`NotTeachable`] where it does not even pass with the newest curve alone; then that one is
    /// forgotten, and the others stay.
    pub fn build(&mut self, version: u32) -> Result<Built, NotTeachable> {
        let mut kept = self.curves.clone();
        loop {
            let built = lookup_of(&kept, version)?;
            let Some(stale) = stale(&kept, &built.lookup) else {
                self.curves = kept;
                return Ok(built);
            };
            match stale {
                Ok(oldest) => drop(kept.remove(oldest)),
                Err(why) => {
                    self.curves.pop();
                    return Err(NotTeachable::Implausible(why));
                }
            }
        }
    }
}

fn lookup_of(curves: &[LoadCurve], version: u32) -> Result<Built, NotTeachable> {
    // What stands on the coil now is described, so it starts from the built-in prior, whatever the
    // device's lookup was before.
    let mut builder = LookupBuilder::new(prior());
    for curve in curves {
        builder.observe(curve, 1.0);
    }
    builder.build(version).ok_or(NotTeachable::Singular)
}

/// The curve to forget next, `None` where all may stay; an error where only the newest is left.
fn stale(curves: &[LoadCurve], lookup: &RlLookup) -> Option<Result<usize, Implausible>> {
    let (newest, older) = curves.split_last()?;
    let beside = |row: usize| older.iter().position(|c| row_of(c).abs_diff(row) <= 1);
    // The device would refuse it for the same reason, with less to say.
    if let Err(why) = plausible::check(lookup) {
        let (Implausible::Range { cell }
        | Implausible::Slope { cell }
        | Implausible::NotMonotone { cell }) = why;
        let oldest = beside(usize::from(cell) / CURRENTS).or((!older.is_empty()).then_some(0));
        return Some(oldest.ok_or(why));
    }
    if deviation(newest, lookup) <= CONTRADICTED {
        return None;
    }
    // Alone, the newest is as well described as the grid can.
    beside(row_of(newest)).map(Ok)
}

/// The lower one of the two rows of the grid that a curve lies between.
fn row_of(curve: &LoadCurve) -> usize {
    split(
        frequency_coordinate(curve.f_sw_hz.round() as u32),
        FREQUENCIES,
    )
    .0
}

/// How far a lookup is from a curve, relative, where it matters.
fn deviation(curve: &LoadCurve, lookup: &RlLookup) -> f64 {
    let at = lookup.at_frequency(curve.f_sw_hz.round() as u32);
    let counts = |p: &&LoadPoint| p.i_a >= WORTH_PUSHING_FROM_A;
    let squares = curve.points.iter().filter(counts).map(|p| {
        let (r, l) = at.interpolate((p.i_a * 1e3) as u32);
        let (r, l) = (p.r_ohm / r.ohm() - 1.0, p.l_h / l.henry() - 1.0);
        f64::max(r * r, l * l)
    });
    let (sum, n) = squares.fold((0.0, 0.0), |(sum, n), x| (sum + x, n + 1.0));
    if n > 0.0 { f64::sqrt(sum / n) } else { 0.0 }
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
    use ihd_sim::behavioural::{BehaviouralLoad, PotKind};

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

    /// The curve of a pot whose R and L are so many times the reference pot's.
    fn pot(f_sw_hz: f64, r_times: f64, l_times: f64) -> LoadCurve {
        let load = BehaviouralLoad::new(PotKind::Ferromagnetic, f_sw_hz);
        let points = (0..400).map(|k| {
            let i_a = 45.0 * f64::from(k) / 399.0;
            let (r, l) = load.r_l(i_a);
            let (r_ohm, l_h) = (r * r_times, l * l_times);
            LoadPoint { i_a, r_ohm, l_h }
        });
        LoadCurve::from_half_cycle(f_sw_hz, points)
    }

    fn error_at(built: &Built, curve: &LoadCurve) -> f64 {
        deviation(curve, &built.lookup)
    }

    #[test]
    fn one_load_loses_no_curve() {
        let mut observations = Observations::default();
        for f_sw_hz in [45e3, 52e3, 60e3, 66e3, 45.1e3] {
            observations.remember(pot(f_sw_hz, 1.0, 1.0));
        }
        observations.build(1).unwrap();
        assert_eq!(observations.curves.len(), 5);
    }

    /// What ended `--follow`: curves of one pot, warm and cold, beside each other.
    #[test]
    fn older_curves_that_contradict_the_newest_are_forgotten() {
        let (cold, warm) = ((1.0, 1.0), (1.2, 0.9));
        let mut observations = Observations::default();
        for f_sw_hz in [48e3, 52e3, 56e3, 61e3] {
            observations.remember(pot(f_sw_hz, cold.0, cold.1));
        }
        let newest = pot(50e3, warm.0, warm.1);
        observations.remember(newest.clone());
        let all = lookup_of(&observations.curves, 1).unwrap();
        let bad = plausible::check(&all.lookup).is_err() || error_at(&all, &newest) > CONTRADICTED;
        assert!(bad, "the test's own point");
        let built = observations.build(1).unwrap();
        assert_eq!(plausible::check(&built.lookup), Ok(()));
        assert!(error_at(&built, &newest) <= CONTRADICTED);
        assert_eq!(observations.curves.last(), Some(&newest));
        assert!(observations.curves.len() < 5);
    }

    #[test]
    fn a_curve_that_no_device_takes_is_forgotten_and_the_others_stay() {
        let mut observations = Observations::default();
        let good = pot(45e3, 1.0, 1.0);
        observations.remember(good.clone());
        observations.build(1).unwrap();
        observations.remember(pot(60e3, 0.1, 0.2));
        let why = observations.build(2).unwrap_err();
        assert!(matches!(why, NotTeachable::Implausible(_)), "{why}");
        assert_eq!(observations.curves, [good]);
    }

    /// Twenty minutes of a pot that warms up (time constant 64 s, R +30 %, L −10 %) and cools again, the power
    /// changed every 45 s and noise of 0.3 % on every curve: nothing is refused, and the lookup is right where
    /// the hob works.
    #[test]
    fn a_pot_that_warms_and_cools_is_followed_for_twenty_minutes() {
        let mut observations = Observations::default();
        let mut offered: Option<RlLookup> = None;
        let (mut warmth, mut pushed, mut worst) = (0.0f64, 0, 0.0f64);
        let mut noise = 1u32;
        for k in 0..6_000u32 {
            let t_s = 0.2 * f64::from(k);
            let powers = [(52e3, 1.5), (47e3, 2.0), (58e3, 1.0), (64e3, 0.7)];
            let (f_sw_hz, kilowatt) = powers[(t_s / 45.0) as usize % powers.len()];
            warmth += (kilowatt / 2.0 - warmth) * 0.2 / 64.0;
            let truth = pot(f_sw_hz, 1.0 + 0.3 * warmth, 1.0 - 0.1 * warmth);
            let mut measured = truth.clone();
            for p in &mut measured.points {
                noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                p.r_ohm *= 1.0 + 6e-3 * (f64::from(noise >> 8) / f64::from(1 << 24) - 0.5);
            }
            let differs = offered.as_ref().is_none_or(|l| is_news(&measured, l));
            observations.remember(measured);
            if differs {
                pushed += 1;
                let built = observations.build(pushed).expect("nothing is refused");
                offered = Some(built.lookup);
            }
            let active = offered.as_ref().expect("the first is news");
            worst = worst.max(deviation(&truth, active));
        }
        println!("{pushed} lookups, {:.2} % at most", 100.0 * worst);
        assert!(worst < WORTH_PUSHING, "{worst}");
        assert!((5..600).contains(&pushed), "{pushed}");
    }

    #[test]
    fn no_more_curves_than_the_limit() {
        let mut observations = Observations::default();
        for k in 0..200 {
            observations.remember(curve(30e3 * 1.011f64.powi(k), 3.0));
        }
        assert_eq!(observations.curves.len(), MAX_CURVES);
        assert!(observations.curves[0].f_sw_hz > 30e3 * 1.011f64.powi(135));
    }
}
