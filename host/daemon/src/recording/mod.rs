//! Recordings of a device: begun by hand, by a fault or by a level, with what came before.
//!
//! ```text
//!  link's thread ── pieces ──► Recorder: a ring of the last minute, the trigger (trigger.rs)
//!                                 │ armed ──► begun ──► ended: by time, by hand
//!                                 └ once begun: the ring, then every piece ──► the file's thread (writing.rs)
//! ```
//!
//! A recorder outlives connections. While it is armed it stays so; what happened while the link was away counts with
//! the first half-cycle after. A recording under way goes on in a second file when the link is back.

mod files;
mod ring;
mod tables;
mod trigger;
mod writing;

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use ihd_link::FrameSink;
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::messages::{AnyMessage, FaultEvent, FrontEnd, Hello, Message, Telemetry};

use crate::board::now_ms;
use crate::model::{RecordSettings, RecordingNow, RecordingPhase, Trigger};

pub use files::{file_name, is_plain_name, list};
pub use ihd_capture::exports::recording::TableError;
use ring::{Piece, Ring};
pub use tables::{Table, table};
use trigger::Known;
pub use trigger::LONGEST_PRE_TRIGGER_S;
use writing::{Beginning, Waiting, Writing};

/// How long whoever begins or ends a recording waits for the disk.
const DISK_WITHIN: Duration = Duration::from_secs(10);

/// A link that says nothing for this long does not end a recording by its clock: the wall's does.
const SILENT: Duration = Duration::from_secs(1);

/// What became of a recording, for whoever is told.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Told {
    /// Where it is now.
    pub phase: RecordingPhase,
    /// By what it was begun, or why it ended.
    pub text: String,
    /// Its file, once it has one.
    pub file: Option<PathBuf>,
}

/// Names the next file; the number is 1 for the first one of a recording.
type Name = dyn Fn(u32) -> PathBuf + Send + Sync;

/// Hears what becomes of a recording, on whichever thread it happens; must not wait.
type Tell = dyn Fn(Told) + Send + Sync;

/// The recorder of one device; cheap to clone.
#[derive(Clone)]
pub struct Recorder(Arc<Shared>);

struct Shared {
    name: Box<Name>,
    tell: Box<Tell>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    device: Option<(Hello, FrontEnd)>,
    /// Counts connections: what comes from one that is over is not taken.
    connection: u64,
    ring: Ring,
    deframer: Deframer,
    known: Known,
    /// The device's last byte lay within a frame.
    mid_frame: bool,
    phase: Phase,
    /// Files that nothing comes into any more, and that are not complete yet.
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

/// A recording that has begun.
struct Recording {
    settings: RecordSettings,
    began: Instant,
    /// When its trigger came, and when it ends, on the transport's clock.
    triggered_at: Duration,
    until: Option<Duration>,
    heard: Instant,
    cause: String,
    part: u32,
    path: PathBuf,
    /// None while the link is away.
    writing: Option<Writing>,
}

/// A recording that was asked for.
pub struct Started {
    /// Its file, where it has begun.
    pub file: Option<PathBuf>,
    /// What it waits for, or that it has begun.
    pub text: String,
    waiting: Option<Waiting>,
}

impl Started {
    /// Waits until its file is there.
    ///
    /// # Errors
    /// Why it is not.
    pub fn wait(&self) -> Result<(), String> {
        match &self.waiting {
            Some(waiting) => waiting.begun(DISK_WITHIN),
            None => Ok(()),
        }
    }
}

/// A recording that was ended, or never begun.
pub struct Stopped {
    /// Its file; none where its trigger never came.
    pub file: Option<PathBuf>,
    waiting: Option<Waiting>,
}

impl Stopped {
    /// Waits until its file is complete.
    ///
    /// # Errors
    /// Why it is not.
    pub fn wait(&self) -> Result<(), String> {
        match &self.waiting {
            Some(waiting) => waiting.ended(DISK_WITHIN),
            None => Ok(()),
        }
    }
}

impl Recorder {
    /// A recorder that names its files, and tells what becomes of its recordings, in these ways.
    pub fn new(
        name: impl Fn(u32) -> PathBuf + Send + Sync + 'static,
        tell: impl Fn(Told) + Send + Sync + 'static,
    ) -> Self {
        Self(Arc::new(Shared {
            name: Box::new(name),
            tell: Box::new(tell),
            state: Mutex::default(),
        }))
    }

    /// A device has shaken hands: the bytes of its link go to what is returned, from `at` on the transport's clock. A
    /// recording under way goes on.
    pub fn connected(&self, hello: &Hello, front_end: &FrontEnd, at: Duration) -> RecorderSink {
        self.disconnected();
        let mut state = self.0.lock();
        state.device = Some((hello.clone(), front_end.clone()));
        state.connection += 1;
        let connection = state.connection;
        let mut told = None;
        let phase = std::mem::take(&mut state.phase);
        if let Phase::Recording(mut recording) = phase {
            let passed = recording.began.elapsed();
            if at < recording.triggered_at {
                // Another clock than before.
                recording.triggered_at = at;
                let left = |s: f64| Duration::from_secs_f64(s).saturating_sub(passed);
                recording.until = recording.settings.duration_s.map(|s| at + left(s));
            }
            recording.heard = Instant::now();
            recording.part += 1;
            let cause = format!("goes on in its file {}: the link is back", recording.part);
            told = Some(self.0.begin_file(&mut state, recording, at, &cause));
        } else {
            state.phase = phase;
        }
        drop(state);
        if let Some(told) = told {
            (self.0.tell)(told);
        }
        RecorderSink {
            shared: Arc::clone(&self.0),
            connection,
        }
    }

    /// The link is gone. A file under way is completed; its recording, and one that is armed, wait for the link.
    pub fn disconnected(&self) {
        let mut state = self.0.lock();
        state.device = None;
        state.connection += 1;
        state.ring.clear();
        state.deframer = Deframer::new();
        state.mid_frame = false;
        if let Phase::Recording(recording) = &mut state.phase
            && let Some(writing) = recording.writing.take()
        {
            let path = recording.path.clone();
            state.finishing.push(path);
            writing.finish("the link went away; it goes on in a second file when that is back");
        }
    }

    /// Begins a recording, or waits for its trigger from now on, which is `at` on the transport's clock.
    ///
    /// # Errors
    /// Settings that cannot be, one that is armed or under way already, or no device.
    pub fn start(&self, settings: RecordSettings, at: Duration) -> Result<Started, String> {
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
            (self.0.tell)(Told {
                phase: RecordingPhase::Armed,
                text: text.clone(),
                file: None,
            });
            return Ok(Started {
                file: None,
                text,
                waiting: None,
            });
        }
        let recording = Recording {
            settings,
            began: now,
            triggered_at: at,
            until: until.map(|s| at + Duration::from_secs_f64(s)),
            heard: now,
            cause: "by hand".to_owned(),
            part: 1,
            path: PathBuf::new(),
            writing: None,
        };
        let told = self
            .0
            .begin_file(&mut state, Box::new(recording), at, "begun by hand");
        let waiting = match &state.phase {
            Phase::Recording(recording) => recording.writing.as_ref().map(|w| w.waiting.clone()),
            _ => None,
        };
        drop(state);
        let (file, failed) = (told.file.clone(), told.phase == RecordingPhase::Failed);
        let text = told.text.clone();
        (self.0.tell)(told);
        match failed {
            true => Err(text),
            false => Ok(Started {
                file,
                text: "recording".to_owned(),
                waiting,
            }),
        }
    }

    /// Ends the recording, or waits no longer for its trigger.
    ///
    /// # Errors
    /// Where there is none.
    pub fn stop(&self, why: &str) -> Result<Stopped, String> {
        let mut state = self.0.lock();
        match std::mem::take(&mut state.phase) {
            Phase::Idle => Err("nothing is being recorded".to_owned()),
            Phase::Armed { settings, .. } => {
                drop(state);
                let text = format!("{why}: {} did not come", settings.trigger);
                (self.0.tell)(Told {
                    phase: RecordingPhase::Disarmed,
                    text,
                    file: None,
                });
                Ok(Stopped {
                    file: None,
                    waiting: None,
                })
            }
            Phase::Recording(recording) => {
                let path = recording.path;
                let waiting = recording.writing.map(|writing| {
                    state.finishing.push(path.clone());
                    writing.finish(why)
                });
                Ok(Stopped {
                    file: Some(path),
                    waiting,
                })
            }
        }
    }

    /// Ends by the wall's clock what a silent link does not end.
    pub fn tick(&self) {
        let mut state = self.0.lock();
        let Phase::Recording(recording) = &state.phase else {
            return;
        };
        let is_over = |s| recording.began.elapsed().as_secs_f64() >= s;
        let is_silent = recording.writing.is_none() || recording.heard.elapsed() >= SILENT;
        if !is_silent || !recording.settings.duration_s.is_some_and(is_over) {
            return;
        }
        let away = recording.writing.is_none().then(|| Told {
            phase: RecordingPhase::Ended,
            text: "its time is over, and the link is not back".to_owned(),
            file: Some(recording.path.clone()),
        });
        state.end_by_time();
        drop(state);
        if let Some(told) = away {
            (self.0.tell)(told);
        }
    }

    /// What is armed or under way.
    pub fn now(&self) -> Option<RecordingNow> {
        let state = self.0.lock();
        let (settings, since, file) = match &state.phase {
            Phase::Idle => return None,
            Phase::Armed { settings, since } => (*settings, *since, None),
            Phase::Recording(r) => (r.settings, r.began, Some(name_of(&r.path))),
        };
        Some(RecordingNow {
            settings,
            file,
            since_s: since.elapsed().as_secs_f64(),
        })
    }

    /// The files that are not complete.
    pub fn incomplete(&self) -> Vec<PathBuf> {
        let mut files = self.0.lock().finishing.clone();
        files.extend(self.path());
        files
    }

    /// The file that is being written.
    pub fn path(&self) -> Option<PathBuf> {
        match &self.0.lock().phase {
            Phase::Recording(r) if r.writing.is_some() => Some(r.path.clone()),
            _ => None,
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        // Every change is complete in itself.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The last part of a path.
pub fn name_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or(path.as_os_str());
    name.to_string_lossy().into_owned()
}

impl Shared {
    /// Begins the recording's next file at `at`; what is to be told.
    fn begin_file(
        self: &Arc<Self>,
        state: &mut State,
        mut recording: Box<Recording>,
        at: Duration,
        cause: &str,
    ) -> Told {
        let mut before = Vec::new();
        if recording.part == 1 {
            let pre_trigger = Duration::from_secs_f64(recording.settings.pre_trigger_s);
            before = state.ring.since(at.saturating_sub(pre_trigger));
        }
        let begins_at = before.first().map_or(at, |first| first.at);
        recording.path = (self.name)(recording.part);
        let path = recording.path.clone();
        let failed = |why: String| Told {
            phase: RecordingPhase::Failed,
            text: why,
            file: Some(path.clone()),
        };
        let Some((hello, front_end)) = state.device.clone() else {
            return failed("the device is not connected".to_owned());
        };
        let beginning = Beginning {
            path: path.clone(),
            hello,
            front_end,
            notes: recording.notes(begins_at, at),
            at: begins_at,
            before,
            mid_frame: state.mid_frame,
        };
        let (shared, written) = (Arc::downgrade(self), path.clone());
        match Writing::begin(beginning, move |ended| has_ended(&shared, &written, ended)) {
            Err(why) => failed(why),
            Ok(writing) => {
                recording.writing = Some(writing);
                state.phase = Phase::Recording(recording);
                Told {
                    phase: RecordingPhase::Begun,
                    text: cause.to_owned(),
                    file: Some(path),
                }
            }
        }
    }

    fn take(self: &Arc<Self>, connection: u64, at: Duration, from_device: bool, bytes: &[u8]) {
        let mut state = self.lock();
        if state.connection != connection {
            return;
        }
        let piece = Piece {
            at,
            from_device,
            mid_frame: from_device && state.mid_frame,
            bytes: bytes.into(),
        };
        state.record(&piece);
        state.ring.push(piece);
        let mut told = None;
        if from_device {
            state.mid_frame = bytes.last().map_or(state.mid_frame, |&b| b != 0);
            if let Some((settings, cause)) = state.judge(bytes) {
                let recording = Box::new(Recording {
                    settings,
                    began: Instant::now(),
                    triggered_at: at,
                    until: settings.duration_s.map(|s| at + Duration::from_secs_f64(s)),
                    heard: Instant::now(),
                    cause: cause.clone(),
                    part: 1,
                    path: PathBuf::new(),
                    writing: None,
                });
                let cause = format!("begun by {cause}");
                told = Some(self.begin_file(&mut state, recording, at, &cause));
            }
        }
        drop(state);
        if let Some(told) = told {
            (self.tell)(told);
        }
    }
}

impl State {
    /// A piece for the recording under way, or its end.
    fn record(&mut self, piece: &Piece) {
        let Phase::Recording(recording) = &mut self.phase else {
            return;
        };
        recording.heard = Instant::now();
        if recording.until.is_some_and(|until| piece.at > until) {
            self.end_by_time();
        } else if let Some(writing) = &recording.writing
            && !writing.take(piece.clone())
        {
            // Its thread tells why.
            self.phase = Phase::Idle;
        }
    }

    fn end_by_time(&mut self) {
        if let Phase::Recording(recording) = std::mem::take(&mut self.phase)
            && let Some(writing) = recording.writing
        {
            let s = recording.settings.duration_s.unwrap_or_default();
            self.finishing.push(recording.path);
            writing.finish(&format!("{s} s are over"));
        }
    }

    /// Looks at what the device says; where that begins a recording, the armed settings and why. It is armed no more.
    fn judge(&mut self, bytes: &[u8]) -> Option<(RecordSettings, String)> {
        let armed = match &self.phase {
            Phase::Armed { settings, .. } => Some(*settings),
            _ => None,
        };
        let mut trigger = armed.as_ref().map(|settings| &settings.trigger);
        let mut began = None;
        let mut rest = bytes;
        while !rest.is_empty() {
            let (taken, is_end) = self.deframer.collect(rest);
            rest = &rest[taken..];
            if !is_end {
                continue;
            }
            // Of all others, which are most of the bytes, nothing is wanted.
            if !matches!(self.deframer.id(), Some(Telemetry::ID | FaultEvent::ID)) {
                self.deframer.skip();
                continue;
            }
            let Some(Ok(frame)) = self.deframer.frame() else {
                continue;
            };
            let cause = match AnyMessage::decode(frame.id, frame.split().1) {
                Ok(AnyMessage::Telemetry(t)) => self.known.telemetry(t, trigger),
                Ok(AnyMessage::FaultEvent(event)) => self.known.fault(&event, trigger),
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
    /// What a file that begins at `begins_at` tells of itself when it is `at`.
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

/// A file is complete, or failed: its recording is over where it went on into it.
fn has_ended(shared: &Weak<Shared>, path: &Path, ended: &Result<String, String>) {
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
            && recording.writing.is_some()
        {
            state.phase = Phase::Idle;
        }
    }
    (shared.tell)(Told {
        phase,
        text: text.clone(),
        file: Some(path.to_owned()),
    });
}

/// The end of a link that a recorder listens at.
pub struct RecorderSink {
    shared: Arc<Shared>,
    connection: u64,
}

impl FrameSink for RecorderSink {
    fn received(&mut self, at: Duration, bytes: &[u8]) -> io::Result<()> {
        self.shared.take(self.connection, at, true, bytes);
        Ok(())
    }

    fn sent(&mut self, at: Duration, frame: &[u8]) -> io::Result<()> {
        self.shared.take(self.connection, at, false, frame);
        Ok(())
    }

    fn finish(self: Box<Self>) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests;
