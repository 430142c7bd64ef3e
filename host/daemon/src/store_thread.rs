//! The store on a thread of its own: jobs of each device in order, and the store's condition.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use ihd_store::{Store, StoreError};
use tokio::sync::{Notify, oneshot};

use crate::board::Board;
use crate::machine::Machine;
use crate::model::{Dropped, Record, StoreCause, StoreFailure, What};
use crate::store_health::{Change, StoreHealth, cause_of};
use crate::store_queue::{Lane, Room, StoreQueue};

type Work = Box<dyn FnOnce(&mut Store) -> Result<(), Failed> + Send>;

/// A job, and what its failure costs.
struct Job {
    writes: Option<Writes>,
    work: Work,
}

/// The record that a job writes, and how many of them are lost if it fails.
#[derive(Clone, Copy, Debug)]
struct Writes {
    record: Record,
    lost: u64,
}

/// Why a job failed; no cause if the store is not at fault.
struct Failed {
    cause: Option<StoreCause>,
    detail: String,
}

impl From<&StoreError> for Failed {
    fn from(error: &StoreError) -> Self {
        Self {
            cause: cause_of(error),
            detail: error.to_string(),
        }
    }
}

/// Why a job of the store was not done.
#[derive(Debug, thiserror::Error)]
pub enum StoreTrouble {
    /// The store said no.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The job panicked, or the thread has ended.
    #[error("the store's thread has ended, or the job failed in it: {0}")]
    Gone(&'static str),
}

/// Work of the store so far.
#[derive(Debug, Default)]
pub struct StoreGauge {
    /// Jobs done.
    pub jobs: AtomicU64,
    /// Jobs that failed.
    pub failures: AtomicU64,
    /// Microseconds spent on jobs.
    pub busy_us: AtomicU64,
    /// Microseconds of the longest job.
    pub longest_us: AtomicU64,
}

/// The queue, and whether anybody may give and is at a job.
#[derive(Default)]
struct Waiting {
    queue: StoreQueue<Job>,
    is_closed: bool,
    is_busy: bool,
}

#[derive(Default)]
struct Shared {
    waiting: Mutex<Waiting>,
    /// A job was given, or the queue was closed: for the thread.
    given: Condvar,
    /// The same, for the task that is the thread of a simulated machine.
    #[cfg(any(test, feature = "simulation"))]
    given_to_task: Notify,
    /// A job was taken or done: for those who wait for room or for the end.
    moved: Notify,
    health: Mutex<StoreHealth>,
    gauge: StoreGauge,
    board: Board,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Every change is complete in itself.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs the jobs.
enum Running {
    Thread(std::thread::JoinHandle<()>),
    #[cfg(any(test, feature = "simulation"))]
    Task(tokio::task::JoinHandle<()>),
}

/// The store's thread; cheap to clone.
#[derive(Clone)]
pub struct StoreThread {
    shared: Arc<Shared>,
    running: Arc<Mutex<Option<Running>>>,
}

/// The way to the store for one owner and one kind of record; cheap to clone.
#[derive(Clone)]
pub struct StoreAccess {
    shared: Arc<Shared>,
    lane: Lane,
    writes: Option<Writes>,
}

impl StoreThread {
    /// Starts it.
    ///
    /// # Errors
    /// What the operating system says where there is no thread to be had.
    pub fn start(store: Store, board: Board, machine: &Machine) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            board,
            ..Shared::default()
        });
        let worker = StoreWorker {
            store,
            shared: Arc::clone(&shared),
        };
        let running = worker.start(machine)?;
        Ok(Self {
            shared,
            running: Arc::new(Mutex::new(Some(running))),
        })
    }

    fn access(&self) -> StoreAccess {
        StoreAccess {
            shared: Arc::clone(&self.shared),
            lane: Lane::Daemon,
            writes: None,
        }
    }

    /// The way to the store for a device, whose jobs wait in a lane of their own.
    pub fn of_device(&self, name: &str) -> StoreAccess {
        StoreAccess {
            lane: Lane::Device(name.into()),
            ..self.access()
        }
    }

    /// The daemon's [`StoreAccess::writing`].
    pub fn writing(&self, record: Record) -> StoreAccess {
        self.access().writing(record)
    }

    /// The daemon's [`StoreAccess::writing_once`].
    pub fn writing_once(&self, record: Record) -> StoreAccess {
        self.access().writing_once(record)
    }

    /// Runs `f` in the daemon's lane: [`StoreAccess::run`].
    ///
    /// # Errors
    /// Those of [`StoreAccess::run`].
    pub async fn run<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreTrouble> {
        self.access().run(f).await
    }

    /// Counts records that were dropped before they came here, because the store does not keep up.
    pub fn dropped(&self, record: Record, n: u64) {
        if n > 0 {
            self.shared
                .change_health(|health, now_ms| health.found_no_room(record, n, now_ms));
        }
    }

    /// Jobs that wait.
    pub fn waiting(&self) -> usize {
        lock(&self.shared.waiting).queue.len()
    }

    /// Work so far.
    pub fn gauge(&self) -> &StoreGauge {
        &self.shared.gauge
    }

    /// The store's failure; `None` while it takes all records.
    pub fn failure(&self) -> Option<StoreFailure> {
        lock(&self.shared.health).failure()
    }

    /// Records dropped since the daemon began.
    pub fn all_dropped(&self) -> Dropped {
        lock(&self.shared.health).dropped()
    }

    /// Looks after the condition, every ten seconds. `before` is what the last look returned: the job that was being done.
    pub async fn look(&self, before: Option<u64>, within: Duration) -> Option<u64> {
        let is_busy = lock(&self.shared.waiting).is_busy;
        let now = is_busy.then(|| self.shared.gauge.jobs.load(Ordering::Relaxed));
        let answers = now.is_none() || now != before;
        let mut may_try = false;
        self.shared.change_health(|health, now_ms| {
            health.answers(answers, now_ms);
            may_try = health.look();
        });
        if may_try && answers {
            let store = self.writing(Record::State);
            let trial = store.run(Store::try_writing);
            if let Ok(Ok(())) = tokio::time::timeout(within, trial).await {
                self.shared.change_health(|health, _| health.proved());
            }
        }
        now
    }

    /// Ready when no job waits and none is being done.
    pub async fn idle(&self) {
        loop {
            let moved = self.shared.moved.notified();
            {
                let waiting = lock(&self.shared.waiting);
                if waiting.queue.is_empty() && !waiting.is_busy {
                    return;
                }
            }
            moved.await;
        }
    }

    /// Ends the thread when all jobs that were given are done, and closes the store.
    pub async fn close(&self) {
        lock(&self.shared.waiting).is_closed = true;
        self.shared.given.notify_all();
        #[cfg(any(test, feature = "simulation"))]
        self.shared.given_to_task.notify_one();
        self.shared.moved.notify_waiters();
        let running = lock(&self.running).take();
        // Its panics are caught in it.
        match running {
            Some(Running::Thread(thread)) => {
                let _ = tokio::task::spawn_blocking(move || thread.join()).await;
            }
            #[cfg(any(test, feature = "simulation"))]
            Some(Running::Task(task)) => {
                let _ = task.await;
            }
            None => {}
        }
    }
}

impl StoreAccess {
    /// The way for records of this kind, which their owner keeps and gives again if they are not written.
    pub fn writing(mut self, record: Record) -> Self {
        self.writes = Some(Writes { record, lost: 0 });
        self
    }

    /// The way for records of this kind that are lost if they are not written at once: each job is one of them.
    pub fn writing_once(mut self, record: Record) -> Self {
        self.writes = Some(Writes { record, lost: 1 });
        self
    }

    /// Runs `f` with the store, after what its owner gave before, and gives what it returned.
    ///
    /// # Errors
    /// What `f` returned; [`StoreTrouble::Gone`] once the thread has ended, or where `f` panicked.
    pub async fn run<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreTrouble> {
        let (answer, answered) = oneshot::channel();
        let mut job = self.job(Box::new(move |store| {
            let outcome = f(store);
            let told = outcome.as_ref().map(drop).map_err(Failed::from);
            // Whoever left meanwhile does not want to know.
            let _ = answer.send(outcome);
            told
        }));
        loop {
            let moved = self.shared.moved.notified();
            match self.shared.give(&self.lane, Room::Share, job)? {
                None => break,
                Some(waits) => job = waits,
            }
            moved.await;
        }
        let panicked = |_| StoreTrouble::Gone("a fault of this program, in the log");
        Ok(answered.await.map_err(panicked)??)
    }

    /// Gives `f` to the store if there is room for it; returns `false` if there is none, which is counted as a loss. Never waits.
    pub fn offer(
        &self,
        f: impl FnOnce(&mut Store) -> Result<(), StoreError> + Send + 'static,
    ) -> bool {
        let room = match self.writes {
            Some(Writes {
                record: Record::Windows,
                ..
            }) => Room::Share,
            _ => Room::Reserve,
        };
        let job = self.job(Box::new(move |store| {
            f(store).map_err(|e| Failed::from(&e))
        }));
        let taken = matches!(self.shared.give(&self.lane, room, job), Ok(None));
        if let (false, Some(Writes { record, lost })) = (taken, self.writes) {
            self.shared
                .change_health(|health, now_ms| health.found_no_room(record, lost, now_ms));
        }
        taken
    }

    fn job(&self, work: Work) -> Job {
        let writes = self.writes;
        Job { writes, work }
    }
}

impl Shared {
    /// Appends a job; gives it back if its lane has no room.
    fn give(&self, lane: &Lane, room: Room, job: Job) -> Result<Option<Job>, StoreTrouble> {
        let mut waiting = lock(&self.waiting);
        if waiting.is_closed {
            return Err(StoreTrouble::Gone("it is stopping"));
        }
        let refused = waiting.queue.push(lane, room, job).err();
        drop(waiting);
        self.given.notify_one();
        #[cfg(any(test, feature = "simulation"))]
        self.given_to_task.notify_one();
        Ok(refused)
    }

    /// Changes the condition, and tells what that changes for others.
    fn change_health(&self, change: impl FnOnce(&mut StoreHealth, i64)) {
        let now_ms = self.board.now_ms();
        let mut health = lock(&self.health);
        change(&mut health, now_ms);
        let Some(change) = health.take_change() else {
            return;
        };
        // Told under the lock, so that changes are told in order.
        let (text, ok) = match change {
            Change::Failing { failure, detail } => {
                let text = failure.text.clone();
                let advice = failure.advice;
                tracing::error!(text, detail, advice, "store: devices go on without it");
                (text, false)
            }
            Change::Well { since_ms, dropped } => {
                let (seconds, dropped) = ((now_ms - since_ms) / 1_000, dropped.text());
                let text = format!(
                    "the store works again after {seconds} s; dropped meanwhile: {dropped}"
                );
                tracing::info!(text, "store");
                (text, true)
            }
        };
        self.board.tell("", What::Store { text, ok });
    }
}

/// The end of the queue that does the jobs: on the store's thread, or step by step in a simulation.
pub struct StoreWorker {
    store: Store,
    shared: Arc<Shared>,
}

impl StoreWorker {
    #[cfg(any(test, feature = "simulation"))]
    fn start(self, machine: &Machine) -> std::io::Result<Running> {
        match machine.disk().cloned() {
            Some(disk) => Ok(Running::Task(tokio::spawn(self.serve_simulated(disk)))),
            None => self.start_thread(),
        }
    }

    #[cfg(not(any(test, feature = "simulation")))]
    fn start(self, _: &Machine) -> std::io::Result<Running> {
        self.start_thread()
    }

    fn start_thread(mut self) -> std::io::Result<Running> {
        let thread = std::thread::Builder::new().name("ihd-store".to_owned());
        let serve = move || while self.wait_for_job() && self.do_next() {};
        Ok(Running::Thread(thread.spawn(serve)?))
    }

    #[cfg(any(test, feature = "simulation"))]
    async fn serve_simulated(mut self, disk: Arc<crate::simulation::Disk>) {
        loop {
            let (is_empty, is_closed) = {
                let waiting = lock(&self.shared.waiting);
                (waiting.queue.is_empty(), waiting.is_closed)
            };
            match (is_empty, is_closed) {
                (true, true) => return,
                (true, false) => self.shared.given_to_task.notified().await,
                (false, _) => {
                    disk.wait().await;
                    disk.apply_to(&self.store);
                    self.do_next();
                }
            }
        }
    }

    /// Waits for a job; `false` once the queue is closed and empty.
    fn wait_for_job(&self) -> bool {
        let waiting = lock(&self.shared.waiting);
        let idle = |waiting: &mut Waiting| waiting.queue.is_empty() && !waiting.is_closed;
        let waited = self.shared.given.wait_while(waiting, idle);
        let waiting = waited.unwrap_or_else(PoisonError::into_inner);
        !waiting.queue.is_empty()
    }

    /// Does the next job; `false` if there is none. Never waits.
    pub fn do_next(&mut self) -> bool {
        let job = {
            let mut waiting = lock(&self.shared.waiting);
            let job = waiting.queue.next();
            waiting.is_busy = job.is_some();
            job
        };
        let Some(Job { writes, work }) = job else {
            return false;
        };
        self.shared.moved.notify_waiters();
        let began = Instant::now();
        // A transaction that a panic leaves is rolled back.
        let outcome = catch_unwind(AssertUnwindSafe(|| work(&mut self.store)));
        let outcome = outcome.unwrap_or_else(|_| {
            Err(Failed {
                cause: Some(StoreCause::Defect),
                detail: "a fault of this program".to_owned(),
            })
        });
        self.shared.gauge.count(began.elapsed(), outcome.is_ok());
        self.shared.note(writes, outcome);
        lock(&self.shared.waiting).is_busy = false;
        self.shared.moved.notify_waiters();
        true
    }
}

impl StoreGauge {
    fn count(&self, took: Duration, ok: bool) {
        let took_us = took.as_micros() as u64;
        self.jobs.fetch_add(1, Ordering::Relaxed);
        self.busy_us.fetch_add(took_us, Ordering::Relaxed);
        self.longest_us.fetch_max(took_us, Ordering::Relaxed);
        self.failures.fetch_add(u64::from(!ok), Ordering::Relaxed);
    }
}

impl Shared {
    /// A job's outcome for the condition. One that writes nothing proves nothing if it succeeds.
    fn note(&self, writes: Option<Writes>, outcome: Result<(), Failed>) {
        let Writes { record, lost } = match (writes, &outcome) {
            (Some(writes), _) => writes,
            (None, Ok(())) => return,
            (None, Err(_)) => Writes {
                record: Record::State,
                lost: 0,
            },
        };
        let Err(Failed { cause, detail }) = outcome else {
            return self.change_health(|health, _| health.written(record));
        };
        // What the store refuses, as a lookup that it does not hold, is no failure of it unless a record is lost.
        let Some(cause) = cause.or((lost > 0).then_some(StoreCause::Defect)) else {
            return;
        };
        self.change_health(|health, now_ms| health.failed(record, cause, &detail, lost, now_ms));
    }
}

#[cfg(test)]
mod tests;
