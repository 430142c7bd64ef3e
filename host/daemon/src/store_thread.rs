//! The store on a thread of its own: jobs in order, and whether it is well.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use ihd_store::{Store, StoreError};
use tokio::sync::{mpsc, oneshot};

use crate::board::Board;
use crate::model::What;

/// Jobs that may wait: with a window of 70 kB each some 9 MB.
const JOBS: usize = 128;

type Job = Box<dyn FnOnce(&mut Store) -> Result<(), String> + Send>;

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

/// How the store does.
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
    ill: AtomicBool,
}

impl StoreGauge {
    /// Whether the last write went well.
    pub fn is_well(&self) -> bool {
        !self.ill.load(Ordering::Relaxed)
    }
}

/// The store's thread; cheap to clone.
#[derive(Clone)]
pub struct StoreThread {
    jobs: Arc<Mutex<Option<mpsc::Sender<Job>>>>,
    thread: Arc<Mutex<Option<JoinHandle<()>>>>,
    gauge: Arc<StoreGauge>,
}

impl StoreThread {
    /// Starts it.
    ///
    /// # Errors
    /// What the operating system says where there is no thread to be had.
    pub fn start(store: Store, board: Board) -> std::io::Result<Self> {
        let (jobs, waiting) = mpsc::channel(JOBS);
        let gauge = Arc::new(StoreGauge::default());
        let told = Arc::clone(&gauge);
        let thread = std::thread::Builder::new()
            .name("ihd-store".to_owned())
            .spawn(move || serve(store, waiting, &told, &board))?;
        Ok(Self {
            jobs: Arc::new(Mutex::new(Some(jobs))),
            thread: Arc::new(Mutex::new(Some(thread))),
            gauge,
        })
    }

    fn sender(&self) -> Option<mpsc::Sender<Job>> {
        self.jobs
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Runs `f` with the store, after what was given before, and gives what it returned.
    ///
    /// # Errors
    /// What `f` returned; [`StoreTrouble::Gone`] once the thread has ended, or where `f` panicked.
    pub async fn run<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreTrouble> {
        let (answer, answered) = oneshot::channel();
        let job: Job = Box::new(move |store| {
            let outcome = f(store);
            let told = outcome.as_ref().map(drop).map_err(ToString::to_string);
            // Whoever left meanwhile does not want to know.
            let _ = answer.send(outcome);
            told
        });
        let jobs = self.sender().ok_or(StoreTrouble::Gone("it is stopping"))?;
        let gone = |_| StoreTrouble::Gone("it is stopping");
        jobs.send(job).await.map_err(gone)?;
        let panicked = |_| StoreTrouble::Gone("a fault of this program, in the log");
        Ok(answered.await.map_err(panicked)??)
    }

    /// Gives `f` to the store where there is room for it; false where there is none. Never waits.
    pub fn offer(
        &self,
        f: impl FnOnce(&mut Store) -> Result<(), StoreError> + Send + 'static,
    ) -> bool {
        let job: Job = Box::new(move |store| f(store).map_err(|e| e.to_string()));
        self.sender().is_some_and(|jobs| jobs.try_send(job).is_ok())
    }

    /// Jobs that wait.
    pub fn waiting(&self) -> usize {
        self.sender()
            .map_or(0, |jobs| jobs.max_capacity() - jobs.capacity())
    }

    /// How it does.
    pub fn gauge(&self) -> &StoreGauge {
        &self.gauge
    }

    /// Ends the thread when all jobs that were given are done, and closes the store.
    pub async fn close(&self) {
        self.jobs
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let thread = self
            .thread
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some(thread) = thread {
            // Its panics are caught in it.
            let _ = tokio::task::spawn_blocking(move || thread.join()).await;
        }
    }
}

fn serve(mut store: Store, mut jobs: mpsc::Receiver<Job>, gauge: &StoreGauge, board: &Board) {
    while let Some(job) = jobs.blocking_recv() {
        let began = Instant::now();
        // A transaction that a panic leaves is rolled back.
        let outcome = catch_unwind(AssertUnwindSafe(|| job(&mut store)))
            .unwrap_or_else(|_| Err("a fault of this program".to_owned()));
        let took_us = began.elapsed().as_micros() as u64;
        gauge.jobs.fetch_add(1, Ordering::Relaxed);
        gauge.busy_us.fetch_add(took_us, Ordering::Relaxed);
        gauge.longest_us.fetch_max(took_us, Ordering::Relaxed);
        if outcome.is_err() {
            gauge.failures.fetch_add(1, Ordering::Relaxed);
        }
        tell_health(outcome, gauge, board);
    }
}

/// A change of health is told once.
fn tell_health(outcome: Result<(), String>, gauge: &StoreGauge, board: &Board) {
    let (text, ok) = match outcome {
        Ok(()) => ("the store works again".to_owned(), true),
        Err(why) => (why, false),
    };
    if gauge.ill.swap(!ok, Ordering::Relaxed) != ok {
        return;
    }
    if ok {
        tracing::info!(text, "store");
    } else {
        tracing::error!(text, "store: devices go on without it");
    }
    board.tell("", What::Store { text, ok });
}
