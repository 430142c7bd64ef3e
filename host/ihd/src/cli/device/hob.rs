//! A device, behind the daemon or not.

#[cfg(feature = "log")]
use std::path::Path;
use std::str::FromStr;

use anyhow::{Context, Result, bail};
use ihd_api::ApiClient;
use ihd_api::client::ClientError;
use ihd_daemon::config::{Address, Config};
use ihd_daemon::model::{Command, CommandError, DeviceReport, Done};
use ihd_link::DeviceSpec;
#[cfg(feature = "log")]
use ihd_link::{LinkError, Transport};

use super::direct::Direct;
use crate::cli::configured;
#[cfg(feature = "log")]
use crate::cli::opener::opener;
use crate::cli::usage::Usage;

/// A device that answers.
pub(super) enum Hob {
    /// Through the daemon.
    Daemon { client: ApiClient, name: String },
    /// With no daemon between.
    Direct(Box<Direct>),
}

impl Hob {
    /// The device of a name of the configuration, or of an address.
    pub(super) fn find(config: Config, wanted: &str) -> Result<Self> {
        let daemon = configured::daemon(&config)?;
        if let Some(client) = daemon {
            let devices = client.devices()?;
            let known = devices
                .iter()
                .find(|d| d.name == wanted)
                .or_else(|| devices.iter().find(|d| d.address == wanted));
            if let Some(device) = known {
                let name = device.name.clone();
                return Ok(Self::Daemon { client, name });
            }
            if DeviceSpec::from_str(wanted).is_err() && !is_configured(&config, wanted) {
                let name = wanted.to_owned();
                return Err(CommandError::NoDevice { name }.into());
            }
        }
        let (config, address) = configured_or_address(config, wanted)?;
        Ok(Self::Direct(Box::new(Direct::open(
            config, address, wanted,
        )?)))
    }

    /// Its name.
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Daemon { name, .. } => name,
            Self::Direct(direct) => direct.name(),
        }
    }

    /// What it does.
    pub(super) fn report(&mut self) -> Result<DeviceReport> {
        match self {
            Self::Daemon { client, name } => Ok(client.device(name)?),
            Self::Direct(direct) => direct.report(),
        }
    }

    /// Carries out a command.
    pub(super) fn command(&mut self, command: &Command) -> Result<Done> {
        match self {
            Self::Daemon { client, name } => Ok(client.command(name, command)?),
            Self::Direct(direct) => direct.command(command),
        }
    }

    /// Takes or renews the lease; without a daemon the link itself is one, which the device hears.
    pub(super) fn take_lease(&mut self, force: bool) -> Result<()> {
        match self {
            Self::Daemon { client, name } => {
                client.take_lease(name, force)?;
            }
            Self::Direct(direct) => direct.keep_alive()?,
        }
        Ok(())
    }

    /// Gives the lease back.
    pub(super) fn release_lease(&mut self) -> Result<()> {
        match self {
            Self::Daemon { client, name } => Ok(client.release_lease(name)?),
            Self::Direct(_) => Ok(()),
        }
    }
}

/// How the device of a name of the configuration, or of an address, is opened without a daemon, each time anew.
///
/// # Errors
/// Where a daemon has it: a link has one host.
#[cfg(feature = "log")]
pub fn direct_opener(
    config: Option<&Path>,
    wanted: &str,
) -> Result<impl FnMut() -> Result<Box<dyn Transport>, LinkError> + use<>> {
    let config = configured::config(config)?;
    let (mut config, address) = configured_or_address(config, wanted)?;
    let place = address_of(&config, &address)?;
    if let Some(client) = configured::daemon(&config)? {
        let devices = client.devices()?;
        let at = place.to_string();
        let theirs = devices.iter().find(|d| d.name == wanted || d.address == at);
        if let Some(device) = theirs {
            bail!(
                "the daemon at {} has {}, and a link has one host: stop the daemon, or take the device out of its \
                 configuration; a debug probe listens beside it (`ihd log --probe`)",
                client.url(),
                device.name
            );
        }
    }
    let open = opener(&mut config)?;
    // Marked by the opener, where it is a simulated hob.
    let place = address_of(&config, &address)?;
    Ok(move || open(&place).map(|opened| opened.transport))
}

/// Whether somebody else commands the device now.
pub(super) fn is_somebody_elses(error: &anyhow::Error) -> bool {
    matches!(
        error.downcast_ref(),
        Some(ClientError::Command(CommandError::Leased { .. }))
    )
}

fn is_configured(config: &Config, name: &str) -> bool {
    config.devices.iter().any(|device| device.name == name)
}

fn configured_or_address(config: Config, wanted: &str) -> Result<(Config, String)> {
    if is_configured(&config, wanted) {
        return Ok((config, wanted.to_owned()));
    }
    match DeviceSpec::from_str(wanted) {
        Ok(DeviceSpec::Sim) => bail!(Usage(
            "a simulated hob lives in the daemon or in `ihd hob`: name one of the configuration, \
             or tcp:HOST:PORT"
                .into()
        )),
        Ok(_) => Ok((config, wanted.to_owned())),
        Err(error) => {
            let names: Vec<&str> = config.devices.iter().map(|d| d.name.as_str()).collect();
            let names = match names.as_slice() {
                [] => "the configuration names none".to_owned(),
                names => format!("the configuration names {}", names.join(", ")),
            };
            Err(Usage(format!("{error}; {names}")).into())
        }
    }
}

/// The address of a device of the configuration, or what is one already.
pub(super) fn address_of(config: &Config, wanted: &str) -> Result<Address> {
    if let Some(device) = config.devices.iter().find(|d| d.name == wanted) {
        return Ok(device.address.clone());
    }
    let spec = DeviceSpec::from_str(wanted).context("no device")?;
    Ok(spec.into())
}
