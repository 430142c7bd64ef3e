//! Events of the daemon as Server-Sent Events.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{Event, KeepAlive, KeepAliveStream, Sse};
use ihd_model::{DaemonEvent, MissedEvents, Problem};
use serde::{Deserialize, Serialize};
use tokio::sync::broadcast::{self, error::RecvError};
use tokio::sync::{OwnedSemaphorePermit, mpsc, watch};
use tokio::time::{Interval, MissedTickBehavior, interval};
use tokio_stream::wrappers::ReceiverStream;
use utoipa::IntoParams;

use super::App;
use crate::problem::{ApiQuery, ErrorResponse};

/// Period of comments without events, by which both ends detect a dead connection.
const HEARTBEAT: Duration = Duration::from_secs(15);

/// Maximum number of events that wait for the socket; more wait in the event bus, where the oldest are dropped and counted as missed.
const QUEUE_LENGTH: usize = 16;

/// Period of the check that the client's session was not closed.
const SESSION_PERIOD: Duration = Duration::from_secs(1);

type EventStream = ReceiverStream<Result<Event, Infallible>>;

/// Query parameters of the event stream.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct EventParameters {
    /// Events of this device and of the daemon only; default: of all devices.
    device: Option<String>,
}

/// Streams all events from now on. A message holds a Notice; a message of type `missed` holds the number of events that were dropped
/// because the client was too slow. Events are not repeated after a reconnection.
#[utoipa::path(get, path = "/events", tag = "daemon", params(EventParameters),
    responses((status = 200, description = "Server-Sent Events", content_type = "text/event-stream", body = DaemonEvent),
        (status = 400, body = Problem), (status = 503, description = "Too many event streams", body = Problem)))]
pub(super) async fn events(
    State(app): State<Arc<App>>,
    ApiQuery(parameters): ApiQuery<EventParameters>,
    headers: HeaderMap,
) -> Result<Sse<KeepAliveStream<EventStream>>, ErrorResponse> {
    let permit = subscriber_permit(&app)?;
    let (tx, rx) = mpsc::channel(QUEUE_LENGTH);
    let subscriber = Subscriber {
        events: app.daemon.watch(),
        device: parameters.device,
        tx,
        app: app.clone(),
        stopping: app.stopping.clone(),
        headers,
        _permit: permit,
    };
    tokio::spawn(subscriber.run());
    let heartbeat = KeepAlive::new().interval(HEARTBEAT).text("");
    Ok(Sse::new(ReceiverStream::new(rx)).keep_alive(heartbeat))
}

/// Reserves one of the event streams until the permit is dropped.
///
/// # Errors
/// 503 if all are in use.
pub(super) fn subscriber_permit(app: &App) -> Result<OwnedSemaphorePermit, ErrorResponse> {
    app.subscribers.clone().try_acquire_owned().map_err(|_| {
        ErrorResponse::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "watchers",
            "the maximum number of event streams is in use",
        )
    })
}

/// Returns ticks of a period; late ones are not made up for.
pub(super) fn ticks(every: Duration) -> Interval {
    let mut ticks = interval(every);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}

/// Task behind one event stream.
struct Subscriber {
    events: broadcast::Receiver<Arc<DaemonEvent>>,
    device: Option<String>,
    tx: mpsc::Sender<Result<Event, Infallible>>,
    app: Arc<App>,
    /// Headers of the request, with its token or session.
    headers: HeaderMap,
    stopping: watch::Receiver<bool>,
    _permit: OwnedSemaphorePermit,
}

impl Subscriber {
    /// Sends events until the client disconnects, its session is closed or the server ends. Watching is use of the session.
    async fn run(mut self) {
        if self
            .tx
            .send(Ok(Event::default().comment("watching")))
            .await
            .is_err()
        {
            return;
        }
        let mut session = ticks(SESSION_PERIOD);
        loop {
            let received = tokio::select! {
                () = self.tx.closed() => return,
                _ = session.tick() => match self.app.access.role(&self.headers) {
                    Some(_) => continue,
                    None => return,
                },
                _ = self.stopping.wait_for(|stopping| *stopping) => return,
                received = self.events.recv() => received,
            };
            let event = match received {
                Ok(event) if self.is_selected(&event) => json(None, &*event),
                Ok(_) => continue,
                Err(RecvError::Lagged(missed)) => {
                    self.app.counts.missed.fetch_add(missed, Ordering::Relaxed);
                    json(Some("missed"), &MissedEvents { missed })
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

    fn is_selected(&self, event: &DaemonEvent) -> bool {
        let selected = self.device.as_deref();
        event.device.is_empty() || selected.is_none_or(|device| device == event.device)
    }
}

fn json(kind: Option<&str>, data: &impl Serialize) -> Option<Event> {
    // Cannot fail: a number that JSON cannot hold is written as null.
    let event = Event::default().json_data(data).ok()?;
    Some(match kind {
        Some(kind) => event.event(kind),
        None => event,
    })
}
