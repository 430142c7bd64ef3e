//! Address of a device named on the command line.

use std::str::FromStr;

use anyhow::{Context, Result};
use ihd_daemon::config::{Address, DaemonConfig};
use ihd_link::DeviceSpec;

/// Returns the address of a configured device, or parses `device` as an address.
pub(super) fn address_of(config: &DaemonConfig, device: &str) -> Result<Address> {
    if let Some(configured) = config.devices.iter().find(|d| d.name == device) {
        return Ok(configured.address.clone());
    }
    let spec = DeviceSpec::from_str(device).context("no device")?;
    Ok(spec.into())
}
