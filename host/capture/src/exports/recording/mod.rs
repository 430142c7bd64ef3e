//! Export of a device's recording to tables and arrays of any length: one window is in memory at a time.
//!
//! Times count from the trigger if the recording had one, as on a scope: earlier ones are negative.

mod csv;
mod npz;

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::mcap::cdr::{SamplesMessage, read_samples};
use crate::mcap::reader::{McapItem, McapMessage};
use crate::mcap::topics::{FaultNote, META_FREE, Telemetry, Topic, WholeWindow, WindowNote};
use crate::mcap::{FileLosses, McapFileError, McapReader};
use crate::recording::MIN_FREE_BYTES;

pub use csv::{half_cycles_csv, samples_csv};
pub use npz::recording_npz;

/// Limit of buffered pairs of a window without an end; a device's windows have about 20 000.
const MAX_PAIRS: usize = 1 << 18;

/// Note of a recording: time of its trigger, in seconds after its beginning.
const TRIGGER_S: &str = "trigger_s";

/// Limits of an export.
#[derive(Debug)]
pub struct ExportLimits<'a> {
    /// Limit of bytes written, before compression.
    pub bytes: u64,
    /// Deadline.
    pub until: Instant,
    /// Set to cancel the export.
    pub stop: &'a AtomicBool,
}

/// Error of exporting a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingExportError {
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] McapFileError),
    /// The table cannot be written.
    #[error("cannot write the table: {0}")]
    Write(#[from] io::Error),
    /// The recording has no such data.
    #[error("{file} holds no {what}: {hint}")]
    Nothing {
        /// The recording.
        file: String,
        /// Missing data.
        what: &'static str,
        /// Advice.
        hint: &'static str,
    },
    /// The export exceeds the limit of bytes.
    #[error("it would become larger than {} MB: download the MCAP file, of which `ihd convert` writes the samples", .bytes / 1_000_000)]
    TooLarge {
        /// The limit in bytes.
        bytes: u64,
    },
    /// The disk has less than [`MIN_FREE_BYTES`] free.
    #[error("less than {} MB are free on its disk: free some, or download the MCAP file", MIN_FREE_BYTES / 1_000_000)]
    NoRoom,
    /// The export missed its deadline.
    #[error(
        "it takes too long here: download the MCAP file, of which `ihd convert` writes the samples"
    )]
    TooLong,
    /// The export was cancelled.
    #[error("the export was cancelled")]
    Stopped,
}

/// Item of a recording, in the order of the file.
enum Row<'a> {
    /// Notes of the file.
    Notes(&'a BTreeMap<String, String>),
    /// Half-cycle, with the time in seconds at which its telemetry came.
    HalfCycle(f64, Box<Telemetry>),
    /// A fault that tripped or was cleared.
    Fault(f64, FaultNote),
    /// Window with its number, its beginning in seconds, its header, and its pairs: time, voltage, current.
    Window(u32, f64, Box<WholeWindow>, &'a [(f64, f32, f32)]),
}

type EachRow<'a> = &'a mut dyn FnMut(Row<'_>) -> Result<(), RecordingExportError>;

/// Reads a recording; damaged parts are skipped. Returns what was lost.
fn rows(
    path: &Path,
    limits: &ExportLimits<'_>,
    each: EachRow<'_>,
) -> Result<FileLosses, RecordingExportError> {
    let mut reader = McapReader::open(path)?;
    let mut table = Rows::default();
    let mut losses = FileLosses::default();
    loop {
        if limits.stop.load(Ordering::Relaxed) {
            return Err(RecordingExportError::Stopped);
        }
        if Instant::now() > limits.until {
            return Err(RecordingExportError::TooLong);
        }
        let damage = match reader.next_item() {
            Ok(None) => break,
            Ok(Some(McapItem::Metadata { name, entries })) if name == META_FREE => {
                let trigger_s = entries.get(TRIGGER_S).and_then(|s| s.parse().ok());
                table.trigger_s = trigger_s.filter(|s: &f64| s.is_finite()).unwrap_or(0.0);
                each(Row::Notes(&entries))?;
                None
            }
            Ok(Some(McapItem::Metadata { .. })) => None,
            Ok(Some(McapItem::Message(message))) => match table.take(&message, each)? {
                Ok(()) => None,
                Err(what) => {
                    let what = format!("a message of {}: {what}", message.topic.name());
                    Some(reader.damaged(what))
                }
            },
            Err(damage) if damage.is_damage() => Some(damage),
            Err(other) => return Err(other.into()),
        };
        if let Some(damage) = damage {
            // A window cut by the damage is dropped.
            table.pairs.clear();
            losses.take(&damage);
        }
    }
    losses.cut_at = reader.is_cut().then(|| reader.at());
    Ok(losses)
}

/// Result of reading a message; the error describes the damage.
type Parsed<T> = Result<T, String>;

#[derive(Default)]
struct Rows {
    trigger_s: f64,
    /// Pairs of the window whose end has not come.
    pairs: Vec<(f64, f32, f32)>,
}

impl Rows {
    fn take(
        &mut self,
        m: &McapMessage<'_>,
        each: EachRow<'_>,
    ) -> Result<Parsed<()>, RecordingExportError> {
        let t_s = m.log_time_ns as f64 * 1e-9 - self.trigger_s;
        let row = match m.topic {
            Topic::Samples => return Ok(self.samples(m)),
            Topic::Window => match parsed(m) {
                Ok(WindowNote {
                    seq,
                    whole: Some(whole),
                    ..
                }) => {
                    let begins_s = whole.zero_crossing_s - self.trigger_s;
                    each(Row::Window(seq, begins_s, Box::new(whole), &self.pairs))?;
                    self.pairs.clear();
                    return Ok(Ok(()));
                }
                Ok(_) => return Ok(Ok(())),
                Err(what) => Err(what),
            },
            Topic::Telemetry => parsed(m).map(|half_cycle| Row::HalfCycle(t_s, half_cycle)),
            Topic::Fault => parsed(m).map(|fault| Row::Fault(t_s, fault)),
            _ => return Ok(Ok(())),
        };
        match row {
            Ok(row) => each(row).map(Ok),
            Err(what) => Ok(Err(what)),
        }
    }

    fn samples(&mut self, m: &McapMessage<'_>) -> Parsed<()> {
        let samples: SamplesMessage =
            read_samples(m.data, m.as_codes).map_err(|e| e.to_string())?;
        if self.pairs.len() + samples.len() > MAX_PAIRS {
            return Err(format!("no window's end after {MAX_PAIRS} pairs"));
        }
        let [mut v_v, mut i_a] = [const { Vec::new() }; 2];
        samples.append_to([&mut v_v, &mut i_a]);
        let pairs = v_v.into_iter().zip(i_a).enumerate();
        let timed = pairs.map(|(k, (v, i))| (samples.at(k) - self.trigger_s, v, i));
        self.pairs.extend(timed);
        Ok(())
    }
}

/// Parses a JSON message.
fn parsed<T: serde::de::DeserializeOwned>(m: &McapMessage<'_>) -> Parsed<T> {
    serde_json::from_slice(m.data).map_err(|e| e.to_string())
}

/// Bytes that an export may still write.
struct ByteBudget {
    left: u64,
    limit: u64,
}

impl ByteBudget {
    fn from_limits(limits: &ExportLimits<'_>) -> Self {
        let (left, limit) = (limits.bytes, limits.bytes);
        Self { left, limit }
    }

    fn write(&mut self, out: &mut impl Write, bytes: &[u8]) -> Result<(), RecordingExportError> {
        let left = self.left.checked_sub(bytes.len() as u64);
        self.left = left.ok_or(RecordingExportError::TooLarge { bytes: self.limit })?;
        Ok(out.write_all(bytes)?)
    }
}

fn nothing(path: &Path, what: &'static str, hint: &'static str) -> RecordingExportError {
    let file = path.file_name().unwrap_or(path.as_os_str());
    RecordingExportError::Nothing {
        file: file.to_string_lossy().into_owned(),
        what,
        hint,
    }
}
