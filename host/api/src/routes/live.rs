//! What devices do now, for a display: pulled at its pace, newest first, never behind.
//!
//! A watcher has one event on its way. The next is made when the socket has taken it, of what is there then: whoever is slow gets
//! fewer events, not older ones, and is told how many intervals each stands for.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::Extension;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::sse::{Event, Sse};
use ihd_daemon::board::now_ms;
use ihd_daemon::model::{DeviceReport, LiveTelemetry, Notice, What, WindowCounts};
use serde::{Deserialize, Serialize};
use tokio::sync::broadcast::{self, error::RecvError};
use tokio::sync::{OwnedSemaphorePermit, mpsc, watch};
use tokio::time::{Instant, Interval, MissedTickBehavior, interval};
use tokio_stream::wrappers::ReceiverStream;
use utoipa::IntoParams;

use super::App;
use super::events::place;
use super::problem::{Asked, Failed};
use crate::backend::Tap;
use crate::connection::Stalled;
use crate::model::{Missed, Problem};

/// Between two events of telemetry, unless told otherwise, in milliseconds.
const DEFAULT_INTERVAL_MS: u32 = 200;

/// A person sees no more.
const LEAST_INTERVAL_MS: u32 = 100;

/// Beyond it `/devices` does as well.
const LARGEST_INTERVAL_MS: u32 = 5_000;

/// How long nothing may come: whoever hears nothing for longer knows that the link is dead.
const SILENCE: Duration = Duration::from_secs(1);

/// Devices are told again this often, changed or not.
const DEVICES_EVERY: Duration = Duration::from_secs(2);

/// Notices that wait for a slow watcher; of what is beyond, the oldest are missed.
const WAITING: usize = 256;

type Events = ReceiverStream<Result<Event, Infallible>>;

/// How often.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct HowOften {
    /// Milliseconds between two events of telemetry, 100 to 5000; 200 unless told.
    interval_ms: Option<u32>,
}

/// What devices do, for a display: `telemetry` (what happened since the last one; at least once a second, then without devices),
/// `devices` (every device, when something changed and every 2 s), `notice` (all but telemetry) and `missed`. Whoever is slow gets
/// fewer, never older ones.
#[utoipa::path(get, path = "/live", tag = "daemon", params(HowOften),
    responses((status = 200, description = "Server-Sent Events; those named `telemetry` hold this", content_type = "text/event-stream",
            body = LiveTelemetry),
        (status = 400, body = Problem), (status = 503, description = "Too many watchers", body = Problem)))]
pub(super) async fn live(
    State(app): State<Arc<App>>,
    Asked(how): Asked<HowOften>,
    stalled: Option<Extension<Stalled>>,
) -> Result<Sse<Events>, Failed> {
    let interval_ms = how.interval_ms.unwrap_or(DEFAULT_INTERVAL_MS);
    if !(LEAST_INTERVAL_MS..=LARGEST_INTERVAL_MS).contains(&interval_ms) {
        let text = format!(
            "interval_ms is {interval_ms}, but must lie between {LEAST_INTERVAL_MS} and {LARGEST_INTERVAL_MS}"
        );
        return Err(Failed::new(StatusCode::BAD_REQUEST, "query", text));
    }
    let every = Duration::from_millis(interval_ms.into());
    let place = place(&app)?;
    let (tx, rx) = mpsc::channel(1);
    let watcher = Watcher {
        tap: app.backend.live(every),
        notices: app.backend.watch(),
        stopping: app.stopping.clone(),
        app,
        stalled: stalled.map(|Extension(stalled)| stalled),
        every,
        outbox: Outbox::default(),
        tx,
        _place: place,
    };
    tokio::spawn(watcher.run());
    Ok(Sse::new(ReceiverStream::new(rx)))
}

/// What waits to be told.
#[derive(Default)]
struct Outbox {
    /// Telemetry is due: it is made when it goes out.
    telemetry: bool,
    notices: VecDeque<Arc<Notice>>,
    missed: u64,
    /// Devices as they were told last, without what changes all the time, and when.
    devices: Option<(Vec<DeviceReport>, Instant)>,
    /// When anything was told last.
    told: Option<Instant>,
}

impl Outbox {
    fn take_in(&mut self, notice: Arc<Notice>) {
        // Which comes in events of its own.
        if matches!(notice.what, What::Telemetry { .. }) {
            return;
        }
        if self.notices.len() == WAITING {
            self.notices.pop_front();
            self.missed += 1;
        }
        self.notices.push_back(notice);
    }

    fn waits(&self) -> bool {
        self.telemetry || self.missed > 0 || !self.notices.is_empty()
    }

    fn silent_for(&self, now: Instant) -> Duration {
        self.told
            .map_or(Duration::MAX, |told| now.duration_since(told))
    }
}

struct Watcher {
    tap: Box<dyn Tap>,
    notices: broadcast::Receiver<Arc<Notice>>,
    app: Arc<App>,
    stopping: watch::Receiver<bool>,
    stalled: Option<Stalled>,
    every: Duration,
    outbox: Outbox,
    tx: mpsc::Sender<Result<Event, Infallible>>,
    _place: OwnedSemaphorePermit,
}

impl Watcher {
    /// Until the reader goes or the server ends.
    async fn run(mut self) {
        let mut telemetry = ticks(self.every);
        let mut silence = ticks(self.every.min(SILENCE));
        let (tx, mut stopping) = (self.tx.clone(), self.stopping.clone());
        loop {
            let takes = !self.stalled.as_ref().is_some_and(Stalled::is_stalled);
            tokio::select! {
                () = tx.closed() => return,
                _ = stopping.wait_for(|stopping| *stopping) => return,
                received = self.notices.recv() => match received {
                    Ok(notice) => self.outbox.take_in(notice),
                    Err(RecvError::Lagged(missed)) => self.outbox.missed += missed,
                    Err(RecvError::Closed) => return,
                },
                _ = telemetry.tick() => self.outbox.telemetry = true,
                // A socket that is free again is seen here.
                _ = silence.tick() => {}
                place = tx.reserve(), if takes && self.is_due() => {
                    let Ok(place) = place else { return };
                    if let Some(event) = self.next() {
                        self.outbox.told = Some(Instant::now());
                        place.send(Ok(event));
                    }
                }
            }
        }
    }

    /// Whether there may be something to tell.
    fn is_due(&self) -> bool {
        let silent = self.outbox.silent_for(Instant::now()) >= SILENCE;
        self.outbox.waits() || silent || self.outbox.devices.is_none()
    }

    /// The next event, made of what is there now.
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
            return json("missed", &Missed { missed });
        }
        if let Some(notice) = self.outbox.notices.pop_front() {
            return json("notice", &*notice);
        }
        (self.outbox.silent_for(now) >= SILENCE).then(|| json("telemetry", &silence()))?
    }

    /// Devices where they have to be told: at the beginning, when something changed, and every 2 s. Not twice in an
    /// interval: what changes all the time must not keep telemetry back.
    fn devices(&mut self) -> Option<Vec<DeviceReport>> {
        let devices = self.app.backend.devices();
        let lasting: Vec<_> = devices.iter().map(lasting).collect();
        let now = Instant::now();
        let told = self.outbox.devices.as_ref();
        match told.map(|(told, when)| (*told == lasting, now.duration_since(*when))) {
            Some((_, ago)) if ago < self.every => None,
            Some((true, ago)) if ago < DEVICES_EVERY => None,
            _ => {
                self.outbox.devices = Some((lasting, now));
                Some(devices)
            }
        }
    }
}

/// What of a device does not change all the time; windows are counted as they come.
fn lasting(device: &DeviceReport) -> DeviceReport {
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

/// Nobody was heard.
fn silence() -> LiveTelemetry {
    LiveTelemetry {
        at_ms: now_ms(),
        ..LiveTelemetry::default()
    }
}

fn ticks(every: Duration) -> Interval {
    let mut ticks = interval(every);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}

fn json(kind: &str, data: &impl Serialize) -> Option<Event> {
    // A number that JSON cannot hold is written as null; nothing else can fail.
    Event::default().event(kind).json_data(data).ok()
}
