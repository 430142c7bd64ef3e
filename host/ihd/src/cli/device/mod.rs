//! `ihd device`: queries and commands devices, through the daemon if one is running, else directly.

mod address;
mod direct;
mod heating;
mod hob;
mod list;
pub(super) mod lookup;
mod recording;
mod text;
mod trigger;
mod watch;

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};
use ihd_api::client::ClientError;
use ihd_daemon::model::{Command, CommandError, RecordSettings, Trigger};
use ihd_shared::hob::RATED_POWER_W;

use super::simulate::quantity::quantity;
use super::{configured, output};
pub use heating::DoesNotHeat;
use hob::Hob;
#[cfg(feature = "log")]
pub use hob::direct_opener;
pub(in crate::cli) use text::{of_pot, one_line};
pub(in crate::cli) use watch::event_text;

/// Query and command devices: through the daemon if one is running, else directly.
///
/// DEV is a name of the configuration, or an address: tcp:HOST:PORT, usb:SERIAL, serial:PATH.
#[derive(Debug, Args)]
#[command(
    override_usage = "ihd device [OPTIONS] list\n       ihd device [OPTIONS] DEV COMMAND",
    subcommand_required = true,
    after_help = "Examples:\n  \
    ihd device list\n  \
    ihd device bench status --json\n  \
    ihd device bench power 1200 --for 60        (^C switches off)\n  \
    ihd device bench sweep --power 700,1000,1500\n  \
    ihd device tcp:127.0.0.1:4711 off\n  \
    ihd device bench lookup show\n  \
    ihd device bench record --trigger 'level:power>1000' --pre-trigger 5 --duration 30\n\n\
    Exit codes: 0 done, 1 failed or somebody else commands it, 2 wrong usage, 3 device or link, 4 the device does not heat"
)]
pub struct DeviceArgs {
    /// The device
    #[arg(value_name = "DEV")]
    device: Option<String>,
    #[command(subcommand)]
    action: Action,
    /// The daemon's configuration; without one ihd.toml of this folder, or what is built in
    #[arg(long, value_name = "FILE", global = true)]
    config: Option<PathBuf>,
    /// Print JSON
    #[arg(long, global = true)]
    json: bool,
    /// Take the lease from the client that commands the device; it is notified
    #[arg(long, global = true)]
    force: bool,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// The devices: the daemon's; without one those of the configuration, and boards on USB
    List,
    /// State of the device
    Status,
    /// Heat with a mean power until ^C, and switch off
    Power {
        /// In watt
        #[arg(value_name = "W", value_parser = clap::value_parser!(u16).range(1..=i64::from(RATED_POWER_W)))]
        power_w: u16,
        /// End after this long, in s
        #[arg(long = "for", value_name = "S", value_parser = quantity)]
        for_s: Option<f64>,
    },
    /// Switch off; needs no lease
    Off,
    /// Leave the safe state after a fault
    ClearFault,
    /// Lookup of R and L
    Lookup {
        #[command(subcommand)]
        action: LookupAction,
    },
    /// Heat with one power after the other, some windows of each, and switch off
    Sweep {
        /// Powers in watt
        #[arg(long, value_name = "W,W,…", value_delimiter = ',', required = true,
            value_parser = clap::value_parser!(u16).range(1..=i64::from(RATED_POWER_W)))]
        power: Vec<u16>,
    },
    /// Record everything that comes into an MCAP file, until ^C: now, or from when something happens
    Record {
        /// The file; through the daemon it is one of the store's folder `recordings`, and downloaded
        #[arg(long, short, value_name = "FILE")]
        out: Option<PathBuf>,
        /// End after this long, in s
        #[arg(long, value_name = "S", value_parser = quantity)]
        duration: Option<f64>,
        /// Trigger: now, fault, or a level that is crossed, as level:power>1000 (W), level:current>40 (A),
        /// level:resistance<2 (ohm), level:inductance<25 (µH), level:frequency<30 (kHz)
        #[arg(long, value_name = "WHAT", default_value = "now", value_parser = trigger::trigger)]
        trigger: Trigger,
        /// Record what came in this time before the trigger too, in s, up to 60
        #[arg(long, value_name = "S", default_value = "0", value_parser = quantity)]
        pre_trigger: f64,
    },
    /// Print events as they occur, until ^C
    Watch,
}

/// Exit code of an error of this command, if it has its own: 3 for device, link or a daemon that is not running, 4 for a device
/// that does not heat.
pub fn exit_code(error: &anyhow::Error) -> Option<u8> {
    if error.is::<DoesNotHeat>() {
        return Some(4);
    }
    let of_command = |error: &CommandError| match error {
        CommandError::NotConnected { .. } | CommandError::Refused { .. } => 3,
        CommandError::NoDevice { .. }
        | CommandError::Leased { .. }
        | CommandError::Failed { .. } => 1,
    };
    if let Some(error) = error.downcast_ref() {
        return Some(of_command(error));
    }
    match error.downcast_ref()? {
        ClientError::Command(error) => Some(of_command(error)),
        ClientError::Unreachable { .. } | ClientError::UnexpectedResponse { .. } => Some(3),
        ClientError::Refused { .. } | ClientError::Certificate { .. } => Some(1),
    }
}

#[derive(Debug, Subcommand)]
enum LookupAction {
    /// Show the one that the device uses, and those of the store
    Show,
    /// Offer one: a file lookup-vN.bin, as `ihd trainer` keeps it
    Push {
        /// The file
        file: PathBuf,
    },
    /// Offer the one that was active before, under a new version
    Rollback,
    /// Back to the built-in one
    Reset,
}

impl DeviceArgs {
    /// Queries or commands, and prints the result.
    ///
    /// # Errors
    /// Any error of daemon, device or configuration.
    pub fn run(&self) -> Result<()> {
        let config = configured::config(self.config.as_deref())?;
        if let (Action::List, None) = (&self.action, &self.device) {
            return list::print(&config, self.json);
        }
        let Some(name) = &self.device else {
            return Err(super::usage::Usage(
                "which device? `ihd device list` shows them: ihd device DEV COMMAND".into(),
            )
            .into());
        };
        ensure_usage!(
            !matches!(self.action, Action::List),
            "`list` is of all devices: ihd device list"
        );
        let mut hob = Hob::find(config, name)?;
        if self.force && !matches!(self.action, Action::Status | Action::Watch | Action::Off) {
            hob.take_lease(true)?;
        }
        match &self.action {
            Action::List => Ok(()),
            Action::Status => text::print(&hob.report()?, self.json),
            Action::Power { power_w, for_s } => {
                ensure_usage!(
                    for_s.is_none_or(|s| s.is_finite() && s > 0.0),
                    "--for must be more than 0 s"
                );
                heating::power(&mut hob, *power_w, *for_s, self.json)
            }
            Action::Off => self.once(&mut hob, &Command::Off),
            Action::ClearFault => self.once(&mut hob, &Command::ClearFault),
            Action::Lookup { action } => self.lookup(&mut hob, action),
            Action::Sweep { power } => heating::sweep(&mut hob, power, self.json),
            Action::Record {
                out,
                duration,
                trigger,
                pre_trigger,
            } => {
                let settings = RecordSettings {
                    trigger: *trigger,
                    pre_trigger_s: *pre_trigger,
                    duration_s: *duration,
                };
                recording::record(hob, out.as_deref(), &settings, self.json)
            }
            Action::Watch => watch::watch(&mut hob, self.json),
        }
    }

    fn once(&self, hob: &mut Hob, command: &Command) -> Result<()> {
        let done = hob.command(command)?;
        if self.force && !matches!(command, Command::Off) {
            hob.release_lease()?;
        }
        if self.json {
            return output::json(&done);
        }
        say!("{}: {}", hob.name(), done.text)
    }

    fn lookup(&self, hob: &mut Hob, action: &LookupAction) -> Result<()> {
        match action {
            LookupAction::Show => lookup::show(hob, self.json),
            LookupAction::Push { file } => {
                let blob = lookup::read(file)?;
                self.once(hob, &Command::LookupPush { blob })
            }
            LookupAction::Rollback => self.once(hob, &Command::LookupRollback { version: None }),
            LookupAction::Reset => self.once(hob, &Command::LookupReset),
        }
    }
}
