//! Recording session of one device: idle, armed, recording; across connections.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use ihd_model::{ActiveRecording, RecordSettings, RecordingPhase, Trigger};
use ihd_shared::wire::messages::{FrontEnd, Hello};

use super::shared::{RecordingOptions, RecordingSink, RecordingStatus, Shared};
use super::state::Phase;
use super::under_way::{OngoingRecording, RecordingLimit};
use super::writer::PendingWrite;

/// Time limit for waiting for the disk at the start and end of a recording.
const DISK_TIMEOUT: Duration = Duration::from_secs(10);

/// Time without data after which the system clock ends a recording instead of the transport's.
const SILENCE_LIMIT: Duration = Duration::from_secs(1);

/// Progress of a recording that has begun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordingProgress {
    /// Seconds of its duration that are over, on the transport's clock.
    pub elapsed_s: f64,
    /// Size of its file in bytes.
    pub bytes: u64,
    /// Limit that is reached; `None` if there is none.
    pub limit: Option<RecordingLimit>,
}

/// Recording session of one device; cheap to clone.
#[derive(Clone)]
pub struct RecordingSession(Arc<Shared>);

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

impl RecordingSession {
    /// Creates a session of a daemon with functions that name its files and publish its status.
    pub fn new(
        name: impl Fn(u32) -> PathBuf + Send + Sync + 'static,
        publish: impl Fn(RecordingStatus) + Send + Sync + 'static,
    ) -> Self {
        Self::with_options(RecordingOptions::default(), name, publish)
    }

    /// Creates a session like [`RecordingSession::new`], with other options.
    pub fn with_options(
        options: RecordingOptions,
        name: impl Fn(u32) -> PathBuf + Send + Sync + 'static,
        publish: impl Fn(RecordingStatus) + Send + Sync + 'static,
    ) -> Self {
        Self(Arc::new(Shared {
            options,
            name: Box::new(name),
            publish: Box::new(publish),
            state: Mutex::default(),
        }))
    }

    /// Starts a connection after the handshake, at `at` on the transport's clock. Returns the sink for the bytes of the link.
    /// A recording under way continues in its next file.
    pub fn connected(&self, hello: &Hello, front_end: &FrontEnd, at: Duration) -> RecordingSink {
        self.disconnected();
        let mut state = self.0.lock();
        state.device = Some((hello.clone(), front_end.clone()));
        state.connection += 1;
        let connection = state.connection;
        let phase = std::mem::take(&mut state.phase);
        if let Phase::Recording(mut recording) = phase {
            let passed = recording.began.elapsed();
            if at < recording.triggered_at {
                // The clock of this transport started later.
                recording.triggered_at = at;
                recording.count_from(at, passed);
            }
            recording.last_data = Instant::now();
            recording.part += 1;
            let cause = format!("goes on in its file {}: the link is back", recording.part);
            self.0.begin_file(&mut state, recording, at, &cause);
        } else {
            state.phase = phase;
        }
        drop(state);
        RecordingSink {
            shared: Arc::clone(&self.0),
            connection,
        }
    }

    /// Ends the connection. A file under way is completed; its recording, and an armed one, wait for the next connection.
    pub fn disconnected(&self) {
        let mut state = self.0.lock();
        state.disconnect();
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
        state.failure = None;
        if settings.trigger != Trigger::Now {
            let before = match settings.pre_trigger_s {
                0.0 => String::new(),
                s => format!(", with {s} s before it"),
            };
            let text = format!("waits for {}{before}", settings.trigger);
            state.phase = Phase::Armed {
                settings,
                since: Instant::now(),
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
        let recording = OngoingRecording::new(settings, at, "by hand");
        let status = self
            .0
            .begin_file(&mut state, recording, at, "begun by hand");
        let pending = match &state.phase {
            Phase::Recording(recording) => recording.pending(),
            _ => None,
        };
        drop(state);
        match status.phase == RecordingPhase::Failed {
            true => Err(status.text),
            false => Ok(StartedRecording {
                file: status.file,
                text: "recording".to_owned(),
                pending,
            }),
        }
    }

    /// Counts the duration of a recording under way from `at` instead of its beginning: its owner has set the device up.
    pub fn count_from(&self, at: Duration) {
        if let Phase::Recording(recording) = &mut self.0.lock().phase {
            recording.count_from(at, Duration::ZERO);
        }
    }

    /// Returns the progress at `at` on the transport's clock; `None` if nothing is under way.
    pub fn progress(&self, at: Duration) -> Option<RecordingProgress> {
        let state = self.0.lock();
        let Phase::Recording(recording) = &state.phase else {
            return None;
        };
        let is_over = recording.until.is_some_and(|until| at >= until);
        Some(RecordingProgress {
            elapsed_s: at.saturating_sub(recording.counts_from).as_secs_f64(),
            bytes: recording.bytes(),
            limit: match is_over {
                true => Some(RecordingLimit::Duration),
                false => recording.exceeded(at),
            },
        })
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
        state.end_by(RecordingLimit::Duration);
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

    /// Returns the reason for which the last recording failed; `None` if it has not.
    pub fn failure(&self) -> Option<String> {
        self.0.lock().failure.clone()
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

/// Returns the last component of a path.
pub fn name_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or(path.as_os_str());
    name.to_string_lossy().into_owned()
}
