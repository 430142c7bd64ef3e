//! A file being written, on a thread of its own: a slow disk costs the recording, not the link.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use ihd_capture::mcap::{McapFileError, SessionRecorder};
use ihd_link::FrameSink;
use ihd_shared::wire::messages::{FrontEnd, Hello};

use super::ring::Piece;

/// Bytes that may wait for the disk, beside those of before the trigger: a minute of a hob that heats.
const MOST_WAITING: usize = 16 << 20;

/// What is to be written, and where.
pub struct Beginning {
    /// The file.
    pub path: PathBuf,
    /// Who the device is.
    pub hello: Hello,
    /// What its codes stand for.
    pub front_end: FrontEnd,
    /// What the file tells of itself.
    pub notes: BTreeMap<String, String>,
    /// Its beginning on the transport's clock.
    pub at: Duration,
    /// What came before the trigger.
    pub before: Vec<Piece>,
    /// What comes next begins within a frame.
    pub mid_frame: bool,
}

/// How far a file is.
#[derive(Clone, Debug, Default)]
struct Progress {
    begun: bool,
    /// Why it ended, or why it failed.
    ended: Option<Result<String, String>>,
}

/// Whoever waits for a file.
#[derive(Clone, Default)]
pub struct Waiting(Arc<(Mutex<Progress>, Condvar)>);

impl Waiting {
    fn tell(&self, change: impl FnOnce(&mut Progress)) {
        let (progress, told) = &*self.0;
        change(&mut progress.lock().unwrap_or_else(PoisonError::into_inner));
        told.notify_all();
    }

    fn until<T>(&self, within: Duration, found: impl Fn(&Progress) -> Option<T>) -> Option<T> {
        let (progress, told) = &*self.0;
        let deadline = Instant::now() + within;
        let mut now = progress.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            if let Some(found) = found(&now) {
                return Some(found);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            let woken = told.wait_timeout(now, left);
            now = woken.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Waits until the file is there, or why it is not.
    pub fn begun(&self, within: Duration) -> Result<(), String> {
        let begun = self.until(within, |p| match (&p.ended, p.begun) {
            (Some(Err(why)), _) => Some(Err(why.clone())),
            (_, true) | (Some(Ok(_)), _) => Some(Ok(())),
            _ => None,
        });
        begun.unwrap_or_else(|| Err(slow(within)))
    }

    /// Waits until the file is complete, or why it is not.
    pub fn ended(&self, within: Duration) -> Result<(), String> {
        let ended = self.until(within, |p| p.ended.clone());
        ended.unwrap_or_else(|| Err(slow(within))).map(drop)
    }
}

fn slow(within: Duration) -> String {
    format!(
        "the disk has not taken it within {} s; it is still being written",
        within.as_secs()
    )
}

/// What a file's thread is told.
enum Job {
    Take(Piece),
    End(String),
}

/// A file being written.
pub struct Writing {
    jobs: mpsc::Sender<Job>,
    waiting_bytes: Arc<AtomicUsize>,
    overrun: Arc<AtomicBool>,
    /// For whoever waits for it.
    pub waiting: Waiting,
}

impl Writing {
    /// Begins; `on_end` hears what became of it, on the file's thread.
    ///
    /// # Errors
    /// Where there is no thread to be had.
    pub fn begin(
        beginning: Beginning,
        on_end: impl FnOnce(&Result<String, String>) + Send + 'static,
    ) -> Result<Self, String> {
        let (jobs, coming) = mpsc::channel();
        let writing = Self {
            jobs,
            waiting_bytes: Arc::default(),
            overrun: Arc::default(),
            waiting: Waiting::default(),
        };
        let (waiting, bytes) = (writing.waiting.clone(), Arc::clone(&writing.waiting_bytes));
        let overrun = Arc::clone(&writing.overrun);
        let serve = move || {
            let written = write(beginning, &waiting, &coming, &bytes, &overrun);
            on_end(&written);
            waiting.tell(|progress| progress.ended = Some(written));
        };
        let started = thread::Builder::new()
            .name("ihd-recording".into())
            .spawn(serve);
        started.map_err(|e| format!("no thread could be started for the file: {e}"))?;
        Ok(writing)
    }

    /// Takes what came next; false when the file has no more room or the disk is too slow, which its end tells.
    pub fn take(&self, piece: Piece) -> bool {
        let bytes = piece.bytes.len();
        if self.waiting_bytes.fetch_add(bytes, Ordering::Relaxed) > MOST_WAITING {
            self.overrun.store(true, Ordering::Relaxed);
            return false;
        }
        self.jobs.send(Job::Take(piece)).is_ok()
    }

    /// Nothing comes any more, for a reason: the file is completed.
    pub fn finish(self, why: &str) -> Waiting {
        // A thread that has failed says so itself.
        let _ = self.jobs.send(Job::End(why.to_owned()));
        self.waiting
    }
}

fn write(
    beginning: Beginning,
    waiting: &Waiting,
    coming: &mpsc::Receiver<Job>,
    waiting_bytes: &AtomicUsize,
    overrun: &AtomicBool,
) -> Result<String, String> {
    let Beginning {
        path,
        hello,
        front_end,
        notes,
        at,
        before,
        mid_frame,
    } = beginning;
    let file = create(&path, &hello, &front_end, notes).map_err(|e| e.to_string())?;
    let first = before.iter().find(|piece| piece.from_device);
    let mut file = Feed {
        file: Box::new(file.starting_at(at).with_wall_clock_flush()),
        in_step: !first.map_or(mid_frame, |first| first.mid_frame),
    };
    waiting.tell(|progress| progress.begun = true);
    // It names the file.
    let words = |e: std::io::Error| e.to_string();
    for piece in before {
        file.take(&piece).map_err(words)?;
    }
    let why = loop {
        match coming.recv() {
            Ok(Job::Take(piece)) => {
                waiting_bytes.fetch_sub(piece.bytes.len(), Ordering::Relaxed);
                file.take(&piece).map_err(words)?;
            }
            Ok(Job::End(why)) => break why,
            // Nobody can say any more.
            Err(_) => break "its recorder is gone".to_owned(),
        }
    };
    file.file.finish().map_err(words)?;
    match overrun.load(Ordering::Relaxed) {
        true => Err(format!(
            "{}: the disk is too slow: {} MB waited for it, and what came after is missing",
            path.display(),
            MOST_WAITING >> 20
        )),
        false => Ok(why),
    }
}

/// A file that could not be begun is not left behind.
fn create(
    path: &Path,
    hello: &Hello,
    front_end: &FrontEnd,
    notes: BTreeMap<String, String>,
) -> Result<SessionRecorder, McapFileError> {
    if let Some(folder) = path.parent() {
        // Creating the file says why it cannot be.
        let _ = fs::create_dir_all(folder);
    }
    let created = SessionRecorder::with_notes(path, hello, front_end, notes);
    created.inspect_err(|error| {
        if !matches!(error, McapFileError::Exists { .. }) {
            let _ = fs::remove_file(path);
        }
    })
}

/// The file from its first whole frame on.
struct Feed {
    file: Box<SessionRecorder>,
    in_step: bool,
}

impl Feed {
    fn take(&mut self, piece: &Piece) -> std::io::Result<()> {
        if !piece.from_device {
            return self.file.sent(piece.at, &piece.bytes);
        }
        let mut bytes = &piece.bytes[..];
        if !self.in_step {
            let Some(end) = bytes.iter().position(|&b| b == 0) else {
                return Ok(());
            };
            self.in_step = true;
            bytes = &bytes[end + 1..];
        }
        match bytes.is_empty() {
            true => Ok(()),
            false => self.file.received(piece.at, bytes),
        }
    }
}
