//! Study of the estimation of a pot's temperature: cooking from tables of the field, with pots, alloys and bias unknown to the
//! estimator; and of false reports of a boil.

pub mod closed_loop;
pub mod figure;
mod kitchen;
pub mod table;

use std::sync::atomic::{AtomicUsize, Ordering};

use ihd_sim::contents::PotContents;
use ihd_sim::cooking::PotDeviation;
use ihd_sim::inverter::InverterError;
use ihd_sim::pot::{PotBase, SimulatedPot};
use serde::Serialize;

use super::parallel::in_parallel;
pub use kitchen::{Sample, cook};

/// Pots of the study: metal, diameter in metre, and the largest power, in watt.
const POTS: [(PotBase, f64, f64); 4] = [
    (PotBase::Ferritic, 0.15, 1200.0),
    (PotBase::Ferritic, 0.18, 1800.0),
    (PotBase::Ferritic, 0.21, 2200.0),
    (PotBase::CastIron, 0.21, 2200.0),
];

/// Range of a pot's lift when it is put on or moved, in metre.
const LIFT_M: f64 = 1e-3;

/// Kind of cooking.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CookingKind {
    /// Water at one power, until it has boiled for some minutes.
    Boil,
    /// Water at a power that the cook changes once.
    BoilInSteps,
    /// Oil held at 160 °C by switching off and on.
    OilSwitched,
    /// Oil held at 160 °C by less power.
    OilHeld,
    /// An empty pot held at 150 °C by less power.
    EmptyHeld,
    /// Food that comes to rest at one power.
    FoodToRest,
    /// Water that simmers below its boiling point.
    Simmer,
    /// Water with a power that changes every 20 s, moved once, taken off before it boils.
    Restless,
}

impl CookingKind {
    /// Kinds that boil.
    pub const BOILS: [Self; 2] = [Self::Boil, Self::BoilInSteps];

    /// Kinds that never boil.
    pub const QUIET: [Self; 6] = [
        Self::OilSwitched,
        Self::OilHeld,
        Self::EmptyHeld,
        Self::FoodToRest,
        Self::Simmer,
        Self::Restless,
    ];

    /// Name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Boil => "water",
            Self::BoilInSteps => "water, power changed",
            Self::OilSwitched => "oil, switched at 160 °C",
            Self::OilHeld => "oil, held near 160 °C",
            Self::EmptyHeld => "empty pot, held near 150 °C",
            Self::FoodToRest => "food, comes to rest",
            Self::Simmer => "water, simmers",
            Self::Restless => "water, power every 20 s, moved",
        }
    }
}

/// Plan of the study.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TemperaturePlan {
    /// Number of runs that boil, and as many that do not.
    pub runs: u64,
    /// First seed.
    pub seed: u64,
    /// Largest deviation of an alloy's heat coefficients from those of its class, as a share.
    pub alloy: f64,
    /// Boils of water in the same pot before each run.
    pub lessons: u64,
}

/// Specification of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CookingJob {
    /// Seed of the hob, the pot and the cook.
    pub seed: u64,
    /// Seed of the noise.
    pub noise_seed: u64,
    /// Kind.
    pub kind: CookingKind,
    /// Pot with its lift and its temperature.
    pub pot: SimulatedPot,
    /// Contents of the pot.
    pub contents: PotContents,
    /// Deviation of the pot from the physical prediction.
    pub deviation: PotDeviation,
    /// Power in watt.
    pub power_w: f64,
    /// Length in seconds.
    pub duration_s: f64,
    /// Boils of water in the same pot before.
    pub lessons: u64,
    /// Time of its move in seconds, and the new lift in metre; `None` if it is not moved.
    pub moved: Option<(f64, f64)>,
}

/// Result of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TemperatureRun {
    /// Seed.
    pub seed: u64,
    /// Kind.
    pub kind: CookingKind,
    /// Name of the pot.
    pub pot: String,
    /// Contents of the pot.
    pub contents: String,
    /// Power in watt.
    pub power_w: f64,
    /// Σ of ΔT's squared errors in K², one a second, with the base at 150 °C at most.
    pub squares_k2: f64,
    /// Number of these errors.
    #[serde(rename = "looks")]
    pub readings: u32,
    /// Σ of squared errors over the stated variance.
    pub z_squares: f64,
    /// Largest error in K.
    pub worst_k: f64,
    /// True time at which bubbles carried half of the heat, in seconds.
    pub bubbles_s: Option<f64>,
    /// Time at which bubbles were reported, in seconds.
    #[serde(rename = "bubbles_said_s")]
    pub bubbles_reported_s: Option<f64>,
    /// True time at which all of the water boiled, in seconds.
    pub boils_s: Option<f64>,
    /// Time at which the boil was reported, in seconds.
    #[serde(rename = "boils_said_s")]
    pub boils_reported_s: Option<f64>,
    /// Distance of the pot's move in mm; 0 without a move.
    pub moved_mm: f64,
    /// Number of moves reported within 3 s.
    #[serde(rename = "moves_told")]
    pub moves_reported: u32,
    /// Number of reported moves that did not happen.
    pub moves_wrong: u32,
    /// Lowest true temperature of the base in °C at which overheating was reported.
    #[serde(rename = "overheats_said_c")]
    pub overheat_reported_c: Option<f64>,
}

/// Seed of its own for a purpose, the same on every machine.
fn derived_seed(seed: u64, purpose: u64) -> u64 {
    let mut x = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ purpose.wrapping_add(1).wrapping_mul(0xD1B5_4A32_D192_ED03);
    for _ in 0..3 {
        x ^= x >> 30;
        x = x.wrapping_mul(0xBF58_476D_1CE4_E5B9);
        x ^= x >> 27;
    }
    x
}

/// Number from 0 to 1 for a seed and a purpose.
fn share(seed: u64, purpose: u64) -> f64 {
    (derived_seed(seed, purpose) >> 11) as f64 / (1u64 << 53) as f64
}

impl TemperaturePlan {
    /// Runs of the plan.
    pub fn jobs(&self) -> Vec<CookingJob> {
        let of = |kinds: &'static [CookingKind], offset: u64| {
            (0..self.runs).map(move |k| {
                let kind = kinds[(k % kinds.len() as u64) as usize];
                self.job(self.seed + offset + k, kind)
            })
        };
        of(&CookingKind::BOILS, 0)
            .chain(of(&CookingKind::QUIET, 1_000_000))
            .collect()
    }

    fn job(&self, seed: u64, kind: CookingKind) -> CookingJob {
        let u = |purpose| share(seed, purpose);
        let around = |purpose, most: f64| most * (2.0 * u(purpose) - 1.0);
        let (metal, diameter_m, most_w) = POTS[(u(0) * POTS.len() as f64) as usize];
        let most_w = if CookingKind::BOILS.contains(&kind) {
            most_w
        } else {
            1400f64.min(most_w)
        };
        let power_w = 800.0 + (most_w - 800.0) * u(1);
        let litre = 0.5 + 2.5 * u(2);
        let contents = match kind {
            CookingKind::OilSwitched | CookingKind::OilHeld => PotContents::Oil(0.3 + u(2)),
            CookingKind::EmptyHeld => PotContents::Empty,
            CookingKind::FoodToRest => PotContents::Food,
            CookingKind::Simmer | CookingKind::Restless => PotContents::Water(1.0 + 0.8 * litre),
            CookingKind::Boil | CookingKind::BoilInSteps => PotContents::Water(litre),
        };
        let duration_s = match kind {
            CookingKind::Boil => boil_s(litre, power_w),
            // At the least power.
            CookingKind::BoilInSteps => litre * 4186.0 * 80.0 / power_w * 2.2 + 120.0,
            CookingKind::FoodToRest => 600.0,
            CookingKind::Restless => 250.0,
            _ => 900.0,
        };
        let moves = matches!(kind, CookingKind::Restless) || u(3) < 0.5;
        CookingJob {
            seed,
            noise_seed: derived_seed(seed, 14),
            kind,
            pot: SimulatedPot {
                lift_m: LIFT_M * u(4),
                temperature_c: 20.0 + around(5, 5.0),
                ..SimulatedPot::new(metal, diameter_m)
            },
            contents,
            deviation: PotDeviation {
                scale: (around(6, 0.02), around(7, 0.01)),
                slope: (around(8, 0.02), around(9, 0.01)),
                alloy: around(10, self.alloy),
                bow_m: around(11, 0.1e-3),
            },
            power_w,
            duration_s,
            lessons: self.lessons,
            moved: moves.then(|| (30.0 + (duration_s - 60.0) * u(12), LIFT_M * u(13))),
        }
    }
}

impl CookingJob {
    /// Boil of water in the same pot, put on anew: another lift, temperature, power, amount of water and noise.
    fn lesson(&self, number: u64) -> Self {
        let own = 100 * (number + 1);
        let u = |purpose| share(self.seed, own + purpose);
        let (litre, power_w) = (0.5 + 0.7 * u(0), self.power_w.max(1200.0));
        Self {
            noise_seed: derived_seed(self.seed, own + 3),
            kind: CookingKind::Boil,
            pot: SimulatedPot {
                lift_m: LIFT_M * u(1),
                temperature_c: 15.0 + 10.0 * u(2),
                ..self.pot
            },
            contents: PotContents::Water(litre),
            power_w,
            duration_s: boil_s(litre, power_w),
            moved: None,
            ..*self
        }
    }
}

/// Time in seconds for heating water at a power, and some minutes of boiling.
fn boil_s(litre: f64, power_w: f64) -> f64 {
    litre * 4186.0 * 80.0 / power_w * 1.6 + 120.0
}

/// Runs the plan on all cores. `progress` is called with the numbers of finished and of all runs.
///
/// # Errors
/// If there is no model of a pot.
pub fn study(
    plan: &TemperaturePlan,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<TemperatureRun>, InverterError> {
    let jobs = plan.jobs();
    let done = AtomicUsize::new(0);
    let runs = in_parallel(&jobs, |job| {
        let run = cook(job, |_| ());
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, jobs.len());
        run
    });
    runs.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_lesson_and_the_judged_run_have_noise_of_their_own_on_one_hob() {
        let plan = TemperaturePlan {
            runs: 4,
            seed: 1,
            alloy: 0.2,
            lessons: 3,
        };
        let jobs = plan.jobs();
        let all: Vec<CookingJob> = jobs
            .iter()
            .flat_map(|job| (0..job.lessons).map(move |k| job.lesson(k)).chain([*job]))
            .collect();
        let noises: BTreeSet<u64> = all.iter().map(|job| job.noise_seed).collect();
        let hobs: BTreeSet<u64> = all.iter().map(|job| job.seed).collect();
        assert_eq!((noises.len(), hobs.len()), (all.len(), jobs.len()));
    }
}
