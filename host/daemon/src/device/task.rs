//! Task of one device: connects, runs sessions, connects again.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;
use std::time::Duration;

use ihd_link::{AsyncClient, LinkError};
use ihd_model::{Command, DeviceState};
use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;

use super::recording;
use super::report::{not_connected_error, publish_lease_expired};
use super::request::DeviceRequest;
use super::session::{DeviceSession, SessionEnd};
use crate::TruthFn;
use crate::clocks::Backoff;
use crate::config::Address;
use crate::context::Context;
use crate::device_record::{DeviceRecord, identity};
use crate::firmware::updates_needed;
use crate::printable::printable;

/// Wait before the next attempt with a device of another protocol.
const INCOMPATIBLE_RETRY: Duration = Duration::from_secs(30);

/// Capacity of a device's event queue.
const EVENT_QUEUE: usize = 256;

/// Session length from which on the back-off is reset.
const GOOD_SESSION: Duration = Duration::from_secs(10);

/// Task of one device.
pub struct DeviceTask {
    /// Shared record of the device.
    pub record: Arc<DeviceRecord>,
    /// Address of the device.
    pub address: Address,
    /// Shared services.
    pub context: Context,
}

impl DeviceTask {
    /// Runs until the stop signal.
    pub async fn run(&self, requests: &mut mpsc::Receiver<DeviceRequest>) {
        let mut hasher = DefaultHasher::new();
        self.record.name.hash(&mut hasher);
        let mut backoff = Backoff::new(hasher.finish());
        while !self.is_stopping() {
            let wait = match self.connect(requests).await {
                Some(Ok(connection)) => {
                    let began = Instant::now();
                    let end = self.run_session(connection, requests).await;
                    if began.elapsed() > GOOD_SESSION {
                        backoff.reset();
                    }
                    let (state, detail) = match end {
                        SessionEnd::Stopping => return,
                        SessionEnd::Suspended(why) => (DeviceState::Suspended, why),
                        SessionEnd::Link(why) => (DeviceState::Searching, why),
                    };
                    self.record.enter(state, &detail);
                    backoff.wait()
                }
                Some(Err(error)) => self.on_connect_error(&error, &mut backoff),
                None => return,
            };
            if !self.wait(wait, requests).await {
                return;
            }
        }
    }

    fn is_stopping(&self) -> bool {
        *self.context.stop.borrow()
    }

    /// Enters the state after a failed attempt. Returns the wait before the next one.
    fn on_connect_error(&self, error: &LinkError, backoff: &mut Backoff) -> Duration {
        match error {
            LinkError::Mismatch { .. } => {
                let why = error.to_string();
                self.record.lock().updates_needed = printable(&why);
                self.record.enter(DeviceState::Incompatible, &why);
                INCOMPATIBLE_RETRY
            }
            _ => {
                self.record
                    .enter(DeviceState::Searching, &error.to_string());
                backoff.wait()
            }
        }
    }

    /// Connects to the device and answers requests meanwhile. Returns `None` at the stop signal.
    async fn connect(
        &self,
        requests: &mut mpsc::Receiver<DeviceRequest>,
    ) -> Option<Result<Connection, LinkError>> {
        let (event_sender, events) = mpsc::channel(EVENT_QUEUE);
        let (open, address) = (Arc::clone(&self.context.open), self.address.clone());
        let (truth_sender, truth) = oneshot::channel();
        let opening = move || {
            let opened = open(&address)?;
            // Fails only if this task no longer waits for the connection.
            let _ = truth_sender.send(opened.truth);
            Ok(opened.transport)
        };
        let connecting = self.context.machine.connect(opening, event_sender);
        tokio::select! {
            biased;
            connected = connecting => {
                let truth = match &connected {
                    Ok(_) => truth.await.ok().flatten(),
                    Err(_) => None,
                };
                Some(connected.map(|client| Connection { client, events, truth }))
            }
            () = self.serve_disconnected(requests) => None,
        }
    }

    /// Waits for `time` and answers requests meanwhile. Returns `false` at the stop signal.
    async fn wait(&self, time: Duration, requests: &mut mpsc::Receiver<DeviceRequest>) -> bool {
        tokio::select! {
            biased;
            () = tokio::time::sleep(time) => true,
            () = self.serve_disconnected(requests) => false,
        }
    }

    /// Answers requests while the device is not connected. Returns at the stop signal.
    async fn serve_disconnected(&self, requests: &mut mpsc::Receiver<DeviceRequest>) {
        let mut tick = tokio::time::interval(Duration::from_millis(250));
        loop {
            tokio::select! {
                biased;
                () = self.context.stopping() => return,
                request = requests.recv() => match request {
                    None => return,
                    Some(DeviceRequest::Command { command: Command::RecordStop, reply, .. }) => {
                        recording::stop(&self.record, reply);
                    }
                    Some(DeviceRequest::Command { reply, .. }) => {
                        let _ = reply.send(Err(not_connected_error(&self.record)));
                    }
                    // The learner builds it again from the next result.
                    Some(DeviceRequest::PushLookup { lookup, .. }) => {
                        self.report_lookup_refused(lookup.lookup.version);
                    }
                },
                _ = tick.tick() => {
                    self.record.recorder.tick();
                    if let Some(holder) = self.record.lock().lease.expired(Instant::now()) {
                        publish_lease_expired(&self.record, &holder);
                    }
                }
            }
        }
    }

    fn report_lookup_refused(&self, version: u32) {
        self.context
            .learner
            .lookup_refused(&self.record.name, version);
    }

    async fn run_session(
        &self,
        connection: Connection,
        requests: &mut mpsc::Receiver<DeviceRequest>,
    ) -> SessionEnd {
        let client = Arc::new(connection.client);
        {
            let mut inner = self.record.lock();
            inner.identity = Some(identity(client.hello()));
            inner.updates_needed = updates_needed(client.hello().protocol_minor);
            inner.connections = inner.connections.saturating_add(1);
            inner.client = Some(Arc::clone(&client));
            inner.last = None;
        }
        let mut session = DeviceSession::new(
            &self.record,
            &self.context,
            Arc::clone(&client),
            connection.truth,
        );
        let end = session.run(connection.events, requests).await;
        session.close(&end).await;
        drop(session);
        self.record.lock().client = None;
        if let Some(client) = Arc::into_inner(client) {
            // A port or interface must be closed before it can be opened again.
            let _ = tokio::time::timeout(Duration::from_secs(5), client.close()).await;
        }
        end
    }
}

/// Connection after the handshake.
struct Connection {
    client: AsyncClient,
    events: mpsc::Receiver<ihd_link::DeviceEvent>,
    /// True R and L; `None` unless the device is simulated in this process.
    truth: Option<Arc<TruthFn>>,
}
