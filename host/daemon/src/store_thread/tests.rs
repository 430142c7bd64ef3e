//! Floods, full disks and a store that hangs, on the thread.

use std::sync::mpsc;

use ihd_store::StoreOptions;
use tokio::sync::broadcast::error::TryRecvError;

use super::*;
use crate::store_queue::DEVICE;

/// Longest wait; it only ends a hang.
const PATIENCE: Duration = Duration::from_secs(300);

struct Rig {
    thread: StoreThread,
    events: tokio::sync::broadcast::Receiver<Arc<ihd_model::DaemonEvent>>,
    _folder: tempfile::TempDir,
}

fn rig() -> Rig {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path(), &StoreOptions::default())
        .unwrap()
        .store;
    let event_bus = EventBus::default();
    let events = event_bus.subscribe();
    let thread = StoreThread::start(store, event_bus, &Machine::default()).unwrap();
    Rig {
        thread,
        events,
        _folder: folder,
    }
}

impl Rig {
    /// Returns the events of the store since the last call.
    fn published(&mut self) -> Vec<(bool, String)> {
        let mut published = Vec::new();
        loop {
            match self.events.try_recv() {
                Ok(event) => match &event.kind {
                    EventKind::Store { ok, text } => published.push((*ok, text.clone())),
                    other => panic!("{other:?}"),
                },
                Err(TryRecvError::Empty) => return published,
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
        .filter(|_| offer("loud", RecordKind::Windows))
        .count();
    assert_eq!(taken, DEVICE);
    assert!((0..10).all(|_| offer("quiet", RecordKind::Windows)));
    assert!(
        offer("loud", RecordKind::Events),
        "the fault that explains the flood"
    );
    let lost = 10 * DEVICE as u64 - DEVICE as u64;
    let failure = rig.thread.failure().unwrap();
    assert_eq!(
        (failure.cause, failure.dropped.windows),
        (StoreCause::TooSlow, lost)
    );
    assert_eq!(failure.dropped, rig.thread.all_dropped());
    assert_eq!(
        rig.published(),
        [(false, StoreCause::TooSlow.text().to_owned())]
    );
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
    let windows = rig.thread.of_device("a").writing_once(RecordKind::Windows);
    for _ in 0..3 {
        assert!(windows.offer(|_| Err(full())));
    }
    let events = rig.thread.writing(RecordKind::Events);
    events
        .run(|store| store.event(None, "test", "it fits"))
        .await
        .unwrap();
    rig.thread
        .run(|store| store.due_events(None, 1))
        .await
        .unwrap();
    rig.thread.idle().await;
    let failure = rig.thread.failure().unwrap();
    assert_eq!(
        (failure.cause, failure.dropped.windows),
        (StoreCause::DiskFull, 3)
    );
    assert_eq!(rig.published().len(), 1);
    assert!(windows.offer(|_| Ok(())));
    rig.thread.idle().await;
    assert_eq!(rig.thread.failure(), None);
    let published = rig.published();
    assert!(
        published.len() == 1 && published[0].0 && published[0].1.contains("3 windows"),
        "{published:?}"
    );
    // A hob that was switched off meanwhile sends no window that could be written.
    assert!(windows.offer(|_| Err(full())));
    rig.thread.idle().await;
    rig.thread.poll_health(None, PATIENCE).await;
    assert_eq!(rig.thread.failure(), None);
    assert_eq!(rig.thread.all_dropped().windows, 4);
}

#[tokio::test]
async fn a_store_that_hangs_is_told_and_a_refusal_is_none_of_its_failures() {
    let mut rig = rig();
    let refused = StoreError::NoLookup { version: 7 };
    let state = rig.thread.writing(RecordKind::State);
    assert!(state.run(|_| Err::<(), _>(refused)).await.is_err());
    assert_eq!(rig.thread.failure(), None);
    let release = rig.stall();
    let job = rig.thread.poll_health(None, PATIENCE).await;
    assert_eq!(rig.thread.failure(), None, "it may have begun just now");
    rig.thread.poll_health(job, PATIENCE).await;
    assert_eq!(rig.thread.failure().unwrap().cause, StoreCause::Silent);
    drop(release);
    rig.thread.idle().await;
    rig.thread.poll_health(job, PATIENCE).await;
    assert_eq!(rig.thread.failure(), None);
    assert_eq!(
        rig.published()
            .iter()
            .map(|(ok, _)| *ok)
            .collect::<Vec<_>>(),
        [false, true]
    );
    let panics = rig.thread.writing_once(RecordKind::Audits);
    assert!(
        panics
            .run(|_| -> Result<(), StoreError> { panic!("a test") })
            .await
            .is_err()
    );
    rig.thread.idle().await;
    let failure = rig.thread.failure().unwrap();
    assert_eq!(
        (failure.cause, failure.dropped.audits),
        (StoreCause::Defect, 1)
    );
    rig.thread.close().await;
    assert!(!rig.thread.access().offer(|_| Ok(())));
}

/// Jobs that each wait for a locked database leave no turn for a query, and the thread goes on all the same.
#[tokio::test]
async fn a_thread_that_ends_its_jobs_progresses_and_one_that_is_stuck_does_not() {
    let rig = rig();
    let later = || Instant::now() + JOB_LIMIT;
    assert!(rig.thread.progresses_at(later()), "without a job");
    let mut release = rig.stall();
    for _ in 0..3 {
        let (hold, held) = mpsc::channel::<()>();
        let (began, begun) = mpsc::channel();
        assert!(rig.thread.access().offer(move |_| {
            began.send(()).unwrap();
            let _ = held.recv();
            Err(full())
        }));
        let before = Instant::now();
        assert!(rig.thread.progresses_at(before), "a young job");
        assert!(!rig.thread.progresses_at(later()), "a stuck one");
        drop(std::mem::replace(&mut release, hold));
        begun.recv_timeout(PATIENCE).unwrap();
        assert!(rig.thread.progresses_at(before + JOB_LIMIT), "the next job");
    }
    drop(release);
    rig.thread.idle().await;
    assert!(rig.thread.progresses_at(later()), "without a job again");
}
