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
    #[cfg(test)]
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
    #[cfg(test)]
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
        #[cfg(test)]
        self.shared.given_to_task.notify_one();
        self.shared.moved.notify_waiters();
        let running = lock(&self.running).take();
        // Its panics are caught in it.
        match running {
            Some(Running::Thread(thread)) => {
                let _ = tokio::task::spawn_blocking(move || thread.join()).await;
            }
            #[cfg(test)]
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
        #[cfg(test)]
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
    fn start(mut self, machine: &Machine) -> std::io::Result<Running> {
        #[cfg(test)]
        if let Some(disk) = machine.disk().cloned() {
            return Ok(Running::Task(tokio::spawn(self.serve_simulated(disk))));
        }
        #[cfg(not(test))]
        let _ = machine;
        let thread = std::thread::Builder::new().name("ihd-store".to_owned());
        let serve = move || while self.wait_for_job() && self.do_next() {};
        Ok(Running::Thread(thread.spawn(serve)?))
    }

    #[cfg(test)]
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
mod tests {
    use std::sync::mpsc;

    use ihd_store::Settings;
    use tokio::sync::broadcast::error::TryRecvError;

    use super::*;
    use crate::store_queue::DEVICE;

    /// Longest wait; it only ends a hang.
    const PATIENCE: Duration = Duration::from_secs(300);

    struct Rig {
        thread: StoreThread,
        notices: tokio::sync::broadcast::Receiver<Arc<crate::model::Notice>>,
        _folder: tempfile::TempDir,
    }

    fn rig() -> Rig {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path(), &Settings::default())
            .unwrap()
            .store;
        let board = Board::default();
        let notices = board.watch();
        let thread = StoreThread::start(store, board, &Machine::default()).unwrap();
        Rig {
            thread,
            notices,
            _folder: folder,
        }
    }

    impl Rig {
        /// Notices of the store since the last call.
        fn told(&mut self) -> Vec<(bool, String)> {
            let mut told = Vec::new();
            loop {
                match self.notices.try_recv() {
                    Ok(notice) => match &notice.what {
                        What::Store { ok, text } => told.push((*ok, text.clone())),
                        other => panic!("{other:?}"),
                    },
                    Err(TryRecvError::Empty) => return told,
                    Err(error) => panic!("{error}"),
                }
            }
        }

        /// Keeps the store busy until it is dropped.
        fn stall(&self) -> mpsc::Sender<()> {
            let (release, released) = mpsc::channel::<()>();
            let (began, begun) = mpsc::channel();
            assert!(self.thread.access().offer(move |_| {
                began.send(()).unwrap();
                let _ = released.recv();
                Ok(())
            }));
            begun.recv_timeout(PATIENCE).unwrap();
            release
        }
    }

    fn full() -> StoreError {
        StoreError::Files {
            file: "/store/windows.db".into(),
            doing: "writing",
            source: std::io::ErrorKind::StorageFull.into(),
        }
    }

    #[tokio::test]
    async fn a_device_that_floods_a_slow_store_loses_its_own_windows_alone() {
        let mut rig = rig();
        let release = rig.stall();
        let done = Arc::new(Mutex::new(Vec::new()));
        let offer = |name: &'static str, record| {
            let done = Arc::clone(&done);
            let store = rig.thread.of_device(name).writing_once(record);
            store.offer(move |_| {
                lock(&done).push(name);
                Ok(())
            })
        };
        let taken = (0..10 * DEVICE)
            .filter(|_| offer("loud", Record::Windows))
            .count();
        assert_eq!(taken, DEVICE);
        assert!((0..10).all(|_| offer("quiet", Record::Windows)));
        assert!(
            offer("loud", Record::Events),
            "the fault that explains the flood"
        );
        let lost = 10 * DEVICE as u64 - DEVICE as u64;
        let failure = rig.thread.failure().unwrap();
        assert_eq!(
            (failure.cause, failure.dropped.windows),
            (StoreCause::TooSlow, lost)
        );
        assert_eq!(failure.dropped, rig.thread.all_dropped());
        assert_eq!(rig.told(), [(false, StoreCause::TooSlow.text().to_owned())]);
        drop(release);
        rig.thread.idle().await;
        let done = lock(&done);
        assert_eq!(done.len(), DEVICE + 11);
        let last_quiet = done.iter().rposition(|name| *name == "quiet").unwrap();
        assert!(
            last_quiet <= 20,
            "the quiet one is served in turn: {last_quiet}"
        );
    }

    #[tokio::test]
    async fn a_full_disk_is_told_once_and_lasts_until_windows_are_written_or_could_be() {
        let mut rig = rig();
        let windows = rig.thread.of_device("a").writing_once(Record::Windows);
        for _ in 0..3 {
            assert!(windows.offer(|_| Err(full())));
        }
        let events = rig.thread.writing(Record::Events);
        events
            .run(|store| store.event(None, "test", "it fits"))
            .await
            .unwrap();
        rig.thread.run(|store| store.due_events(1)).await.unwrap();
        rig.thread.idle().await;
        let failure = rig.thread.failure().unwrap();
        assert_eq!(
            (failure.cause, failure.dropped.windows),
            (StoreCause::DiskFull, 3)
        );
        assert_eq!(rig.told().len(), 1);
        assert!(windows.offer(|_| Ok(())));
        rig.thread.idle().await;
        assert_eq!(rig.thread.failure(), None);
        let told = rig.told();
        assert!(
            told.len() == 1 && told[0].0 && told[0].1.contains("3 windows"),
            "{told:?}"
        );
        // A hob that was switched off meanwhile sends no window that could be written.
        assert!(windows.offer(|_| Err(full())));
        rig.thread.idle().await;
        rig.thread.look(None, PATIENCE).await;
        assert_eq!(rig.thread.failure(), None);
        assert_eq!(rig.thread.all_dropped().windows, 4);
    }

    #[tokio::test]
    async fn a_store_that_hangs_is_told_and_a_refusal_is_none_of_its_failures() {
        let mut rig = rig();
        let refused = StoreError::NoLookup { version: 7 };
        let state = rig.thread.writing(Record::State);
        assert!(state.run(|_| Err::<(), _>(refused)).await.is_err());
        assert_eq!(rig.thread.failure(), None);
        let release = rig.stall();
        let job = rig.thread.look(None, PATIENCE).await;
        assert_eq!(rig.thread.failure(), None, "it may have begun just now");
        rig.thread.look(job, PATIENCE).await;
        assert_eq!(rig.thread.failure().unwrap().cause, StoreCause::Silent);
        drop(release);
        rig.thread.idle().await;
        rig.thread.look(job, PATIENCE).await;
        assert_eq!(rig.thread.failure(), None);
        assert_eq!(
            rig.told().iter().map(|(ok, _)| *ok).collect::<Vec<_>>(),
            [false, true]
        );
        let panics = rig.thread.writing_once(Record::Audits);
        assert!(
            panics
                .run(|_| -> Result<(), StoreError> { panic!("a test") })
                .await
                .is_err()
        );
        let failure = rig.thread.failure().unwrap();
        assert_eq!(
            (failure.cause, failure.dropped.audits),
            (StoreCause::Defect, 1)
        );
        rig.thread.close().await;
        assert!(!rig.thread.access().offer(|_| Ok(())));
    }
}
