//! Study of the paper's Tables 1 to 3 with this project's PINN presets, least squares, EKF and lock-in. Every cell is stored in a
//! file, so that an interrupted study can be continued.

mod cell;
mod comparison;
mod figure;
mod job;
mod lowpass;
mod nmse;
mod origin;
pub mod report;
mod waveforms;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use ihd_identify::IdentifyError;
use ihd_pinn::{PinnConfig, PinnError, PresetLibrary};
use ihd_signal::truth::Mre;
use ihd_signal::truth::PeriodTruth;
use ihd_sim::inverter::InverterError;
use ihd_sim::recording::settings::LoadKind;
use ihd_sim::trial::Trial;
use serde::{Deserialize, Serialize};

pub use self::job::{Contender, PaperJob};
use crate::parallel::in_parallel;
use ihd_plot::FigureError;

/// One entry of a loss curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LossAt {
    /// Step or epoch.
    pub step: usize,
    /// Physics term, the paper's eq. (4).
    pub l_f: f64,
    /// Data terms, the paper's eqs. (5) and (6), together.
    pub l_i: f64,
}

/// Errors in percent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaperErrors {
    /// Mean relative error of R in percent.
    pub r_pct: f64,
    /// Mean relative error of L in percent.
    pub l_pct: f64,
}

impl From<Mre> for PaperErrors {
    fn from(mre: Mre) -> Self {
        Self {
            r_pct: mre.r_pct,
            l_pct: mre.l_pct,
        }
    }
}

/// Result of a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaperCell {
    /// Job.
    pub job: PaperJob,
    /// Program that made it.
    #[serde(default)]
    pub build: String,
    /// Settings of its network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub settings: Option<PinnConfig>,
    /// Errors over the last mains half-cycle.
    pub whole: PaperErrors,
    /// Errors over its middle 80 %.
    pub middle: PaperErrors,
    /// Errors on the field model over the whole half-cycle against the describing function, which holds for a sinusoidal current.
    #[serde(default)]
    pub describing: Option<PaperErrors>,
    /// Order of the impedance law that the network was given or has found.
    #[serde(default)]
    pub impedance_order: Option<f64>,
    /// NMSE of v and i against the waveforms without noise in percent, if it reconstructs them.
    pub nmse_pct: Option<(f64, f64)>,
    /// NMSE against these waveforms after the paper's low-pass: its Table 3.
    #[serde(default)]
    pub nmse_filtered_pct: Option<(f64, f64)>,
    /// NMSE with the reconstruction after the low-pass, too.
    #[serde(default)]
    pub nmse_both_filtered_pct: Option<(f64, f64)>,
    /// NMSE of the waveforms without noise themselves by the definition of Table 3: the harmonics that the low-pass removes from
    /// the reference.
    #[serde(default)]
    pub nmse_unfiltered_itself_pct: Option<(f64, f64)>,
    /// P/I_rms² against the waveform's own, mean weighted with I², in percent; PINN only.
    pub power_r_pct: Option<f64>,
    /// P/I_rms² against R of the describing function, on the field model, in percent.
    #[serde(default)]
    pub power_describing_pct: Option<f64>,
    /// Wall-clock time in seconds.
    pub elapsed_s: f64,
    /// Steps or epochs; 0 for estimators that do not iterate.
    pub steps: usize,
    /// Reason of the stop.
    pub stopped: String,
    /// (time in seconds, R in ohm, L in henry) of the estimate.
    #[serde(rename = "track")]
    pub trajectory: Vec<(f64, f64, f64)>,
    /// Trajectory of the truth.
    pub truth: Vec<(f64, f64, f64)>,
    /// Contribution of the noise of single samples to the data terms, normalised like them; `None` without noise.
    #[serde(default)]
    pub noise_in_samples: Option<f64>,
    /// Loss curve.
    pub losses: Vec<LossAt>,
}

/// Error of the study.
#[derive(Debug, thiserror::Error)]
pub enum PaperStudyError {
    /// The simulator reported an error.
    #[error(transparent)]
    Simulation(#[from] InverterError),
    /// An estimator reported an error.
    #[error("{cell}: {source}")]
    Identify {
        /// Name of the cell.
        cell: String,
        /// Error.
        source: IdentifyError,
    },
    /// The network reported an error.
    #[error("{cell}: {source}")]
    Pinn {
        /// Name of the cell.
        cell: String,
        /// Error.
        source: PinnError,
    },
    /// An estimate has no time in common with the truth.
    #[error("{0}: no estimate within the last mains half-cycle")]
    Nothing(String),
    /// A file of the study cannot be read or written.
    #[error("{path}: {why}; remove it, or choose another --out")]
    File {
        /// Path of the file.
        path: String,
        /// Reason.
        why: String,
    },
    /// A figure cannot be drawn.
    #[error(transparent)]
    Figure(#[from] FigureError),
}

/// Operating point, which is simulated once.
struct Point {
    load: LoadKind,
    f_sw_hz: f64,
    trial: Trial,
    /// Voltage in volt and current in ampere without noise, after the paper's low-pass.
    filtered: (Vec<f64>, Vec<f64>),
    describing: Option<Vec<PeriodTruth>>,
}

impl Point {
    fn simulate(load: LoadKind, f_sw_hz: f64) -> Result<Self, InverterError> {
        let trial = Trial::simulate(load, f_sw_hz)?;
        let describing = match load {
            LoadKind::Field => Some(trial.describing()?),
            LoadKind::Behavioural | LoadKind::Surrogate => None,
        };
        let filtered = |x: &[f64]| lowpass::zero_phase(x, trial.clean.dt_s);
        Ok(Self {
            load,
            f_sw_hz,
            filtered: (filtered(&trial.clean.v_v), filtered(&trial.clean.i_a)),
            trial,
            describing,
        })
    }

    fn is_of(&self, job: &PaperJob) -> bool {
        (self.load, self.f_sw_hz) == (job.load, job.f_sw_hz)
    }
}

/// Presets, folder and program of a study.
struct StudyPlace<'a> {
    presets: &'a PresetLibrary,
    folder: &'a Path,
    build: String,
}

/// Runs the jobs on all cores; a cell with a file in `folder`, made by the same build with the same settings, is read instead. The result does not depend on the number of cores.
/// `progress` is called with the number of finished cells and the networks' reports.
///
/// # Errors
/// [`PaperStudyError`]: the first of the jobs' order, after all have run.
pub fn study(
    jobs: &[PaperJob],
    presets: &PresetLibrary,
    folder: &Path,
    progress: &(dyn Fn(usize, &str) + Sync),
) -> Result<Vec<PaperCell>, PaperStudyError> {
    let place = StudyPlace {
        presets,
        folder,
        build: origin::build(),
    };
    let stored: Vec<Option<PaperCell>> = jobs
        .iter()
        .map(|job| stored_cell(job, &place))
        .collect::<Result<_, _>>()?;
    let missing: Vec<&PaperJob> = jobs
        .iter()
        .zip(&stored)
        .filter(|(_, cell)| cell.is_none())
        .map(|(job, _)| job)
        .collect();
    let points = simulate(&missing)?;
    let done = AtomicUsize::new(jobs.len() - missing.len());
    let run = |job: &&PaperJob| {
        let report = |text: String| progress(done.load(Ordering::Relaxed), &text);
        let cell = run_and_store(job, &place, &points, &report);
        done.fetch_add(1, Ordering::Relaxed);
        report(job.file_stem());
        cell
    };
    let results = in_parallel(&missing, run);
    let mut cells = stored;
    for (empty, cell) in cells.iter_mut().filter(|c| c.is_none()).zip(results) {
        *empty = Some(cell?);
    }
    Ok(cells.into_iter().flatten().collect())
}

/// Simulates the operating points of the jobs, each once.
fn simulate(jobs: &[&PaperJob]) -> Result<Vec<Point>, PaperStudyError> {
    let settings = distinct(jobs, |job| (job.load, job.f_sw_hz));
    let points = in_parallel(&settings, |(load, f_sw_hz)| {
        Point::simulate(*load, *f_sw_hz)
    });
    Ok(points.into_iter().collect::<Result<_, _>>()?)
}

/// Runs a job and writes its cell's file.
fn run_and_store(
    job: &PaperJob,
    place: &StudyPlace<'_>,
    points: &[Point],
    report: &dyn Fn(String),
) -> Result<PaperCell, PaperStudyError> {
    let stem = job.file_stem();
    let point = points.iter().find(|point| point.is_of(job));
    let point = point.ok_or_else(|| PaperStudyError::Nothing(stem.clone()))?;
    let checkpoint = place.folder.join(format!("{stem}.bpk"));
    let cell = cell::run(job, place, point, &checkpoint, &mut |text| {
        report(format!("{stem}: {text}"));
    })?;
    let path = place.folder.join(format!("{stem}.json"));
    write(
        &path,
        &serde_json::to_vec(&cell).map_err(|e| broken(&path, &e))?,
    )?;
    // The file of the cell holds everything from here on.
    if checkpoint.exists() {
        fs::remove_file(&checkpoint).map_err(|e| broken(&checkpoint, &e))?;
    }
    Ok(cell)
}

/// Writes report.md, cells.json and the figures into `folder`; returns the report's path. `presets` has their descriptions.
///
/// # Errors
/// [`PaperStudyError`].
pub fn publish(
    cells: &[PaperCell],
    presets: &PresetLibrary,
    folder: &Path,
) -> Result<PathBuf, PaperStudyError> {
    let json = folder.join("cells.json");
    let text = serde_json::to_vec_pretty(cells).map_err(|e| broken(&json, &e))?;
    write(&json, &text)?;
    let figures = figure::all(cells, folder)?;
    let path = folder.join("report.md");
    write(&path, report::markdown(cells, presets, &figures).as_bytes())?;
    Ok(path)
}

/// Cell in the folder's file of the job, if there is one.
fn stored_cell(
    job: &PaperJob,
    place: &StudyPlace<'_>,
) -> Result<Option<PaperCell>, PaperStudyError> {
    let path = place.folder.join(format!("{}.json", job.file_stem()));
    if !path.exists() {
        return Ok(None);
    }
    let bytes = fs::read(&path).map_err(|e| broken(&path, &e))?;
    let cell: PaperCell = serde_json::from_slice(&bytes).map_err(|e| broken(&path, &e))?;
    if cell.build != place.build {
        return Err(broken(&path, &"is by another build of ihd-study"));
    }
    if cell.settings != origin::settings(job, place.presets)? {
        return Err(broken(&path, &"is of other settings of this preset"));
    }
    Ok(Some(cell))
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), PaperStudyError> {
    fs::write(path, bytes).map_err(|e| broken(path, &e))
}

fn broken(path: &Path, why: &dyn std::fmt::Display) -> PaperStudyError {
    PaperStudyError::File {
        path: path.display().to_string(),
        why: why.to_string(),
    }
}

/// Distinct values of a quantity of the items, in their order.
fn distinct<I, T: PartialEq>(items: &[&I], of: impl Fn(&I) -> T) -> Vec<T> {
    let mut values = Vec::new();
    for value in items.iter().map(|item| of(item)) {
        if !values.contains(&value) {
            values.push(value);
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::report::tests::cell;
    use super::*;

    #[test]
    fn a_stored_cell_stands_for_its_own_build_and_settings_alone() {
        let folder = tempfile::tempdir().unwrap();
        let place = StudyPlace {
            presets: &PresetLibrary::default(),
            folder: folder.path(),
            build: "this one".to_owned(),
        };
        let mut stored = cell(1, 2.0);
        stored.job.contender = Contender::Pinn("hybrid".to_owned());
        stored.build.clone_from(&place.build);
        stored.settings = origin::settings(&stored.job, place.presets).unwrap();
        let read = |cell: &PaperCell| {
            let path = folder.path().join(format!("{}.json", cell.job.file_stem()));
            fs::write(path, serde_json::to_vec(cell).unwrap()).unwrap();
            stored_cell(&cell.job, &place).map_err(|e| e.to_string())
        };
        assert_eq!(read(&stored), Ok(Some(stored.clone())));
        let mut other = stored.clone();
        other.build.push_str(" of yesterday");
        assert!(read(&other).unwrap_err().contains("another build"));
        let mut other = stored.clone();
        other.settings.as_mut().unwrap().spline_intervals += 1;
        assert!(read(&other).unwrap_err().contains("other settings"));
    }
}
