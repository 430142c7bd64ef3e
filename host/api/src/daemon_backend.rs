//! [`Backend`] of a real daemon, with its metrics.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use ihd_daemon::event_bus::now_ms;
use ihd_daemon::learning::LearnerFigures;
use ihd_daemon::model::{
    Command, CommandError, CommandReply, DaemonEvent, DeviceReport, Fit, FleetReport, History, Hob,
    JournalEntry, Lease, LiveTelemetry, Map, PotCurve, RecordingFile, Scope, StoreFailure,
    WindowQuery, WindowSummary,
};
use ihd_daemon::{Daemon, DaemonError, JournalFilter, LiveTap};
use ihd_store::{LookupRow, ResultFilter, ResultRow};
use tokio::sync::{Mutex, broadcast};
use tokio::time::{Instant, timeout};

use crate::backend::{Backend, BackendFuture, LiveSource, Liveness, Metric};
use crate::model::{StoredLookup, StoredResult};

/// Maximum response time of a store that counts as alive.
const STORE_TIMEOUT: Duration = Duration::from_secs(5);

/// Lifetime of a cached health result: frequent requests must not load the store.
const HEALTH_CACHED: Duration = Duration::from_secs(1);

/// [`Backend`] of a [`Daemon`].
pub struct DaemonBackend {
    daemon: Daemon,
    health: Mutex<Option<(Instant, Liveness)>>,
}

impl DaemonBackend {
    /// Wraps a daemon for [`Server::run`](crate::Server::run).
    pub fn new(daemon: Daemon) -> Self {
        Self {
            daemon,
            health: Mutex::new(None),
        }
    }

    fn require_device(&self, device: &str) -> Result<(), CommandError> {
        match self.daemon.device(device) {
            Some(_) => Ok(()),
            None => Err(CommandError::NoDevice {
                name: device.into(),
            }),
        }
    }
}

/// Returns `true` if the daemon's store responds in time, even with an error.
pub async fn store_answers(daemon: &Daemon) -> bool {
    let nothing = ResultFilter {
        limit: Some(1),
        ..ResultFilter::default()
    };
    timeout(STORE_TIMEOUT, daemon.results(nothing))
        .await
        .is_ok()
}

/// Converts an error for the client. Errors of the store contain file names, which go to the log only.
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

impl LiveSource for LiveTap {
    fn collect(&mut self) -> LiveTelemetry {
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
    ) -> BackendFuture<'a, CommandReply> {
        Box::pin(self.daemon.command(device, holder, command))
    }

    fn take_lease<'a>(
        &'a self,
        device: &'a str,
        holder: &'a str,
        force: bool,
    ) -> BackendFuture<'a, Lease> {
        Box::pin(self.daemon.take_lease(device, holder, force))
    }

    fn release_lease<'a>(&'a self, device: &'a str, holder: &'a str) -> BackendFuture<'a, ()> {
        Box::pin(self.daemon.release_lease(device, holder))
    }

    fn watch(&self) -> broadcast::Receiver<Arc<DaemonEvent>> {
        self.daemon.watch()
    }

    fn live(&self, every: Duration) -> Box<dyn LiveSource> {
        Box::new(self.daemon.live().every(every))
    }

    fn results<'a>(
        &'a self,
        device: &'a str,
        limit: u32,
        since_ms: Option<i64>,
    ) -> BackendFuture<'a, Vec<StoredResult>> {
        Box::pin(async move {
            self.require_device(device)?;
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

    fn lookups<'a>(&'a self, device: &'a str) -> BackendFuture<'a, Vec<StoredLookup>> {
        Box::pin(async move {
            self.require_device(device)?;
            let rows = self.daemon.lookups(device).await;
            let rows = rows.map_err(|error| failed(&error))?;
            Ok(rows.into_iter().rev().map(StoredLookup::from).collect())
        })
    }

    fn recordings(&self) -> BackendFuture<'_, Vec<RecordingFile>> {
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
    ) -> BackendFuture<'a, History> {
        let history = self.daemon.history(device, from_ms, to_ms, columns);
        Box::pin(async { history.await.map_err(|error| failed(&error)) })
    }

    fn windows<'a>(
        &'a self,
        device: &'a str,
        limit: usize,
    ) -> BackendFuture<'a, Vec<WindowSummary>> {
        let windows = self.daemon.windows(device, limit);
        Box::pin(async { windows.await.map_err(|error| failed(&error)) })
    }

    fn scope<'a>(
        &'a self,
        device: &'a str,
        query: WindowQuery,
    ) -> BackendFuture<'a, Option<Scope>> {
        let scope = self.daemon.scope(device, query);
        Box::pin(async { scope.await.map_err(|error| failed(&error)) })
    }

    fn training<'a>(&'a self, device: &'a str, limit: usize) -> BackendFuture<'a, Vec<Fit>> {
        let training = self.daemon.training(device, limit);
        Box::pin(async { training.await.map_err(|error| failed(&error)) })
    }

    fn pot_curve(&self, device: &str) -> Option<PotCurve> {
        self.daemon.pot_curve(device)
    }

    fn map<'a>(&'a self, device: &'a str, version: Option<u32>) -> BackendFuture<'a, Option<Map>> {
        let map = self.daemon.map(device, version);
        Box::pin(async { map.await.map_err(|error| failed(&error)) })
    }

    fn journal(&self, filter: JournalFilter) -> BackendFuture<'_, Vec<JournalEntry>> {
        let journal = self.daemon.journal(filter);
        Box::pin(async { journal.await.map_err(|error| failed(&error)) })
    }

    fn backup(&self, to: PathBuf) -> BackendFuture<'_, ()> {
        Box::pin(async move {
            let created = match to.parent() {
                Some(folder) => std::fs::create_dir_all(folder),
                None => Ok(()),
            };
            if let Err(error) = created {
                tracing::warn!(%error, "the folder for backups cannot be made");
            }
            self.daemon.backup(to).await.map_err(|error| failed(&error))
        })
    }

    fn metrics(&self) -> Vec<Metric> {
        let f = self.daemon.figures();
        let mut all = vec![
            gauge("up_seconds", "Seconds since the daemon began", f.up_s),
            gauge("devices", "Devices", f.devices as f64),
            gauge(
                "store_well",
                "1 while the store accepts all records",
                f64::from(u8::from(f.store_failure.is_none())),
            ),
            gauge(
                "store_failing_since_seconds",
                "When the store's present failure began, in seconds since 1970; 0 while it accepts all records",
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
            "Commands that were executed and are missing in the audit",
            f.audits_lost as f64,
        ));
        all.extend(f.store_dropped.by_kind().map(|(kind, n)| Metric {
            label: Some(("record", kind)),
            ..counter(
                "store_dropped_total",
                "Records that the store did not accept and that are lost, by kind; telemetry in seconds of a device",
                n as f64,
            )
        }));
        all.extend(learner_metrics(&f.learner));
        if let Some(fleet) = self.daemon.fleet() {
            all.extend(fleet_metrics(&fleet));
        }
        if let Some(bytes) = f.rss_bytes {
            let help = "Resident memory of the daemon";
            all.push(gauge("resident_memory_bytes", help, bytes as f64));
        }
        all
    }

    fn liveness(&self) -> BackendFuture<'_, Liveness> {
        Box::pin(async move {
            // Held during the query: concurrent requests wait for the same result.
            let mut health = self.health.lock().await;
            if let Some((at, liveness)) = &*health
                && at.elapsed() < HEALTH_CACHED
            {
                return Ok(liveness.clone());
            }
            let answers = store_answers(&self.daemon).await;
            let figures = self.daemon.figures();
            let failure = figures.store_failure;
            let liveness = Liveness {
                store_failure: failure
                    .or_else(|| (!answers).then(|| StoreFailure::silent(now_ms()))),
                audit: figures.audit_is_healthy,
                // Its tasks run on the threads that serve this request.
                supervisor: true,
            };
            *health = Some((Instant::now(), liveness.clone()));
            Ok(liveness)
        })
    }
}

fn gauge(name: &'static str, help: &'static str, value: f64) -> Metric {
    Metric {
        name,
        help,
        label: None,
        counter: false,
        value,
    }
}

fn counter(name: &'static str, help: &'static str, value: f64) -> Metric {
    Metric {
        counter: true,
        ..gauge(name, help, value)
    }
}

fn learner_metrics(f: &LearnerFigures) -> Vec<Metric> {
    let mut all = vec![
        gauge("learner_threads", "Threads that train", f.threads as f64),
        gauge(
            "learner_queue",
            "Windows that wait for the learner",
            f.waiting as f64,
        ),
        counter(
            "learner_windows_total",
            "Windows that were processed",
            f.learned as f64,
        ),
        counter(
            "learner_dropped_total",
            "Windows that were dropped before they were processed",
            f.unlearned as f64,
        ),
        counter(
            "learner_panics_total",
            "Windows whose training panicked",
            f.panics as f64,
        ),
        counter(
            "learner_busy_seconds_total",
            "Seconds that the threads trained, in total",
            f.busy_s,
        ),
    ];
    let p50 = f.fit_p50_s.map(|s| {
        gauge(
            "learner_fit_p50_seconds",
            "Median duration of the last fits",
            s,
        )
    });
    let p99 = f.fit_p99_s.map(|s| {
        gauge(
            "learner_fit_p99_seconds",
            "99th percentile of the duration of the last fits",
            s,
        )
    });
    all.extend(p50.into_iter().chain(p99));
    all
}

/// Returns the metrics of the fleet from the last report; that is current if `fleet_connected` is 1.
fn fleet_metrics(fleet: &FleetReport) -> Vec<Metric> {
    let mut all = vec![
        gauge(
            "fleet_connected",
            "1 while the fleet's server responds; else the other fleet metrics are old",
            f64::from(u8::from(fleet.connected)),
        ),
        gauge(
            "fleet_outbox",
            "Windows and results of this edge that the fleet has not acknowledged",
            fleet.outbox as f64,
        ),
        gauge(
            "fleet_backlog",
            "Windows in the fleet that no worker has identified yet",
            fleet.backlog as f64,
        ),
        gauge(
            "fleet_dead",
            "Windows in the fleet that were given up",
            fleet.dead as f64,
        ),
        gauge(
            "fleet_workers",
            "Workers of the fleet",
            fleet.workers.len() as f64,
        ),
        gauge(
            "fleet_alarms",
            "Alarms of this edge: windows that stay in a state for too long, a name used by another store, a worker with refuted results",
            fleet.alarms.len() as f64,
        ),
    ];
    all.extend(fleet.states.by_name().map(|(state, n)| Metric {
        label: Some(("state", state)),
        ..gauge(
            "fleet_windows",
            "Windows in this edge's store by fleet state; their sum is the number of stored windows",
            n as f64,
        )
    }));
    all.extend(fleet.answers.by_name().map(|(outcome, n)| Metric {
        label: Some(("outcome", outcome)),
        ..gauge(
            "fleet_answers",
            "Workers' results for windows of this edge, by outcome",
            n as f64,
        )
    }));
    all
}

/// Returns `None` for values that JSON cannot represent.
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
