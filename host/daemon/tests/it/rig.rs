//! Test rig: simulated hobs that run in real time, and a daemon with a store of its own.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use ihd_daemon::{Daemon, DaemonConfig, OpenDevice, OpenedDevice, TruthFn};
use ihd_firmware::control::request::PanelEvent;
use ihd_link::{DeviceSpec, LinkError, Transport};
use ihd_model::{
    Command, CommandError, CommandReply, DaemonEvent, DeviceReport, DeviceState, EventKind,
};
use ihd_sim::hob::{HobConfig, SimHob};
use tokio::sync::broadcast::{self, error::TryRecvError};
use tokio::task::JoinHandle;

/// Longest wait for an event; it only ends a hang.
pub const PATIENCE: Duration = Duration::from_secs(300);

/// Largest lag behind real time that is caught up with, in seconds.
const MAX_LAG_S: f64 = 0.05;

/// Clock of the daemon, which stands still between two calls of [`Clock::pass`]. The hobs' clocks go on.
pub struct Clock {
    /// Keeps a blocking task running: without one a paused clock jumps ahead when all tasks wait.
    _holds: std::sync::mpsc::Sender<()>,
}

impl Clock {
    /// Stops the clock of this runtime, which must have one thread.
    pub fn stop() -> Self {
        tokio::time::pause();
        let (holds, held) = std::sync::mpsc::channel::<()>();
        tokio::task::spawn_blocking(move || held.recv());
        Self { _holds: holds }
    }

    /// Lets time pass in steps; the daemon receives the hobs' messages in each.
    pub async fn pass(&self, time: Duration) {
        let mut left = time;
        while !left.is_zero() {
            let step = left.min(Duration::from_millis(500));
            tokio::time::advance(step).await;
            nap().await;
            left -= step;
        }
    }

    /// Lets the clock run again.
    pub fn go_on(self) {
        tokio::time::resume();
    }
}

/// Waits until a hob's own time has advanced by `time_s`.
pub async fn let_hob_run(bench: &Bench, time_s: f64) {
    let until_s = bench.hob().t_s() + time_s;
    while bench.hob().t_s() < until_s {
        nap().await;
    }
}

/// Sleeps 10 ms of real time, so that other threads can run.
pub async fn nap() {
    let nap = || thread::sleep(Duration::from_millis(10));
    tokio::task::spawn_blocking(nap).await.unwrap();
}

/// Simulated hob with its connection.
pub struct Bench {
    hob: Mutex<SimHob>,
    /// Number of threads that wait for the hob, which yields to them between two steps even if it lags.
    waiting: AtomicU64,
    /// Clock of the connections in microseconds: simulated time of the hobs, and time waited for a mute one.
    clock_us: AtomicU64,
    /// Number of the last connection; earlier ones are closed.
    connection: AtomicU64,
    /// `true` while no connection is possible; an open one is cut.
    pub unplugged: AtomicBool,
    /// `true` while no byte passes in either direction.
    pub mute: AtomicBool,
    stop: AtomicBool,
}

impl Bench {
    pub fn new(config: &HobConfig) -> Arc<Self> {
        let bench = Arc::new(Self {
            hob: Mutex::new(SimHob::new(config)),
            waiting: AtomicU64::new(0),
            clock_us: AtomicU64::new(0),
            connection: AtomicU64::new(0),
            unplugged: AtomicBool::new(false),
            mute: AtomicBool::new(false),
            stop: AtomicBool::new(false),
        });
        let running = Arc::clone(&bench);
        thread::spawn(move || running.run());
        bench
    }

    pub fn hob(&self) -> MutexGuard<'_, SimHob> {
        self.waiting.fetch_add(1, Ordering::Relaxed);
        let hob = self.hob.lock().unwrap_or_else(PoisonError::into_inner);
        self.waiting.fetch_sub(1, Ordering::Relaxed);
        hob
    }

    /// Replaces the hob by another one, as after a reset.
    pub fn replace(&self, config: &HobConfig) {
        *self.hob() = SimHob::new(config);
    }

    fn run(&self) {
        let mut due_s = self.hob().t_s();
        let mut last = Instant::now();
        while !self.stop.load(Ordering::Relaxed) {
            due_s += last.elapsed().as_secs_f64();
            last = Instant::now();
            {
                let mut hob = self.hob();
                due_s = due_s.min(hob.t_s() + MAX_LAG_S);
                if due_s < hob.t_s() - 1.0 {
                    due_s = hob.t_s();
                }
                let from_s = hob.t_s();
                while hob.t_s() < due_s && self.waiting.load(Ordering::Relaxed) == 0 {
                    hob.step();
                }
                let passed_us = (1e6 * (hob.t_s() - from_s)).round() as u64;
                self.clock_us.fetch_add(passed_us, Ordering::Relaxed);
            }
            thread::sleep(Duration::from_millis(1));
        }
    }

    pub fn panel(&self, level: u8) {
        self.hob().panel(PanelEvent::Level(level));
    }

    /// Returns the requested power of the hob, from daemon or panel, in watt.
    pub fn asked_w(&self) -> u16 {
        self.hob().housekeeping().control().asked_w()
    }

    /// Returns the source of true R and L.
    fn truth(self: &Arc<Self>) -> Arc<TruthFn> {
        let truths = self.hob().truths().clone();
        Arc::new(move |half_cycle| truths.get(half_cycle))
    }

    fn plug(self: &Arc<Self>, name: &str) -> Result<Box<dyn Transport>, LinkError> {
        if self.unplugged.load(Ordering::Relaxed) {
            return Err(LinkError::Connect {
                device: name.to_owned(),
                hint: "; it is unplugged".to_owned(),
                source: std::io::ErrorKind::NotFound.into(),
            });
        }
        let connection = 1 + self.connection.fetch_add(1, Ordering::Relaxed);
        Ok(Box::new(Plug {
            bench: Arc::clone(self),
            connection,
            name: name.to_owned(),
        }))
    }
}

struct Plug {
    bench: Arc<Bench>,
    connection: u64,
    name: String,
}

impl Plug {
    fn check(&self) -> Result<(), LinkError> {
        let cut = self.bench.unplugged.load(Ordering::Relaxed)
            || self.bench.connection.load(Ordering::Relaxed) != self.connection;
        match cut {
            true => Err(LinkError::Closed {
                device: self.name.clone(),
            }),
            false => Ok(()),
        }
    }
}

impl Transport for Plug {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.check()?;
        if !self.bench.mute.load(Ordering::Relaxed) {
            self.bench.hob().send(bytes);
        }
        Ok(())
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        let deadline = self.clock() + timeout;
        loop {
            self.check()?;
            let n = self.bench.hob().receive(buf);
            if self.bench.mute.load(Ordering::Relaxed) {
                thread::sleep(Duration::from_millis(1));
                let waited_us = timeout.as_micros() as u64;
                self.bench.clock_us.fetch_add(waited_us, Ordering::Relaxed);
                return Ok(0);
            }
            if n > 0 {
                return Ok(n);
            }
            if self.clock() >= deadline {
                return Ok(0);
            }
            thread::sleep(Duration::from_millis(1));
        }
    }

    /// Returns the hob's time, which runs slowly on a busy machine: waiting times follow it.
    fn clock(&self) -> Duration {
        Duration::from_micros(self.bench.clock_us.load(Ordering::Relaxed))
    }

    fn describe(&self) -> String {
        self.name.clone()
    }
}

/// Hobs by name, and a store that outlives the daemons on it.
pub struct Rig {
    pub benches: HashMap<String, Arc<Bench>>,
    pub folder: tempfile::TempDir,
}

impl Rig {
    /// Creates a hob of each name.
    pub fn new(names: &[&str]) -> Self {
        let bench = |(k, name): (usize, &&str)| {
            let config = HobConfig {
                seed: 1 + k as u64,
                ..HobConfig::default()
            };
            ((*name).to_owned(), Bench::new(&config))
        };
        Self {
            benches: names.iter().enumerate().map(bench).collect(),
            folder: tempfile::tempdir().unwrap(),
        }
    }

    pub fn bench(&self) -> &Arc<Bench> {
        &self.benches["bench"]
    }

    pub fn config(&self) -> DaemonConfig {
        let mut text = String::from("discover_usb = false\n");
        for name in self.benches.keys() {
            text += &format!("[[device]]\nname = \"{name}\"\naddress = \"serial:{name}\"\n");
        }
        let mut config = DaemonConfig::parse(&text, "test").unwrap();
        config.store = self.folder.path().join("store");
        config
    }

    /// Starts a daemon on the rig's store.
    pub async fn daemon(&self) -> Daemon {
        self.daemon_with(self.config()).await
    }

    pub async fn daemon_with(&self, config: DaemonConfig) -> Daemon {
        let benches = self.benches.clone();
        let open: Arc<OpenDevice> = Arc::new(move |address| match &address.spec {
            DeviceSpec::Serial(name) => benches[name].plug(name).map(|transport| OpenedDevice {
                transport,
                truth: Some(benches[name].truth()),
            }),
            other => panic!("{other} is on no bench"),
        });
        Daemon::start(config, open).await.unwrap()
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        for bench in self.benches.values() {
            bench.stop.store(true, Ordering::Relaxed);
        }
    }
}

/// Waits until the report of the device `bench` meets a condition; returns the report.
pub async fn until(daemon: &Daemon, is_met: impl Fn(&DeviceReport) -> bool) -> DeviceReport {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let report = daemon.view().device("bench").expect("it is configured");
        if is_met(&report) {
            return report;
        }
        assert!(Instant::now() < deadline, "still {report:#?}");
        nap().await;
    }
}

pub async fn until_state(daemon: &Daemon, state: DeviceState) -> DeviceReport {
    until(daemon, |report| report.state == state).await
}

/// Waits for an event of the device `bench`.
pub async fn wait_for_event<T>(
    events: &mut broadcast::Receiver<Arc<DaemonEvent>>,
    select: impl Fn(&EventKind) -> Option<T>,
) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        match events.try_recv() {
            Ok(event) => {
                if let Some(value) = select(&event.kind) {
                    return value;
                }
            }
            Err(TryRecvError::Empty) => {
                assert!(Instant::now() < deadline, "no such event");
                nap().await;
            }
            Err(e) => panic!("events were missed, or the daemon has ended: {e}"),
        }
    }
}

pub async fn power(
    daemon: &Daemon,
    holder: &str,
    power_w: u16,
) -> Result<CommandReply, CommandError> {
    daemon
        .command("bench", holder, Command::Power { power_w })
        .await
}

/// Carries out a command of which the store must know. On a busy machine the store may miss the device's time limit, and the
/// daemon refuses: nothing happened then, and the command is given again.
pub async fn command_stored(
    daemon: &Daemon,
    command: Command,
) -> Result<CommandReply, CommandError> {
    loop {
        match daemon.command("bench", "a", command.clone()).await {
            Err(error) if error.to_string().contains("the store ") => nap().await,
            done => return done,
        }
    }
}

/// Task that renews the lease of `bench` until it is dropped: on a busy machine a test may take longer than a lease lasts.
pub struct LeaseKeeper(JoinHandle<()>);

/// Keeps the lease of `bench` for a holder.
pub fn keep_lease(daemon: &Daemon, holder: &'static str) -> LeaseKeeper {
    let daemon = daemon.clone();
    LeaseKeeper(tokio::spawn(async move {
        loop {
            // Another holder may have it, as some tests intend.
            let _ = daemon.take_lease("bench", holder, false).await;
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    }))
}

impl Drop for LeaseKeeper {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// TCP server of a simulated hob, until it is dropped.
pub struct Tcp {
    pub port: u16,
    stop: Arc<AtomicBool>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Tcp {
    pub fn start(address: &str, seed: u64) -> Self {
        let config = HobConfig {
            seed,
            ..HobConfig::default()
        };
        let mut server = ihd_sim::server::HobServer::bind(address, SimHob::new(&config)).unwrap();
        let port = server.address().port();
        let stop = Arc::new(AtomicBool::new(false));
        let stopping = Arc::clone(&stop);
        let thread = thread::spawn(move || server.run(1.0, &stopping, |_| ()).unwrap());
        Self {
            port,
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Tcp {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
