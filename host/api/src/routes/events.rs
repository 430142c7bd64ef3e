//! Everything that happens, as Server-Sent Events.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{Event, KeepAlive, KeepAliveStream, Sse};
use ihd_daemon::model::Notice;
use serde::{Deserialize, Serialize};
use tokio::sync::broadcast::{self, error::RecvError};
use tokio::sync::{OwnedSemaphorePermit, mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;
use utoipa::IntoParams;

use super::App;
use super::problem::{Asked, Failed};
use crate::model::{Missed, Problem};

/// A comment this often where nothing happens, so that both ends notice a dead link.
const HEARTBEAT: Duration = Duration::from_secs(15);

/// Events that wait for the socket; what comes after is counted as missed.
const WAITING: usize = 16;

type Notices = ReceiverStream<Result<Event, Infallible>>;

/// Which events.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct WhichEvents {
    /// Of this device and of the daemon itself; of all where it is left out.
    device: Option<String>,
}

/// Everything that happens from now on. A message holds a Notice; a message of type `missed` says how many were dropped because
/// this reader was too slow. Nothing is kept for a reader that comes back.
#[utoipa::path(get, path = "/events", tag = "daemon", params(WhichEvents),
    responses((status = 200, description = "Server-Sent Events", content_type = "text/event-stream", body = Notice),
        (status = 503, description = "Too many watchers", body = Problem)))]
pub(super) async fn events(
    State(app): State<Arc<App>>,
    Asked(which): Asked<WhichEvents>,
    headers: HeaderMap,
) -> Result<Sse<KeepAliveStream<Notices>>, Failed> {
    let place = place(&app)?;
    let (tx, rx) = mpsc::channel(WAITING);
    let watcher = Watcher {
        notices: app.backend.watch(),
        device: which.device,
        tx,
        app: app.clone(),
        stopping: app.stopping.clone(),
        _place: place,
    };
    let greeting = if headers.contains_key("last-event-id") {
        "nothing is kept of what happened before; devices and results have it"
    } else {
        "watching"
    };
    tokio::spawn(watcher.run(greeting));
    let heartbeat = KeepAlive::new().interval(HEARTBEAT).text("");
    Ok(Sse::new(ReceiverStream::new(rx)).keep_alive(heartbeat))
}

/// A place among the watchers, until it is dropped.
pub(super) fn place(app: &App) -> Result<OwnedSemaphorePermit, Failed> {
    app.watchers.clone().try_acquire_owned().map_err(|_| {
        Failed::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "watchers",
            "as many watch already as there are places for",
        )
    })
}

struct Watcher {
    notices: broadcast::Receiver<Arc<Notice>>,
    device: Option<String>,
    tx: mpsc::Sender<Result<Event, Infallible>>,
    app: Arc<App>,
    stopping: watch::Receiver<bool>,
    _place: OwnedSemaphorePermit,
}

impl Watcher {
    /// Until the reader goes or the server ends.
    async fn run(mut self, greeting: &str) {
        if self
            .tx
            .send(Ok(Event::default().comment(greeting)))
            .await
            .is_err()
        {
            return;
        }
        loop {
            let received = tokio::select! {
                () = self.tx.closed() => return,
                _ = self.stopping.wait_for(|stopping| *stopping) => return,
                received = self.notices.recv() => received,
            };
            let event = match received {
                Ok(notice) if self.concerns(&notice) => json(None, &*notice),
                Ok(_) => continue,
                Err(RecvError::Lagged(missed)) => {
                    self.app.counts.missed.fetch_add(missed, Ordering::Relaxed);
                    json(Some("missed"), &Missed { missed })
                }
                Err(RecvError::Closed) => return,
            };
            let Some(event) = event else { continue };
            tokio::select! {
                sent = self.tx.send(Ok(event)) => if sent.is_err() { return },
                _ = self.stopping.wait_for(|stopping| *stopping) => return,
            }
        }
    }

    fn concerns(&self, notice: &Notice) -> bool {
        let wanted = self.device.as_deref();
        notice.device.is_empty() || wanted.is_none_or(|wanted| wanted == notice.device)
    }
}

fn json(kind: Option<&str>, data: &impl Serialize) -> Option<Event> {
    // A number that JSON cannot hold is written as null; nothing else can fail.
    let event = Event::default().json_data(data).ok()?;
    Some(match kind {
        Some(kind) => event.event(kind),
        None => event,
    })
}
