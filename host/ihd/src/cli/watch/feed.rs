//! Data from the daemon, on threads of its own: a slow or stopped daemon must not delay keys.

use std::collections::BTreeSet;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, sleep};
use std::time::Duration;

use ihd_api::ApiClient;
use ihd_api::client::events::StreamItem;
use ihd_model::{Command, DaemonEvent, DeviceReport, History};

use super::trend::SPAN_S;

/// Period of reading the reports of all devices.
const REPORT_PERIOD: Duration = Duration::from_secs(1);

/// First and longest pause between two attempts to reconnect.
const RETRY_PAUSE: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(5));

/// Update from the daemon.
#[derive(Debug)]
pub(super) enum FeedUpdate {
    /// Reports of all devices.
    Devices(Vec<DeviceReport>),
    /// Event.
    DaemonEvent(Box<DaemonEvent>),
    /// Number of dropped events: this reader was too slow.
    Missed(u64),
    /// Last minutes of a device, from the store.
    History(String, Box<History>),
    /// The daemon does not answer; with the reason.
    Gone(String),
    /// Result of a command; `true` if it was carried out.
    Answer(String, bool),
}

/// Threads that read from the daemon, and commands to it.
pub(super) struct Feed {
    client: ApiClient,
    updates: Sender<FeedUpdate>,
}

impl Feed {
    /// Starts reading; `only` restricts it to one device.
    pub(super) fn start(client: ApiClient, only: Option<String>) -> (Self, Receiver<FeedUpdate>) {
        let (updates, receiver) = channel();
        let (own, sender) = (client.clone(), updates.clone());
        let device = only.clone();
        thread::spawn(move || read_reports(&own, device.as_deref(), &sender));
        let (own, sender) = (client.clone(), updates.clone());
        thread::spawn(move || forward_events(&own, only.as_deref(), &sender));
        (Self { client, updates }, receiver)
    }

    /// Switches a device off, whichever client commands it.
    pub(super) fn switch_off(&self, device: String) {
        let (client, updates) = (self.client.clone(), self.updates.clone());
        thread::spawn(move || {
            let answer = match client.command(&device, &Command::Off) {
                Ok(done) => FeedUpdate::Answer(format!("{device}: {}", done.text), true),
                Err(error) => {
                    FeedUpdate::Answer(format!("{device} NOT switched off: {error}"), false)
                }
            };
            let _ = updates.send(answer);
        });
    }
}

/// Reads the reports of all devices periodically, and the last minutes of each new one; ends when the receiver is dropped.
fn read_reports(client: &ApiClient, only: Option<&str>, updates: &Sender<FeedUpdate>) {
    let mut filled = BTreeSet::new();
    let mut pause = RETRY_PAUSE.0;
    loop {
        let sent = match client.devices() {
            Ok(devices) => {
                pause = RETRY_PAUSE.0;
                let names: Vec<String> = devices
                    .iter()
                    .map(|d| d.name.clone())
                    .filter(|name| only.is_none_or(|only| only == name))
                    .collect();
                let mut sent = updates.send(FeedUpdate::Devices(devices));
                for name in names {
                    if sent.is_ok() && filled.insert(name.clone()) {
                        sent = history(client, name, updates);
                    }
                }
                sent.is_ok().then_some(REPORT_PERIOD)
            }
            Err(error) => {
                // The store may be another one after a restart.
                filled.clear();
                let wait = pause;
                pause = (2 * pause).min(RETRY_PAUSE.1);
                let sent = updates.send(FeedUpdate::Gone(error.to_string()));
                sent.is_ok().then_some(wait)
            }
        };
        match sent {
            Some(wait) => sleep(wait),
            None => return,
        }
    }
}

/// Last minutes of a device; none from an older daemon that does not have them.
fn history(
    client: &ApiClient,
    name: String,
    updates: &Sender<FeedUpdate>,
) -> Result<(), std::sync::mpsc::SendError<FeedUpdate>> {
    match client.history(&name, SPAN_S as u32 * 1000, SPAN_S as u32) {
        Ok(history) => updates.send(FeedUpdate::History(name, Box::new(history))),
        Err(_) => Ok(()),
    }
}

/// Forwards events; reconnects after an interruption.
fn forward_events(client: &ApiClient, only: Option<&str>, updates: &Sender<FeedUpdate>) {
    loop {
        if let Ok(events) = client.events(only) {
            for event in events {
                let sent = match event {
                    Ok(StreamItem::Event(notice)) => updates.send(FeedUpdate::DaemonEvent(notice)),
                    Ok(StreamItem::Missed(n)) => updates.send(FeedUpdate::Missed(n)),
                    Ok(StreamItem::Heartbeat | StreamItem::Unknown(_)) => Ok(()),
                    // The reports show that the daemon has stopped.
                    Err(_) => break,
                };
                if sent.is_err() {
                    return;
                }
            }
        }
        sleep(RETRY_PAUSE.0);
    }
}
