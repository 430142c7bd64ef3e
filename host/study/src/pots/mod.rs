//! Study of a pot library's benefit: one hob knows a pot, another gets it for the first time, with its own lift, winding, gain and
//! noise. It runs with and without the first hob's knowledge, and with a wrong library.

pub mod hobs;
pub mod lie;
pub mod table;

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use ihd_map::{Library, PotEntry, PotMap};
use ihd_pinn::PinnError;
use ihd_sim::inverter::InverterError;
use ihd_sim::perturbation::Perturbation;
use ihd_sim::recording::settings::LoadKind;
use ihd_train::lookup::{BuiltLookup, LookupAccuracy, judge_cells};
use serde::Serialize;

use self::hobs::{SecondHob, entry};
use super::map::places::PotPlacement;
use super::parallel::in_parallel;

/// Plan of the study.
#[derive(Clone, Debug, PartialEq)]
pub struct PotsPlan {
    /// Pots in their places on the second hob; the first one knows them centred, cold and at their usual height.
    pub pots: Vec<PotPlacement>,
    /// Departures of the pots from the standard model; `None` for the standard one.
    pub perturbations: Vec<Option<Perturbation>>,
    /// Other pots that the first hob knows.
    pub others: Vec<PotPlacement>,
    /// Load model.
    pub load: LoadKind,
    /// Seeds of the noise; at least one.
    pub seeds: u64,
}

/// Contents of the second hob's library.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LibraryContents {
    /// Empty.
    Nothing,
    /// The pot alone.
    Same,
    /// The pot among all others.
    Among,
    /// The others only.
    Others,
    /// An entry that fits the first window and is a little wrong everywhere else.
    NearMiss,
    /// An entry that fits the first window and is very wrong elsewhere.
    Lie,
}

impl LibraryContents {
    /// All contents.
    pub const ALL: [Self; 6] = [
        Self::Nothing,
        Self::Same,
        Self::Among,
        Self::Others,
        Self::NearMiss,
        Self::Lie,
    ];
}

/// Lookup after a number of windows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TaughtLookup {
    /// Number of windows.
    pub windows: u32,
    /// Errors; `None` if no device would accept it.
    pub error: Option<LookupAccuracy>,
    /// Share of the reached cells that are marked as known.
    pub known: f64,
    /// Largest error of R and of L in marked cells, in percent; `None` without any.
    pub worst_known_pct: Option<[f64; 2]>,
    /// Weight of the library in the map's hypotheses.
    pub recognised: f64,
}

/// One pot, one departure, one library, one seed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PotsRun {
    /// Name of the pot and its place on the second hob.
    pub pot: String,
    /// Departure from the standard model.
    pub perturbation: Option<Perturbation>,
    /// Contents of the library.
    pub library: LibraryContents,
    /// Seed of the noise.
    pub seed: u64,
    /// Number of cells that the hob reaches.
    pub reached: usize,
    /// `true` if the first hob had an entry for this pot.
    pub told: bool,
    /// Lookups after each window.
    pub after: Vec<TaughtLookup>,
}

/// Error of the study for a pot.
#[derive(Debug, thiserror::Error)]
#[error("{pot}: {source}")]
pub struct PotsStudyError {
    /// Name of the pot.
    pot: String,
    /// Error.
    source: PotError,
}

/// Error of studying one pot.
#[derive(Debug, thiserror::Error)]
pub enum PotError {
    /// The simulator reported an error.
    #[error(transparent)]
    Simulation(#[from] InverterError),
    /// The network could not be trained on a window.
    #[error(transparent)]
    Network(#[from] PinnError),
}

impl PotError {
    fn into_study_error(self, pot: &str) -> PotsStudyError {
        PotsStudyError {
            pot: pot.to_owned(),
            source: self,
        }
    }
}

/// Runs the plan on all cores; the result does not depend on their number. `progress` is called with the numbers of finished and of
/// all pots. Runs are ordered by pot, departure, seed and library.
///
/// # Errors
/// [`PotsStudyError`].
pub fn study(
    plan: &PotsPlan,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<PotsRun>, PotsStudyError> {
    let jobs: Vec<_> = plan
        .pots
        .iter()
        .flat_map(|pot| plan.perturbations.iter().map(move |p| (pot, *p)))
        .collect();
    let total = plan.others.len() + jobs.len();
    let done = AtomicUsize::new(0);
    let finished = || progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
    let entries = in_parallel(&plan.others, |other| {
        let entry = entry(plan.load, &other.pot, &other.name, OTHERS_SEED);
        finished();
        entry
    });
    let mut others = Vec::new();
    for (other, entry) in plan.others.iter().zip(entries) {
        let entry = entry.map_err(|why| why.into_study_error(&other.name))?;
        others.extend(entry.map(|e| (other, e)));
    }
    let results = in_parallel(&jobs, |(pot, perturbation)| {
        let runs = runs(plan, pot, *perturbation, &others);
        finished();
        runs
    });
    let mut runs = Vec::new();
    for ((pot, _), result) in jobs.iter().zip(results) {
        runs.extend(result.map_err(|why| why.into_study_error(&pot.name))?);
    }
    Ok(runs)
}

/// Seed of the noise with which the first hob learned the others.
const OTHERS_SEED: u64 = 99;

fn runs(
    plan: &PotsPlan,
    placed: &PotPlacement,
    perturbation: Option<Perturbation>,
    others: &[(&PotPlacement, PotEntry)],
) -> Result<Vec<PotsRun>, PotError> {
    let hob = SecondHob::new(plan.load, placed, perturbation)?;
    let mut runs = Vec::new();
    for seed in 1..=plan.seeds {
        let known = ihd_sim::pot::SimulatedPot {
            perturbation,
            ..hobs::at_home(&placed.pot)
        };
        let same = match hob.is_heated() {
            true => entry(plan.load, &known, "the-pot", seed)?,
            false => None,
        };
        // The same metal and size count as the same pot.
        let is_other =
            |other: &PotPlacement| perturbation.is_some() || !hobs::is_same(&other.pot, &known);
        let strangers: Vec<_> = others
            .iter()
            .filter(|(other, _)| is_other(other))
            .map(|(_, e)| e.clone())
            .collect();
        let curves = hob.curves(seed)?;
        let first_hz = curves.first().map_or(0.0, |c| c.f_sw_hz);
        for library in LibraryContents::ALL {
            let Some(shelf) = shelf(library, same.as_ref(), &strangers, first_hz) else {
                continue;
            };
            let mut map = PotMap::default().with_library(Arc::new(shelf));
            let after = curves.iter().map(|curve| {
                map.observe(curve.clone());
                map.refresh(curve.t_s);
                hob.judge(&map, curve.t_s)
            });
            runs.push(PotsRun {
                pot: placed.name.clone(),
                perturbation,
                library,
                seed,
                reached: hob.truth().reached(),
                told: same.is_some(),
                after: after.collect(),
            });
        }
    }
    Ok(runs)
}

/// Library with some contents, of the pot's entry and the others; `None` if an entry is refused, or cannot be forged: that is no run of an
/// empty library. Forged entries fit at `first_hz`, the first window's frequency.
fn shelf(
    contents: LibraryContents,
    same: Option<&PotEntry>,
    others: &[PotEntry],
    first_hz: f64,
) -> Option<Library> {
    let lie = |by| Some(vec![lie::forged_entry(same?, first_hz, by)?]);
    let entries: Vec<PotEntry> = match contents {
        LibraryContents::Nothing => Vec::new(),
        LibraryContents::Same => same.into_iter().cloned().collect(),
        LibraryContents::Among => same.into_iter().chain(others).cloned().collect(),
        LibraryContents::Others => others.to_vec(),
        LibraryContents::NearMiss => lie(lie::SMALL)?,
        LibraryContents::Lie => lie(lie::LARGE)?,
    };
    let mut shelf = Library::default();
    for entry in entries {
        shelf.add(entry).ok()?;
    }
    Some(shelf)
}

impl SecondHob {
    /// Compares the lookup of a map with the truth.
    fn judge(&self, map: &PotMap, now_s: f64) -> TaughtLookup {
        let windows = map.curves().iter().map(|c| c.windows).sum();
        let recognised = map.recognised().map(|(_, share)| share).sum();
        let nothing = TaughtLookup {
            windows,
            error: None,
            known: 0.0,
            worst_known_pct: None,
            recognised,
        };
        let built = map
            .cells(now_s)
            .map(|cells| BuiltLookup::from_cells(cells, 1));
        let Some(Ok(built)) = built else {
            return nothing;
        };
        let cells = judge_cells(&built, self.truth());
        let known = cells
            .iter()
            .filter(|c| built.lookup.is_observed(c.frequency, c.current));
        let worst = |a: [f64; 2], b: [f64; 2]| [a[0].max(b[0]), a[1].max(b[1])];
        TaughtLookup {
            error: Some(LookupAccuracy::from_cells(&cells)),
            known: known.clone().count() as f64 / cells.len().max(1) as f64,
            worst_known_pct: known.map(|c| [c.r_pct.abs(), c.l_pct.abs()]).reduce(worst),
            ..nothing
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lie_that_cannot_be_told_is_no_run_of_an_empty_library() {
        let empty = shelf(LibraryContents::Nothing, None, &[], 5e4);
        assert!(empty.is_some_and(|library| library.entries().is_empty()));
        for contents in [LibraryContents::NearMiss, LibraryContents::Lie] {
            assert!(shelf(contents, None, &[], 5e4).is_none());
        }
    }
}
