//! Daemon with two simulated hobs, and a server in front of it.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ihd_api::{ApiServer, ServerOptions};
use ihd_daemon::config::DeviceConfig;
use ihd_daemon::simulation::{self, HobKind, World};
use ihd_daemon::{Daemon, DaemonConfig};
use ihd_model::{Command, DaemonEvent, DeviceReport, DeviceState, EventKind};
use tokio::runtime::{Handle, Runtime};
use tokio::sync::broadcast::{self, error::TryRecvError};
use tokio::sync::{mpsc, watch};

use crate::http::PATIENCE;

/// Name of the first device; must be percent-encoded in a path.
pub const NAME: &str = "serial:/dev/tty ä";

/// Path of the first device.
pub const DEVICE: &str = "/api/v1/devices/serial%3A%2Fdev%2Ftty%20%C3%A4";

/// Name of the second device, which sorts after the first.
pub const OTHER: &str = "usb:2064";

/// Scheduler turns within which all work that became due by moving the clock is done.
const TURNS: u32 = 32;

/// Clock of a server and its hobs, paused between calls of [`Clock::pass`].
pub struct Clock {
    moves: mpsc::UnboundedSender<(Duration, std::sync::mpsc::Sender<()>)>,
}

impl Clock {
    /// Drives a single-threaded runtime with a paused clock until the clock is dropped.
    fn start(runtime: Runtime) -> Self {
        let (moves, mut moved) =
            mpsc::unbounded_channel::<(Duration, std::sync::mpsc::Sender<()>)>();
        std::thread::spawn(move || {
            runtime.block_on(async {
                // A paused clock jumps ahead when all tasks wait, unless a blocking one is running.
                let (holds, held) = std::sync::mpsc::channel::<()>();
                let holding = tokio::task::spawn_blocking(move || held.recv());
                while let Some((time, passed)) = moved.recv().await {
                    tokio::time::advance(time).await;
                    for _ in 0..TURNS {
                        tokio::task::yield_now().await;
                    }
                    // The test may have ended meanwhile.
                    let _ = passed.send(());
                }
                drop(holds);
                let _ = holding.await;
            });
            runtime.shutdown_background();
        });
        Self { moves }
    }

    /// Advances the clock by `time` and one millisecond (timers round up); returns when the server has done all work that became due.
    pub fn pass(&self, time: Duration) {
        let (passed, has_passed) = std::sync::mpsc::channel();
        let time = time + Duration::from_millis(1);
        self.moves.send((time, passed)).expect("the server runs");
        has_passed.recv().expect("the server runs");
    }

    /// Lets a second pass in steps of 10 ms, within which hobs and daemon exchange messages.
    pub fn second(&self) {
        for _ in 0..100 {
            self.pass(Duration::from_millis(9));
        }
    }

    /// Runs `f`, which waits for a hob, while the clock goes on.
    pub fn during<T: Send>(&self, f: impl FnOnce() -> T + Send) -> T {
        std::thread::scope(|scope| {
            let running = scope.spawn(f);
            while !running.is_finished() {
                self.pass(Duration::ZERO);
                std::thread::sleep(Duration::from_millis(1));
            }
            running.join().expect("it does not panic")
        })
    }
}

/// Server that ends with the test.
pub struct Running {
    pub daemon: Daemon,
    /// Hobs and disk.
    pub world: Arc<World>,
    pub address: std::net::SocketAddr,
    pub url: String,
    pub certificate: Option<PathBuf>,
    /// Folder of the server's files; the store is in `store`.
    pub dir: tempfile::TempDir,
    events: broadcast::Receiver<Arc<DaemonEvent>>,
    stop: watch::Sender<bool>,
    served: tokio::task::JoinHandle<()>,
    handle: Handle,
    runtime: Option<Runtime>,
}

impl Running {
    /// Starts it on loopback without tokens, without a hob.
    pub fn start() -> Self {
        Self::with(|_, _| {})
    }

    /// Starts it with options changed by `set`, without a hob; the path is a folder for files.
    pub fn with(set: impl FnOnce(&mut ServerOptions, &Path)) -> Self {
        Self::on(Runtime::new().unwrap(), false, set)
    }

    /// Starts it with options changed by `set`, with connected hobs.
    pub fn with_hobs(set: impl FnOnce(&mut ServerOptions, &Path)) -> Self {
        let server = Self::on(Runtime::new().unwrap(), true, set);
        let deadline = Instant::now() + PATIENCE;
        while !server.is_connected() {
            assert!(Instant::now() < deadline, "no hob connects");
            std::thread::sleep(Duration::from_millis(5));
        }
        server
    }

    /// Starts it on loopback without tokens and without a hob, with a clock moved by the test.
    pub fn with_clock() -> (Self, Clock) {
        Self::with_clock_and(|_, _| {})
    }

    /// Starts it with options changed by `set`, without a hob, with a clock moved by the test.
    pub fn with_clock_and(set: impl FnOnce(&mut ServerOptions, &Path)) -> (Self, Clock) {
        Self::on_clock(false, set)
    }

    /// Starts it with options changed by `set`, with connected hobs and a clock moved by the test.
    pub fn with_hobs_and_clock(set: impl FnOnce(&mut ServerOptions, &Path)) -> (Self, Clock) {
        let (server, clock) = Self::on_clock(true, set);
        for _ in 0..1_000 {
            if server.is_connected() {
                return (server, clock);
            }
            clock.pass(Duration::from_millis(9));
        }
        panic!("no hob connects");
    }

    fn on_clock(is_plugged: bool, set: impl FnOnce(&mut ServerOptions, &Path)) -> (Self, Clock) {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        let runtime = builder.enable_all().start_paused(true).build().unwrap();
        let mut server = Self::on(runtime, is_plugged, set);
        let runtime = server.runtime.take().expect("it was just built");
        (server, Clock::start(runtime))
    }

    fn on(runtime: Runtime, is_plugged: bool, set: impl FnOnce(&mut ServerOptions, &Path)) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut options = ServerOptions {
            listen: "127.0.0.1:0".into(),
            allowed_hosts: vec![],
            token_file: None,
            tls: None,
            backups: dir.path().join("backups"),
        };
        set(&mut options, dir.path());
        // Seed 0 has no faults.
        let world = World::new(0, HobKind::Script, false);
        for socket in &mut world.lock().sockets {
            socket.is_plugged = is_plugged;
        }
        let (daemon, server) = runtime.block_on(async {
            let daemon = simulation::start(&world, config(dir.path())).await.unwrap();
            simulation::spawn_learner(&daemon);
            (daemon, ApiServer::bind(&options).await.unwrap())
        });
        let (stop, stopping) = watch::channel(false);
        let (address, url) = (server.address(), server.url());
        let certificate = server.certificate().map(|(_, path)| path);
        let events = daemon.watch();
        let served = runtime.spawn(server.run(daemon.clone(), stopping));
        Self {
            daemon,
            world,
            address,
            url,
            certificate,
            dir,
            events,
            stop,
            served,
            handle: runtime.handle().clone(),
            runtime: Some(runtime),
        }
    }

    fn is_connected(&self) -> bool {
        let settled = |report: &DeviceReport| report.state == DeviceState::Idle;
        self.daemon.view().devices().iter().all(settled)
    }

    /// Returns the daemon's time, in milliseconds since 1970, UTC.
    pub fn now_ms(&self) -> i64 {
        // For the clock.
        let _in_runtime = self.handle.enter();
        self.daemon.view().now_ms()
    }

    /// Returns the report of the first device.
    pub fn report(&self) -> DeviceReport {
        self.daemon.view().device(NAME).expect("it is configured")
    }

    /// Returns holder and text of all commands since the start.
    pub fn commands(&mut self) -> Vec<(String, String)> {
        let mut all = Vec::new();
        loop {
            match self.events.try_recv() {
                Ok(event) => {
                    if let EventKind::Command { holder, text, .. } = &event.kind {
                        all.push((holder.clone(), text.clone()));
                    }
                }
                Err(TryRecvError::Empty) => return all,
                Err(error) => panic!("{error}"),
            }
        }
    }

    /// Sends a command to the first device.
    pub fn command(&self, holder: &str, command: Command) {
        let commanded = self.daemon.command(NAME, holder, command);
        self.handle.block_on(commanded).unwrap();
    }

    /// Publishes an event of a device: `holder` takes its lease from any other.
    pub fn take_lease(&self, device: &str, holder: &str) {
        let taken = self.daemon.take_lease(device, holder, true);
        self.handle.block_on(taken).unwrap();
    }

    /// Publishes an event of a device: `holder` releases its lease.
    pub fn release_lease(&self, device: &str, holder: &str) {
        let released = self.daemon.release_lease(device, holder);
        self.handle.block_on(released).unwrap();
    }

    /// Returns the folder of recordings.
    pub fn recordings(&self) -> PathBuf {
        let folder = self.dir.path().join("store/recordings");
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    /// Stops the server and waits for its end.
    pub fn stop(&self) {
        self.stop.send(true).unwrap();
        let deadline = Instant::now() + PATIENCE;
        while !self.served.is_finished() {
            assert!(Instant::now() < deadline, "it does not end");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// Returns the configuration of both devices. Names as those of boards on USB are beyond what the file may name.
fn config(folder: &Path) -> DaemonConfig {
    let mut config = DaemonConfig::parse("discover_usb = false", "test").unwrap();
    config.store = folder.join("store");
    config.devices = [(NAME, "serial:left"), (OTHER, "serial:right")]
        .map(|(name, address)| DeviceConfig {
            name: name.into(),
            address: address.parse::<ihd_link::DeviceSpec>().unwrap().into(),
        })
        .into();
    config
}
