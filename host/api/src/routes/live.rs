//! Live telemetry for a display, at the pace of the client.
//!
//! At most one event per subscriber waits for the socket. The next one is made from current data once the socket has accepted it: a slow
//! client receives fewer events, not older ones. Each event has the number of intervals that were skipped.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::Extension;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{Event, Sse};
use ihd_daemon::LiveTap;
use ihd_model::{
    DaemonEvent, DeviceReport, EventKind, LiveTelemetry, MissedEvents, Problem, WindowCounts,
};
use serde::{Deserialize, Serialize};
use tokio::sync::broadcast::{self, error::RecvError};
use tokio::sync::{OwnedSemaphorePermit, mpsc, watch};
use tokio::time::Instant;
use tokio_stream::wrappers::ReceiverStream;
use utoipa::IntoParams;

use super::App;
use super::events::{subscriber_permit, ticks};
use crate::connection::WriteStall;
use crate::problem::{ApiQuery, ErrorResponse};

/// Default interval between telemetry events, in milliseconds.
const DEFAULT_INTERVAL_MS: u32 = 200;

/// Minimum interval, in milliseconds; a person cannot follow faster ones.
const MIN_INTERVAL_MS: u32 = 100;

/// Maximum interval, in milliseconds; for longer ones `/devices` is sufficient.
const MAX_INTERVAL_MS: u32 = 5_000;

/// Maximum time without an event, by which the client detects a dead connection.
const MAX_SILENCE: Duration = Duration::from_secs(1);

/// Period of `devices` without a change.
const DEVICES_PERIOD: Duration = Duration::from_secs(2);

/// Maximum number of notices that wait for a slow client; beyond it the oldest are dropped.
const QUEUE_LENGTH: usize = 256;

type EventStream = ReceiverStream<Result<Event, Infallible>>;

/// Query parameters of the live stream.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct LiveParameters {
    /// Interval between telemetry events in milliseconds, 100 to 5000; default 200.
    interval_ms: Option<u32>,
}

/// Streams live data for a display: `telemetry` (data since the last one; at least once per second, if need be without devices),
/// `devices` (all reports, after a change and every 2 s), `notice` (all events but telemetry) and `missed`. A slow client receives
/// fewer, never older events. The stream counts as use of the session, and ends with it.
#[utoipa::path(get, path = "/live", tag = "daemon", params(LiveParameters),
    responses((status = 200, description = "Server-Sent Events; schema of the event `telemetry`", content_type = "text/event-stream",
            body = LiveTelemetry),
        (status = 400, body = Problem), (status = 503, description = "Too many event streams", body = Problem)))]
pub(super) async fn live(
    State(app): State<Arc<App>>,
    ApiQuery(parameters): ApiQuery<LiveParameters>,
    headers: HeaderMap,
    stall: Option<Extension<WriteStall>>,
) -> Result<Sse<EventStream>, ErrorResponse> {
    let interval_ms = parameters.interval_ms.unwrap_or(DEFAULT_INTERVAL_MS);
    if !(MIN_INTERVAL_MS..=MAX_INTERVAL_MS).contains(&interval_ms) {
        let text = format!(
            "interval_ms is {interval_ms}, but must lie between {MIN_INTERVAL_MS} and {MAX_INTERVAL_MS}"
        );
        return Err(ErrorResponse::new(StatusCode::BAD_REQUEST, "query", text));
    }
    let every = Duration::from_millis(interval_ms.into());
    let permit = subscriber_permit(&app)?;
    let (tx, rx) = mpsc::channel(1);
    let subscriber = Subscriber {
        tap: app.daemon.view().live().every(every),
        events: app.daemon.watch(),
        stopping: app.stopping.clone(),
        app,
        headers,
        stall: stall.map(|Extension(stall)| stall),
        every,
        outbox: Outbox::default(),
        tx,
        _permit: permit,
    };
    tokio::spawn(subscriber.run());
    Ok(Sse::new(ReceiverStream::new(rx)))
}

/// Data that waits to be sent.
#[derive(Default)]
struct Outbox {
    /// `true` if telemetry is due; it is collected when it is sent.
    telemetry: bool,
    notices: VecDeque<Arc<DaemonEvent>>,
    /// Number of dropped notices.
    missed: u64,
    /// Reports of the last `devices`, without the fields that always change, and its time; `None` before the first.
    devices: Option<(Vec<DeviceReport>, Instant)>,
    /// Time of the last event; `None` before the first.
    last_sent: Option<Instant>,
}

impl Outbox {
    fn push(&mut self, notice: Arc<DaemonEvent>) {
        // Telemetry has events of its own.
        if matches!(notice.kind, EventKind::Telemetry { .. }) {
            return;
        }
        if self.notices.len() == QUEUE_LENGTH {
            self.notices.pop_front();
            self.missed += 1;
        }
        self.notices.push_back(notice);
    }

    fn is_pending(&self) -> bool {
        self.telemetry || self.missed > 0 || !self.notices.is_empty()
    }

    fn silent_for(&self, now: Instant) -> Duration {
        self.last_sent
            .map_or(Duration::MAX, |sent| now.duration_since(sent))
    }
}

/// Task behind one live stream.
struct Subscriber {
    tap: LiveTap,
    events: broadcast::Receiver<Arc<DaemonEvent>>,
    app: Arc<App>,
    /// Headers of the request, with its token or session.
    headers: HeaderMap,
    stopping: watch::Receiver<bool>,
    stall: Option<WriteStall>,
    every: Duration,
    outbox: Outbox,
    tx: mpsc::Sender<Result<Event, Infallible>>,
    _permit: OwnedSemaphorePermit,
}

impl Subscriber {
    /// Sends events until the client disconnects, its session is closed or the server ends. Watching is use of the session.
    async fn run(mut self) {
        let mut telemetry = ticks(self.every);
        let mut silence = ticks(self.every.min(MAX_SILENCE));
        let (tx, mut stopping) = (self.tx.clone(), self.stopping.clone());
        loop {
            let is_writable = !self.stall.as_ref().is_some_and(WriteStall::is_stalled);
            tokio::select! {
                () = tx.closed() => return,
                _ = stopping.wait_for(|stopping| *stopping) => return,
                received = self.events.recv() => match received {
                    Ok(notice) => self.outbox.push(notice),
                    Err(RecvError::Lagged(missed)) => self.outbox.missed += missed,
                    Err(RecvError::Closed) => return,
                },
                _ = telemetry.tick() => self.outbox.telemetry = true,
                // Wakes the loop, which then sees that a stalled socket is writable again.
                _ = silence.tick() => if self.app.access.role(&self.headers).is_none() { return },
                permit = tx.reserve(), if is_writable && self.is_due() => {
                    let Ok(permit) = permit else { return };
                    if let Some(event) = self.next() {
                        self.outbox.last_sent = Some(Instant::now());
                        permit.send(Ok(event));
                    }
                }
            }
        }
    }

    /// Returns `true` if an event may be due.
    fn is_due(&self) -> bool {
        let silent = self.outbox.silent_for(Instant::now()) >= MAX_SILENCE;
        self.outbox.is_pending() || silent || self.outbox.devices.is_none()
    }

    /// Returns telemetry without devices.
    fn empty_telemetry(&self) -> LiveTelemetry {
        LiveTelemetry {
            at_ms: self.app.daemon.view().now_ms(),
            ..LiveTelemetry::default()
        }
    }

    /// Returns the next event, made from current data; `None` if none is due.
    fn next(&mut self) -> Option<Event> {
        if let Some(devices) = self.devices() {
            return json("devices", &devices);
        }
        let now = Instant::now();
        if self.outbox.telemetry {
            self.outbox.telemetry = false;
            let telemetry = self.tap.take();
            if !telemetry.devices.is_empty() {
                return json("telemetry", &telemetry);
            }
        }
        if self.outbox.missed > 0 {
            let missed = std::mem::take(&mut self.outbox.missed);
            self.app.counts.missed.fetch_add(missed, Ordering::Relaxed);
            return json("missed", &MissedEvents { missed });
        }
        if let Some(notice) = self.outbox.notices.pop_front() {
            return json("notice", &*notice);
        }
        (self.outbox.silent_for(now) >= MAX_SILENCE)
            .then(|| json("telemetry", &self.empty_telemetry()))?
    }

    /// Returns the reports if they are due: first, after a change, and every [`DEVICES_PERIOD`]; at most once per interval, so that frequent
    /// changes do not delay telemetry.
    fn devices(&mut self) -> Option<Vec<DeviceReport>> {
        let devices = self.app.daemon.view().devices();
        let stable: Vec<_> = devices.iter().map(stable_fields).collect();
        let now = Instant::now();
        let last = self.outbox.devices.as_ref();
        match last.map(|(sent, at)| (*sent == stable, now.duration_since(*at))) {
            Some((_, ago)) if ago < self.every => None,
            Some((true, ago)) if ago < DEVICES_PERIOD => None,
            _ => {
                self.outbox.devices = Some((stable, now));
                Some(devices)
            }
        }
    }
}

/// Returns a report without the fields that always change.
fn stable_fields(device: &DeviceReport) -> DeviceReport {
    let mut device = device.clone();
    device.live = None;
    device.pot_temperature = None;
    device.since_s = 0;
    device.windows = WindowCounts::default();
    if let Some(lease) = &mut device.lease {
        lease.expires_in_s = 0;
    }
    if let Some(recording) = &mut device.recording_now {
        recording.since_s = 0.0;
    }
    device
}

fn json(kind: &str, data: &impl Serialize) -> Option<Event> {
    // Cannot fail: a number that JSON cannot hold is written as null.
    Event::default().event(kind).json_data(data).ok()
}
