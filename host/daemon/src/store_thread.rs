//! The store on a thread of its own: jobs in order, and whether it is well.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use ihd_store::{Store, StoreError};
use tokio::sync::{mpsc, oneshot};

use crate::board::Board;
use crate::machine::Machine;
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

/// Runs the jobs.
enum Running {
    Thread(std::thread::JoinHandle<()>),
    #[cfg(test)]
    Task(tokio::task::JoinHandle<()>),
}

/// The store's thread; cheap to clone.
#[derive(Clone)]
pub struct StoreThread {
    jobs: Arc<Mutex<Option<mpsc::Sender<Job>>>>,
    running: Arc<Mutex<Option<Running>>>,
    gauge: Arc<StoreGauge>,
}

impl StoreThread {
    /// Starts it.
    ///
    /// # Errors
    /// What the operating system says where there is no thread to be had.
    pub fn start(store: Store, board: Board, machine: &Machine) -> std::io::Result<Self> {
        let (jobs, waiting) = mpsc::channel(JOBS);
        let gauge = Arc::new(StoreGauge::default());
        let worker = Worker {
            store,
            gauge: Arc::clone(&gauge),
            board,
        };
        Ok(Self {
            jobs: Arc::new(Mutex::new(Some(jobs))),
            running: Arc::new(Mutex::new(Some(worker.start(waiting, machine)?))),
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
        let running = self
            .running
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
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

/// The store, on its thread.
struct Worker {
    store: Store,
    gauge: Arc<StoreGauge>,
    board: Board,
}

impl Worker {
    fn start(
        mut self,
        mut jobs: mpsc::Receiver<Job>,
        machine: &Machine,
    ) -> std::io::Result<Running> {
        #[cfg(test)]
        if let Some(disk) = machine.disk().cloned() {
            return Ok(Running::Task(tokio::spawn(async move {
                while let Some(job) = jobs.recv().await {
                    disk.wait().await;
                    disk.apply_to(&self.store);
                    self.carry_out(job);
                }
            })));
        }
        #[cfg(not(test))]
        let _ = machine;
        let serve = move || {
            while let Some(job) = jobs.blocking_recv() {
                self.carry_out(job);
            }
        };
        let thread = std::thread::Builder::new().name("ihd-store".to_owned());
        Ok(Running::Thread(thread.spawn(serve)?))
    }

    fn carry_out(&mut self, job: Job) {
        let began = Instant::now();
        // A transaction that a panic leaves is rolled back.
        let outcome = catch_unwind(AssertUnwindSafe(|| job(&mut self.store)))
            .unwrap_or_else(|_| Err("a fault of this program".to_owned()));
        let took_us = began.elapsed().as_micros() as u64;
        let gauge = &self.gauge;
        gauge.jobs.fetch_add(1, Ordering::Relaxed);
        gauge.busy_us.fetch_add(took_us, Ordering::Relaxed);
        gauge.longest_us.fetch_max(took_us, Ordering::Relaxed);
        if outcome.is_err() {
            gauge.failures.fetch_add(1, Ordering::Relaxed);
        }
        tell_health(outcome, gauge, &self.board);
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
