//! Sessions with devices that heat, vanish, return, fall silent, or have another protocol.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use ihd_daemon::{Daemon, DaemonConfig, OpenDevice, OpenedDevice};
use ihd_link::tcp::TcpTransport;
use ihd_link::{DeviceSpec, LinkError, Transport};
use ihd_model::{DeviceState, WindowCounts};
use ihd_shared::wire::frame::{MAX_ENCODED, encode};
use ihd_shared::wire::hello::{ROLE_DEVICE, ours};
use ihd_sim::hob::HobConfig;

use super::rig::{Clock, PATIENCE, Rig, Tcp, let_hob_run, nap, power, until, until_state};

/// Returns `true` if each announced window is accounted for, and only once.
fn is_balanced(c: WindowCounts) -> bool {
    c.announced == c.stored + c.refused + c.not_stored + c.dropped_by_device + c.lost
}

#[tokio::test(flavor = "multi_thread")]
async fn it_heats_nothing_by_itself_and_stores_what_the_panel_heats() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    let report = until_state(&daemon, DeviceState::Idle).await;
    assert_eq!(report.identity.unwrap().board, "simulated hob");
    let_hob_run(rig.bench(), 0.5).await;
    assert_eq!(rig.bench().asked_w(), 0);
    rig.bench().panel(6);
    let report = until(&daemon, |r| {
        r.state == DeviceState::Learning && r.windows.stored >= 5
    })
    .await;
    assert_eq!(report.asked_by_daemon_w, 0);
    assert!(report.live.unwrap().power_w > 100.0);
    rig.bench().panel(0);
    let report = until(&daemon, |r| {
        r.state == DeviceState::Idle && is_balanced(r.windows)
    })
    .await;
    daemon.stop().await;
    // Windows acknowledged before the stop are in the store.
    let store = ihd_store::Store::open(&rig.config().store, &rig.config().store_settings());
    let store = store.unwrap().store;
    assert!(
        store.figures().windows == 0,
        "a new store counts from its start"
    );
    assert!(report.windows.stored >= 5);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pot_is_waited_for() {
    let rig = Rig::new(&["bench"]);
    rig.bench()
        .hob()
        .set_pot(ihd_sim::behavioural::PotKind::None)
        .unwrap();
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    power(&daemon, "me", 1_000).await.unwrap();
    let report = until_state(&daemon, DeviceState::WaitingForPot).await;
    assert!(report.detail.contains("pot"), "{}", report.detail);
    daemon.stop().await;
    assert_eq!(rig.bench().asked_w(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cut_link_is_found_again_with_the_hob_off_and_nothing_counted_twice() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    power(&daemon, "me", 1_000).await.unwrap();
    let before = until(&daemon, |r| r.windows.stored >= 3).await;
    rig.bench().unplugged.store(true, Ordering::Relaxed);
    let gone = until_state(&daemon, DeviceState::Searching).await;
    assert!(!gone.detail.is_empty());
    assert!(gone.live.is_none(), "nobody knows what it does");
    let refused = power(&daemon, "me", 1_000).await.unwrap_err().to_string();
    assert!(refused.contains("not connected"), "{refused}");
    rig.bench().unplugged.store(false, Ordering::Relaxed);
    let back = until(&daemon, |r| {
        r.connections >= 2 && r.state == DeviceState::Idle && is_balanced(r.windows)
    })
    .await;
    assert_eq!((rig.bench().asked_w(), back.asked_by_daemon_w), (0, 0));
    assert!(back.windows.announced >= before.windows.announced);
    daemon.stop().await;
}

#[tokio::test]
async fn a_silent_device_is_suspended_and_comes_back() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    until_state(&daemon, DeviceState::Idle).await;
    let clock = Clock::stop();
    rig.bench().mute.store(true, Ordering::Relaxed);
    // Messages sent before are received now.
    nap().await;
    clock.pass(Duration::from_millis(1_500)).await;
    assert_eq!(
        daemon.view().device("bench").unwrap().state,
        DeviceState::Idle
    );
    clock.pass(Duration::from_secs(1)).await;
    let report = until_state(&daemon, DeviceState::Suspended).await;
    assert!(report.detail.contains("nothing came"), "{}", report.detail);
    // Three requests follow at intervals of two seconds; each waits for its response on the link's own clock.
    let deadline = Instant::now() + PATIENCE;
    while daemon.view().device("bench").unwrap().state == DeviceState::Suspended {
        assert!(Instant::now() < deadline, "it is never given up");
        clock.pass(Duration::from_millis(500)).await;
    }
    until_state(&daemon, DeviceState::Searching).await;
    rig.bench().mute.store(false, Ordering::Relaxed);
    clock.go_on();
    until_state(&daemon, DeviceState::Idle).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_was_reset_begins_anew() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    rig.bench().panel(6);
    let before = until(&daemon, |r| r.windows.stored >= 2).await;
    rig.bench().replace(&HobConfig {
        seed: 77,
        ..HobConfig::default()
    });
    rig.bench().panel(6);
    until(&daemon, |r| {
        r.identity.as_ref().is_some_and(|i| i.boot_id == 77)
            && r.windows.stored > before.windows.stored + 2
    })
    .await;
    rig.bench().panel(0);
    until(&daemon, |r| is_balanced(r.windows)).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_boot_with_the_number_of_another_replaces_nothing_that_is_stored() {
    let rig = Rig::new(&["bench"]);
    let daemon = rig.daemon().await;
    rig.bench().panel(6);
    until(&daemon, |r| r.windows.stored >= 3).await;
    daemon.stop().await;
    rig.bench().replace(&HobConfig::default());
    let daemon = rig.daemon().await;
    rig.bench().panel(6);
    let windows = until(&daemon, |r| r.windows.not_stored >= 2).await.windows;
    assert_eq!((windows.stored, windows.learned), (0, 0), "{windows:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_is_killed_is_found_again_over_tcp() {
    let folder = tempfile::tempdir().unwrap();
    let server = Tcp::start("127.0.0.1:0", 5);
    let port = server.port;
    let mut config = DaemonConfig::parse(
        &format!("[[device]]\nname = \"bench\"\naddress = \"tcp:127.0.0.1:{port}\"\n"),
        "test",
    )
    .unwrap();
    config.store = folder.path().to_owned();
    let open: Arc<OpenDevice> = Arc::new(|address| match &address.spec {
        DeviceSpec::Tcp(place) => Ok(OpenedDevice::real(Box::new(TcpTransport::connect(place)?))),
        other => panic!("{other}"),
    });
    let daemon = Daemon::start(config, open).await.unwrap();
    until_state(&daemon, DeviceState::Idle).await;
    drop(server);
    let report = until_state(&daemon, DeviceState::Searching).await;
    assert!(report.detail.contains("127.0.0.1"), "{}", report.detail);
    let _server = Tcp::start(&format!("127.0.0.1:{port}"), 6);
    let report = until(&daemon, |r| {
        r.state == DeviceState::Idle && r.connections >= 2
    })
    .await;
    assert_eq!(report.identity.unwrap().boot_id, 6);
    daemon.stop().await;
}

/// Transport that answers a hello with one of another major version.
struct Foreign(Vec<u8>);

impl Transport for Foreign {
    fn send(&mut self, _: &[u8]) -> Result<(), LinkError> {
        let mut hello = ours(ROLE_DEVICE, 0, 9, "ihd-firmware 9\u{1b}[2J", "board");
        hello.protocol_major += 1;
        let mut frame = [0; MAX_ENCODED];
        let length = encode(&hello, 0, &mut frame).unwrap();
        self.0.extend(&frame[..length]);
        Ok(())
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        if self.0.is_empty() {
            std::thread::sleep(timeout.min(Duration::from_millis(5)));
        }
        let n = self.0.len().min(buf.len());
        buf[..n].copy_from_slice(&self.0[..n]);
        self.0.drain(..n);
        Ok(n)
    }

    fn describe(&self) -> String {
        "foreign".to_owned()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_of_another_protocol_says_what_to_update() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = DaemonConfig::parse(
        "[[device]]\nname = \"bench\"\naddress = \"usb:1\"\n",
        "test",
    )
    .unwrap();
    config.store = folder.path().to_owned();
    let open: Arc<OpenDevice> = Arc::new(|_| Ok(OpenedDevice::real(Box::new(Foreign(Vec::new())))));
    let daemon = Daemon::start(config, open).await.unwrap();
    let report = until_state(&daemon, DeviceState::Incompatible).await;
    assert!(
        report.detail.contains("flash the firmware"),
        "{}",
        report.detail
    );
    assert!(!report.detail.contains('\u{1b}'), "{:?}", report.detail);
    daemon.stop().await;
}

#[tokio::test]
async fn stopping_does_not_wait_for_a_device_that_is_not_there() {
    let rig = Rig::new(&["bench"]);
    rig.bench().unplugged.store(true, Ordering::Relaxed);
    let daemon = rig.daemon().await;
    until(&daemon, |r| r.detail.contains("unplugged")).await;
    // Immediately, as no time passes.
    let _clock = Clock::stop();
    let stopping = tokio::spawn(async move { daemon.stop().await });
    let deadline = Instant::now() + PATIENCE;
    while !stopping.is_finished() {
        assert!(Instant::now() < deadline, "it waits");
        nap().await;
    }
}
