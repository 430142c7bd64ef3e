//! `ihd trainer --ui`: a simulated hob that heats by itself, as an example for the page, until a user commands it.

use std::path::PathBuf;
use std::time::Duration;

use ihd_daemon::Daemon;
use ihd_daemon::config::{Address, DaemonConfig, DeviceConfig};
use ihd_link::DeviceSpec;
use ihd_model::{Command, CommandError, DaemonEvent, EventKind};
use tokio::sync::broadcast::error::RecvError;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep};

use super::device::RENEW_PERIOD;

/// Name of its device.
pub const DEVICE: &str = "simulated";

/// Name of the demonstration as a client.
const HOLDER: &str = "demonstration";

/// Polling period.
const POLL_PERIOD: Duration = Duration::from_millis(500);

/// Shortest time between the beginnings of two sweeps, so that a hob that does not heat is not commanded continuously.
const SWEEP_LASTS: Duration = Duration::from_secs(10);

/// Configuration of a demonstration.
#[derive(Debug)]
pub struct Demonstration {
    /// Options of the simulated hob, in the form of a configuration.
    pub sim: toml::Table,
    /// Powers of the sweep, in watt.
    pub powers_w: Vec<u16>,
    /// Folder of the store.
    pub store: PathBuf,
    /// Settings of the network, in the form of a configuration.
    pub network: Option<toml::Table>,
}

impl Demonstration {
    /// Returns the daemon's configuration with the demonstration's device: the user's, if there is one, else one that listens on a
    /// free port of the loopback.
    pub fn config(&self, of_file: Option<DaemonConfig>) -> DaemonConfig {
        let base = of_file.unwrap_or_else(|| DaemonConfig {
            listen: ([127, 0, 0, 1], 0).into(),
            store: self.store.clone(),
            ..DaemonConfig::default()
        });
        let address = Address {
            spec: DeviceSpec::Sim,
            sim: self.sim.clone(),
        };
        let name = DEVICE.to_owned();
        DaemonConfig {
            devices: vec![DeviceConfig { name, address }],
            discover_usb: Some(false),
            network: self.network.clone().or(base.network.clone()),
            ..base
        }
    }
}

/// Heats a device with the powers in turn, repeatedly; returns the name of another client that takes over.
pub async fn heat(daemon: Daemon, device: &str, powers_w: Vec<u16>) -> String {
    let mut notices = daemon.watch();
    let mut poll = interval(POLL_PERIOD);
    poll.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut sweep: Option<Instant> = None;
    let mut renewed = Instant::now();
    loop {
        let somebody = tokio::select! {
            notice = notices.recv() => match notice {
                Ok(notice) => commander(&notice, device),
                // The lease shows a missed event.
                Err(RecvError::Lagged(_)) => None,
                Err(RecvError::Closed) => return sleep_for_ever().await,
            },
            _ = poll.tick() => {
                let due = match sweep {
                    None => true,
                    Some(began) => began.elapsed() > SWEEP_LASTS && is_over(&daemon, device),
                };
                if due {
                    sweep = Some(Instant::now());
                    renewed = Instant::now();
                    let powers_w = powers_w.clone();
                    let asked = daemon.command(device, HOLDER, Command::Sweep { powers_w }).await;
                    // The device is not connected yet, or its panel is off: retry.
                    if let Err(CommandError::NotConnected { .. }) = asked {
                        sweep = None;
                    }
                    other(asked)
                } else if renewed.elapsed() > RENEW_PERIOD {
                    renewed = Instant::now();
                    other(daemon.take_lease(device, HOLDER, false).await)
                } else {
                    None
                }
            }
        };
        if let Some(somebody) = somebody {
            // The new owner's lease is kept; the demonstration's request ended with its own.
            let _ = daemon.release_lease(device, HOLDER).await;
            return somebody;
        }
    }
}

async fn sleep_for_ever() -> String {
    loop {
        sleep(Duration::from_secs(3_600)).await;
    }
}

/// Returns `true` if the sweep is over.
fn is_over(daemon: &Daemon, device: &str) -> bool {
    let report = daemon.view().device(device);
    report.is_none_or(|r| r.sweep_left_w.is_empty() && r.asked_by_daemon_w == 0)
}

/// Holder of the lease if it is another client.
fn other<T>(outcome: Result<T, CommandError>) -> Option<String> {
    match outcome {
        Err(CommandError::Leased { holder, .. }) => Some(holder),
        _ => None,
    }
}

/// Client that commands the device according to an event, if it is another one.
fn commander(notice: &DaemonEvent, device: &str) -> Option<String> {
    let holder = match &notice.kind {
        EventKind::Command { holder, ok, .. } if *ok => holder,
        EventKind::Lease {
            holder, taken_from, ..
        } if taken_from == HOLDER => holder,
        _ => return None,
    };
    (notice.device == device && holder != HOLDER).then(|| holder.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn notice(device: &str, kind: EventKind) -> DaemonEvent {
        DaemonEvent {
            at_ms: 0,
            device: device.into(),
            kind,
        }
    }

    fn command(holder: &str, ok: bool) -> EventKind {
        EventKind::Command {
            holder: holder.into(),
            text: "off".into(),
            ok,
        }
    }

    #[test]
    fn who_commands_ends_it_and_who_is_refused_does_not() {
        let ada = Some("Ada".to_owned());
        assert_eq!(commander(&notice("a", command("Ada", true)), "a"), ada);
        assert_eq!(commander(&notice("a", command("Ada", false)), "a"), None);
        assert_eq!(commander(&notice("b", command("Ada", true)), "a"), None);
        assert_eq!(commander(&notice("a", command(HOLDER, true)), "a"), None);
        let lease = |from: &str| EventKind::Lease {
            holder: "Ada".into(),
            taken_from: from.into(),
            why: String::new(),
        };
        assert_eq!(commander(&notice("a", lease(HOLDER)), "a"), ada);
        assert_eq!(commander(&notice("a", lease("Bob")), "a"), None);
    }

    #[test]
    fn it_listens_where_a_configuration_says_and_else_on_a_free_port() {
        let demonstration = Demonstration {
            sim: toml::Table::new(),
            powers_w: vec![700],
            store: "here".into(),
            network: None,
        };
        let config = demonstration.config(None);
        assert_eq!(config.listen.to_string(), "127.0.0.1:0");
        assert_eq!(config.store.to_str(), Some("here"));
        let text = "listen = \"127.0.0.1:9\"\nstore = \"there\"\n[[device]]\nname = \"b\"\naddress = \"usb\"\n";
        let config = demonstration.config(Some(DaemonConfig::parse(text, "ihd.toml").unwrap()));
        assert_eq!(config.listen.to_string(), "127.0.0.1:9");
        assert_eq!(config.store.to_str(), Some("there"));
        assert_eq!(config.devices.len(), 1, "nobody else's hob heats by itself");
        assert_eq!(config.devices[0].name, "simulated");
        assert!(!config.discovers_usb());
    }
}
