//! Recording that has begun: its limits and the metadata of its files.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use ihd_model::RecordSettings;

use super::writer::{PendingWrite, RecordingWriter};

/// Limit that a recording has reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordingLimit {
    /// Its duration.
    Duration,
    /// The size of its file.
    Size,
}

/// Recording that has begun.
pub struct OngoingRecording {
    /// Settings.
    pub settings: RecordSettings,
    /// Time of the trigger, on the system's clock.
    pub began: Instant,
    /// Time of the trigger, on the transport's clock.
    pub triggered_at: Duration,
    /// Time from which the duration counts, on the transport's clock.
    pub counts_from: Duration,
    /// End on the transport's clock; `None` without a limit of the duration.
    pub until: Option<Duration>,
    /// Time of the last chunk, on the system's clock.
    pub last_data: Instant,
    /// Cause of the beginning.
    pub cause: String,
    /// Number of its file, from 1.
    pub part: u32,
    /// Path of its file.
    pub path: PathBuf,
    /// Writer of its file; `None` while the device is not connected.
    pub writer: Option<RecordingWriter>,
}

impl OngoingRecording {
    /// Returns a recording that was triggered at `at` on the transport's clock, before its first file.
    pub fn new(settings: RecordSettings, at: Duration, cause: &str) -> Box<Self> {
        let now = Instant::now();
        Box::new(Self {
            settings,
            began: now,
            triggered_at: at,
            counts_from: at,
            until: settings.duration_s.map(|s| at + Duration::from_secs_f64(s)),
            last_data: now,
            cause: cause.to_owned(),
            part: 1,
            path: PathBuf::new(),
            writer: None,
        })
    }

    /// Counts the duration from `at` on the transport's clock; `passed` of it are over.
    pub fn count_from(&mut self, at: Duration, passed: Duration) {
        let left = |s: f64| Duration::from_secs_f64(s).saturating_sub(passed);
        self.counts_from = at;
        self.until = self.settings.duration_s.map(|s| at + left(s));
    }

    /// Progress of its present file; `None` while there is none.
    pub fn pending(&self) -> Option<PendingWrite> {
        self.writer.as_ref().map(|writer| writer.pending.clone())
    }

    /// Size of its present file in bytes; 0 while there is none.
    pub fn bytes(&self) -> u64 {
        self.writer.as_ref().map_or(0, RecordingWriter::bytes)
    }

    /// Returns the limit that data of `at` on the transport's clock exceed; `None` if there is none.
    pub fn exceeded(&self, at: Duration) -> Option<RecordingLimit> {
        if self.until.is_some_and(|until| at > until) {
            return Some(RecordingLimit::Duration);
        }
        let max_bytes = self.settings.max_bytes;
        let is_full = max_bytes.is_some_and(|max| self.bytes() >= max);
        is_full.then_some(RecordingLimit::Size)
    }

    /// Returns the reason of an end by a limit.
    pub fn limit_text(&self, limit: RecordingLimit) -> String {
        match limit {
            RecordingLimit::Duration => {
                format!(
                    "{} s are over",
                    self.settings.duration_s.unwrap_or_default()
                )
            }
            RecordingLimit::Size => format!("its file has {} bytes", self.bytes()),
        }
    }

    /// Returns the metadata of a file that begins at `begins_at`, if the present time is `at`, both on the transport's clock.
    pub fn notes(&self, begins_at: Duration, at: Duration) -> BTreeMap<String, String> {
        let seconds = |to: Duration, from: Duration| to.as_secs_f64() - from.as_secs_f64();
        let utc = |after: Duration| {
            let ms = jiff::Timestamp::now().as_millisecond() + (seconds(after, at) * 1e3) as i64;
            jiff::Timestamp::from_millisecond(ms)
                .map_or_else(|_| ms.to_string(), |t| format!("{t:.3}"))
        };
        let mut notes = self.undated_notes(begins_at);
        notes.insert("began_at".to_owned(), utc(begins_at));
        notes.insert("trigger_at".to_owned(), utc(self.triggered_at));
        notes
    }

    /// Returns the part of [`OngoingRecording::notes`] that is the same each time.
    pub fn undated_notes(&self, begins_at: Duration) -> BTreeMap<String, String> {
        let trigger_s = self.triggered_at.as_secs_f64() - begins_at.as_secs_f64();
        let pre_trigger_s = self.settings.pre_trigger_s;
        let mut notes = BTreeMap::from([
            ("trigger".to_owned(), self.cause.clone()),
            ("trigger_s".to_owned(), format!("{trigger_s:.6}")),
            ("pre_trigger_s".to_owned(), pre_trigger_s.to_string()),
        ]);
        if self.part > 1 {
            notes.insert("part".to_owned(), self.part.to_string());
        }
        notes
    }
}
