//! Choice of the device to examine, and connection to it.

use anyhow::Result;
use ihd_link::{Client, DeviceSpec, Transport};
use ihd_sim::hob::SimHob;
use ihd_sim::transport::SharedHob;

use crate::cli::simulated::SimulatedHobArgs;
use crate::cli::usage::Usage;

/// Device to examine.
pub(super) enum DeviceChoice {
    /// By address.
    Spec(DeviceSpec),
    /// By name in a configuration.
    #[cfg(feature = "daemon")]
    Configured {
        open: std::sync::Arc<ihd_daemon::OpenDevice>,
        address: Box<ihd_daemon::config::Address>,
    },
}

/// Returns the device with an address, or with a name of the configuration.
#[cfg(feature = "daemon")]
pub(super) fn of_name(name: &str, config: Option<&std::path::Path>) -> Result<DeviceChoice> {
    let of_spec = name.parse::<DeviceSpec>();
    if let (Ok(spec), None) = (&of_spec, config) {
        return Ok(DeviceChoice::Spec(spec.clone()));
    }
    let mut config = crate::cli::configured::config(config)?;
    // Checks the options of the simulated hobs, and marks their devices.
    let open = crate::cli::opener::opener(&mut config)?;
    let named = config.devices.iter().find(|device| device.name == name);
    match (named, of_spec) {
        (Some(device), _) => Ok(DeviceChoice::Configured {
            open,
            address: Box::new(device.address.clone()),
        }),
        (None, Ok(spec)) => Ok(DeviceChoice::Spec(spec)),
        (None, Err(error)) => Err(Usage(format!("{error}, or a name of the configuration")).into()),
    }
}

/// Returns the device with an address.
#[cfg(not(feature = "daemon"))]
pub(super) fn of_name(name: &str) -> Result<DeviceChoice> {
    Ok(DeviceChoice::Spec(name.parse().map_err(Usage::from_error)?))
}

impl DeviceChoice {
    /// Connects.
    pub(super) fn connect(self, simulated: &SimulatedHobArgs) -> Result<Client> {
        match self {
            Self::Spec(spec) => {
                let config = simulated.config()?;
                let sim =
                    || -> Box<dyn Transport> { Box::new(SharedHob::new(SimHob::new(&config))) };
                Ok(Client::connect(spec.open(sim)?)?)
            }
            #[cfg(feature = "daemon")]
            Self::Configured { open, address } => Ok(Client::connect(open(&address)?.transport)?),
        }
    }
}
