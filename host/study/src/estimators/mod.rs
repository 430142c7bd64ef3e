//! All estimators on the same captures with truth: four switching frequencies, no noise and 70, 50 and 30 dB, several seeds; errors
//! over the last mains half-cycle.

pub mod published;
pub mod table;

use std::sync::atomic::{AtomicUsize, Ordering};

use ihd_identify::accuracy::Accuracy;
use ihd_identify::{IdentifyOptions, Method, run};
use ihd_signal::truth::PeriodTruth;
use ihd_sim::inverter::InverterError;
use ihd_sim::recording::settings::LoadKind;
use ihd_sim::trial::Trial;
use serde::Serialize;

use super::parallel::in_parallel;

/// Switching frequencies of the paper's tables, in hertz.
pub const F_SW_HZ: [f64; 4] = [45e3, 50e3, 60e3, 70e3];

/// Signal-to-noise ratios of the paper's tables in decibel; `None` is without noise.
pub const SNR_DB: [Option<f64>; 4] = [None, Some(70.0), Some(50.0), Some(30.0)];

/// Reference of a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ComparisonLoad {
    /// The behavioural reference load, for which v = R·i + L·di/dt holds exactly.
    Behavioural,
    /// Field model: R and L of the waveform's own fundamental, period by period.
    FieldWaveform,
    /// Field model: the describing function at the current's amplitude (sinusoidal current).
    FieldDescribing,
}

impl ComparisonLoad {
    /// All references, in the order of tables.
    pub const ALL: [Self; 3] = [
        Self::Behavioural,
        Self::FieldWaveform,
        Self::FieldDescribing,
    ];

    fn load(self) -> LoadKind {
        match self {
            Self::Behavioural => LoadKind::Behavioural,
            Self::FieldWaveform | Self::FieldDescribing => LoadKind::Field,
        }
    }
}

/// Plan of the study.
#[derive(Clone, Debug, PartialEq)]
pub struct EstimatorsPlan {
    /// Estimators.
    pub methods: Vec<Method>,
    /// Seeds of the noise; at least one.
    pub seeds: u64,
    /// `true` to include the field model.
    pub field: bool,
}

/// Mean relative errors of R and L in percent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RlErrors {
    /// Error of R in percent.
    pub r_pct: f64,
    /// Error of L in percent.
    pub l_pct: f64,
}

/// Cell of the study: a method at an operating point, over all seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EstimatorsCell {
    /// Reference.
    pub reference: ComparisonLoad,
    /// Method.
    pub method: Method,
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// Signal-to-noise ratio in decibel.
    pub snr_db: Option<f64>,
    /// Number of runs with an estimate.
    pub runs: usize,
    /// Number of runs without an estimate, or without one to compare.
    pub failed: usize,
    /// Reason of the first failure.
    pub failure: Option<String>,
    /// Mean over the runs, whole half-cycle.
    pub whole: RlErrors,
    /// Largest over the runs, whole half-cycle.
    pub worst: RlErrors,
    /// Mean over the runs, middle 80 %.
    pub middle: RlErrors,
    /// Mean over the runs, weighted with |i|².
    pub weighted: RlErrors,
}

/// Operating point, which is simulated once.
struct Point {
    trial: Trial,
    references: Vec<(ComparisonLoad, Vec<PeriodTruth>)>,
}

impl Point {
    fn new(load: LoadKind, f_sw_hz: f64) -> Result<Self, InverterError> {
        let trial = Trial::simulate(load, f_sw_hz)?;
        let mut references = Vec::new();
        for reference in ComparisonLoad::ALL.into_iter().filter(|r| r.load() == load) {
            let truth = match reference {
                ComparisonLoad::FieldDescribing => trial.describing()?,
                ComparisonLoad::Behavioural | ComparisonLoad::FieldWaveform => trial.truth.clone(),
            };
            references.push((reference, truth));
        }
        Ok(Self { trial, references })
    }
}

/// Results of one run: every method on one capture against every reference; in words where there is none.
type Run = Vec<(Method, ComparisonLoad, Result<Accuracy, String>)>;

/// Runs the plan on all cores; the result does not depend on their number. `progress` is called with the numbers of finished and of
/// all captures.
///
/// # Errors
/// If a capture cannot be simulated.
pub fn study(
    plan: &EstimatorsPlan,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<EstimatorsCell>, InverterError> {
    let loads: &[LoadKind] = if plan.field {
        &[LoadKind::Behavioural, LoadKind::Field]
    } else {
        &[LoadKind::Behavioural]
    };
    let per_point: usize = SNR_DB.iter().map(|snr| seeds(plan, *snr)).sum();
    let total = loads.len() * F_SW_HZ.len() * per_point;
    let done = AtomicUsize::new(0);
    let mut cells = Vec::new();
    // One operating point at a time: a capture of 50 MS/s takes 16 MB, its truth some ms.
    for &load in loads {
        for f_sw_hz in F_SW_HZ {
            let point = Point::new(load, f_sw_hz)?;
            let jobs: Vec<(Option<f64>, u64)> = SNR_DB
                .iter()
                .flat_map(|snr| (1..=seeds(plan, *snr) as u64).map(|seed| (*snr, seed)))
                .collect();
            let runs = in_parallel(&jobs, |(snr_db, seed)| {
                let run = run_all(plan, &point, *snr_db, *seed);
                progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
                run
            });
            for snr_db in SNR_DB {
                let of_snr = jobs.iter().zip(&runs).filter(|(job, _)| job.0 == snr_db);
                let of_snr: Vec<&Run> = of_snr.map(|(_, run)| run).collect();
                for (reference, _) in &point.references {
                    for &method in &plan.methods {
                        cells.push(cell(*reference, method, f_sw_hz, snr_db, &of_snr));
                    }
                }
            }
        }
    }
    Ok(cells)
}

/// Number of seeds; one without noise.
fn seeds(plan: &EstimatorsPlan, snr_db: Option<f64>) -> usize {
    snr_db.map_or(1, |_| plan.seeds.max(1) as usize)
}

fn run_all(plan: &EstimatorsPlan, point: &Point, snr_db: Option<f64>, seed: u64) -> Run {
    let segment = point.trial.noisy(snr_db, seed);
    // The paper drops the first half-cycle, in which filters settle.
    let from_s = segment.half_cycle_s();
    let mut settings = IdentifyOptions::default();
    // The result must not depend on the machine's load.
    settings.pinn.deterministic = true;
    let mut results = Vec::new();
    for &method in &plan.methods {
        let estimate = run(method, &segment, &settings).map_err(|why| why.to_string());
        for (reference, truth) in &point.references {
            let accuracy = estimate
                .as_ref()
                .map_err(String::clone)
                .and_then(|estimate| {
                    let accuracy = Accuracy::measure(estimate, &segment, truth, from_s);
                    accuracy.ok_or_else(|| "no time in common with the truth".to_owned())
                });
            results.push((method, *reference, accuracy));
        }
    }
    results
}

fn cell(
    reference: ComparisonLoad,
    method: Method,
    f_sw_hz: f64,
    snr_db: Option<f64>,
    runs: &[&Run],
) -> EstimatorsCell {
    let mut cell = EstimatorsCell {
        reference,
        method,
        f_sw_hz,
        snr_db,
        runs: 0,
        failed: 0,
        failure: None,
        whole: RlErrors::default(),
        worst: RlErrors::default(),
        middle: RlErrors::default(),
        weighted: RlErrors::default(),
    };
    let own = |r: &&(Method, ComparisonLoad, _)| (r.0, r.1) == (method, reference);
    for (_, _, result) in runs.iter().flat_map(|r| r.iter()).filter(own) {
        match result {
            Ok(a) => {
                cell.runs += 1;
                cell.whole.add(a.whole.r_pct, a.whole.l_pct);
                cell.middle.add(a.middle.r_pct, a.middle.l_pct);
                cell.weighted.add(a.weighted.r_pct, a.weighted.l_pct);
                cell.worst.r_pct = cell.worst.r_pct.max(a.whole.r_pct);
                cell.worst.l_pct = cell.worst.l_pct.max(a.whole.l_pct);
            }
            Err(why) => {
                cell.failed += 1;
                cell.failure.get_or_insert_with(|| why.clone());
            }
        }
    }
    let n = cell.runs.max(1) as f64;
    for errors in [&mut cell.whole, &mut cell.middle, &mut cell.weighted] {
        errors.r_pct /= n;
        errors.l_pct /= n;
    }
    cell
}

impl RlErrors {
    fn add(&mut self, r_pct: f64, l_pct: f64) {
        self.r_pct += r_pct;
        self.l_pct += l_pct;
    }
}
