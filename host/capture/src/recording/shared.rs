//! Files of a recording session: their beginning, the bytes of the link, their end.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use ihd_link::FrameSink;
use ihd_model::{RecordSettings, RecordingPhase, Trigger};

use super::ring::ByteChunk;
use super::state::{Phase, SessionState};
use super::under_way::OngoingRecording;
use super::writer::{FileStart, FreeBytes, RecordingWriter};

/// Function that names the next file; the number is 1 for the first one of a recording.
type Name = dyn Fn(u32) -> PathBuf + Send + Sync;

/// Function that publishes a status, on any thread; must not block, nor call the session.
type Publish = dyn Fn(RecordingStatus) + Send + Sync;

/// Differences between a daemon's recording, which is the default, and that of a command which owns the link.
#[derive(Clone, Copy, Debug, Default)]
pub struct RecordingOptions {
    /// `true` if the link's clock is that of a simulation: the same session gives the same bytes, so that the file has no date,
    /// and the link waits for the disk.
    pub simulated_clock: bool,
    /// `true` if a limit that is reached is only reported ([`RecordingSession::progress`]), so that the file also holds how the
    /// owner leaves the device; `false` if it ends the recording.
    pub ends_by_owner: bool,
    /// Free room of the disk: too little ends a recording without a limit of its own. `None` if it is not looked at.
    pub free_bytes: Option<FreeBytes>,
}

/// Status of a recording, as published.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordingStatus {
    /// Phase of the recording.
    pub phase: RecordingPhase,
    /// Cause of its start or end.
    pub text: String,
    /// File of the recording; `None` before it has begun.
    pub file: Option<PathBuf>,
}

/// Session as its handles, its sink and the thread of its file share it.
pub struct Shared {
    /// Options of the session.
    pub options: RecordingOptions,
    /// Namer of its files.
    pub name: Box<Name>,
    /// Publisher of its status.
    pub publish: Box<Publish>,
    /// Ring, trigger and phase.
    pub state: Mutex<SessionState>,
}

impl Shared {
    /// Locks the state.
    pub fn lock(&self) -> MutexGuard<'_, SessionState> {
        // Poisoning is ignored: no lock scope leaves a half-written value.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins the recording's next file at `at`. Returns the status, which is published while the state is locked: an early end of the
    /// file comes after it.
    pub fn begin_file(
        self: &Arc<Self>,
        state: &mut SessionState,
        recording: Box<OngoingRecording>,
        at: Duration,
        cause: &str,
    ) -> RecordingStatus {
        let status = self.open_file(state, recording, at, cause);
        (self.publish)(status.clone());
        status
    }

    fn open_file(
        self: &Arc<Self>,
        state: &mut SessionState,
        mut recording: Box<OngoingRecording>,
        at: Duration,
        cause: &str,
    ) -> RecordingStatus {
        let mut before = Vec::new();
        if recording.part == 1 {
            let pre_trigger = Duration::from_secs_f64(recording.settings.pre_trigger_s);
            before = state.ring.since(at.saturating_sub(pre_trigger));
        }
        let begins_at = before.first().map_or(at, |first| first.at);
        recording.path = (self.name)(recording.part);
        let path = recording.path.clone();
        let failed = |state: &mut SessionState, why: String| {
            state.failure = Some(why.clone());
            RecordingStatus {
                phase: RecordingPhase::Failed,
                text: why,
                file: Some(path.clone()),
            }
        };
        let Some((hello, front_end)) = state.device.clone() else {
            return failed(state, "the device is not connected".to_owned());
        };
        let RecordSettings {
            duration_s,
            max_bytes,
            ..
        } = recording.settings;
        let is_unlimited = duration_s.is_none() && max_bytes.is_none();
        let simulated = self.options.simulated_clock;
        let notes = match (simulated, recording.settings.trigger) {
            (true, Trigger::Now) => BTreeMap::new(),
            (true, _) => recording.undated_notes(begins_at),
            (false, _) => recording.notes(begins_at, at),
        };
        let start = FileStart {
            path: path.clone(),
            hello,
            front_end,
            notes,
            at: begins_at,
            before,
            mid_frame: state.mid_frame,
            wall_clock_flush: !simulated,
            free_bytes: self.options.free_bytes.filter(|_| is_unlimited),
        };
        let (shared, written) = (Arc::downgrade(self), path.clone());
        match RecordingWriter::begin(start, move |ended| on_file_end(&shared, &written, ended)) {
            Err(why) => failed(state, why),
            Ok(writer) => {
                recording.writer = Some(writer);
                state.phase = Phase::Recording(recording);
                RecordingStatus {
                    phase: RecordingPhase::Begun,
                    text: cause.to_owned(),
                    file: Some(path),
                }
            }
        }
    }

    fn record_chunk(
        self: &Arc<Self>,
        connection: u64,
        at: Duration,
        from_device: bool,
        bytes: &[u8],
    ) {
        let mut state = self.lock();
        if state.connection != connection {
            return;
        }
        let chunk = ByteChunk {
            at,
            from_device,
            mid_frame: from_device && state.mid_frame,
            bytes: bytes.into(),
        };
        state.write_chunk(&chunk, !self.options.ends_by_owner);
        state.remember(chunk);
        if from_device && let Some((settings, cause)) = state.check_trigger(bytes) {
            let recording = OngoingRecording::new(settings, at, &cause);
            let cause = format!("begun by {cause}");
            self.begin_file(&mut state, recording, at, &cause);
        }
        let written = match &state.phase {
            Phase::Recording(r) if self.options.simulated_clock => r.pending(),
            _ => None,
        };
        drop(state);
        if let Some(written) = written {
            written.wait_written();
        }
    }
}

/// Publishes the end or failure of a file, and ends the recording if it was being written to that file.
fn on_file_end(shared: &Weak<Shared>, path: &Path, ended: &Result<String, String>) {
    let Some(shared) = shared.upgrade() else {
        return;
    };
    let (phase, text) = match ended {
        Ok(why) => (RecordingPhase::Ended, why),
        Err(why) => (RecordingPhase::Failed, why),
    };
    {
        let mut state = shared.lock();
        state.finishing.retain(|file| file != path);
        if let Err(why) = ended {
            state.failure = Some(why.clone());
        }
        if let Phase::Recording(recording) = &state.phase
            && recording.path == path
            && recording.writer.is_some()
        {
            state.phase = Phase::Idle;
        }
    }
    (shared.publish)(RecordingStatus {
        phase,
        text: text.clone(),
        file: Some(path.to_owned()),
    });
}

/// Sink of a session for the bytes of one connection.
pub struct RecordingSink {
    /// Session.
    pub(super) shared: Arc<Shared>,
    /// Number of the connection; the sink of an earlier one records nothing.
    pub(super) connection: u64,
}

impl FrameSink for RecordingSink {
    fn received(&mut self, at: Duration, bytes: &[u8]) -> io::Result<()> {
        self.shared.record_chunk(self.connection, at, true, bytes);
        Ok(())
    }

    fn sent(&mut self, at: Duration, frame: &[u8]) -> io::Result<()> {
        self.shared.record_chunk(self.connection, at, false, frame);
        Ok(())
    }

    fn finish(self: Box<Self>) -> io::Result<()> {
        Ok(())
    }
}
