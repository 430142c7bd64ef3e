//! `ihd device`: queries and commands devices, through the daemon if one is running, else directly.

mod address;
mod direct;
mod heating;
mod hob;
mod list;
pub mod lookup;
mod text;
mod watch;

use std::time::Duration;

use anyhow::Result;
use clap::{Args, Subcommand};
use ihd_daemon::config::DaemonConfig;
use ihd_model::Command;

use super::global::Global;
use super::simulate::quantity::{duration, power_w};
use super::{configured, output};
pub use heating::DoesNotHeat;
pub(in crate::cli) use heating::RENEW_PERIOD;
pub(in crate::cli) use hob::Hob;
#[cfg(feature = "log")]
pub use hob::direct_opener;
pub(in crate::cli) use list::HEALTH_WITHIN;
use lookup::Offer;
pub(in crate::cli) use text::{of_pot, one_line};
pub(in crate::cli) use watch::{event_text, now_ms};

/// Query and command devices: through the daemon if one is running, else directly.
///
/// DEV is a name of the configuration, or an address: tcp:HOST:PORT, usb:SERIAL, serial:PATH.
#[derive(Debug, Args)]
#[command(
    override_usage = "ihd device [OPTIONS] status\n       ihd device [OPTIONS] DEV COMMAND",
    subcommand_required = true,
    after_help = "Examples:\n  \
    ihd device status                           (all devices)\n  \
    ihd device bench status --json\n  \
    ihd device bench power 1200 --for 60        (^C switches off)\n  \
    ihd device bench power 700,1000,1500        (some windows of each)\n  \
    ihd device tcp:127.0.0.1:4711 off\n  \
    ihd device bench lookup show\n  \
    ihd device bench lookup push previous\n\n\
    Exit codes: 0 done, 1 failed or somebody else commands it, 2 wrong usage, 3 device or link, 4 the device does not heat"
)]
pub struct DeviceArgs {
    /// The device
    #[arg(value_name = "DEV")]
    device: Option<String>,
    #[command(subcommand)]
    action: Action,
}

/// Lease of a command.
#[derive(Clone, Copy, Debug, Args)]
struct LeaseArgs {
    /// Take the lease from the client that commands the device; it is notified
    #[arg(long)]
    force: bool,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// State of the device; without DEV the devices: the daemon's, without one those of the configuration, and boards on USB
    Status,
    /// Heat with a mean power until ^C, or with one power after the other, some windows of each; then switch off
    Power {
        /// In watt; several, or --windows: some windows of each
        #[arg(value_name = "W,W,…", value_delimiter = ',', required = true, value_parser = power_w)]
        powers_w: Vec<u16>,
        /// End after this long, in s
        #[arg(long = "for", value_name = "S", value_parser = duration, conflicts_with = "windows")]
        for_time: Option<Duration>,
        /// End a single power, too, once some windows of it have come
        #[arg(long)]
        windows: bool,
        #[command(flatten)]
        lease: LeaseArgs,
    },
    /// Switch off; needs no lease
    Off,
    /// Leave the safe state after a fault
    ClearFault(LeaseArgs),
    /// Lookup of R and L
    Lookup {
        #[command(subcommand)]
        action: LookupAction,
    },
}

#[derive(Debug, Subcommand)]
enum LookupAction {
    /// Show the one that the device uses, and those of the store
    Show,
    /// Offer one
    Push {
        /// A file lookup-vN.bin, as `ihd trainer` keeps it; `previous`: the one that was active before, under a new version;
        /// `builtin`: back to the built-in one
        #[arg(value_name = "FILE|previous|builtin")]
        lookup: Offer,
        #[command(flatten)]
        lease: LeaseArgs,
    },
}

impl DeviceArgs {
    /// Queries or commands, and prints the result.
    ///
    /// # Errors
    /// Any error of daemon, device or configuration.
    pub fn run(&self, global: &Global) -> Result<()> {
        let config = configured::config(global.config.as_deref())?;
        if let (Action::Status, None) = (&self.action, &self.device) {
            return list::print(&config, global.json);
        }
        let Some(name) = &self.device else {
            return Err(super::usage::Usage(
                "which device? `ihd device status` shows them: ihd device DEV COMMAND".into(),
            )
            .into());
        };
        // All that can be wrong here, before the lease is taken from anybody.
        let command = self.action.single_command()?;
        let mut hob = match &self.action {
            Action::Off => Hob::find_to_switch_off(config, name)?,
            _ => Hob::find(config, name)?,
        };
        let forces = self.action.forces();
        if forces {
            hob.take_lease(true)?;
        }
        match (&self.action, command) {
            (_, Some(command)) => once(&mut hob, &command, forces, global.json),
            (
                Action::Power {
                    powers_w,
                    for_time,
                    windows,
                    ..
                },
                None,
            ) => match powers_w.as_slice() {
                [power_w] if !windows => heating::power(&mut hob, *power_w, *for_time, global.json),
                several => heating::sweep(&mut hob, several, global.json),
            },
            (Action::Lookup { .. }, None) => lookup::show(&mut hob, global.json),
            (_, None) => status(&mut hob, global.json),
        }
    }
}

impl Action {
    /// Returns the command of an action that is one command; `None` for the others.
    ///
    /// # Errors
    /// If the action cannot be meant: a time that is none, a file that is no lookup.
    fn single_command(&self) -> Result<Option<Command>> {
        Ok(match self {
            Self::Power {
                powers_w, for_time, ..
            } => {
                ensure_usage!(
                    for_time.is_none_or(|time| !time.is_zero()),
                    "--for must be more than 0 s"
                );
                ensure_usage!(
                    for_time.is_none() || powers_w.len() == 1,
                    "--for goes with one power: several end after their windows"
                );
                None
            }
            Self::Off => Some(Command::Off),
            Self::ClearFault(_) => Some(Command::ClearFault),
            Self::Lookup {
                action: LookupAction::Push { lookup, .. },
            } => Some(lookup.command()?),
            Self::Status | Self::Lookup { .. } => None,
        })
    }

    /// Returns `true` if the lease is to be taken from another client.
    fn forces(&self) -> bool {
        match self {
            Self::Power { lease, .. }
            | Self::ClearFault(lease)
            | Self::Lookup {
                action: LookupAction::Push { lookup: _, lease },
            } => lease.force,
            Self::Status | Self::Off | Self::Lookup { .. } => false,
        }
    }
}

/// Prints the report of a device, and what its daemon's store does not take.
fn status(hob: &mut Hob, json: bool) -> Result<()> {
    text::print(&hob.report()?, json)?;
    if !json && let Some(failure) = hob.store_failure()? {
        say!("store      {failure}")?;
    }
    Ok(())
}

/// Carries out a command and prints the reply. A lease that was taken by force is given back, whatever the command came to.
fn once(hob: &mut Hob, command: &Command, forces: bool, json: bool) -> Result<()> {
    let done = hob.command(command);
    let given_back = if forces { hob.release_lease() } else { Ok(()) };
    let done = done?;
    match json {
        true => output::json(&done),
        false => say!("{}: {}", hob.name(), done.text),
    }?;
    given_back
}

/// Prints a line for each event of a device until Ctrl-C.
pub(super) fn lines(config: DaemonConfig, device: &str, json: bool) -> Result<()> {
    watch::watch(&mut Hob::find(config, device)?, json)
}
