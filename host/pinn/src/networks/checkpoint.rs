//! Training state as a burnpack file, from which a training continues as if it had not stopped.

use std::path::Path;

use burn_pack::{Bytes, DType, Reader, Tensor, Writer};

use crate::adam::Adam;
use crate::progress::TrainingProgress;
use crate::waveform::NormalisedWaveform;
use crate::{PinnConfig, PinnError, ViMlp};

/// State that the next epoch depends on, with the history so far.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct State {
    pub epoch: usize,
    pub theta: Vec<f64>,
    pub adam: Adam,
    /// Parameters of the least loss since `w_f` changed last, and that loss.
    pub best: Vec<f64>,
    pub best_loss: f64,
    /// Factor on the learning rate: halved by every rollback.
    pub rate_factor: f64,
    pub rollbacks: u32,
    /// Weight of the physics term, which loss balancing changes.
    pub w_f: f64,
    /// R, L at the slow times of the last checks, oldest first.
    pub past: Vec<Vec<f64>>,
    pub history: Vec<TrainingProgress>,
}

/// Name of the fingerprint of window and configuration in the file.
const FINGERPRINT: &str = "ihd-fingerprint";

/// Columns of a history row.
const HISTORY_WIDTH: usize = 9;

/// File of a training; without a path nothing is stored.
pub(crate) struct Checkpoint<'a> {
    path: Option<&'a Path>,
    fingerprint: String,
}

impl<'a> Checkpoint<'a> {
    /// Creates the checkpoint of a training on this window with this configuration.
    pub fn new(
        path: Option<&'a Path>,
        samples: &NormalisedWaveform,
        config: &PinnConfig,
        vi: &ViMlp,
    ) -> Self {
        Self {
            path,
            fingerprint: fingerprint(samples, config, vi),
        }
    }

    /// Reads the state from the file; returns `first` if there is no file.
    ///
    /// # Errors
    /// [`PinnError::Checkpoint`] for a file of another window or configuration, or a damaged one.
    pub fn load(&self, first: State) -> Result<State, PinnError> {
        let Some(path) = self.path.filter(|path| path.exists()) else {
            return Ok(first);
        };
        let tensors = tensors(path, &self.fingerprint)?;
        let state = restored(path, &tensors, &first)?;
        let parts = [
            &state.theta,
            &state.adam.mean,
            &state.adam.square,
            &state.best,
        ];
        if parts.iter().all(|x| x.len() == first.theta.len()) {
            return Ok(state);
        }
        let partial = "is damaged: not all parameters are there; remove it";
        Err(broken(path, &partial))
    }

    /// Writes the state; after a crash meanwhile the old file is intact.
    pub fn save(&self, state: impl FnOnce() -> State) -> Result<(), PinnError> {
        let Some(path) = self.path else {
            return Ok(());
        };
        let state = state();
        let numbers = vec![
            state.epoch as f64,
            f64::from(state.adam.steps),
            state.best_loss,
            state.rate_factor,
            f64::from(state.rollbacks),
            state.w_f,
            state.past.len() as f64,
        ];
        let rows: Vec<f64> = state.history.iter().flat_map(history_row).collect();
        let tensors = vec![
            tensor("numbers", &numbers),
            tensor("theta", &state.theta),
            tensor("adam.mean", &state.adam.mean),
            tensor("adam.square", &state.adam.square),
            tensor("best", &state.best),
            tensor("past", &state.past.concat()),
            tensor("history", &rows),
        ];
        Writer::new(tensors)
            .with_metadata("producer", "ihd-pinn checkpoint 1")
            .with_metadata(FINGERPRINT, &self.fingerprint)
            .write_to_file(path)
            .map_err(|e| broken(path, &e))
    }
}

/// Fingerprint of window and configuration, which protects against a wrong checkpoint.
fn fingerprint(samples: &NormalisedWaveform, config: &PinnConfig, vi: &ViMlp) -> String {
    let crc = crc::Crc::<u64>::new(&crc::CRC_64_XZ);
    let mut digest = crc.digest();
    // Only limits may change when a training continues.
    let settings = PinnConfig {
        // A rate that falls over all epochs depends on their number.
        max_iterations: match vi.last_rate {
            1.0 => 1,
            _ => config.max_iterations,
        },
        time_limit_s: 1.0,
        ..config.clone()
    };
    digest.update(format!("{settings:?}").as_bytes());
    let scales = [
        samples.omega,
        samples.t0_s,
        samples.dt_s,
        samples.f_mains_hz,
    ];
    for x in samples.v.iter().chain(&samples.i).chain(&scales) {
        digest.update(&x.to_le_bytes());
    }
    format!("{:016x}", digest.finalize())
}

/// All tensors of the file; an error if its fingerprint differs.
fn tensors(path: &Path, fingerprint: &str) -> Result<Vec<Tensor>, PinnError> {
    let reader = Reader::from_file(path).map_err(|e| broken(path, &e))?;
    if reader.metadata().get(FINGERPRINT).map(String::as_str) != Some(fingerprint) {
        let other = "belongs to another window or configuration; remove it or choose another file";
        return Err(broken(path, &other));
    }
    reader.into_tensors().map_err(|e| broken(path, &e))
}

/// State in the tensors; Adam's constants are those of `like`.
fn restored(path: &Path, tensors: &[Tensor], like: &State) -> Result<State, PinnError> {
    let values = |name: &str| -> Result<Vec<f64>, PinnError> {
        let tensor = tensors.iter().find(|t| t.name == name);
        let tensor = tensor.ok_or_else(|| broken(path, &format!("has no tensor {name}")))?;
        let bytes = tensor.to_bytes().map_err(|e| broken(path, &e))?;
        let (chunks, _) = bytes.as_chunks::<8>();
        Ok(chunks.iter().map(|c| f64::from_le_bytes(*c)).collect())
    };
    let numbers = values("numbers")?;
    let [epoch, steps, best_loss, rate_factor, rollbacks, w_f, looks] = numbers[..] else {
        return Err(broken(path, &"is damaged; remove it"));
    };
    let (past, history) = (values("past")?, values("history")?);
    let width = past.len().checked_div(looks as usize).unwrap_or(0).max(1);
    let mut adam = like.adam.clone();
    adam.steps = steps as u32;
    adam.mean = values("adam.mean")?;
    adam.square = values("adam.square")?;
    Ok(State {
        epoch: epoch as usize,
        theta: values("theta")?,
        adam,
        best: values("best")?,
        best_loss,
        rate_factor,
        rollbacks: rollbacks as u32,
        w_f,
        past: past.chunks_exact(width).map(<[f64]>::to_vec).collect(),
        history: history.chunks_exact(HISTORY_WIDTH).map(progress).collect(),
    })
}

fn broken(path: &Path, detail: &dyn std::fmt::Display) -> PinnError {
    PinnError::Checkpoint {
        path: path.display().to_string(),
        detail: detail.to_string(),
    }
}

fn tensor(name: &str, values: &[f64]) -> Tensor {
    let bytes: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
    Tensor::new(
        name.to_owned(),
        DType::F64,
        vec![values.len()],
        None,
        Bytes::from_bytes_vec(bytes),
    )
}

fn history_row(p: &TrainingProgress) -> [f64; HISTORY_WIDTH] {
    let (r, l) = p.mre_pct.unwrap_or((f64::NAN, f64::NAN));
    [
        p.pass as f64,
        p.iteration as f64,
        p.loss,
        p.l_f,
        p.l_i,
        r,
        l,
        p.change,
        p.elapsed_s,
    ]
}

fn progress(row: &[f64]) -> TrainingProgress {
    TrainingProgress {
        pass: row[0] as usize,
        iteration: row[1] as usize,
        loss: row[2],
        l_f: row[3],
        l_i: row[4],
        mre_pct: (!row[5].is_nan()).then_some((row[5], row[6])),
        change: row[7],
        elapsed_s: row[8],
    }
}
