//! Commands on their way to the audit: each behind the answer that it was given, in their order.
//!
//! A command never waits for the disk. What the store cannot write is tried again until it can; what is dropped, because too many wait or
//! the daemon stops, is counted.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

use crate::daemon::lock;
use crate::face::Face;
use crate::model::Record;
use crate::store_thread::{StoreThread, StoreTrouble};

/// Commands that may wait: with a database that is locked for ten minutes, two a second.
const WAITING: usize = 1_024;

/// Between two tries of what the store could not write.
const TRY_AGAIN: Duration = Duration::from_secs(5);

/// A command, and what became of it.
#[derive(Clone)]
struct Audit {
    at_ms: i64,
    device: String,
    address: String,
    holder: String,
    command: String,
    outcome: String,
}

/// State of the audit.
#[derive(Default)]
struct Gauge {
    lost: AtomicU64,
    is_late: AtomicBool,
}

impl Gauge {
    fn lose(&self, why: &str) {
        if self.lost.fetch_add(1, Ordering::Relaxed) == 0 {
            tracing::error!(
                why,
                "a command is missing in the audit; others are counted alone"
            );
        }
    }
}

/// The way of commands to the audit.
pub struct Auditor {
    commands: Mutex<Option<mpsc::Sender<Audit>>>,
    writing: Mutex<Option<JoinHandle<()>>>,
    gauge: Arc<Gauge>,
}

impl Auditor {
    /// Starts to write into this store.
    pub fn start(store: StoreThread, stopped: watch::Receiver<bool>) -> Self {
        let (commands, waiting) = mpsc::channel(WAITING);
        let gauge = Arc::new(Gauge::default());
        let writer = Writer {
            store,
            stopped,
            gauge: Arc::clone(&gauge),
        };
        Self {
            commands: Mutex::new(Some(commands)),
            writing: Mutex::new(Some(tokio::spawn(writer.run(waiting)))),
            gauge,
        }
    }

    /// Takes a command that was answered; never waits.
    pub fn take(&self, face: &Face, holder: String, command: String, outcome: String) {
        let audit = Audit {
            at_ms: face.board.now_ms(),
            device: face.name.clone(),
            address: face.address.clone(),
            holder,
            command,
            outcome,
        };
        let commands = lock(&self.commands);
        let has_room = |commands: &mpsc::Sender<Audit>| commands.try_send(audit).is_ok();
        if !commands.as_ref().is_some_and(has_room) {
            self.gauge.lose("too many wait for the store");
        }
    }

    /// Commands that the audit does not have and will not get.
    pub fn lost(&self) -> u64 {
        self.gauge.lost.load(Ordering::Relaxed)
    }

    /// Returns `true` if all commands so far are written, or on their way to a store that writes.
    pub fn is_well(&self) -> bool {
        self.lost() == 0 && !self.gauge.is_late.load(Ordering::Relaxed)
    }

    /// Takes no more, and writes what waits, as far as the store can; the daemon has to be stopping.
    pub async fn close(&self) {
        lock(&self.commands).take();
        let writing = lock(&self.writing).take();
        if let Some(writing) = writing {
            // Its panics are told where they happen.
            let _ = writing.await;
        }
    }
}

struct Writer {
    store: StoreThread,
    stopped: watch::Receiver<bool>,
    gauge: Arc<Gauge>,
}

impl Writer {
    async fn run(self, mut waiting: mpsc::Receiver<Audit>) {
        while let Some(audit) = waiting.recv().await {
            while let Err(error) = self.write(audit.clone()).await {
                let is_first = !self.gauge.is_late.swap(true, Ordering::Relaxed);
                if is_first {
                    tracing::error!(%error, "audit: commands wait to be written");
                }
                if *self.stopped.borrow() || !matches!(error, StoreTrouble::Store(_)) {
                    self.gauge.lose(&error.to_string());
                    break;
                }
                let mut stopped = self.stopped.clone();
                // Ends at once when the daemon stops.
                let _ = tokio::time::timeout(TRY_AGAIN, stopped.wait_for(|&stopped| stopped)).await;
            }
            if *self.stopped.borrow() && self.gauge.is_late.load(Ordering::Relaxed) {
                // Each would take as long to fail.
                while waiting.recv().await.is_some() {
                    self.gauge
                        .lose("the store could not write when the daemon stopped");
                }
            }
        }
    }

    async fn write(&self, audit: Audit) -> Result<(), StoreTrouble> {
        let write = move |store: &mut ihd_store::Store| {
            let device = store.device(&audit.device, &audit.address)?;
            let Audit {
                at_ms,
                holder,
                command,
                outcome,
                ..
            } = &audit;
            store.audit(*at_ms, Some(device), holder, command, outcome)
        };
        let store = self.store.writing(Record::Audits);
        store.run(write).await?;
        if self.gauge.is_late.swap(false, Ordering::Relaxed) {
            tracing::info!("audit: commands are written again");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use ihd_store::{Reader, Settings, Store};

    use super::*;
    use crate::board::Board;
    use crate::machine::Machine;
    use crate::recording::Recorder;

    /// Longest wait for another thread; it only ends a hang.
    const PATIENCE: Duration = Duration::from_secs(300);

    async fn until(wanted: impl Fn() -> bool) {
        let began = Instant::now();
        while !wanted() {
            assert!(began.elapsed() < PATIENCE, "it does not happen");
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    #[tokio::test(start_paused = true)]
    async fn what_the_store_cannot_write_is_written_later_or_counted() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path(), &Settings::default()).unwrap();
        let store = StoreThread::start(store.store, Board::default(), &Machine::default()).unwrap();
        let (stop, stopped) = watch::channel(false);
        let auditor = Auditor::start(store.clone(), stopped);
        let recorder = Recorder::new(|_| panic!("nothing is recorded"), |_| ());
        let face = Face::new("hob".into(), "sim".into(), Board::default(), recorder);
        let take = |command: &str| auditor.take(&face, "a".into(), command.into(), "done".into());
        let database = rusqlite::Connection::open(folder.path().join("ihd.db")).unwrap();
        let break_it = || database.execute_batch("ALTER TABLE audit RENAME TO elsewhere");
        let mend_it = || database.execute_batch("ALTER TABLE elsewhere RENAME TO audit");
        let written = || {
            let rows = Reader::open(folder.path()).unwrap().audit(10).unwrap();
            let commands = rows.into_iter().rev().map(|row| row.command);
            commands.collect::<Vec<_>>()
        };
        break_it().unwrap();
        take("first");
        take("second");
        until(|| !auditor.is_well()).await;
        mend_it().unwrap();
        until(|| auditor.is_well()).await;
        take("third");
        until(|| written().len() == 3).await;
        assert_eq!(written(), ["first", "second", "third"]);
        assert_eq!(auditor.lost(), 0);

        break_it().unwrap();
        for _ in 0..WAITING + 10 {
            take("never");
        }
        assert!(auditor.lost() >= 9, "there is no room for all");
        stop.send_replace(true);
        auditor.close().await;
        assert_eq!(auditor.lost(), WAITING as u64 + 10);
        take("after the end");
        assert_eq!(auditor.lost(), WAITING as u64 + 11);
        mend_it().unwrap();
        assert_eq!(written().len(), 3);
        store.close().await;
    }
}
