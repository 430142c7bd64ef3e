//! Device, through the daemon or directly.

#[cfg(feature = "log")]
use std::path::Path;
use std::str::FromStr;

use anyhow::{Result, bail};
use ihd_api::ApiClient;
use ihd_api::client::ClientError;
use ihd_daemon::config::DaemonConfig;
use ihd_link::DeviceSpec;
#[cfg(feature = "log")]
use ihd_link::{LinkError, Transport};
use ihd_model::{Command, CommandError, CommandReply, DeviceReport};

use super::address::address_of;
use super::direct::Direct;
use super::list::store_failure;
use crate::cli::configured;
#[cfg(feature = "log")]
use crate::cli::opener::opener;
use crate::cli::output;
use crate::cli::usage::Usage;

/// Connected device.
pub(in crate::cli) enum Hob {
    /// Through the daemon.
    Daemon { client: ApiClient, name: String },
    /// Without a daemon.
    Direct(Box<Direct>),
}

impl Hob {
    /// Connects to the device with a name of the configuration, or an address.
    pub(in crate::cli) fn find(config: DaemonConfig, device: &str) -> Result<Self> {
        let daemon = configured::daemon(&config)?;
        Self::find_behind(daemon, config, device)
    }

    /// Connects to the device that is to be switched off: directly, where the daemon does not answer.
    pub(super) fn find_to_switch_off(config: DaemonConfig, device: &str) -> Result<Self> {
        let daemon = configured::daemon(&config).unwrap_or_else(|error| {
            let why = crate::cli::message(&error);
            output::complain(format_args!("ihd: {why}; going without the daemon"));
            None
        });
        Self::find_behind(daemon, config, device)
    }

    fn find_behind(daemon: Option<ApiClient>, config: DaemonConfig, device: &str) -> Result<Self> {
        if let Some(client) = daemon {
            let devices = client.devices()?;
            let known = devices
                .iter()
                .find(|d| d.name == device)
                .or_else(|| devices.iter().find(|d| d.address == device));
            if let Some(device) = known {
                let name = device.name.clone();
                return Ok(Self::Daemon { client, name });
            }
            if DeviceSpec::from_str(device).is_err() && !is_configured(&config, device) {
                let name = device.to_owned();
                return Err(CommandError::NoDevice { name }.into());
            }
        }
        let (config, address) = configured_or_address(config, device)?;
        Ok(Self::Direct(Box::new(Direct::open(
            config, address, device,
        )?)))
    }

    /// Name of the device.
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Daemon { name, .. } => name,
            Self::Direct(direct) => direct.name(),
        }
    }

    /// Reads its report.
    pub(super) fn report(&mut self) -> Result<DeviceReport> {
        match self {
            Self::Daemon { client, name } => Ok(client.device(name)?),
            Self::Direct(direct) => direct.report(),
        }
    }

    /// Text of the failure of the daemon's store; `None` while it takes everything, and without a daemon.
    pub(super) fn store_failure(&self) -> Result<Option<String>> {
        match self {
            Self::Daemon { client, .. } => store_failure(client),
            Self::Direct(_) => Ok(None),
        }
    }

    /// Carries out a command.
    pub(super) fn command(&mut self, command: &Command) -> Result<CommandReply> {
        match self {
            Self::Daemon { client, name } => Ok(client.command(name, command)?),
            Self::Direct(direct) => direct.command(command),
        }
    }

    /// Acquires or renews the lease; without a daemon it keeps the link alive, which has the same effect.
    pub(super) fn take_lease(&mut self, force: bool) -> Result<()> {
        match self {
            Self::Daemon { client, name } => {
                client.take_lease(name, force)?;
            }
            Self::Direct(direct) => direct.keep_alive()?,
        }
        Ok(())
    }

    /// Releases the lease.
    pub(super) fn release_lease(&mut self) -> Result<()> {
        match self {
            Self::Daemon { client, name } => Ok(client.release_lease(name)?),
            Self::Direct(_) => Ok(()),
        }
    }
}

/// Returns a function that opens a device by its name or address without a daemon, each time it is called.
///
/// # Errors
/// If a daemon uses it: a link has one host.
#[cfg(feature = "log")]
pub fn direct_opener(
    config: Option<&Path>,
    device: &str,
) -> Result<impl FnMut() -> Result<Box<dyn Transport>, LinkError> + use<>> {
    let config = configured::config(config)?;
    let (mut config, address) = configured_or_address(config, device)?;
    let place = address_of(&config, &address)?;
    if let Some(client) = configured::daemon(&config)? {
        let devices = client.devices()?;
        let at = place.to_string();
        let theirs = devices.iter().find(|d| d.name == device || d.address == at);
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
    // The opener has marked simulated hobs.
    let place = address_of(&config, &address)?;
    Ok(move || open(&place).map(|opened| opened.transport))
}

/// Returns `true` if another client commands the device.
pub(super) fn is_leased_elsewhere(error: &anyhow::Error) -> bool {
    matches!(
        error.downcast_ref(),
        Some(ClientError::Command(CommandError::Leased { .. }))
    )
}

fn is_configured(config: &DaemonConfig, name: &str) -> bool {
    config.devices.iter().any(|device| device.name == name)
}

fn configured_or_address(config: DaemonConfig, device: &str) -> Result<(DaemonConfig, String)> {
    if is_configured(&config, device) {
        return Ok((config, device.to_owned()));
    }
    match DeviceSpec::from_str(device) {
        Ok(DeviceSpec::Sim) => bail!(Usage(
            "a simulated hob lives in the daemon or in `ihd hob`: name one of the configuration, \
             or tcp:HOST:PORT"
                .into()
        )),
        Ok(_) => Ok((config, device.to_owned())),
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
