//! Queue of commands for the audit, written in order after each response.
//!
//! A command never waits for the disk. A failed write is retried until it succeeds. Commands dropped because the queue is full or the
//! daemon stops are counted.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use ihd_model::RecordKind;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

use crate::device_record::DeviceRecord;
use crate::locking::lock;
use crate::store_thread::{StoreThread, StoreThreadError};

/// Capacity of the queue: two commands per second while the database is locked for ten minutes.
const CAPACITY: usize = 1_024;

/// Pause before a failed write is retried.
const RETRY_DELAY: Duration = Duration::from_secs(5);

/// Audit entry: a command and its outcome.
#[derive(Clone)]
struct Audit {
    at_ms: i64,
    device: String,
    address: String,
    holder: String,
    command: String,
    outcome: String,
}

/// State of the audit, shared with the writer.
#[derive(Default)]
struct AuditState {
    lost: AtomicU64,
    is_late: AtomicBool,
}

impl AuditState {
    fn count_lost(&self, why: &str) {
        if self.lost.fetch_add(1, Ordering::Relaxed) == 0 {
            tracing::error!(
                why,
                "a command is missing in the audit; others are counted alone"
            );
        }
    }
}

/// Writer of the audit, on a task of its own.
pub struct Auditor {
    commands: Mutex<Option<mpsc::Sender<Audit>>>,
    writing: Mutex<Option<JoinHandle<()>>>,
    state: Arc<AuditState>,
}

impl Auditor {
    /// Starts the writing task.
    pub fn start(store: StoreThread, stopped: watch::Receiver<bool>) -> Self {
        let (commands, waiting) = mpsc::channel(CAPACITY);
        let state = Arc::new(AuditState::default());
        let writer = Writer {
            store,
            stopped,
            state: Arc::clone(&state),
        };
        Self {
            commands: Mutex::new(Some(commands)),
            writing: Mutex::new(Some(tokio::spawn(writer.run(waiting)))),
            state,
        }
    }

    /// Queues an answered command; never waits.
    pub fn record(&self, device: &DeviceRecord, holder: String, command: String, outcome: String) {
        let audit = Audit {
            at_ms: device.event_bus.now_ms(),
            device: device.name.clone(),
            address: device.address.clone(),
            holder,
            command,
            outcome,
        };
        let commands = lock(&self.commands);
        let has_room = |commands: &mpsc::Sender<Audit>| commands.try_send(audit).is_ok();
        if !commands.as_ref().is_some_and(has_room) {
            self.state.count_lost("too many wait for the store");
        }
    }

    /// Returns the number of commands lost to the audit.
    pub fn lost(&self) -> u64 {
        self.state.lost.load(Ordering::Relaxed)
    }

    /// Returns `true` if no command was lost and writing does not fail.
    pub fn is_healthy(&self) -> bool {
        self.lost() == 0 && !self.state.is_late.load(Ordering::Relaxed)
    }

    /// Closes the queue and waits until it is written or lost; the daemon has to be stopping.
    pub async fn close(&self) {
        lock(&self.commands).take();
        let writing = lock(&self.writing).take();
        if let Some(writing) = writing {
            // Panics are logged where they happen.
            let _ = writing.await;
        }
    }
}

struct Writer {
    store: StoreThread,
    stopped: watch::Receiver<bool>,
    state: Arc<AuditState>,
}

impl Writer {
    async fn run(self, mut waiting: mpsc::Receiver<Audit>) {
        while let Some(audit) = waiting.recv().await {
            while let Err(error) = self.write(audit.clone()).await {
                let is_first = !self.state.is_late.swap(true, Ordering::Relaxed);
                if is_first {
                    tracing::error!(%error, "audit: commands wait to be written");
                }
                if *self.stopped.borrow() || !matches!(error, StoreThreadError::Store(_)) {
                    self.state.count_lost(&error.to_string());
                    break;
                }
                let mut stopped = self.stopped.clone();
                // Ends at once when the daemon stops.
                let _ =
                    tokio::time::timeout(RETRY_DELAY, stopped.wait_for(|&stopped| stopped)).await;
            }
            if *self.stopped.borrow() && self.state.is_late.load(Ordering::Relaxed) {
                // Each of the others would take as long to fail.
                while waiting.recv().await.is_some() {
                    self.state
                        .count_lost("the store could not write when the daemon stopped");
                }
            }
        }
    }

    async fn write(&self, audit: Audit) -> Result<(), StoreThreadError> {
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
        let store = self.store.writing(RecordKind::Audits);
        store.run(write).await?;
        if self.state.is_late.swap(false, Ordering::Relaxed) {
            tracing::info!("audit: commands are written again");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use ihd_capture::recording::RecordingSession;
    use ihd_store::{Store, StoreOptions, StoreReader};

    use super::*;
    use crate::event_bus::EventBus;
    use crate::machine::Machine;

    /// Longest wait for another thread; it only ends a hang.
    const HANG_TIMEOUT: Duration = Duration::from_secs(300);

    async fn until(condition: impl Fn() -> bool) {
        let began = Instant::now();
        while !condition() {
            assert!(began.elapsed() < HANG_TIMEOUT, "it does not happen");
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    #[tokio::test(start_paused = true)]
    async fn what_the_store_cannot_write_is_written_later_or_counted() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path(), &StoreOptions::default()).unwrap();
        let store =
            StoreThread::start(store.store, EventBus::default(), &Machine::default()).unwrap();
        let (stop, stopped) = watch::channel(false);
        let auditor = Auditor::start(store.clone(), stopped);
        let recorder = RecordingSession::new(|_| panic!("nothing is recorded"), |_| ());
        let record = DeviceRecord::new("hob".into(), "sim".into(), EventBus::default(), recorder);
        let audit =
            |command: &str| auditor.record(&record, "a".into(), command.into(), "done".into());
        let database = rusqlite::Connection::open(folder.path().join("ihd.db")).unwrap();
        let break_it = || database.execute_batch("ALTER TABLE audit RENAME TO elsewhere");
        let mend_it = || database.execute_batch("ALTER TABLE elsewhere RENAME TO audit");
        let written = || {
            let rows = StoreReader::open(folder.path()).unwrap().audit(10).unwrap();
            let commands = rows.into_iter().rev().map(|row| row.command);
            commands.collect::<Vec<_>>()
        };
        break_it().unwrap();
        audit("first");
        audit("second");
        until(|| !auditor.is_healthy()).await;
        mend_it().unwrap();
        until(|| auditor.is_healthy()).await;
        audit("third");
        until(|| written().len() == 3).await;
        assert_eq!(written(), ["first", "second", "third"]);
        assert_eq!(auditor.lost(), 0);

        break_it().unwrap();
        for _ in 0..CAPACITY + 10 {
            audit("never");
        }
        assert!(auditor.lost() >= 9, "there is no room for all");
        stop.send_replace(true);
        auditor.close().await;
        assert_eq!(auditor.lost(), CAPACITY as u64 + 10);
        audit("after the end");
        assert_eq!(auditor.lost(), CAPACITY as u64 + 11);
        mend_it().unwrap();
        assert_eq!(written().len(), 3);
        store.close().await;
    }
}
