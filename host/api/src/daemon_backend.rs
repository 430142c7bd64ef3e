//! The daemon itself behind the routes.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use ihd_daemon::board::now_ms;
use ihd_daemon::learning::LearnerFigures;
use ihd_daemon::model::{
    Command, CommandError, DeviceReport, Done, Fit, FleetReport, History, Hob, JournalEntry, Lease,
    LiveTelemetry, Map, Notice, PotCurve, RecordingFile, Scope, StoreFailure, WindowSummary,
    WindowWanted,
};
use ihd_daemon::{Daemon, DaemonError, JournalFilter, LiveTap};
use ihd_store::{LookupRow, ResultFilter, ResultRow};
use tokio::sync::{Mutex, broadcast};
use tokio::time::{Instant, timeout};

use crate::backend::{Alive, Answer, Backend, Figure, Tap};
use crate::model::{StoredLookup, StoredResult};

/// A store that does not answer a question within this is not alive.
const STORE_ANSWERS: Duration = Duration::from_secs(5);

/// How long an answer about health holds: whoever asks often does not load the store.
const HEALTH_HOLDS: Duration = Duration::from_secs(1);

/// A [`Daemon`] as a [`Backend`].
pub struct DaemonBackend {
    daemon: Daemon,
    health: Mutex<Option<(Instant, Alive)>>,
}

impl DaemonBackend {
    /// The daemon, for the server.
    pub fn new(daemon: Daemon) -> Self {
        Self {
            daemon,
            health: Mutex::new(None),
        }
    }

    fn known(&self, device: &str) -> Result<(), CommandError> {
        match self.daemon.device(device) {
            Some(_) => Ok(()),
            None => Err(CommandError::NoDevice {
                name: device.into(),
            }),
        }
    }
}

/// Whether the daemon's store answers at all, well or not.
pub async fn store_answers(daemon: &Daemon) -> bool {
    let nothing = ResultFilter {
        limit: Some(1),
        ..ResultFilter::default()
    };
    timeout(STORE_ANSWERS, daemon.results(nothing))
        .await
        .is_ok()
}

/// Messages of the store name files, which are nobody's business but the log's.
fn failed(error: &DaemonError) -> CommandError {
    if let DaemonError::NoDevice(name) = error {
        let name = name.clone();
        return CommandError::NoDevice { name };
    }
    tracing::warn!(%error, "a request failed");
    CommandError::Failed {
        why: "the store could not do that; the daemon's log says why".into(),
    }
}

impl Tap for LiveTap {
    fn take(&mut self) -> LiveTelemetry {
        LiveTap::take(self)
    }
}

impl Backend for DaemonBackend {
    fn hob(&self) -> Hob {
        ihd_daemon::hob()
    }

    fn devices(&self) -> Vec<DeviceReport> {
        self.daemon.devices()
    }

    fn device(&self, name: &str) -> Option<DeviceReport> {
        self.daemon.device(name)
    }

    fn fleet(&self) -> Option<Arc<FleetReport>> {
        self.daemon.fleet()
    }

    fn command<'a>(
        &'a self,
        device: &'a str,
        holder: &'a str,
        command: Command,
    ) -> Answer<'a, Done> {
        Box::pin(self.daemon.command(device, holder, command))
    }

    fn take_lease<'a>(
        &'a self,
        device: &'a str,
        holder: &'a str,
        force: bool,
    ) -> Answer<'a, Lease> {
        Box::pin(self.daemon.take_lease(device, holder, force))
    }

    fn release_lease<'a>(&'a self, device: &'a str, holder: &'a str) -> Answer<'a, ()> {
        Box::pin(self.daemon.release_lease(device, holder))
    }

    fn watch(&self) -> broadcast::Receiver<Arc<Notice>> {
        self.daemon.watch()
    }

    fn live(&self, every: Duration) -> Box<dyn Tap> {
        Box::new(self.daemon.live().every(every))
    }

    fn results<'a>(
        &'a self,
        device: &'a str,
        limit: u32,
        since_ms: Option<i64>,
    ) -> Answer<'a, Vec<StoredResult>> {
        Box::pin(async move {
            self.known(device)?;
            let filter = ResultFilter {
                device: Some(device.into()),
                since_ms,
                limit: Some(limit),
            };
            let rows = self.daemon.results(filter).await;
            let rows = rows.map_err(|error| failed(&error))?;
            Ok(rows.into_iter().map(StoredResult::from).collect())
        })
    }

    fn lookups<'a>(&'a self, device: &'a str) -> Answer<'a, Vec<StoredLookup>> {
        Box::pin(async move {
            self.known(device)?;
            let rows = self.daemon.lookups(device).await;
            let rows = rows.map_err(|error| failed(&error))?;
            Ok(rows.into_iter().rev().map(StoredLookup::from).collect())
        })
    }

    fn recordings(&self) -> Answer<'_, Vec<RecordingFile>> {
        Box::pin(async move {
            let all = self.daemon.recordings().await;
            all.map_err(|error| failed(&error))
        })
    }

    fn recordings_folder(&self) -> PathBuf {
        self.daemon.recordings_folder().to_owned()
    }

    fn history<'a>(
        &'a self,
        device: &'a str,
        from_ms: i64,
        to_ms: i64,
        columns: usize,
    ) -> Answer<'a, History> {
        let history = self.daemon.history(device, from_ms, to_ms, columns);
        Box::pin(async { history.await.map_err(|error| failed(&error)) })
    }

    fn windows<'a>(&'a self, device: &'a str, limit: usize) -> Answer<'a, Vec<WindowSummary>> {
        let windows = self.daemon.windows(device, limit);
        Box::pin(async { windows.await.map_err(|error| failed(&error)) })
    }

    fn scope<'a>(&'a self, device: &'a str, wanted: WindowWanted) -> Answer<'a, Option<Scope>> {
        let scope = self.daemon.scope(device, wanted);
        Box::pin(async { scope.await.map_err(|error| failed(&error)) })
    }

    fn training<'a>(&'a self, device: &'a str, limit: usize) -> Answer<'a, Vec<Fit>> {
        let training = self.daemon.training(device, limit);
        Box::pin(async { training.await.map_err(|error| failed(&error)) })
    }

    fn pot_curve(&self, device: &str) -> Option<PotCurve> {
        self.daemon.pot_curve(device)
    }

    fn map<'a>(&'a self, device: &'a str, version: Option<u32>) -> Answer<'a, Option<Map>> {
        let map = self.daemon.map(device, version);
        Box::pin(async { map.await.map_err(|error| failed(&error)) })
    }

    fn journal(&self, filter: JournalFilter) -> Answer<'_, Vec<JournalEntry>> {
        let journal = self.daemon.journal(filter);
        Box::pin(async { journal.await.map_err(|error| failed(&error)) })
    }

    fn backup(&self, to: PathBuf) -> Answer<'_, ()> {
        Box::pin(async move {
            let done = match to.parent() {
                Some(folder) => std::fs::create_dir_all(folder),
                None => Ok(()),
            };
            if let Err(error) = done {
                tracing::warn!(%error, "the folder for backups cannot be made");
            }
            self.daemon.backup(to).await.map_err(|error| failed(&error))
        })
    }

    fn figures(&self) -> Vec<Figure> {
        let f = self.daemon.figures();
        let mut all = vec![
            gauge("up_seconds", "Seconds since the daemon began", f.up_s),
            gauge("devices", "Devices", f.devices as f64),
            gauge(
                "store_well",
                "1 while the store takes all records",
                f64::from(u8::from(f.store_failure.is_none())),
            ),
            gauge(
                "store_failing_since_seconds",
                "When the store's present failure began, in seconds since 1970; 0 while it takes all records",
                f.store_failure
                    .map_or(0.0, |failure| failure.since_ms as f64 * 1e-3),
            ),
            gauge(
                "store_queue",
                "Jobs that wait for the store",
                f.store_waiting as f64,
            ),
            gauge(
                "store_longest_seconds",
                "Longest job of the store",
                f.store_longest_s,
            ),
            counter("store_jobs_total", "Jobs of the store", f.store_jobs as f64),
            counter(
                "store_failures_total",
                "Jobs of the store that failed",
                f.store_failures as f64,
            ),
            counter(
                "store_busy_seconds_total",
                "Seconds that the store was busy",
                f.store_busy_s,
            ),
        ];
        all.push(counter(
            "audit_lost_total",
            "Commands that were carried out and that the audit does not have",
            f.audits_lost as f64,
        ));
        all.extend(f.store_dropped.by_kind().map(|(kind, n)| Figure {
            label: Some(("record", kind)),
            ..counter(
                "store_dropped_total",
                "Records that are in no store because it did not take them, by kind; telemetry in seconds of a device",
                n as f64,
            )
        }));
        all.extend(learner_figures(&f.learner));
        if let Some(fleet) = self.daemon.fleet() {
            all.extend(fleet_figures(&fleet));
        }
        if let Some(bytes) = f.rss_bytes {
            let help = "Memory of the daemon that is resident";
            all.push(gauge("resident_memory_bytes", help, bytes as f64));
        }
        all
    }

    fn alive(&self) -> Answer<'_, Alive> {
        Box::pin(async move {
            // Held while the store is asked: who asks meanwhile waits for the same answer.
            let mut health = self.health.lock().await;
            if let Some((at, alive)) = &*health
                && at.elapsed() < HEALTH_HOLDS
            {
                return Ok(alive.clone());
            }
            let answers = store_answers(&self.daemon).await;
            let figures = self.daemon.figures();
            let failure = figures.store_failure;
            let alive = Alive {
                store_failure: failure
                    .or_else(|| (!answers).then(|| StoreFailure::silent(now_ms()))),
                audit: figures.audit_is_well,
                // Its tasks run on the threads that answer this.
                supervisor: true,
            };
            *health = Some((Instant::now(), alive.clone()));
            Ok(alive)
        })
    }
}

fn gauge(name: &'static str, help: &'static str, value: f64) -> Figure {
    Figure {
        name,
        help,
        label: None,
        counter: false,
        value,
    }
}

fn counter(name: &'static str, help: &'static str, value: f64) -> Figure {
    Figure {
        counter: true,
        ..gauge(name, help, value)
    }
}

fn learner_figures(f: &LearnerFigures) -> Vec<Figure> {
    let mut all = vec![
        gauge("learner_threads", "Threads that train", f.threads as f64),
        gauge(
            "learner_queue",
            "Windows that wait to be learned from",
            f.waiting as f64,
        ),
        counter(
            "learner_windows_total",
            "Windows that were looked at",
            f.learned as f64,
        ),
        counter(
            "learner_dropped_total",
            "Windows that were dropped before they were looked at",
            f.unlearned as f64,
        ),
        counter(
            "learner_panics_total",
            "Windows whose training failed within",
            f.panics as f64,
        ),
        counter(
            "learner_busy_seconds_total",
            "Seconds that the threads trained, all together",
            f.busy_s,
        ),
    ];
    let p50 = f
        .fit_p50_s
        .map(|s| gauge("learner_fit_p50_seconds", "Half of the last fits", s));
    let p99 = f
        .fit_p99_s
        .map(|s| gauge("learner_fit_p99_seconds", "99 % of the last fits", s));
    all.extend(p50.into_iter().chain(p99));
    all
}

/// Of the fleet as this edge knew it last; `fleet_connected` says whether that is now.
fn fleet_figures(fleet: &FleetReport) -> Vec<Figure> {
    let mut all = vec![
        gauge(
            "fleet_connected",
            "1 where the fleet's server answers; else the others are what they were last",
            f64::from(u8::from(fleet.connected)),
        ),
        gauge(
            "fleet_outbox",
            "Windows and results of this edge that the fleet has not acknowledged",
            fleet.outbox as f64,
        ),
        gauge(
            "fleet_backlog",
            "Windows in the fleet that nobody has identified yet",
            fleet.backlog as f64,
        ),
        gauge(
            "fleet_dead",
            "Windows in the fleet that were given up",
            fleet.dead as f64,
        ),
        gauge(
            "fleet_workers",
            "Workers that the fleet knows",
            fleet.workers.len() as f64,
        ),
        gauge(
            "fleet_alarms",
            "What needs somebody at this edge: windows that stay in a state for too long, a name that is another store's, a worker whose answers are refuted",
            fleet.alarms.len() as f64,
        ),
    ];
    all.extend(fleet.states.by_name().map(|(state, n)| Figure {
        label: Some(("state", state)),
        ..gauge(
            "fleet_windows",
            "Windows in this edge's store by their progress with the fleet: together all",
            n as f64,
        )
    }));
    all.extend(fleet.answers.by_name().map(|(outcome, n)| Figure {
        label: Some(("outcome", outcome)),
        ..gauge(
            "fleet_answers",
            "Workers' answers to this edge's windows by what the windows made of them",
            n as f64,
        )
    }));
    all
}

/// JSON has no NaN.
fn finite(x: f64) -> Option<f64> {
    x.is_finite().then_some(x)
}

impl From<ResultRow> for StoredResult {
    fn from(row: ResultRow) -> Self {
        Self {
            device: row.device,
            boot: row.boot,
            seq: row.seq,
            at_ms: row.at_ms,
            half_cycle: row.half_cycle,
            f_sw_hz: row.f_sw_hz,
            i_crest_a: finite(row.i_crest_a),
            power_w: row.power_w.and_then(finite),
            r_ohm: finite(row.r_ohm),
            l_h: finite(row.l_h),
            sigma_r_pct: finite(row.sigma_r_pct),
            sigma_l_pct: finite(row.sigma_l_pct),
            pass: row.pass,
            why: row.why,
            changed_lookup: row.changed_lookup,
        }
    }
}

impl From<LookupRow> for StoredLookup {
    fn from(row: LookupRow) -> Self {
        Self {
            version: row.version,
            state: row.state.to_string(),
            origin: row.origin,
            at_ms: row.at_ms,
            why: row.why,
            blob: row.blob,
        }
    }
}
