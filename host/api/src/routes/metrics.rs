//! Metrics for Prometheus.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use ihd_daemon::DaemonFigures;
use ihd_daemon::learning::LearnerFigures;
use ihd_model::{DeviceReport, DeviceState, FleetReport, Problem, StoreFailure};

use super::App;
use crate::prometheus::Exposition;
use crate::served::ServedTls;

/// Age in milliseconds from which on numbers of the fleet, read every 10 s, are not present ones.
const MAX_FLEET_AGE_MS: i64 = 60_000;

/// Returns metrics in the text format of Prometheus.
#[utoipa::path(get, path = "/metrics", tag = "daemon",
    responses((status = 200, description = "Prometheus text", content_type = "text/plain", body = String),
        (status = 401, body = Problem)))]
pub(super) async fn metrics(State(app): State<Arc<App>>) -> impl IntoResponse {
    let mut text = Exposition::default();
    let figures = app.daemon.upkeep().figures();
    daemon(&mut text, &figures);
    learner(&mut text, &figures.learner);
    if let Some(report) = app.daemon.fleet().report() {
        fleet(&mut text, &report, app.daemon.view().now_ms());
    }
    if let Some(bytes) = figures.rss_bytes {
        let help = "Resident memory of the daemon";
        text.gauge("resident_memory_bytes", help, bytes as f64);
    }
    server(&mut text, &app);
    devices(&mut text, &app.daemon.view().devices());
    (
        [(CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")],
        text.into_text(),
    )
}

/// Writes the metrics of the daemon and its store.
fn daemon(text: &mut Exposition, f: &DaemonFigures) {
    text.gauge("up_seconds", "Seconds since the daemon began", f.up_s);
    text.gauge("devices", "Devices", f.devices as f64);
    text.gauge(
        "store_well",
        "1 while the store accepts all records",
        f64::from(u8::from(f.store_failure.is_none())),
    );
    let since_s = |failure: &StoreFailure| failure.since_ms as f64 * 1e-3;
    text.gauge(
        "store_failing_since_seconds",
        "When the store's present failure began, in seconds since 1970; 0 while it accepts all records",
        f.store_failure.as_ref().map_or(0.0, since_s),
    );
    text.gauge(
        "store_queue",
        "Jobs that wait for the store",
        f.store_waiting as f64,
    );
    text.gauge(
        "store_longest_seconds",
        "Longest job of the store",
        f.store_longest_s,
    );
    for (name, help, count) in [
        ("store_jobs_total", "Jobs of the store", f.store_jobs as f64),
        (
            "store_failures_total",
            "Jobs of the store that failed",
            f.store_failures as f64,
        ),
        (
            "store_busy_seconds_total",
            "Seconds that the store was busy",
            f.store_busy_s,
        ),
        (
            "audit_lost_total",
            "Commands that were executed and are missing in the audit",
            f.audits_lost as f64,
        ),
    ] {
        text.counter(name, help, count);
    }
    text.counters(
        "store_dropped_total",
        "Records that the store did not accept and that are lost, by kind; telemetry in seconds of a device",
        "record",
        f.store_dropped.by_kind(),
    );
}

fn learner(text: &mut Exposition, f: &LearnerFigures) {
    text.gauge("learner_threads", "Threads that train", f.threads as f64);
    text.gauge(
        "learner_queue",
        "Windows that wait for the learner",
        f.waiting as f64,
    );
    for (name, help, count) in [
        (
            "learner_windows_total",
            "Windows that were processed",
            f.learned as f64,
        ),
        (
            "learner_dropped_total",
            "Windows that were dropped before they were processed",
            f.unlearned as f64,
        ),
        (
            "learner_panics_total",
            "Windows whose training panicked",
            f.panics as f64,
        ),
        (
            "learner_busy_seconds_total",
            "Seconds that the threads trained, in total",
            f.busy_s,
        ),
    ] {
        text.counter(name, help, count);
    }
    for (name, help, fit_s) in [
        (
            "learner_fit_p50_seconds",
            "Median duration of the last fits",
            f.fit_p50_s,
        ),
        (
            "learner_fit_p99_seconds",
            "99th percentile of the duration of the last fits",
            f.fit_p99_s,
        ),
    ] {
        if let Some(fit_s) = fit_s {
            text.gauge(name, help, fit_s);
        }
    }
}

/// Writes the metrics of the fleet from the last report; numbers of the whole fleet only if they were read of late.
fn fleet(text: &mut Exposition, fleet: &FleetReport, now_ms: i64) {
    let is_read = fleet.at_ms > 0 && now_ms - fleet.at_ms <= MAX_FLEET_AGE_MS;
    let of_fleet = |number: f64| is_read.then_some(number);
    for (name, help, value) in [
        (
            "fleet_connected",
            "1 while the fleet's server responds",
            Some(f64::from(u8::from(fleet.connected))),
        ),
        (
            "fleet_outbox",
            "Windows and results of this edge that the fleet has not acknowledged",
            Some(fleet.outbox as f64),
        ),
        (
            "fleet_backlog",
            "Windows in the fleet that no worker has identified yet",
            of_fleet(fleet.backlog as f64),
        ),
        (
            "fleet_dead",
            "Windows in the fleet that were given up",
            of_fleet(fleet.dead as f64),
        ),
        (
            "fleet_workers",
            "Workers of the fleet",
            of_fleet(fleet.workers.len() as f64),
        ),
        (
            "fleet_alarms",
            "Alarms of this edge: windows that stay in a state for too long, a name used by another store, a worker with refuted results, a part that fails",
            Some(fleet.alarms.len() as f64),
        ),
    ] {
        if let Some(value) = value {
            text.gauge(name, help, value);
        }
    }
    text.gauges(
        "fleet_windows",
        "Windows in this edge's store by fleet state; their sum is the number of stored windows",
        "state",
        fleet.states.by_name(),
    );
    text.gauges(
        "fleet_answers",
        "Workers' results for windows of this edge, by outcome",
        "outcome",
        fleet.answers.by_name(),
    );
}

/// Writes the metrics of the server.
fn server(text: &mut Exposition, app: &App) {
    if let Some(end_s) = app.tls.as_ref().and_then(ServedTls::expires_s) {
        let help = "End of the TLS certificate in use, in seconds since 1970";
        text.gauge("tls_certificate_expires_seconds", help, end_s as f64);
    }
    let counts = &app.counts;
    for (name, help, count) in [
        (
            "http_connections_total",
            "Connections accepted",
            counts.connections.load(Ordering::Relaxed),
        ),
        (
            "http_given_way_total",
            "Connections that were closed in favour of others at the maximum number of connections",
            app.slots.evictions(),
        ),
        (
            "events_missed_total",
            "Events that were dropped for slow subscribers",
            counts.missed.load(Ordering::Relaxed),
        ),
    ] {
        text.counter(name, help, count as f64);
    }
}

fn devices(text: &mut Exposition, devices: &[DeviceReport]) {
    states(text, devices);
    windows(text, devices);
    family_of_devices(
        text,
        devices,
        "connections_total",
        "Connections made to a device",
        "counter",
        |d| Some(f64::from(d.connections)),
    );
    family_of_devices(
        text,
        devices,
        "power_watts",
        "Mean power of the last second",
        "gauge",
        |d| d.live.as_ref().map(|live| live.power_w),
    );
    family_of_devices(
        text,
        devices,
        "lookup_version",
        "Version of the lookup that a device uses",
        "gauge",
        |d| d.lookup.on_device.map(f64::from),
    );
    family_of_devices(
        text,
        devices,
        "lookup_observed_cells",
        "Observed cells of the active lookup",
        "gauge",
        |d| Some(f64::from(d.lookup.observed_cells)),
    );
}

/// Writes the states of all devices.
fn states(text: &mut Exposition, devices: &[DeviceReport]) {
    text.family(
        "device_state",
        "1 for the present state of a device",
        "gauge",
    );
    for device in devices {
        for state in DeviceState::ALL {
            let labels = [("device", device.name.as_str()), ("state", state.as_str())];
            let value = f64::from(u8::from(device.state == state));
            text.sample("device_state", &labels, value);
        }
    }
}

/// Writes the outcomes of all windows.
fn windows(text: &mut Exposition, devices: &[DeviceReport]) {
    text.family(
        "windows_total",
        "Windows of a device since the start of the daemon, by outcome",
        "counter",
    );
    for device in devices {
        let w = &device.windows;
        for (outcome, count) in [
            ("announced", w.announced),
            ("stored", w.stored),
            ("refused", w.refused),
            ("dropped-by-device", w.dropped_by_device),
            ("lost", w.lost),
            ("not-stored", w.not_stored),
            ("learned", w.learned),
            ("unfit", w.unfit),
            ("unlearned", w.unlearned),
        ] {
            let labels = [("device", device.name.as_str()), ("fate", outcome)];
            text.sample("windows_total", &labels, count as f64);
        }
    }
}

/// Writes a family with one sample per device of which the value is known.
fn family_of_devices(
    text: &mut Exposition,
    devices: &[DeviceReport],
    name: &str,
    help: &str,
    kind: &str,
    value: impl Fn(&DeviceReport) -> Option<f64>,
) {
    text.family(name, help, kind);
    for device in devices {
        if let Some(value) = value(device) {
            text.sample(name, &[("device", &device.name)], value);
        }
    }
}
