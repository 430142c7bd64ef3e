//! Study of the map's accuracy. A builder gets windows of pots at a few powers. Every cell of its lookup that the hob reaches is
//! compared with the truth, which the builder does not know.

pub mod figure;
pub mod places;
pub mod table;
pub mod teach;

use std::sync::atomic::{AtomicUsize, Ordering};

use ihd_signal::truth::MapTruth;
use ihd_sim::inverter::InverterError;
use ihd_sim::perturbation::Perturbation;
use ihd_sim::recording::settings::LoadKind;
use ihd_train::lookup::{BuiltLookup, JudgedCell, LookupAccuracy, judge_cells};
use serde::Serialize;

use self::places::PotPlacement;
use super::parallel::in_parallel;

/// Plan of the study.
#[derive(Clone, Debug, PartialEq)]
pub struct MapPlan {
    /// Pots in their places.
    pub pots: Vec<PotPlacement>,
    /// Powers of the windows, in watt.
    pub powers_w: Vec<u16>,
    /// Load model.
    pub load: LoadKind,
    /// Departures from the standard model; `None` for the standard one.
    pub perturbations: Vec<Option<Perturbation>>,
    /// Seeds of the noise; at least one.
    pub seeds: u64,
    /// Noise as a signal-to-noise ratio in decibel at the rated power, as with `--snr`.
    pub snr_db: f64,
    /// `true` to use the simulated hob, with its firmware, link and gate, instead of windows made from the truth.
    pub closed_loop: bool,
}

/// Operating point of a window.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MapOperatingPoint {
    /// Requested power, in watt.
    pub asked_w: u16,
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Crest of the current's fundamental in ampere.
    pub crest_a: f64,
}

/// Judgement of a lookup.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LookupJudgement {
    /// Reason why there is none, or why no device would accept it.
    pub refused: Option<String>,
    /// Errors; `None` if there is no lookup.
    pub error: Option<LookupAccuracy>,
    /// All reached cells.
    pub cells: Vec<JudgedCell>,
}

/// One pot, one departure, one seed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapRun {
    /// Name of the pot and its place.
    pub pot: String,
    /// Departure from the standard model.
    pub perturbation: Option<Perturbation>,
    /// Seed of the noise.
    pub seed: u64,
    /// Number of cells that the hob reaches.
    pub reached: usize,
    /// Operating points of the windows.
    pub shown: Vec<MapOperatingPoint>,
    /// Judgement of the map made of the windows' curves; `None` in the closed loop.
    pub map: Option<LookupJudgement>,
    /// Judgement of the closed loop's lookup; `None` without it.
    pub learned: Option<LookupJudgement>,
}

/// Error of the simulator for a pot.
#[derive(Debug, thiserror::Error)]
#[error("{pot}: {source}")]
pub struct MapStudyError {
    /// Name of the pot.
    pot: String,
    /// Error.
    source: InverterError,
}

impl LookupJudgement {
    fn refused(why: String) -> Self {
        Self {
            refused: Some(why),
            error: None,
            cells: Vec::new(),
        }
    }

    fn judge(built: &BuiltLookup, truth: &MapTruth) -> Self {
        let cells = judge_cells(built, truth);
        Self {
            refused: None,
            error: Some(LookupAccuracy::from_cells(&cells)),
            cells,
        }
    }
}

/// Runs the plan on all cores; the result does not depend on their number. `progress` is called with the numbers of finished and of
/// all pots. Runs are ordered by pot, departure and seed.
///
/// # Errors
/// [`MapStudyError`].
pub fn study(
    plan: &MapPlan,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<MapRun>, MapStudyError> {
    let jobs: Vec<(&PotPlacement, Option<Perturbation>)> = plan
        .pots
        .iter()
        .flat_map(|pot| plan.perturbations.iter().map(move |p| (pot, *p)))
        .collect();
    let done = AtomicUsize::new(0);
    let results = in_parallel(&jobs, |(pot, perturbation)| {
        let runs = teach::runs(plan, pot, *perturbation);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, jobs.len());
        runs
    });
    let mut runs = Vec::new();
    for ((pot, _), result) in jobs.iter().zip(results) {
        runs.extend(result.map_err(|source| MapStudyError {
            pot: pot.name.clone(),
            source,
        })?);
    }
    Ok(runs)
}
