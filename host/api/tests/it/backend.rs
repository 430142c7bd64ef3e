//! Fake daemon with one device, and a server in front of it.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use ihd_api::backend::{Backend, BackendFuture, LiveSource, Liveness, Metric};
use ihd_api::model::{StoredLookup, StoredResult};
use ihd_api::{Server, ServerOptions};
use ihd_daemon::JournalFilter;
use ihd_daemon::model::{
    Command, CommandError, CommandReply, DaemonEvent, DeviceReport, DeviceState, Fit, FleetReport,
    History, Hob, JournalEntry, Lease, Live, LiveDevice, LiveTelemetry, LookupReport, Map,
    PotCurve, PotPoint, RecordingFile, Scope, StoreFailure, WindowCounts, WindowQuery,
    WindowSummary,
};
use tokio::runtime::Runtime;
use tokio::sync::{broadcast, mpsc, watch};
use tokio::time::Instant;

use crate::http::PATIENCE;

/// Name of the only device; must be percent-encoded in a path.
pub const NAME: &str = "serial:/dev/tty ä";

/// Requests that the fake has received, and its state.
#[derive(Default)]
pub struct Requests {
    pub commands: Vec<(String, Command)>,
    pub lease: Option<String>,
    pub backups: Vec<PathBuf>,
    pub results: Vec<(u32, Option<i64>)>,
    pub histories: Vec<(i64, i64, usize)>,
    pub windows: Vec<usize>,
    pub scopes: Vec<WindowQuery>,
    pub trainings: Vec<usize>,
    pub maps: Vec<Option<u32>>,
    pub journals: Vec<JournalFilter>,
    pub store_failure: Option<StoreFailure>,
    /// Report of the fleet; initially `None`.
    pub fleet: Option<Arc<FleetReport>>,
}

#[derive(Clone)]
pub struct Fake {
    pub asked: Arc<Mutex<Requests>>,
    pub notices: broadcast::Sender<Arc<DaemonEvent>>,
    pub recordings: Arc<tempfile::TempDir>,
    pub world: Arc<World>,
}

/// Simulated devices, with counters of the queries.
#[derive(Default)]
pub struct World {
    /// Half-cycles of each device so far.
    pub half_cycles: AtomicU64,
    /// Calls of `collect` by all subscribers.
    pub collections: AtomicU64,
    /// Number of devices that send telemetry.
    pub devices: AtomicU64,
    /// `true` if each report differs from the one before.
    pub restless: AtomicBool,
    /// Number of reports so far.
    pub reports: AtomicU32,
}

struct FakeSource {
    world: Arc<World>,
    every: Duration,
    seen: u64,
    collected: Instant,
}

impl LiveSource for FakeSource {
    fn collect(&mut self) -> LiveTelemetry {
        self.world.collections.fetch_add(1, Ordering::Relaxed);
        let came = self.world.half_cycles.load(Ordering::Relaxed);
        let passed = self.collected.elapsed().as_secs_f64() / self.every.as_secs_f64();
        let device = LiveDevice {
            half_cycles: came - self.seen,
            skipped: (passed.round() as u32).saturating_sub(1),
            last: live(came),
            phase_deg: None,
            resonance_hz: None,
            power_w: [1.0, 2.0],
            r_ohm: None,
            l_h: None,
            f_sw_hz: None,
        };
        (self.seen, self.collected) = (came, Instant::now());
        let count = match device.half_cycles {
            0 => 0,
            _ => self.world.devices.load(Ordering::Relaxed),
        };
        LiveTelemetry {
            at_ms: ihd_daemon::event_bus::now_ms(),
            devices: (0..count)
                .map(|k| (format!("device-{k:03}"), device.clone()))
                .collect(),
        }
    }
}

pub fn live(half_cycle: u64) -> Live {
    Live {
        half_cycle: half_cycle as u32,
        state: "Heating".into(),
        pot: "Ferromagnetic".into(),
        fault: 0,
        fault_text: String::new(),
        limit: "None".into(),
        asked_w: 1_200,
        power_w: 1_203.5,
        f_sw_hz: 51_020,
        i_crest_a: 44.75,
        r_ohm: 3.274,
        l_h: 19.1e-6,
    }
}

impl Fake {
    pub fn new() -> Self {
        Self {
            asked: Arc::default(),
            notices: broadcast::channel(64).0,
            recordings: Arc::new(tempfile::tempdir().unwrap()),
            world: Arc::default(),
        }
    }

    fn report(&self) -> DeviceReport {
        let asked = self.asked.lock().unwrap();
        let reports = self.world.reports.fetch_add(1, Ordering::Relaxed);
        let restless = self.world.restless.load(Ordering::Relaxed);
        DeviceReport {
            connections: if restless {
                reports
            } else {
                report().connections
            },
            live: Some(live(self.world.half_cycles.load(Ordering::Relaxed))),
            lease: asked.lease.clone().map(|holder| Lease {
                holder,
                expires_in_s: 10,
            }),
            ..report()
        }
    }

    fn known(device: &str) -> Result<(), CommandError> {
        if device == NAME {
            Ok(())
        } else {
            Err(CommandError::NoDevice {
                name: device.into(),
            })
        }
    }

    fn leased(&self, holder: &str) -> Result<(), CommandError> {
        match &self.asked.lock().unwrap().lease {
            Some(other) if other != holder => Err(CommandError::Leased {
                name: NAME.into(),
                holder: other.clone(),
                expires_in_s: 7,
            }),
            _ => Ok(()),
        }
    }
}

fn report() -> DeviceReport {
    DeviceReport {
        name: NAME.into(),
        address: NAME.into(),
        serial: NAME.into(),
        updates_needed: String::new(),
        state: DeviceState::Faulted,
        since_s: 5,
        detail: "a \"fault\"\nin two lines".into(),
        identity: None,
        live: None,
        lookup: LookupReport::default(),
        windows: WindowCounts {
            announced: 12,
            stored: 11,
            lost: 1,
            ..WindowCounts::default()
        },
        asked_by_daemon_w: 0,
        lease: None,
        sweep_left_w: vec![],
        recording: None,
        recording_now: None,
        pot_temperature: None,
        connections: 3,
        frames_beyond: 0,
    }
}

fn answer<'a, T: Send + 'a>(answer: Result<T, CommandError>) -> BackendFuture<'a, T> {
    Box::pin(async move { answer })
}

impl Backend for Fake {
    fn hob(&self) -> Hob {
        ihd_daemon::hob()
    }

    fn devices(&self) -> Vec<DeviceReport> {
        vec![self.report()]
    }

    fn device(&self, name: &str) -> Option<DeviceReport> {
        (name == NAME).then(|| self.report())
    }

    fn fleet(&self) -> Option<Arc<FleetReport>> {
        self.asked.lock().unwrap().fleet.clone()
    }

    fn live(&self, every: Duration) -> Box<dyn LiveSource> {
        Box::new(FakeSource {
            world: self.world.clone(),
            every,
            seen: self.world.half_cycles.load(Ordering::Relaxed),
            collected: Instant::now(),
        })
    }

    fn command<'a>(
        &'a self,
        device: &'a str,
        holder: &'a str,
        command: Command,
    ) -> BackendFuture<'a, CommandReply> {
        let known = Self::known(device).and_then(|()| self.leased(holder));
        answer(known.map(|()| {
            let mut asked = self.asked.lock().unwrap();
            asked.commands.push((holder.into(), command));
            CommandReply {
                text: "done".into(),
                file: None,
            }
        }))
    }

    fn take_lease<'a>(
        &'a self,
        device: &'a str,
        holder: &'a str,
        force: bool,
    ) -> BackendFuture<'a, Lease> {
        let free = if force { Ok(()) } else { self.leased(holder) };
        answer(Self::known(device).and(free).map(|()| {
            self.asked.lock().unwrap().lease = Some(holder.into());
            Lease {
                holder: holder.into(),
                expires_in_s: 10,
            }
        }))
    }

    fn release_lease<'a>(&'a self, device: &'a str, holder: &'a str) -> BackendFuture<'a, ()> {
        let free = Self::known(device).and_then(|()| self.leased(holder));
        answer(free.map(|()| self.asked.lock().unwrap().lease = None))
    }

    fn watch(&self) -> broadcast::Receiver<Arc<DaemonEvent>> {
        self.notices.subscribe()
    }

    fn results<'a>(
        &'a self,
        device: &'a str,
        limit: u32,
        since_ms: Option<i64>,
    ) -> BackendFuture<'a, Vec<StoredResult>> {
        self.asked.lock().unwrap().results.push((limit, since_ms));
        answer(Self::known(device).map(|()| vec![]))
    }

    fn lookups<'a>(&'a self, device: &'a str) -> BackendFuture<'a, Vec<StoredLookup>> {
        answer(Self::known(device).map(|()| {
            vec![StoredLookup {
                version: 3,
                state: "active".into(),
                at_ms: 1,
                origin: "host".into(),
                why: String::new(),
                blob: vec![0, 255],
            }]
        }))
    }

    fn recordings(&self) -> BackendFuture<'_, Vec<RecordingFile>> {
        let listed = ihd_daemon::recording::list(&self.recordings_folder(), &[NAME.into()], &[]);
        answer(listed.map_err(|e| CommandError::Failed { why: e.to_string() }))
    }

    fn recordings_folder(&self) -> PathBuf {
        self.recordings.path().to_owned()
    }

    fn history<'a>(
        &'a self,
        device: &'a str,
        from_ms: i64,
        to_ms: i64,
        columns: usize,
    ) -> BackendFuture<'a, History> {
        let query = (from_ms, to_ms, columns);
        self.asked.lock().unwrap().histories.push(query);
        answer(Self::known(device).map(|()| History {
            from_ms,
            to_ms,
            ..History::default()
        }))
    }

    fn windows<'a>(
        &'a self,
        device: &'a str,
        limit: usize,
    ) -> BackendFuture<'a, Vec<WindowSummary>> {
        self.asked.lock().unwrap().windows.push(limit);
        answer(Self::known(device).map(|()| vec![]))
    }

    /// The only window is number 5 of boot 7.
    fn scope<'a>(
        &'a self,
        device: &'a str,
        query: WindowQuery,
    ) -> BackendFuture<'a, Option<Scope>> {
        self.asked.lock().unwrap().scopes.push(query);
        let scope = Scope {
            boot: 7,
            seq: 5,
            ..Scope::default()
        };
        let is_there = query.which.is_none_or(|which| which == (7, 5));
        answer(Self::known(device).map(|()| is_there.then_some(scope)))
    }

    fn training<'a>(&'a self, device: &'a str, limit: usize) -> BackendFuture<'a, Vec<Fit>> {
        self.asked.lock().unwrap().trainings.push(limit);
        answer(Self::known(device).map(|()| vec![]))
    }

    /// Versions are 0 to 3; the device uses 3.
    fn map<'a>(&'a self, device: &'a str, version: Option<u32>) -> BackendFuture<'a, Option<Map>> {
        self.asked.lock().unwrap().maps.push(version);
        let version = version.unwrap_or(3);
        let map = Map {
            version,
            ..Map::default()
        };
        answer(Self::known(device).map(|()| (version <= 3).then_some(map)))
    }

    fn pot_curve(&self, device: &str) -> Option<PotCurve> {
        let point = PotPoint {
            at_ms: 2_000,
            rise_k: 41.5,
            sigma_k: 5.0,
        };
        (device == NAME).then(|| PotCurve {
            now: None,
            points: vec![point],
        })
    }

    fn journal(&self, filter: JournalFilter) -> BackendFuture<'_, Vec<JournalEntry>> {
        self.asked.lock().unwrap().journals.push(filter);
        answer(Ok(vec![]))
    }

    fn backup(&self, to: PathBuf) -> BackendFuture<'_, ()> {
        self.asked.lock().unwrap().backups.push(to);
        answer(Ok(()))
    }

    fn metrics(&self) -> Vec<Metric> {
        let queue = Metric {
            name: "store_queue",
            help: "Jobs that wait for the store",
            label: None,
            counter: false,
            value: 2.0,
        };
        let dropped = |kind, value| Metric {
            name: "store_dropped_total",
            help: "Records that are in no store",
            label: Some(("record", kind)),
            counter: true,
            value,
        };
        vec![queue, dropped("windows", 7.0), dropped("audits", 0.0)]
    }

    fn liveness(&self) -> BackendFuture<'_, Liveness> {
        answer(Ok(Liveness {
            store_failure: self.asked.lock().unwrap().store_failure.clone(),
            supervisor: true,
            audit: true,
        }))
    }
}

/// Scheduler turns within which all work that became due by moving the clock is done.
const TURNS: u32 = 32;

/// Clock of a server, paused between calls of [`Clock::pass`].
pub struct Clock {
    moves: mpsc::UnboundedSender<(Duration, std::sync::mpsc::Sender<()>)>,
}

impl Clock {
    /// Pauses the clock of a single-threaded runtime and drives that runtime until the clock is dropped.
    fn stop(runtime: Runtime) -> Self {
        let (moves, mut moved) =
            mpsc::unbounded_channel::<(Duration, std::sync::mpsc::Sender<()>)>();
        std::thread::spawn(move || {
            runtime.block_on(async {
                tokio::time::pause();
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
}

/// Server that ends with the test.
pub struct Running {
    pub fake: Fake,
    pub address: std::net::SocketAddr,
    pub url: String,
    pub certificate: Option<PathBuf>,
    pub dir: tempfile::TempDir,
    stop: watch::Sender<bool>,
    served: tokio::task::JoinHandle<()>,
    runtime: Option<Runtime>,
}

impl Running {
    /// Starts it on loopback without tokens.
    pub fn start() -> Self {
        Self::with(|_, _| {})
    }

    /// Starts it with options changed by `set`; the path is a folder for files.
    pub fn with(set: impl FnOnce(&mut ServerOptions, &std::path::Path)) -> Self {
        Self::on(Runtime::new().unwrap(), set)
    }

    /// Starts it on loopback without tokens, with a clock moved by the test.
    pub fn with_clock() -> (Self, Clock) {
        Self::with_clock_and(|_, _| {})
    }

    /// Starts it with options changed by `set` and a clock moved by the test.
    pub fn with_clock_and(set: impl FnOnce(&mut ServerOptions, &std::path::Path)) -> (Self, Clock) {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        let mut server = Self::on(builder.enable_all().build().unwrap(), set);
        let runtime = server.runtime.take().expect("it was just built");
        (server, Clock::stop(runtime))
    }

    fn on(runtime: Runtime, set: impl FnOnce(&mut ServerOptions, &std::path::Path)) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut settings = ServerOptions {
            listen: "127.0.0.1:0".into(),
            allowed_hosts: vec![],
            token_file: None,
            tls: None,
            backups: dir.path().join("backups"),
        };
        set(&mut settings, dir.path());
        let fake = Fake::new();
        let (stop, stopping) = watch::channel(false);
        let server = runtime.block_on(Server::bind(&settings)).unwrap();
        let (address, url) = (server.address(), server.url());
        let certificate = server.certificate().map(|(_, path)| path.into());
        let served = runtime.spawn(server.run(Arc::new(fake.clone()), stopping));
        Self {
            fake,
            address,
            url,
            certificate,
            dir,
            stop,
            served,
            runtime: Some(runtime),
        }
    }

    /// Stops the server and waits for its end.
    pub fn stop(&self) {
        self.stop.send(true).unwrap();
        let deadline = std::time::Instant::now() + PATIENCE;
        while !self.served.is_finished() {
            assert!(std::time::Instant::now() < deadline, "it does not end");
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
