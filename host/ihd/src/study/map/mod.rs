//! The map under judgement: pots are shown to whoever builds the lookup at a few powers, and every cell that the hob reaches
//! is compared with the truth, of which the builder knows nothing.

pub mod figure;
pub mod places;
pub mod table;
pub mod teach;

use std::sync::atomic::{AtomicUsize, Ordering};

use ihd_signal::truth::MapTruth;
use ihd_sim::inverter::InverterError;
use ihd_sim::perturbation::Perturbation;
use ihd_sim::recording::settings::LoadKind;
use ihd_train::lookup::{Built, JudgedCell, MapError, judged};
use serde::Serialize;

use self::places::Placed;
use super::parallel::{WorkerLost, in_parallel};

/// What to run.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Pots in their places.
    pub pots: Vec<Placed>,
    /// Powers in watt at which they are shown.
    pub powers_w: Vec<u16>,
    /// Load model.
    pub load: LoadKind,
    /// Departures from the standard model; `None` is that.
    pub perturbations: Vec<Option<Perturbation>>,
    /// Seeds of the noise; at least one.
    pub seeds: u64,
    /// Noise as a signal-to-noise ratio in decibel at the rated power, as `--snr` has it.
    pub snr_db: f64,
    /// Whether the simulated hob is asked, with its firmware, link and gate, instead of windows made from the truth.
    pub closed_loop: bool,
}

/// A point at which a pot was shown.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Shown {
    /// Power asked for, in watt.
    pub asked_w: u16,
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Crest of the current's fundamental in ampere.
    pub crest_a: f64,
}

/// A lookup under judgement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// Why there is none, or why no device would take it.
    pub refused: Option<String>,
    /// Its errors, where there is one.
    pub error: Option<MapError>,
    /// Every reached cell.
    pub cells: Vec<JudgedCell>,
}

/// One pot, one departure, one seed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Run {
    /// The pot and where it stands.
    pub pot: String,
    /// What of its model is not the standard one's.
    pub perturbation: Option<Perturbation>,
    /// Seed of the noise.
    pub seed: u64,
    /// Cells that the hob reaches.
    pub reached: usize,
    /// Where it was shown.
    pub shown: Vec<Shown>,
    /// What the map makes of the windows' curves; `None` in the closed loop.
    pub map: Option<Verdict>,
    /// What the closed loop's learning makes of it; `None` without it.
    pub learned: Option<Verdict>,
}

/// Why the study could not be made.
#[derive(Debug, thiserror::Error)]
pub enum MapStudyError {
    /// The simulator refused a pot.
    #[error("{pot}: {source}")]
    Simulation {
        /// Which.
        pot: String,
        /// Why.
        source: InverterError,
    },
    /// A worker ended without its results.
    #[error(transparent)]
    Workers(#[from] WorkerLost),
}

impl Verdict {
    fn refused(why: String) -> Self {
        Self {
            refused: Some(why),
            error: None,
            cells: Vec::new(),
        }
    }

    fn of(built: &Built, truth: &MapTruth) -> Self {
        let cells = judged(built, truth);
        Self {
            refused: None,
            error: Some(MapError::of(&cells)),
            cells,
        }
    }
}

/// Runs the plan on all cores; the result does not depend on how many there are. `progress` hears finished pots and
/// their number. Runs come pot by pot, departure by departure, seed by seed.
///
/// # Errors
/// [`MapStudyError`].
pub fn study(
    plan: &Plan,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<Run>, MapStudyError> {
    let jobs: Vec<(&Placed, Option<Perturbation>)> = plan
        .pots
        .iter()
        .flat_map(|pot| plan.perturbations.iter().map(move |p| (pot, *p)))
        .collect();
    let done = AtomicUsize::new(0);
    let results = in_parallel(&jobs, |(pot, perturbation)| {
        let runs = teach::runs(plan, pot, *perturbation);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, jobs.len());
        runs
    })?;
    let mut runs = Vec::new();
    for ((pot, _), result) in jobs.iter().zip(results) {
        runs.extend(result.map_err(|source| MapStudyError::Simulation {
            pot: pot.name.clone(),
            source,
        })?);
    }
    Ok(runs)
}
