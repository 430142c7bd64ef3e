//! Tasks of an edge beside a simulated daemon and server, in simulated time.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use ihd_daemon::locking::lock;
use ihd_daemon::simulation::{HobKind, World, spawn_learner, start};
use ihd_daemon::{Daemon, DaemonConfig};
use ihd_link::Window;
use ihd_model::DeviceState;
use ihd_shared::lookup::prior::prior;
use ihd_shared::wire::hello::{ROLE_DEVICE, ours};
use ihd_shared::wire::messages::FrontEnd;
use ihd_store::{Store, StoreOptions, StoreReader};
use tempfile::TempDir;
use tokio::sync::watch;
use tokio::time::sleep;

use super::link::Link;
use super::lookups::{PushOutcome, push};
use super::state::State;
use super::{events, given_up, inbox, outbox};
use crate::lookups::LookupMessage;
use crate::names;
use crate::server::FleetServer;
use crate::simulation::line::SimulatedConnection;
use crate::simulation::server::ServerMemory;
use crate::standing::Standing;
use crate::stream_message::Outgoing;
use crate::wire::tests::window_message;

/// 2026-11-22T20:00:00Z, some hours before the simulated world begins.
const EVENING_MS: i64 = 1_795_377_600_000;

const DAY_MS: i64 = 86_400_000;

/// An admitted edge with the hobs "left" and "right".
struct Bench {
    folder: TempDir,
    world: Arc<World>,
    memory: Arc<ServerMemory>,
    daemon: Daemon,
    link: Arc<Link>,
    _stop: watch::Sender<bool>,
}

impl Bench {
    async fn start(folder: TempDir) -> Self {
        // Seed 0 is calm.
        let world = World::new(0, HobKind::Script, true);
        let text = "discover_usb = false
            [[device]]\nname = \"left\"\naddress = \"serial:left\"
            [[device]]\nname = \"right\"\naddress = \"serial:right\"
            [fleet]\nurl = \"nats://simulated\"\nedge = \"kitchen\"\n";
        let mut config = DaemonConfig::parse(text, "test").unwrap();
        config.store = folder.path().to_owned();
        let daemon = start(&world, config).await.unwrap();
        let (memory, state) = (ServerMemory::new(), State::begin());
        {
            let mut state = lock(&state);
            state.connect();
            state.standing = Standing::Held;
        }
        let line = SimulatedConnection::new(
            Arc::clone(&world),
            Arc::clone(&memory),
            Arc::clone(&state),
            0,
        );
        let (stop, stopped) = watch::channel(false);
        let link = Link::new(
            daemon.clone(),
            "kitchen".to_owned(),
            "nats://simulated".to_owned(),
            FleetServer::Simulated(line),
            state,
            stopped,
        );
        Self {
            folder,
            world,
            memory,
            daemon,
            link: Arc::new(link),
            _stop: stop,
        }
    }

    /// Publishes as another key's owner.
    fn publish(&self, subject: String, number: Option<String>) {
        let message = Outgoing {
            subject,
            payload: "x".into(),
            number,
            after: None,
        };
        let published = self.memory.disk().publish(self.world.now(), message);
        assert!(!published.unwrap().is_duplicate);
    }

    /// Returns the number of messages of a subject.
    fn count(&self, stream: &str, subject: &str) -> usize {
        let mut disk = self.memory.disk();
        let messages = disk.stream(stream).messages.values();
        messages.filter(|m| m.subject == subject).count()
    }

    async fn until_idle(&self, hob: &str) {
        while self.daemon.view().device(hob).unwrap().state != DeviceState::Idle {
            sleep(Duration::from_millis(100)).await;
        }
    }
}

/// Stores windows of a device that are due, and an event.
fn fill(folder: &Path, device: &str, at_ms: i64, windows: u32) {
    let settings = StoreOptions::default();
    let opened = Store::open_with_clock(folder, &settings, Arc::new(move || at_ms));
    let mut store = opened.unwrap().store;
    // Events from here on are for the fleet.
    store.due_events(None, 1).unwrap();
    let id = store.device(device, "serial:/dev/null").unwrap();
    let hello = ours(ROLE_DEVICE, 1, 7, "ihd-firmware 0.1.0", "sim");
    let front_end = FrontEnd {
        v_full_scale_mv: 700_000,
        i_full_scale_ma: 90_000,
        bus_full_scale_mv: 450_000,
        mains_full_scale_mv: 450_000,
        bits: 12,
    };
    let session = store.begin_session(id, &hello, &front_end).unwrap();
    for seq in 0..windows {
        let window = Window {
            seq,
            ..window_message().window
        };
        store.keep_window_for(session, &window, true).unwrap();
    }
    store.event(Some(id), "state", "it was there").unwrap();
}

/// Damages the samples or the trajectory of one window of a day.
fn damage(day: &Path) {
    const ZSTD: [u8; 4] = [0x28, 0xB5, 0x2F, 0xFD];
    let mut bytes = std::fs::read(day).unwrap();
    let packed = bytes.windows(4).rposition(|at| at == ZSTD).unwrap();
    bytes[packed] = 0;
    std::fs::write(day, bytes).unwrap();
}

/// More than a batch of an old name are the oldest windows: the key of the edge has no rights for them any more.
#[tokio::test(start_paused = true)]
async fn a_damaged_window_and_a_renamed_hob_hold_up_no_other() {
    let folder = tempfile::tempdir().unwrap();
    fill(folder.path(), "renamed", EVENING_MS - DAY_MS, 70);
    fill(folder.path(), "left", EVENING_MS, 3);
    damage(&folder.path().join("windows-2026-11-22.db"));
    let bench = Bench::start(folder).await;
    tokio::spawn(outbox::run(Arc::clone(&bench.link)));
    tokio::spawn(events::run(Arc::clone(&bench.link)));
    sleep(Duration::from_secs(20)).await;
    let tally = bench.daemon.fleet().tally().await.unwrap();
    assert_eq!((tally.due, tally.sent, tally.dead), (70, 2, 1), "{tally:?}");
    assert_eq!(bench.count(names::WINDOWS, &names::window("left")), 2);
    assert_eq!(bench.count(names::WINDOWS, &names::window("renamed")), 0);
    assert!(bench.count(names::EVENTS, &names::event("left")) > 0);
    assert_eq!(bench.count(names::EVENTS, &names::event("renamed")), 0);
    assert_eq!(bench.link.failure_text(), "");
    // With its name it is sent.
    let again = bench.daemon.fleet();
    let due = again.due_windows(vec!["renamed".to_owned()], 100).await;
    assert_eq!(due.unwrap().len(), 70);
    bench.daemon.stop().await;
}

#[tokio::test(start_paused = true)]
async fn a_lookup_for_a_hob_that_is_away_or_commanded_waits_without_a_command() {
    let bench = Bench::start(tempfile::tempdir().unwrap()).await;
    bench.until_idle("right").await;
    bench.until_idle("left").await;
    let mut lookup = prior();
    lookup.version = 1;
    lookup.r[0][0] += 1;
    let requested = LookupMessage::new(&lookup, "ada", false);
    {
        let left = &mut bench.world.lock().sockets[0];
        (left.is_plugged, left.connection) = (false, left.connection + 1);
    }
    while bench.daemon.view().device("left").unwrap().state != DeviceState::Searching {
        sleep(Duration::from_millis(100)).await;
    }
    bench
        .daemon
        .take_lease("right", "ada", false)
        .await
        .unwrap();
    for hob in ["left", "right"] {
        let waits = push(&bench.link, hob, &requested).await;
        assert_eq!(waits, Ok(PushOutcome::Waits), "{hob}");
    }
    bench.daemon.release_lease("right", "ada").await.unwrap();
    // The second time stands for an edge that ended before it noted the first.
    for _ in 0..2 {
        let pushed = push(&bench.link, "right", &requested).await;
        assert!(matches!(pushed, Ok(PushOutcome::InUse(_))), "{pushed:?}");
    }
    bench.daemon.stop().await;
    let reader = StoreReader::open(bench.folder.path()).unwrap();
    let commands = reader.audit(50).unwrap();
    let of_fleet = commands.iter().filter(|row| row.holder == "fleet").count();
    assert_eq!(of_fleet, 1, "{commands:?}");
}

/// "left" has no rights on the server, and more windows and events than a batch, all older than those of "right".
#[tokio::test(start_paused = true)]
async fn a_hob_without_rights_stops_no_other_and_is_an_alarm() {
    let folder = tempfile::tempdir().unwrap();
    fill(folder.path(), "left", EVENING_MS - DAY_MS, 155);
    fill(folder.path(), "right", EVENING_MS, 70);
    let bench = Bench::start(folder).await;
    bench.memory.disk().refused = ["left".to_owned()].into();
    tokio::spawn(outbox::run(Arc::clone(&bench.link)));
    tokio::spawn(events::run(Arc::clone(&bench.link)));
    sleep(Duration::from_secs(20)).await;
    let tally = bench.daemon.fleet().tally().await.unwrap();
    assert_eq!((tally.due, tally.sent), (155, 70), "{tally:?}");
    assert!(bench.count(names::EVENTS, &names::event("right")) > 0);
    let alarms = bench.link.alarms();
    assert!(
        alarms.len() == 1 && alarms[0].contains("hob left (events, sending)"),
        "{alarms:?}"
    );
    // With its rights everything follows.
    bench.memory.disk().refused.clear();
    sleep(Duration::from_secs(90)).await;
    let tally = bench.daemon.fleet().tally().await.unwrap();
    assert_eq!((tally.due, tally.sent), (0, 225), "{tally:?}");
    assert!(bench.count(names::EVENTS, &names::event("left")) > 0);
    assert_eq!(bench.link.alarms(), [""; 0]);
    bench.daemon.stop().await;
}

#[tokio::test(start_paused = true)]
async fn an_event_does_not_pass_for_another_keys_duplicate() {
    let folder = tempfile::tempdir().unwrap();
    fill(folder.path(), "left", EVENING_MS, 1);
    let bench = Bench::start(folder).await;
    for number in 1..=300 {
        let id = format!("kitchen-event-{number}");
        bench.publish(names::event("elsewhere"), Some(id));
    }
    tokio::spawn(events::run(Arc::clone(&bench.link)));
    sleep(Duration::from_secs(20)).await;
    assert!(bench.count(names::EVENTS, &names::event("left")) > 0);
    bench.daemon.stop().await;
}

/// A worker's key has published results of windows to come: a worker's own answers are refused, and nothing arrives.
#[tokio::test(start_paused = true)]
async fn a_window_whose_result_was_put_in_advance_is_identified_here() {
    let folder = tempfile::tempdir().unwrap();
    fill(folder.path(), "left", EVENING_MS, 3);
    let bench = Bench::start(folder).await;
    let due = bench.daemon.fleet();
    let due = due.due_windows(vec!["left".to_owned()], 9).await.unwrap();
    assert_eq!(due.len(), 3);
    spawn_learner(&bench.daemon);
    tokio::spawn(inbox::run(Arc::clone(&bench.link)));
    bench.publish(names::result("left", due[0].boot, 1_000), None);
    sleep(Duration::from_secs(10)).await;
    let later = ("left".to_owned(), due[0].boot, 1_000);
    assert!(bench.link.state().oddities.is_early(&later));
    let alarms = bench.link.alarms();
    assert!(
        alarms.len() == 1 && alarms[0].contains("left"),
        "{alarms:?}"
    );
    for window in &due {
        let key = (window.device.clone(), window.boot, window.seq);
        bench.link.state().oddities.expect_none(key);
    }
    tokio::spawn(outbox::run(Arc::clone(&bench.link)));
    tokio::spawn(given_up::run(Arc::clone(&bench.link)));
    sleep(Duration::from_secs(60)).await;
    let tally = bench.daemon.fleet().tally().await.unwrap();
    assert_eq!(
        (tally.due, tally.sent, tally.answered),
        (0, 0, 3),
        "{tally:?}"
    );
    bench.daemon.stop().await;
}

#[tokio::test(start_paused = true)]
async fn a_part_that_panics_is_an_alarm_and_begins_anew() {
    let bench = Bench::start(tempfile::tempdir().unwrap()).await;
    let (began, starts) = watch::channel(0);
    let began = Arc::new(began);
    let run = move |_| {
        let began = Arc::clone(&began);
        async move {
            began.send_modify(|n| *n += 1);
            assert!(*began.borrow() > 1, "the first time");
            std::future::pending().await
        }
    };
    tokio::spawn(Arc::clone(&bench.link).keep("cards", run));
    sleep(Duration::from_secs(10)).await;
    assert_eq!(*starts.borrow(), 2);
    let alarms = bench.link.alarms();
    assert!(
        alarms.len() == 1 && alarms[0].contains("cards"),
        "{alarms:?}"
    );
    bench.daemon.stop().await;
}
