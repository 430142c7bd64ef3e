//! What comes from the daemon, on threads of its own: a daemon that is slow or gone must not keep a key waiting.

use std::collections::BTreeSet;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, sleep};
use std::time::Duration;

use ihd_api::ApiClient;
use ihd_api::client::events::Watched;
use ihd_daemon::model::{Command, DeviceReport, History, Notice};

use super::trend::SPAN_S;

/// Between two looks at all devices.
const REPORTS_EVERY: Duration = Duration::from_secs(1);

/// Between two tries of a daemon that is gone, at first and at most.
const AGAIN: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(5));

/// What is new.
#[derive(Debug)]
pub(super) enum News {
    /// All devices, as they are now.
    Devices(Vec<DeviceReport>),
    /// Something happened.
    Notice(Box<Notice>),
    /// So many events were dropped: this reader was too slow.
    Missed(u64),
    /// A device's last minutes, from the store.
    History(String, Box<History>),
    /// The daemon does not answer, and why.
    Gone(String),
    /// What became of a command, and whether it was carried out.
    Answer(String, bool),
}

/// Threads that ask the daemon, and commands to it.
pub(super) struct Feed {
    client: ApiClient,
    news: Sender<News>,
}

impl Feed {
    /// Starts to ask; `only` is the device that is looked at, where it is one.
    pub(super) fn start(client: ApiClient, only: Option<String>) -> (Self, Receiver<News>) {
        let (news, receiver) = channel();
        let (own, sender) = (client.clone(), news.clone());
        let wanted = only.clone();
        thread::spawn(move || reports(&own, wanted.as_deref(), &sender));
        let (own, sender) = (client.clone(), news.clone());
        thread::spawn(move || events(&own, only.as_deref(), &sender));
        (Self { client, news }, receiver)
    }

    /// Switches a device off, whoever commands it.
    pub(super) fn switch_off(&self, device: String) {
        let (client, news) = (self.client.clone(), self.news.clone());
        thread::spawn(move || {
            let answer = match client.command(&device, &Command::Off) {
                Ok(done) => News::Answer(format!("{device}: {}", done.text), true),
                Err(error) => News::Answer(format!("{device} NOT switched off: {error}"), false),
            };
            let _ = news.send(answer);
        });
    }
}

/// Asks for all devices again and again, and for the last minutes of each that is new; ends when nobody listens.
fn reports(client: &ApiClient, only: Option<&str>, news: &Sender<News>) {
    let mut filled = BTreeSet::new();
    let mut pause = AGAIN.0;
    loop {
        let told = match client.devices() {
            Ok(devices) => {
                pause = AGAIN.0;
                let names: Vec<String> = devices
                    .iter()
                    .map(|d| d.name.clone())
                    .filter(|name| only.is_none_or(|only| only == name))
                    .collect();
                let mut told = news.send(News::Devices(devices));
                for name in names {
                    if told.is_ok() && filled.insert(name.clone()) {
                        told = history(client, name, news);
                    }
                }
                told.is_ok().then_some(REPORTS_EVERY)
            }
            Err(error) => {
                // Its store may be another one when it is back.
                filled.clear();
                let wait = pause;
                pause = (2 * pause).min(AGAIN.1);
                let told = news.send(News::Gone(error.to_string()));
                told.is_ok().then_some(wait)
            }
        };
        match told {
            Some(wait) => sleep(wait),
            None => return,
        }
    }
}

/// The last minutes, where the daemon has them: an older one does not.
fn history(
    client: &ApiClient,
    name: String,
    news: &Sender<News>,
) -> Result<(), std::sync::mpsc::SendError<News>> {
    match client.history(&name, SPAN_S as u32 * 1000, SPAN_S as u32) {
        Ok(history) => news.send(News::History(name, Box::new(history))),
        Err(_) => Ok(()),
    }
}

/// Events, as they come; connects anew when they are cut off.
fn events(client: &ApiClient, only: Option<&str>, news: &Sender<News>) {
    loop {
        if let Ok(events) = client.events(only) {
            for event in events {
                let told = match event {
                    Ok(Watched::Notice(notice)) => news.send(News::Notice(notice)),
                    Ok(Watched::Missed(n)) => news.send(News::Missed(n)),
                    Ok(Watched::Heartbeat | Watched::Unknown(_)) => Ok(()),
                    // The reports say that the daemon is gone.
                    Err(_) => break,
                };
                if told.is_err() {
                    return;
                }
            }
        }
        sleep(AGAIN.0);
    }
}
