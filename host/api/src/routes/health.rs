//! For service managers and for Prometheus.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::IntoResponse;
use ihd_daemon::board::now_ms;
use ihd_daemon::model::{DeviceReport, DeviceState, StoreFailure};

use super::App;
use crate::backend::Alive;
use crate::model::{Health, Problem};
use crate::prometheus::Exposition;

/// Health of the daemon; needs no token. A store that drops records says why, since when, which, and what to do.
#[utoipa::path(get, path = "/healthz", tag = "daemon",
    responses((status = 200, body = Health), (status = 503, body = Health)))]
pub(super) async fn healthz(State(app): State<Arc<App>>) -> (StatusCode, Json<Health>) {
    let alive = app.backend.alive().await.unwrap_or_else(|_| Alive {
        store_failure: Some(StoreFailure::silent(now_ms())),
        supervisor: false,
        audit: false,
    });
    let health = Health {
        service: "ihd".into(),
        store: alive.store_failure.is_none(),
        store_failure: alive.store_failure,
        supervisor: alive.supervisor,
        audit: alive.audit,
    };
    let status = if health.store && health.supervisor {
        StatusCode::OK
    } else {
        StatusCode::SERVICE_UNAVAILABLE
    };
    (status, Json(health))
}

/// Numbers in the text format of Prometheus.
#[utoipa::path(get, path = "/metrics", tag = "daemon",
    responses((status = 200, description = "Prometheus text", content_type = "text/plain", body = String),
        (status = 401, body = Problem)))]
pub(super) async fn metrics(State(app): State<Arc<App>>) -> impl IntoResponse {
    let mut text = Exposition::default();
    let mut family = "";
    for figure in app.backend.figures() {
        let kind = if figure.counter { "counter" } else { "gauge" };
        if figure.name != std::mem::replace(&mut family, figure.name) {
            text.family(figure.name, figure.help, kind);
        }
        text.sample(figure.name, figure.label.as_slice(), figure.value);
    }
    own(&mut text, &app);
    devices(&mut text, &app.backend.devices());
    (
        [(CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")],
        text.into_text(),
    )
}

/// The server's own.
fn own(text: &mut Exposition, app: &App) {
    let counts = &app.counts;
    for (name, help, count) in [
        (
            "http_connections_total",
            "Connections accepted",
            counts.connections.load(Ordering::Relaxed),
        ),
        (
            "http_given_way_total",
            "Connections that gave way to others, all places being taken",
            app.places.given_way(),
        ),
        (
            "events_missed_total",
            "Notices that slow watchers missed",
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
        "1 for the state that a device is in",
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
        "Windows of a device since the daemon began, by what became of them",
        "counter",
    );
    for device in devices {
        let w = &device.windows;
        for (fate, count) in [
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
            let labels = [("device", device.name.as_str()), ("fate", fate)];
            text.sample("windows_total", &labels, count as f64);
        }
    }
    each(
        text,
        devices,
        "connections_total",
        "Connections made to a device",
        "counter",
        |d| f64::from(d.connections),
    );
    each(
        text,
        devices,
        "power_watts",
        "Mean power of the last half-cycle",
        "gauge",
        |d| d.live.as_ref().map_or(0.0, |live| live.power_w),
    );
    each(
        text,
        devices,
        "lookup_version",
        "Version of the lookup that a device uses",
        "gauge",
        |d| d.lookup.on_device.map_or(f64::NAN, f64::from),
    );
    each(
        text,
        devices,
        "lookup_observed_cells",
        "Cells of the active lookup that rest on observations",
        "gauge",
        |d| f64::from(d.lookup.observed_cells),
    );
}

fn each(
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
