//! Recordings of a device: begun by hand, by a fault or by a level, with a pre-trigger.
//!
//! ```text
//!  link's thread ── chunks ──► Recorder: ring of the last minute (ring.rs), trigger (trigger.rs)
//!                                 │ armed ──► begun ──► ended: by time, by hand
//!                                 └ once begun: the ring, then every chunk ──► the file's thread (writer.rs)
//! ```
//!
//! A recorder outlives connections. An armed trigger stays armed; a change while the device was not connected is judged
//! with the first half-cycle after. A recording under way continues in a second file after a reconnect.

mod files;
mod ring;
mod tables;
mod trigger;
mod writer;

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use ihd_link::FrameSink;
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::messages::{AnyMessage, FaultEvent, FrontEnd, Hello, Message, Telemetry};

use crate::event_bus::now_ms;
use crate::model::{ActiveRecording, RecordSettings, RecordingPhase, Trigger};

pub use files::{file_name, is_plain_name, list};
pub use ihd_capture::exports::recording::TableError;
use ring::{Chunk, Ring};
pub use tables::{Table, table};
pub use trigger::LONGEST_PRE_TRIGGER_S;
use trigger::TriggerState;
use writer::{FileStart, PendingWrite, RecordingWriter};

/// Time limit for waiting for the disk at the start and end of a recording.
const DISK_TIMEOUT: Duration = Duration::from_secs(10);

/// Time without data after which the system clock ends a recording instead of the transport's.
const SILENCE_LIMIT: Duration = Duration::from_secs(1);

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

/// Function that names the next file; the number is 1 for the first one of a recording.
type Name = dyn Fn(u32) -> PathBuf + Send + Sync;

/// Function that publishes a status, on any thread; must not block.
type Publish = dyn Fn(RecordingStatus) + Send + Sync;

/// Recorder of one device; cheap to clone.
#[derive(Clone)]
pub struct Recorder(Arc<Shared>);

struct Shared {
    name: Box<Name>,
    publish: Box<Publish>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    device: Option<(Hello, FrontEnd)>,
    /// Number of the present connection; data of earlier ones are ignored.
    connection: u64,
    ring: Ring,
    deframer: Deframer,
    trigger_state: TriggerState,
    /// `true` if the device's last byte lies within a frame.
    mid_frame: bool,
    phase: Phase,
    /// Files that receive no more data and are not complete yet.
    finishing: Vec<PathBuf>,
}

#[derive(Default)]
enum Phase {
    #[default]
    Idle,
    Armed {
        settings: RecordSettings,
        since: Instant,
    },
    Recording(Box<Recording>),
}

/// Recording that has begun.
struct Recording {
    settings: RecordSettings,
    began: Instant,
    /// Time of the trigger, on the transport's clock.
    triggered_at: Duration,
    /// End on the transport's clock; `None` if it ends by hand.
    until: Option<Duration>,
    last_data: Instant,
    cause: String,
    part: u32,
    path: PathBuf,
    /// Writer of its file; `None` while the device is not connected.
    writer: Option<RecordingWriter>,
}

/// Recording that was started or armed.
pub struct StartedRecording {
    /// File of the recording; `None` if it is armed.
    pub file: Option<PathBuf>,
    /// Description for the requester.
    pub text: String,
    pending: Option<PendingWrite>,
}

impl StartedRecording {
    /// Waits until the file has begun.
    ///
    /// # Errors
    /// Reason why it has not.
    pub fn wait(&self) -> Result<(), String> {
        match &self.pending {
            Some(pending) => pending.wait_begun(DISK_TIMEOUT),
            None => Ok(()),
        }
    }
}

/// Recording that was ended or disarmed.
pub struct StoppedRecording {
    /// File of the recording; `None` if it never began.
    pub file: Option<PathBuf>,
    pending: Option<PendingWrite>,
}

impl StoppedRecording {
    /// Waits until the file is complete.
    ///
    /// # Errors
    /// Reason why it is not.
    pub fn wait(&self) -> Result<(), String> {
        match &self.pending {
            Some(pending) => pending.wait_complete(DISK_TIMEOUT),
            None => Ok(()),
        }
    }
}

impl Recorder {
    /// Creates a recorder with functions that name its files and publish its status.
    pub fn new(
        name: impl Fn(u32) -> PathBuf + Send + Sync + 'static,
        publish: impl Fn(RecordingStatus) + Send + Sync + 'static,
    ) -> Self {
        Self(Arc::new(Shared {
            name: Box::new(name),
            publish: Box::new(publish),
            state: Mutex::default(),
        }))
    }

    /// Starts a connection after the handshake, at `at` on the transport's clock. Returns the sink for the bytes of the link.
    /// A recording under way continues in its next file.
    pub fn connected(&self, hello: &Hello, front_end: &FrontEnd, at: Duration) -> RecorderSink {
        self.disconnected();
        let mut state = self.0.lock();
        state.device = Some((hello.clone(), front_end.clone()));
        state.connection += 1;
        let connection = state.connection;
        let mut status = None;
        let phase = std::mem::take(&mut state.phase);
        if let Phase::Recording(mut recording) = phase {
            let passed = recording.began.elapsed();
            if at < recording.triggered_at {
                // The clock of this transport started later.
                recording.triggered_at = at;
                let left = |s: f64| Duration::from_secs_f64(s).saturating_sub(passed);
                recording.until = recording.settings.duration_s.map(|s| at + left(s));
            }
            recording.last_data = Instant::now();
            recording.part += 1;
            let cause = format!("goes on in its file {}: the link is back", recording.part);
            status = Some(self.0.begin_file(&mut state, recording, at, &cause));
        } else {
            state.phase = phase;
        }
        drop(state);
        if let Some(status) = status {
            (self.0.publish)(status);
        }
        RecorderSink {
            shared: Arc::clone(&self.0),
            connection,
        }
    }

    /// Ends the connection. A file under way is completed; its recording, and an armed one, wait for the next connection.
    pub fn disconnected(&self) {
        let mut state = self.0.lock();
        state.device = None;
        state.connection += 1;
        state.ring.clear();
        state.deframer = Deframer::new();
        state.mid_frame = false;
        if let Phase::Recording(recording) = &mut state.phase
            && let Some(writer) = recording.writer.take()
        {
            let path = recording.path.clone();
            state.finishing.push(path);
            writer.finish("the link went away; it goes on in a second file when that is back");
        }
    }

    /// Begins a recording or arms its trigger, at `at` on the transport's clock.
    ///
    /// # Errors
    /// Invalid settings, a recording that is armed or under way, or no connected device.
    pub fn start(
        &self,
        settings: RecordSettings,
        at: Duration,
    ) -> Result<StartedRecording, String> {
        settings.check()?;
        let mut state = self.0.lock();
        match &state.phase {
            Phase::Idle => {}
            Phase::Armed { settings, .. } => {
                let trigger = settings.trigger;
                return Err(format!(
                    "a recording waits for {trigger} already: stop it first"
                ));
            }
            Phase::Recording(recording) => {
                let path = recording.path.display();
                return Err(format!("{path} is being recorded into already"));
            }
        }
        if state.device.is_none() {
            return Err("the device is not connected".to_owned());
        }
        let (now, until) = (Instant::now(), settings.duration_s);
        if settings.trigger != Trigger::Now {
            let before = match settings.pre_trigger_s {
                0.0 => String::new(),
                s => format!(", with {s} s before it"),
            };
            let text = format!("waits for {}{before}", settings.trigger);
            state.phase = Phase::Armed {
                settings,
                since: now,
            };
            drop(state);
            (self.0.publish)(RecordingStatus {
                phase: RecordingPhase::Armed,
                text: text.clone(),
                file: None,
            });
            return Ok(StartedRecording {
                file: None,
                text,
                pending: None,
            });
        }
        let recording = Recording {
            settings,
            began: now,
            triggered_at: at,
            until: until.map(|s| at + Duration::from_secs_f64(s)),
            last_data: now,
            cause: "by hand".to_owned(),
            part: 1,
            path: PathBuf::new(),
            writer: None,
        };
        let status = self
            .0
            .begin_file(&mut state, Box::new(recording), at, "begun by hand");
        let pending = match &state.phase {
            Phase::Recording(recording) => recording.writer.as_ref().map(|w| w.pending.clone()),
            _ => None,
        };
        drop(state);
        let (file, failed) = (status.file.clone(), status.phase == RecordingPhase::Failed);
        let text = status.text.clone();
        (self.0.publish)(status);
        match failed {
            true => Err(text),
            false => Ok(StartedRecording {
                file,
                text: "recording".to_owned(),
                pending,
            }),
        }
    }

    /// Ends the recording or disarms its trigger.
    ///
    /// # Errors
    /// Nothing is armed or under way.
    pub fn stop(&self, why: &str) -> Result<StoppedRecording, String> {
        let mut state = self.0.lock();
        match std::mem::take(&mut state.phase) {
            Phase::Idle => Err("nothing is being recorded".to_owned()),
            Phase::Armed { settings, .. } => {
                drop(state);
                let text = format!("{why}: {} did not come", settings.trigger);
                (self.0.publish)(RecordingStatus {
                    phase: RecordingPhase::Disarmed,
                    text,
                    file: None,
                });
                Ok(StoppedRecording {
                    file: None,
                    pending: None,
                })
            }
            Phase::Recording(recording) => {
                let path = recording.path;
                let pending = recording.writer.map(|writer| {
                    state.finishing.push(path.clone());
                    writer.finish(why)
                });
                Ok(StoppedRecording {
                    file: Some(path),
                    pending,
                })
            }
        }
    }

    /// Ends a recording by the system clock while the link is silent. To be called periodically.
    pub fn tick(&self) {
        let mut state = self.0.lock();
        let Phase::Recording(recording) = &state.phase else {
            return;
        };
        let is_over = |s| recording.began.elapsed().as_secs_f64() >= s;
        let is_silent =
            recording.writer.is_none() || recording.last_data.elapsed() >= SILENCE_LIMIT;
        if !is_silent || !recording.settings.duration_s.is_some_and(is_over) {
            return;
        }
        let away = recording.writer.is_none().then(|| RecordingStatus {
            phase: RecordingPhase::Ended,
            text: "its time is over, and the link is not back".to_owned(),
            file: Some(recording.path.clone()),
        });
        state.end_by_time();
        drop(state);
        if let Some(status) = away {
            (self.0.publish)(status);
        }
    }

    /// Returns the recording that is armed or under way; `None` if there is none.
    pub fn active(&self) -> Option<ActiveRecording> {
        let state = self.0.lock();
        let (settings, since, file) = match &state.phase {
            Phase::Idle => return None,
            Phase::Armed { settings, since } => (*settings, *since, None),
            Phase::Recording(r) => (r.settings, r.began, Some(name_of(&r.path))),
        };
        Some(ActiveRecording {
            settings,
            file,
            since_s: since.elapsed().as_secs_f64(),
        })
    }

    /// Returns the files that are not complete.
    pub fn incomplete(&self) -> Vec<PathBuf> {
        let mut files = self.0.lock().finishing.clone();
        files.extend(self.path());
        files
    }

    /// Returns the file of the recording under way; `None` while nothing is written.
    pub fn path(&self) -> Option<PathBuf> {
        match &self.0.lock().phase {
            Phase::Recording(r) if r.writer.is_some() => Some(r.path.clone()),
            _ => None,
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        // Poisoning is ignored: no lock scope leaves a half-written value.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns the last component of a path.
pub fn name_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or(path.as_os_str());
    name.to_string_lossy().into_owned()
}

impl Shared {
    /// Begins the recording's next file at `at`. Returns the status to be published.
    fn begin_file(
        self: &Arc<Self>,
        state: &mut State,
        mut recording: Box<Recording>,
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
        let failed = |why: String| RecordingStatus {
            phase: RecordingPhase::Failed,
            text: why,
            file: Some(path.clone()),
        };
        let Some((hello, front_end)) = state.device.clone() else {
            return failed("the device is not connected".to_owned());
        };
        let start = FileStart {
            path: path.clone(),
            hello,
            front_end,
            notes: recording.notes(begins_at, at),
            at: begins_at,
            before,
            mid_frame: state.mid_frame,
        };
        let (shared, written) = (Arc::downgrade(self), path.clone());
        match RecordingWriter::begin(start, move |ended| on_file_end(&shared, &written, ended)) {
            Err(why) => failed(why),
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
        let chunk = Chunk {
            at,
            from_device,
            mid_frame: from_device && state.mid_frame,
            bytes: bytes.into(),
        };
        state.write_chunk(&chunk);
        state.ring.push(chunk);
        let mut status = None;
        if from_device {
            state.mid_frame = bytes.last().map_or(state.mid_frame, |&b| b != 0);
            if let Some((settings, cause)) = state.check_trigger(bytes) {
                let recording = Box::new(Recording {
                    settings,
                    began: Instant::now(),
                    triggered_at: at,
                    until: settings.duration_s.map(|s| at + Duration::from_secs_f64(s)),
                    last_data: Instant::now(),
                    cause: cause.clone(),
                    part: 1,
                    path: PathBuf::new(),
                    writer: None,
                });
                let cause = format!("begun by {cause}");
                status = Some(self.begin_file(&mut state, recording, at, &cause));
            }
        }
        drop(state);
        if let Some(status) = status {
            (self.publish)(status);
        }
    }
}

impl State {
    /// Writes a chunk to the recording under way, or ends it.
    fn write_chunk(&mut self, chunk: &Chunk) {
        let Phase::Recording(recording) = &mut self.phase else {
            return;
        };
        recording.last_data = Instant::now();
        if recording.until.is_some_and(|until| chunk.at > until) {
            self.end_by_time();
        } else if let Some(writer) = &recording.writer
            && !writer.write(chunk.clone())
        {
            // The writer's thread publishes the reason.
            self.phase = Phase::Idle;
        }
    }

    fn end_by_time(&mut self) {
        if let Phase::Recording(recording) = std::mem::take(&mut self.phase)
            && let Some(writer) = recording.writer
        {
            let s = recording.settings.duration_s.unwrap_or_default();
            self.finishing.push(recording.path);
            writer.finish(&format!("{s} s are over"));
        }
    }

    /// Checks the device's bytes for the armed trigger. If it has come, disarms it and returns the settings and the cause.
    fn check_trigger(&mut self, bytes: &[u8]) -> Option<(RecordSettings, String)> {
        let armed = match &self.phase {
            Phase::Armed { settings, .. } => Some(*settings),
            _ => None,
        };
        let mut trigger = armed.as_ref().map(|settings| &settings.trigger);
        let mut began = None;
        let mut rest = bytes;
        while !rest.is_empty() {
            let (used, is_end) = self.deframer.collect(rest);
            rest = &rest[used..];
            if !is_end {
                continue;
            }
            // All other messages, which are most of the bytes, are skipped undecoded.
            if !matches!(self.deframer.id(), Some(Telemetry::ID | FaultEvent::ID)) {
                self.deframer.skip();
                continue;
            }
            let Some(Ok(frame)) = self.deframer.frame() else {
                continue;
            };
            let cause = match AnyMessage::decode(frame.id, frame.split().1) {
                Ok(AnyMessage::Telemetry(t)) => self.trigger_state.telemetry(t, trigger),
                Ok(AnyMessage::FaultEvent(event)) => self.trigger_state.fault(&event, trigger),
                _ => None,
            };
            if let Some(cause) = cause {
                trigger = None;
                self.phase = Phase::Idle;
                began = armed.map(|settings| (settings, cause));
            }
        }
        began
    }
}

impl Recording {
    /// Returns the metadata of a file that begins at `begins_at`, if the present time is `at`, both on the transport's clock.
    fn notes(&self, begins_at: Duration, at: Duration) -> BTreeMap<String, String> {
        let seconds = |to: Duration, from: Duration| to.as_secs_f64() - from.as_secs_f64();
        let utc = |after: Duration| {
            let ms = now_ms() + (seconds(after, at) * 1e3) as i64;
            jiff::Timestamp::from_millisecond(ms)
                .map_or_else(|_| ms.to_string(), |t| format!("{t:.3}"))
        };
        let mut notes = BTreeMap::from([
            ("began_at".to_owned(), utc(begins_at)),
            ("trigger".to_owned(), self.cause.clone()),
            ("trigger_at".to_owned(), utc(self.triggered_at)),
            (
                "trigger_s".to_owned(),
                format!("{:.6}", seconds(self.triggered_at, begins_at)),
            ),
            (
                "pre_trigger_s".to_owned(),
                self.settings.pre_trigger_s.to_string(),
            ),
        ]);
        if self.part > 1 {
            notes.insert("part".to_owned(), self.part.to_string());
        }
        notes
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

/// Sink of a recorder for the bytes of one connection.
pub struct RecorderSink {
    shared: Arc<Shared>,
    connection: u64,
}

impl FrameSink for RecorderSink {
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

#[cfg(test)]
mod tests;
