//! Thread of the store: runs the jobs of each device in order and tracks the store's condition.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use ihd_model::{DroppedRecords, EventKind, RecordKind, StoreCause, StoreFailure};
use ihd_store::{Store, StoreError};
use tokio::sync::{Notify, oneshot};

use crate::event_bus::EventBus;
use crate::locking::lock;
use crate::machine::Machine;
use crate::store_health::{HealthChange, StoreHealth, cause_of};
use crate::store_queue::{Lane, LaneLimit, StoreQueue};

/// Time after which a job counts as stuck: several times what a job takes that waits for a locked database (5 s) and fails.
const JOB_LIMIT: Duration = Duration::from_secs(30);

type Work = Box<dyn FnOnce(&mut Store) -> Result<(), JobFailure> + Send>;

/// Job of the store, with the record that it writes.
struct Job {
    record: Option<JobRecord>,
    work: Work,
}

/// Record that a job writes.
#[derive(Clone, Copy, Debug)]
struct JobRecord {
    kind: RecordKind,
    /// Records lost if the job fails.
    lost: u64,
}

/// Failure of a job.
struct JobFailure {
    /// Cause; `None` if the store is not at fault.
    cause: Option<StoreCause>,
    detail: String,
}

impl From<&StoreError> for JobFailure {
    fn from(error: &StoreError) -> Self {
        Self {
            cause: cause_of(error),
            detail: error.to_string(),
        }
    }
}

/// Error of a job of the store.
#[derive(Debug, thiserror::Error)]
pub enum StoreThreadError {
    /// Error of the store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The job panicked, or the thread has ended.
    #[error("the store's thread has ended, or the job failed in it: {0}")]
    Gone(&'static str),
}

/// Counters of the store's jobs.
#[derive(Debug, Default)]
pub struct StoreGauge {
    /// Completed jobs, including failures.
    pub jobs: AtomicU64,
    /// Failed jobs.
    pub failures: AtomicU64,
    /// Time spent on jobs, in microseconds.
    pub busy_us: AtomicU64,
    /// Duration of the longest job, in microseconds.
    pub longest_us: AtomicU64,
}

/// Queue, with the state of its two ends.
#[derive(Default)]
struct QueueState {
    queue: StoreQueue<Job>,
    /// `true` once no more jobs are accepted.
    is_closed: bool,
    /// Time since which the thread has not ended the present job, or not taken one that waits; `None` without a job.
    due_since: Option<Instant>,
}

#[derive(Default)]
struct Shared {
    state: Mutex<QueueState>,
    /// Signal to the thread: a job was queued, or the queue was closed.
    job_added: Condvar,
    /// Same signal, to the task that is the thread of a simulated machine.
    #[cfg(any(test, feature = "simulation"))]
    job_added_task: Notify,
    /// Signal to callers that wait for room or for the end: a job was taken or done.
    progress: Notify,
    health: Mutex<StoreHealth>,
    gauge: StoreGauge,
    event_bus: EventBus,
}

/// Handle of the thread or task that runs the jobs.
enum WorkerHandle {
    Thread(std::thread::JoinHandle<()>),
    #[cfg(any(test, feature = "simulation"))]
    Task(tokio::task::JoinHandle<()>),
}

/// Handle of the store's thread; cheap to clone.
#[derive(Clone)]
pub struct StoreThread {
    shared: Arc<Shared>,
    running: Arc<Mutex<Option<WorkerHandle>>>,
}

/// Access to the store for one owner and one kind of record; cheap to clone.
#[derive(Clone)]
pub struct StoreAccess {
    shared: Arc<Shared>,
    lane: Lane,
    record: Option<JobRecord>,
}

impl StoreThread {
    /// Starts the thread.
    ///
    /// # Errors
    /// Error of the operating system.
    pub fn start(store: Store, event_bus: EventBus, machine: &Machine) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            event_bus,
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

    pub fn access(&self) -> StoreAccess {
        StoreAccess {
            shared: Arc::clone(&self.shared),
            lane: Lane::Daemon,
            record: None,
        }
    }

    /// Returns access to the store for a device, in the device's own lane.
    pub fn of_device(&self, name: &str) -> StoreAccess {
        StoreAccess {
            lane: Lane::Device(name.into()),
            ..self.access()
        }
    }

    /// Returns access in the daemon's lane, as [`StoreAccess::writing`].
    pub fn writing(&self, record: RecordKind) -> StoreAccess {
        self.access().writing(record)
    }

    /// Returns access in the daemon's lane, as [`StoreAccess::writing_once`].
    pub fn writing_once(&self, record: RecordKind) -> StoreAccess {
        self.access().writing_once(record)
    }

    /// Runs `f` in the daemon's lane, as [`StoreAccess::run`].
    ///
    /// # Errors
    /// As [`StoreAccess::run`].
    pub async fn run<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreThreadError> {
        self.access().run(f).await
    }

    /// Counts `n` records that were dropped before they were offered, because the store is too slow.
    pub fn count_dropped(&self, kind: RecordKind, n: u64) {
        if n > 0 {
            self.shared
                .change_health(|health, now_ms| health.count_no_room(kind, n, now_ms));
        }
    }

    /// Returns the number of waiting jobs.
    pub fn waiting(&self) -> usize {
        lock(&self.shared.state).queue.len()
    }

    /// Returns the counters of jobs.
    pub fn gauge(&self) -> &StoreGauge {
        &self.shared.gauge
    }

    /// Returns the store's failure; `None` while it accepts all records.
    pub fn failure(&self) -> Option<StoreFailure> {
        lock(&self.shared.health).failure()
    }

    /// Returns the records dropped since the start of the daemon.
    pub fn all_dropped(&self) -> DroppedRecords {
        lock(&self.shared.health).dropped()
    }

    /// Polls the condition, every ten seconds, and tries to write if that can clear a failure, for at most `timeout`. Returns the number
    /// of the present job; `before` is the number from the last poll.
    pub async fn poll_health(&self, before: Option<u64>, timeout: Duration) -> Option<u64> {
        let is_busy = lock(&self.shared.state).due_since.is_some();
        let now = is_busy.then(|| self.shared.gauge.jobs.load(Ordering::Relaxed));
        let is_responding = now.is_none() || now != before;
        let mut may_try = false;
        self.shared.change_health(|health, now_ms| {
            health.set_responding(is_responding, now_ms);
            may_try = health.poll();
        });
        if may_try && is_responding {
            let store = self.writing(RecordKind::State);
            let trial = store.run(Store::try_writing);
            if let Ok(Ok(())) = tokio::time::timeout(timeout, trial).await {
                self.shared
                    .change_health(|health, _| health.trial_succeeded());
            }
        }
        now
    }

    /// Returns `true` if the thread has no job, or has ended or taken one within [`JOB_LIMIT`], even with an error.
    pub fn progresses(&self) -> bool {
        self.progresses_at(Instant::now())
    }

    fn progresses_at(&self, now: Instant) -> bool {
        let due_since = lock(&self.shared.state).due_since;
        due_since.is_none_or(|since| now.saturating_duration_since(since) < JOB_LIMIT)
    }

    /// Returns once no job is waiting or being done.
    pub async fn idle(&self) {
        loop {
            let progress = self.shared.progress.notified();
            {
                if lock(&self.shared.state).due_since.is_none() {
                    return;
                }
            }
            progress.await;
        }
    }

    /// Ends the thread once all queued jobs are done, and closes the store.
    pub async fn close(&self) {
        lock(&self.shared.state).is_closed = true;
        self.shared.job_added.notify_all();
        #[cfg(any(test, feature = "simulation"))]
        self.shared.job_added_task.notify_one();
        self.shared.progress.notify_waiters();
        let running = lock(&self.running).take();
        // Panics of jobs are caught in the thread.
        match running {
            Some(WorkerHandle::Thread(thread)) => {
                let _ = tokio::task::spawn_blocking(move || thread.join()).await;
            }
            #[cfg(any(test, feature = "simulation"))]
            Some(WorkerHandle::Task(task)) => {
                let _ = task.await;
            }
            None => {}
        }
    }
}

impl StoreAccess {
    /// Returns access for records of this kind that their owner keeps and writes again if a job fails.
    pub fn writing(mut self, kind: RecordKind) -> Self {
        self.record = Some(JobRecord { kind, lost: 0 });
        self
    }

    /// Returns access for records of this kind, one per job, that are lost if the job fails.
    pub fn writing_once(mut self, kind: RecordKind) -> Self {
        self.record = Some(JobRecord { kind, lost: 1 });
        self
    }

    /// Runs `f` with the store, after the earlier jobs of the same lane. Returns its outcome.
    ///
    /// # Errors
    /// Error of `f`; [`StoreThreadError::Gone`] if the thread has ended or `f` panicked.
    pub async fn run<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreThreadError> {
        let (answer, answered) = oneshot::channel();
        let mut job = self.job(Box::new(move |store| {
            let outcome = f(store);
            let result = outcome.as_ref().map(drop).map_err(JobFailure::from);
            // Fails only if the caller has left.
            let _ = answer.send(outcome);
            result
        }));
        loop {
            let progress = self.shared.progress.notified();
            match self.shared.enqueue(&self.lane, LaneLimit::Share, job)? {
                None => break,
                Some(refused) => job = refused,
            }
            progress.await;
        }
        let panicked = |_| StoreThreadError::Gone("a fault of this program, in the log");
        Ok(answered.await.map_err(panicked)??)
    }

    /// Queues `f` without waiting. Returns `false`, and counts the loss, if there is no room.
    pub fn offer(
        &self,
        f: impl FnOnce(&mut Store) -> Result<(), StoreError> + Send + 'static,
    ) -> bool {
        let room = match self.record {
            Some(JobRecord {
                kind: RecordKind::Windows,
                ..
            }) => LaneLimit::Share,
            _ => LaneLimit::Reserve,
        };
        let job = self.job(Box::new(move |store| {
            f(store).map_err(|e| JobFailure::from(&e))
        }));
        let is_queued = matches!(self.shared.enqueue(&self.lane, room, job), Ok(None));
        if let (false, Some(JobRecord { kind, lost })) = (is_queued, self.record) {
            self.shared
                .change_health(|health, now_ms| health.count_no_room(kind, lost, now_ms));
        }
        is_queued
    }

    fn job(&self, work: Work) -> Job {
        let record = self.record;
        Job { record, work }
    }
}

impl Shared {
    /// Appends a job; returns it if its lane has no room.
    fn enqueue(
        &self,
        lane: &Lane,
        room: LaneLimit,
        job: Job,
    ) -> Result<Option<Job>, StoreThreadError> {
        let mut state = lock(&self.state);
        if state.is_closed {
            return Err(StoreThreadError::Gone("it is stopping"));
        }
        let refused = state.queue.push(lane, room, job).err();
        state.due_since.get_or_insert_with(Instant::now);
        drop(state);
        self.job_added.notify_one();
        #[cfg(any(test, feature = "simulation"))]
        self.job_added_task.notify_one();
        Ok(refused)
    }

    /// Changes the condition, and publishes a change of the failure.
    fn change_health(&self, change: impl FnOnce(&mut StoreHealth, i64)) {
        let now_ms = self.event_bus.now_ms();
        let mut health = lock(&self.health);
        change(&mut health, now_ms);
        let Some(change) = health.take_change() else {
            return;
        };
        // Published under the lock, so that changes are published in order.
        let (text, ok) = match change {
            HealthChange::Failing { failure, detail } => {
                let text = failure.text.clone();
                let advice = failure.advice;
                tracing::error!(text, detail, advice, "store: devices go on without it");
                (text, false)
            }
            HealthChange::Recovered { since_ms, dropped } => {
                let (seconds, dropped) = ((now_ms - since_ms) / 1_000, dropped.text());
                let text = format!(
                    "the store works again after {seconds} s; dropped meanwhile: {dropped}"
                );
                tracing::info!(text, "store");
                (text, true)
            }
        };
        self.event_bus.publish("", EventKind::Store { text, ok });
    }
}

/// Worker that runs the jobs: on the store's thread, or step by step in a simulation.
pub struct StoreWorker {
    store: Store,
    shared: Arc<Shared>,
}

impl StoreWorker {
    #[cfg(any(test, feature = "simulation"))]
    fn start(self, machine: &Machine) -> std::io::Result<WorkerHandle> {
        match machine.disk().cloned() {
            Some(disk) => Ok(WorkerHandle::Task(tokio::spawn(self.serve_simulated(disk)))),
            None => self.start_thread(),
        }
    }

    #[cfg(not(any(test, feature = "simulation")))]
    fn start(self, _: &Machine) -> std::io::Result<WorkerHandle> {
        self.start_thread()
    }

    fn start_thread(mut self) -> std::io::Result<WorkerHandle> {
        let thread = std::thread::Builder::new().name("ihd-store".to_owned());
        let serve = move || while self.wait_for_job() && self.do_next() {};
        Ok(WorkerHandle::Thread(thread.spawn(serve)?))
    }

    #[cfg(any(test, feature = "simulation"))]
    async fn serve_simulated(mut self, disk: Arc<crate::simulation::disk::SimulatedDisk>) {
        loop {
            let (is_empty, is_closed) = {
                let state = lock(&self.shared.state);
                (state.queue.is_empty(), state.is_closed)
            };
            match (is_empty, is_closed) {
                (true, true) => return,
                (true, false) => self.shared.job_added_task.notified().await,
                (false, _) => {
                    disk.wait().await;
                    disk.apply_to(&self.store);
                    self.do_next();
                }
            }
        }
    }

    /// Waits for a job. Returns `false` once the queue is closed and empty.
    fn wait_for_job(&self) -> bool {
        let state = lock(&self.shared.state);
        let idle = |state: &mut QueueState| state.queue.is_empty() && !state.is_closed;
        let waited = self.shared.job_added.wait_while(state, idle);
        let state = waited.unwrap_or_else(PoisonError::into_inner);
        !state.queue.is_empty()
    }

    /// Runs the next job without waiting for one. Returns `false` if there is none.
    pub fn do_next(&mut self) -> bool {
        let job = {
            let mut state = lock(&self.shared.state);
            let job = state.queue.next();
            state.due_since = job.is_some().then(Instant::now);
            job
        };
        let Some(Job { record, work }) = job else {
            return false;
        };
        self.shared.progress.notify_waiters();
        let began = Instant::now();
        // After a panic the store rolls the transaction back.
        let outcome = catch_unwind(AssertUnwindSafe(|| work(&mut self.store)));
        let outcome = outcome.unwrap_or_else(|_| {
            Err(JobFailure {
                cause: Some(StoreCause::Defect),
                detail: "a fault of this program".to_owned(),
            })
        });
        self.shared.gauge.count(began.elapsed(), outcome.is_ok());
        self.shared.record_outcome(record, outcome);
        {
            let mut state = lock(&self.shared.state);
            state.due_since = (!state.queue.is_empty()).then(Instant::now);
        }
        self.shared.progress.notify_waiters();
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
    /// Updates the condition from a job's outcome. The success of a job without a record changes nothing.
    fn record_outcome(&self, record: Option<JobRecord>, outcome: Result<(), JobFailure>) {
        let JobRecord { kind, lost } = match (record, &outcome) {
            (Some(record), _) => record,
            (None, Ok(())) => return,
            (None, Err(_)) => JobRecord {
                kind: RecordKind::State,
                lost: 0,
            },
        };
        let Err(JobFailure { cause, detail }) = outcome else {
            return self.change_health(|health, _| health.written(kind));
        };
        // A refusal, such as of an unknown lookup, is no failure of the store unless a record is lost.
        let Some(cause) = cause.or((lost > 0).then_some(StoreCause::Defect)) else {
            return;
        };
        self.change_health(|health, now_ms| health.failed(kind, cause, &detail, lost, now_ms));
    }
}

#[cfg(test)]
mod tests;
