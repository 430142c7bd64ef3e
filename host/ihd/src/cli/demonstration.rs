//! `ihd trainer --ui`: a hob that heats by itself, so that the page has something to show, until somebody takes it over.

use std::path::PathBuf;
use std::time::Duration;

use ihd_daemon::Daemon;
use ihd_daemon::config::{Address, Config, DeviceConfig};
use ihd_daemon::model::{Command, CommandError, Notice, What};
use ihd_link::DeviceSpec;
use tokio::sync::broadcast::error::RecvError;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep};

/// Who heats.
const HOLDER: &str = "demonstration";

/// Between two renewals; the lease lasts 10 s.
const RENEW_EVERY: Duration = Duration::from_secs(3);

/// Between two looks.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// From the beginning of a sweep to that of the next at least: a hob that will not heat is not asked without end.
const SWEEP_LASTS: Duration = Duration::from_secs(10);

/// What is demonstrated.
#[derive(Debug)]
pub struct Demonstration {
    /// The device.
    pub device: DeviceSpec,
    /// Options of the simulated hob, as a configuration has them.
    pub sim: toml::Table,
    /// Powers to heat with one after the other, in watt.
    pub powers_w: Vec<u16>,
    /// Folder of the store.
    pub store: PathBuf,
    /// Settings of the network, as a configuration has them.
    pub network: Option<toml::Table>,
}

impl Demonstration {
    /// Name of its device.
    pub fn name(&self) -> &'static str {
        match self.device {
            DeviceSpec::Sim => "simulated",
            _ => "hob",
        }
    }

    /// Where somebody has a configuration, it says where the daemon listens and what it keeps; else it listens on a free port of the
    /// loopback. The device is the demonstration's.
    pub fn config(&self, of_file: Option<Config>) -> Config {
        let base = of_file.unwrap_or_else(|| Config {
            listen: ([127, 0, 0, 1], 0).into(),
            store: self.store.clone(),
            ..Config::default()
        });
        let address = Address {
            spec: self.device.clone(),
            sim: self.sim.clone(),
        };
        let name = self.name().to_owned();
        Config {
            devices: vec![DeviceConfig { name, address }],
            discover_usb: Some(false),
            network: self.network.clone().or(base.network.clone()),
            ..base
        }
    }
}

/// Heats a device with one power after the other, again and again; returns who commands it instead.
pub async fn heat(daemon: Daemon, device: &str, powers_w: Vec<u16>) -> String {
    let mut notices = daemon.watch();
    let mut look = interval(LOOK_EVERY);
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut sweep: Option<Instant> = None;
    let mut renewed = Instant::now();
    loop {
        let somebody = tokio::select! {
            notice = notices.recv() => match notice {
                Ok(notice) => commander(&notice, device),
                // A notice that was missed is seen in the lease.
                Err(RecvError::Lagged(_)) => None,
                Err(RecvError::Closed) => return sleep_for_ever().await,
            },
            _ = look.tick() => {
                let due = match sweep {
                    None => true,
                    Some(began) => began.elapsed() > SWEEP_LASTS && is_over(&daemon, device),
                };
                if due {
                    sweep = Some(Instant::now());
                    renewed = Instant::now();
                    let powers_w = powers_w.clone();
                    let asked = daemon.command(device, HOLDER, Command::Sweep { powers_w }).await;
                    // It is not there yet, or its panel is off: it is asked again.
                    if let Err(CommandError::NotConnected { .. }) = asked {
                        sweep = None;
                    }
                    other(asked)
                } else if renewed.elapsed() > RENEW_EVERY {
                    renewed = Instant::now();
                    other(daemon.take_lease(device, HOLDER, false).await)
                } else {
                    None
                }
            }
        };
        if let Some(somebody) = somebody {
            // Theirs is not given back, and what was asked for under ours ends with it.
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

/// Whether nothing of a sweep is left.
fn is_over(daemon: &Daemon, device: &str) -> bool {
    let report = daemon.device(device);
    report.is_none_or(|r| r.sweep_left_w.is_empty() && r.asked_by_daemon_w == 0)
}

/// Who holds the lease, where it is not us.
fn other<T>(outcome: Result<T, CommandError>) -> Option<String> {
    match outcome {
        Err(CommandError::Leased { holder, .. }) => Some(holder),
        _ => None,
    }
}

/// Who commands the device by what a notice says, where it is not us.
fn commander(notice: &Notice, device: &str) -> Option<String> {
    let holder = match &notice.what {
        What::Command { holder, ok, .. } if *ok => holder,
        What::Lease { holder, taken_from } if taken_from == HOLDER => holder,
        _ => return None,
    };
    (notice.device == device && holder != HOLDER).then(|| holder.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn notice(device: &str, what: What) -> Notice {
        Notice {
            at_ms: 0,
            device: device.into(),
            what,
        }
    }

    fn command(holder: &str, ok: bool) -> What {
        What::Command {
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
        let lease = |from: &str| What::Lease {
            holder: "Ada".into(),
            taken_from: from.into(),
        };
        assert_eq!(commander(&notice("a", lease(HOLDER)), "a"), ada);
        assert_eq!(commander(&notice("a", lease("Bob")), "a"), None);
    }

    #[test]
    fn it_listens_where_a_configuration_says_and_else_on_a_free_port() {
        let demonstration = Demonstration {
            device: DeviceSpec::Sim,
            sim: toml::Table::new(),
            powers_w: vec![700],
            store: "here".into(),
            network: None,
        };
        let config = demonstration.config(None);
        assert_eq!(config.listen.to_string(), "127.0.0.1:0");
        assert_eq!(config.store.to_str(), Some("here"));
        let text = "listen = \"127.0.0.1:9\"\nstore = \"there\"\n[[device]]\nname = \"b\"\naddress = \"usb\"\n";
        let config = demonstration.config(Some(Config::parse(text, "ihd.toml").unwrap()));
        assert_eq!(config.listen.to_string(), "127.0.0.1:9");
        assert_eq!(config.store.to_str(), Some("there"));
        assert_eq!(config.devices.len(), 1, "nobody else's hob heats by itself");
        assert_eq!(config.devices[0].name, "simulated");
        assert!(!config.discovers_usb());
    }
}
