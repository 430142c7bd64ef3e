//! Writer of a recording's file, on a thread of its own, so that a slow disk does not delay the link.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use ihd_link::{FrameAligner, FrameSink};
use ihd_shared::wire::messages::{FrontEnd, Hello};

use super::ring::ByteChunk;
use crate::mcap::{McapFileError, SessionRecorder};

/// Largest number of bytes waiting for the disk, beside the pre-trigger: a minute of a heating hob.
const MAX_WAITING: usize = 16 << 20;

/// Time limit for a chunk to be written.
const WRITTEN_TIMEOUT: Duration = Duration::from_secs(60);

/// Least free room, in bytes, on the disk of a recording without a limit of its own, and of an export.
pub const MIN_FREE_BYTES: u64 = 500_000_000;

/// Bytes written between two looks at the free room.
const ROOM_CHECK_BYTES: usize = 4 << 20;

/// Function that returns the free bytes of a folder's disk; `None` if they are not known.
pub type FreeBytes = fn(&Path) -> Option<u64>;

/// Path, metadata and pre-trigger of a new file.
pub struct FileStart {
    /// Path of the file.
    pub path: PathBuf,
    /// Identity of the device.
    pub hello: Hello,
    /// Scales of its ADC codes.
    pub front_end: FrontEnd,
    /// Metadata of the recording.
    pub notes: BTreeMap<String, String>,
    /// Start of the file on the transport's clock.
    pub at: Duration,
    /// Chunks before the trigger.
    pub before: Vec<ByteChunk>,
    /// `true` if the next chunk starts within a frame.
    pub mid_frame: bool,
    /// `true` to flush by the system's clock, too.
    pub wall_clock_flush: bool,
    /// Free room of the disk, below [`MIN_FREE_BYTES`] of which the file ends; `None` if it is not looked at.
    pub free_bytes: Option<FreeBytes>,
}

/// Progress of a file.
#[derive(Clone, Debug, Default)]
struct Progress {
    /// Size of the file; `None` until it has begun, with its pre-trigger.
    size: Option<Arc<AtomicU64>>,
    /// Number of bytes waiting for the disk.
    waiting: usize,
    /// `true` if more than [`MAX_WAITING`] have waited.
    overrun: bool,
    /// Reason for the end, or for the failure; `None` while it is being written.
    ended: Option<Result<String, String>>,
}

/// Progress of a file, to wait for.
#[derive(Clone, Default)]
pub struct PendingWrite(Arc<(Mutex<Progress>, Condvar)>);

impl PendingWrite {
    fn lock(&self) -> MutexGuard<'_, Progress> {
        self.0.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn update(&self, change: impl FnOnce(&mut Progress)) {
        change(&mut self.lock());
        self.0.1.notify_all();
    }

    /// Waits until `ready` returns a value; `None` after `timeout`.
    fn wait_for<T>(&self, timeout: Duration, ready: impl Fn(&Progress) -> Option<T>) -> Option<T> {
        let deadline = Instant::now() + timeout;
        let mut now = self.lock();
        loop {
            if let Some(value) = ready(&now) {
                return Some(value);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            let woken = self.0.1.wait_timeout(now, left);
            now = woken.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Waits until the file has begun.
    ///
    /// # Errors
    /// Reason of the failure, or of the timeout.
    pub fn wait_begun(&self, timeout: Duration) -> Result<(), String> {
        let begun = self.wait_for(timeout, |p| match (&p.ended, p.size.is_some()) {
            (Some(Err(why)), _) => Some(Err(why.clone())),
            (_, true) | (Some(Ok(_)), _) => Some(Ok(())),
            _ => None,
        });
        begun.unwrap_or_else(|| Err(timeout_text(timeout)))
    }

    /// Waits until all that was given is written, the file has ended, or a minute is over.
    pub fn wait_written(&self) {
        let written =
            |p: &Progress| (p.ended.is_some() || p.size.is_some() && p.waiting == 0).then_some(());
        self.wait_for(WRITTEN_TIMEOUT, written);
    }

    /// Waits until the file is complete.
    ///
    /// # Errors
    /// Reason of the failure, or of the timeout.
    pub fn wait_complete(&self, timeout: Duration) -> Result<(), String> {
        let ended = self.wait_for(timeout, |p| p.ended.clone());
        ended
            .unwrap_or_else(|| Err(timeout_text(timeout)))
            .map(drop)
    }
}

fn timeout_text(timeout: Duration) -> String {
    format!(
        "the disk has not taken it within {} s; it is still being written",
        timeout.as_secs()
    )
}

/// Job of a file's thread.
enum Job {
    Chunk(ByteChunk),
    End(String),
}

/// Writer of a file.
pub struct RecordingWriter {
    jobs: mpsc::Sender<Job>,
    /// Progress of the file.
    pub pending: PendingWrite,
}

impl RecordingWriter {
    /// Begins a file. `on_end` is called with the outcome, on the file's thread.
    ///
    /// # Errors
    /// The thread could not be started.
    pub fn begin(
        start: FileStart,
        on_end: impl FnOnce(&Result<String, String>) + Send + 'static,
    ) -> Result<Self, String> {
        let (jobs, received) = mpsc::channel();
        let writer = Self {
            jobs,
            pending: PendingWrite::default(),
        };
        let pending = writer.pending.clone();
        let serve = move || {
            let written = write(start, &pending, &received);
            on_end(&written);
            pending.update(|progress| progress.ended = Some(written));
        };
        let started = thread::Builder::new()
            .name("ihd-recording".into())
            .spawn(serve);
        started.map_err(|e| format!("no thread could be started for the file: {e}"))?;
        Ok(writer)
    }

    /// Writes a chunk without waiting. Returns `false` if the file has ended or the disk is too slow; `on_end` gets the reason.
    pub fn write(&self, chunk: ByteChunk) -> bool {
        {
            let mut progress = self.pending.lock();
            if progress.waiting > MAX_WAITING {
                progress.overrun = true;
                return false;
            }
            progress.waiting += chunk.bytes.len();
        }
        self.jobs.send(Job::Chunk(chunk)).is_ok()
    }

    /// Size of the file in bytes.
    pub fn bytes(&self) -> u64 {
        let size = self.pending.lock().size.clone();
        size.map_or(0, |size| size.load(Ordering::Relaxed))
    }

    /// Completes the file, for this reason. Returns its progress.
    pub fn finish(self, why: &str) -> PendingWrite {
        // Fails only if the thread has ended, which it has reported.
        let _ = self.jobs.send(Job::End(why.to_owned()));
        self.pending
    }
}

fn write(
    start: FileStart,
    pending: &PendingWrite,
    received: &mpsc::Receiver<Job>,
) -> Result<String, String> {
    let FileStart {
        path,
        hello,
        front_end,
        notes,
        at,
        before,
        mid_frame,
        wall_clock_flush,
        free_bytes,
    } = start;
    let has_room = || {
        let free = free_bytes.and_then(|free| free(path.parent().unwrap_or(&path)));
        free.is_none_or(|bytes| bytes >= MIN_FREE_BYTES)
    };
    let file = create(&path, &hello, &front_end, notes).map_err(|e| e.to_string())?;
    let mut file = file.starting_at(at);
    if wall_clock_flush {
        file = file.with_wall_clock_flush();
    }
    let size = file.size();
    let first = before.iter().find(|chunk| chunk.from_device);
    let mut file = AlignedFile {
        file: Box::new(file),
        aligner: FrameAligner::new(first.map_or(mid_frame, |first| first.mid_frame)),
    };
    // The error names the file.
    let text = |e: std::io::Error| e.to_string();
    for chunk in before {
        file.write(&chunk).map_err(text)?;
    }
    pending.update(|progress| progress.size = Some(size));
    let mut unchecked = ROOM_CHECK_BYTES;
    let why = loop {
        if unchecked >= ROOM_CHECK_BYTES {
            if !has_room() {
                break no_room_text();
            }
            unchecked = 0;
        }
        match received.recv() {
            Ok(Job::Chunk(chunk)) => {
                file.write(&chunk).map_err(text)?;
                unchecked += chunk.bytes.len();
                pending.update(|progress| progress.waiting -= chunk.bytes.len());
            }
            Ok(Job::End(why)) => break why,
            // The writer was dropped without an end.
            Err(_) => break "its recorder is gone".to_owned(),
        }
    };
    file.file.finish().map_err(text)?;
    match pending.lock().overrun {
        true => Err(format!(
            "{}: the disk is too slow: {} MB waited for it, and what came after is missing",
            path.display(),
            MAX_WAITING >> 20
        )),
        false => Ok(why),
    }
}

fn no_room_text() -> String {
    format!(
        "less than {} MB are free on its disk: free some, or give the recording a duration or a size",
        MIN_FREE_BYTES / 1_000_000
    )
}

/// Creates a file. If that fails, no file is left.
fn create(
    path: &Path,
    hello: &Hello,
    front_end: &FrontEnd,
    notes: BTreeMap<String, String>,
) -> Result<SessionRecorder, McapFileError> {
    if let Some(folder) = path.parent() {
        // If this fails, creating the file fails, too, with the reason.
        let _ = fs::create_dir_all(folder);
    }
    let created = SessionRecorder::with_notes(path, hello, front_end, notes);
    created.inspect_err(|error| {
        if !matches!(error, McapFileError::Exists { .. }) {
            let _ = fs::remove_file(path);
        }
    })
}

/// File that begins with a whole frame of the device.
struct AlignedFile {
    file: Box<SessionRecorder>,
    aligner: FrameAligner,
}

impl AlignedFile {
    fn write(&mut self, chunk: &ByteChunk) -> std::io::Result<()> {
        if !chunk.from_device {
            return self.file.sent(chunk.at, &chunk.bytes);
        }
        match self.aligner.whole_frames(&chunk.bytes) {
            [] => Ok(()),
            whole => self.file.received(chunk.at, whole),
        }
    }
}
