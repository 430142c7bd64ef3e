//! Health for service managers, metrics for Prometheus.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use ihd_daemon::event_bus::now_ms;
use ihd_daemon::model::{DeviceReport, DeviceState, StoreFailure};

use super::App;
use crate::backend::Liveness;
use crate::model::{Health, Problem};
use crate::prometheus::Exposition;

/// Returns the health of the daemon; needs no token. A failure of the store has its cause, its time, the lost records and advice.
#[utoipa::path(get, path = "/healthz", tag = "daemon",
    responses((status = 200, body = Health), (status = 503, body = Health)))]
pub(super) async fn healthz(State(app): State<Arc<App>>) -> (StatusCode, Json<Health>) {
    let liveness = app.backend.liveness().await.unwrap_or_else(|_| Liveness {
        store_failure: Some(StoreFailure::silent(now_ms())),
        supervisor: false,
        audit: false,
    });
    let health = Health {
        service: "ihd".into(),
        store: liveness.store_failure.is_none(),
        store_failure: liveness.store_failure,
        supervisor: liveness.supervisor,
        audit: liveness.audit,
    };
    let status = if health.store && health.supervisor {
        StatusCode::OK
    } else {
        StatusCode::SERVICE_UNAVAILABLE
    };
    (status, Json(health))
}

/// Returns metrics in the text format of Prometheus.
#[utoipa::path(get, path = "/metrics", tag = "daemon",
    responses((status = 200, description = "Prometheus text", content_type = "text/plain", body = String),
        (status = 401, body = Problem)))]
pub(super) async fn metrics(State(app): State<Arc<App>>) -> impl IntoResponse {
    let mut text = Exposition::default();
    let mut family = "";
    for metric in app.backend.metrics() {
        let kind = if metric.counter { "counter" } else { "gauge" };
        if metric.name != std::mem::replace(&mut family, metric.name) {
            text.family(metric.name, metric.help, kind);
        }
        text.sample(metric.name, metric.label.as_slice(), metric.value);
    }
    server(&mut text, &app);
    devices(&mut text, &app.backend.devices());
    (
        [(CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")],
        text.into_text(),
    )
}

/// Writes the metrics of the server.
fn server(text: &mut Exposition, app: &App) {
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
        text.family(name, help, "counter");
        text.sample(name, &[], count as f64);
    }
}

const STATES: [DeviceState; 8] = [
    DeviceState::Searching,
    DeviceState::Connected,
    DeviceState::WaitingForPot,
    DeviceState::Learning,
    DeviceState::Idle,
    DeviceState::Faulted,
    DeviceState::Suspended,
    DeviceState::Incompatible,
];

fn state_name(state: DeviceState) -> String {
    match serde_json::to_value(state) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::new(),
    }
}

fn devices(text: &mut Exposition, devices: &[DeviceReport]) {
    text.family(
        "device_state",
        "1 for the present state of a device",
        "gauge",
    );
    for device in devices {
        for state in STATES {
            let labels = [
                ("device", device.name.as_str()),
                ("state", &state_name(state)),
            ];
            let value = f64::from(u8::from(device.state == state));
            text.sample("device_state", &labels, value);
        }
    }
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
    family_of_devices(
        text,
        devices,
        "connections_total",
        "Connections made to a device",
        "counter",
        |d| f64::from(d.connections),
    );
    family_of_devices(
        text,
        devices,
        "power_watts",
        "Mean power of the last half-cycle",
        "gauge",
        |d| d.live.as_ref().map_or(0.0, |live| live.power_w),
    );
    family_of_devices(
        text,
        devices,
        "lookup_version",
        "Version of the lookup that a device uses",
        "gauge",
        |d| d.lookup.on_device.map_or(f64::NAN, f64::from),
    );
    family_of_devices(
        text,
        devices,
        "lookup_observed_cells",
        "Observed cells of the active lookup",
        "gauge",
        |d| f64::from(d.lookup.observed_cells),
    );
}

/// Writes a family with one sample per device.
fn family_of_devices(
    text: &mut Exposition,
    devices: &[DeviceReport],
    name: &str,
    help: &str,
    kind: &str,
    value: impl Fn(&DeviceReport) -> f64,
) {
    text.family(name, help, kind);
    for device in devices {
        text.sample(name, &[("device", &device.name)], value(device));
    }
}
