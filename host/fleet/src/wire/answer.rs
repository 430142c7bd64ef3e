//! Answer of a worker to the window's edge. Its content is checked against the window
//! ([`ihd_daemon::learning::WorkerAnswer`]).

use std::time::Duration;

use ihd_daemon::config::is_name;
use ihd_daemon::learning::{StatedLoad, WorkerAnswer};
use ihd_model::{FitRemark, FitStep};
use ihd_store::MAX_POINTS;
use serde::{Deserialize, Serialize};

use super::packing::{Singles, pack, unpack};
use super::{MessageError, VERSION, check_hob, check_version};

/// Longest text of an answer (a reason, a remark) in bytes.
const MAX_TEXT_BYTES: usize = 2_000;

/// Most remarks and most steps.
const MAX_ENTRIES: usize = 1_024;

/// Longest plausible work on a window in milliseconds; the slowest network takes minutes.
const MAX_BUSY_MS: u32 = 3_600_000;

/// Answer of a worker to the window's edge.
#[derive(Clone, Debug, PartialEq)]
pub struct AnswerMessage {
    /// The hob's name.
    pub hob: String,
    /// The hob's boot.
    pub boot: u32,
    /// The window's number since that boot.
    pub seq: u32,
    /// Time at which the edge stored the window, in milliseconds since 1970, UTC.
    pub window_at_ms: i64,
    /// Time of the answer, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// The answer.
    pub answer: WorkerAnswer,
}

#[derive(Serialize, Deserialize)]
struct Fields {
    version: u16,
    hob: String,
    boot: u32,
    seq: u32,
    window_at_ms: i64,
    at_ms: i64,
    by: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    skew_s: Option<f64>,
    busy_ms: u32,
    found: Outcome,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Outcome {
    Load(Load),
    Nothing { why: String },
}

#[derive(Serialize, Deserialize)]
struct Load {
    t_s: Singles,
    r_ohm: Singles,
    l_h: Singles,
    #[serde(default, skip_serializing_if = "Singles::is_empty")]
    r_sigma_ohm: Singles,
    #[serde(default, skip_serializing_if = "Singles::is_empty")]
    l_sigma_h: Singles,
    #[serde(default)]
    iterations: u32,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    steps: Vec<Step>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    remarks: Vec<Remark>,
}

/// Number, loss, relative change.
#[derive(Serialize, Deserialize)]
struct Step(u32, f32, Option<f32>);

#[derive(Serialize, Deserialize)]
struct Remark {
    code: String,
    severity: String,
    text: String,
}

impl AnswerMessage {
    /// Serialises the message.
    ///
    /// # Errors
    /// [`MessageError::Packed`] if zstd lacks memory.
    pub fn to_bytes(&self) -> Result<Vec<u8>, MessageError> {
        let answer = &self.answer;
        let busy_ms = u32::try_from(answer.busy.as_millis()).unwrap_or(MAX_BUSY_MS);
        pack(&Fields {
            version: VERSION,
            hob: self.hob.clone(),
            boot: self.boot,
            seq: self.seq,
            window_at_ms: self.window_at_ms,
            at_ms: self.at_ms,
            by: answer.by.clone(),
            skew_s: answer.skew_s,
            busy_ms: busy_ms.min(MAX_BUSY_MS),
            found: match &answer.load {
                Ok(stated) => Outcome::Load(Load::from_stated(stated)),
                Err(why) => Outcome::Nothing {
                    why: why.chars().take(MAX_TEXT_BYTES / 4).collect(),
                },
            },
        })
    }

    /// Reads a message.
    ///
    /// # Errors
    /// [`MessageError`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MessageError> {
        let fields: Fields = unpack(bytes)?;
        check_version(fields.version)?;
        if fields.busy_ms > MAX_BUSY_MS {
            let why = format!("is {}, more than {MAX_BUSY_MS}", fields.busy_ms);
            return Err(MessageError::value("busy_ms", why));
        }
        let load = match fields.found {
            Outcome::Load(load) => Ok(load.read()?),
            Outcome::Nothing { why } => Err(text("why", why)?),
        };
        Ok(Self {
            hob: check_hob(fields.hob)?,
            boot: fields.boot,
            seq: fields.seq,
            window_at_ms: fields.window_at_ms,
            at_ms: fields.at_ms,
            answer: WorkerAnswer {
                by: worker(fields.by)?,
                skew_s: fields.skew_s.filter(|skew_s| skew_s.is_finite()),
                load,
                busy: Duration::from_millis(fields.busy_ms.into()),
            },
        })
    }
}

impl Load {
    fn from_stated(stated: &StatedLoad) -> Self {
        let step = |s: &FitStep| Step(s.step, s.loss as f32, s.change.map(|c| c as f32));
        let remark = |r: &FitRemark| Remark {
            code: r.code.clone(),
            severity: r.severity.clone(),
            text: r.text.clone(),
        };
        Self {
            t_s: Singles::encode(&stated.t_s),
            r_ohm: Singles::encode(&stated.r_ohm),
            l_h: Singles::encode(&stated.l_h),
            r_sigma_ohm: Singles::encode(&stated.r_sigma_ohm),
            l_sigma_h: Singles::encode(&stated.l_sigma_h),
            iterations: stated.iterations,
            steps: stated.steps.iter().map(step).collect(),
            remarks: stated.remarks.iter().map(remark).collect(),
        }
    }

    fn read(self) -> Result<StatedLoad, MessageError> {
        let numbers = |field, list: &Singles| list.read(field, MAX_POINTS);
        let t_s = numbers("t_s", &self.t_s)?;
        let of_times = |field, list: &Singles, may_miss: bool| {
            let values = numbers(field, list)?;
            match values.len() == t_s.len() || may_miss && values.is_empty() {
                true => Ok(values),
                false => {
                    let why = format!("has {} points, t_s has {}", values.len(), t_s.len());
                    Err(MessageError::value(field, why))
                }
            }
        };
        let (r_ohm, l_h) = (
            of_times("r_ohm", &self.r_ohm, false)?,
            of_times("l_h", &self.l_h, false)?,
        );
        let (r_sigma_ohm, l_sigma_h) = (
            of_times("r_sigma_ohm", &self.r_sigma_ohm, true)?,
            of_times("l_sigma_h", &self.l_sigma_h, true)?,
        );
        if self.steps.len().max(self.remarks.len()) > MAX_ENTRIES {
            let why = format!("have more than {MAX_ENTRIES} entries");
            return Err(MessageError::value("steps or remarks", why));
        }
        let step = |Step(step, loss, change): Step| FitStep {
            step,
            loss: loss.into(),
            change: change.map(f64::from).filter(|c| c.is_finite()),
        };
        let remark = |r: Remark| {
            Ok(FitRemark {
                code: text("code", r.code)?,
                severity: text("severity", r.severity)?,
                text: text("text", r.text)?,
            })
        };
        let remarks = self.remarks.into_iter().map(remark);
        Ok(StatedLoad {
            r_ohm,
            l_h,
            r_sigma_ohm,
            l_sigma_h,
            iterations: self.iterations,
            steps: self
                .steps
                .into_iter()
                .map(step)
                .filter(|s| s.loss.is_finite())
                .collect(),
            remarks: remarks.collect::<Result<_, MessageError>>()?,
            t_s,
        })
    }
}

fn worker(name: String) -> Result<String, MessageError> {
    match is_name(&name) {
        true => Ok(name),
        false => Err(MessageError::value("by", "is no worker's name")),
    }
}

fn text(field: &'static str, text: String) -> Result<String, MessageError> {
    match text.len() <= MAX_TEXT_BYTES {
        true => Ok(text),
        false => {
            let why = format!("has {} bytes, more than {MAX_TEXT_BYTES}", text.len());
            Err(MessageError::value(field, why))
        }
    }
}
