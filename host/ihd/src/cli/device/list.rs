//! `ihd device status` without a device: all of them.

use std::time::Duration;

use anyhow::Result;
use ihd_api::ApiClient;
use ihd_daemon::config::DaemonConfig;
use ihd_link::usb;
use ihd_model::DeviceReport;
use serde::Serialize;

use super::text::one_line;
use crate::cli::{configured, output};

/// Time limit of the daemon's health check; it reports a hanging store after five seconds.
pub const HEALTH_WITHIN: Duration = Duration::from_secs(10);

#[derive(Serialize)]
struct ListedDevice {
    name: String,
    address: String,
    /// State in the daemon; `None` without one.
    state: Option<&'static str>,
    detail: String,
}

impl From<&DeviceReport> for ListedDevice {
    fn from(report: &DeviceReport) -> Self {
        Self {
            name: report.name.clone(),
            address: report.address.clone(),
            state: Some(report.state.as_str()),
            detail: report.detail.clone(),
        }
    }
}

/// Prints the daemon's devices, else the known ones.
pub(super) fn print(config: &DaemonConfig, json: bool) -> Result<()> {
    let daemon = configured::daemon(config)?;
    let listed: Vec<ListedDevice> = match &daemon {
        Some(client) => client.devices()?.iter().map(ListedDevice::from).collect(),
        None => without_daemon(config),
    };
    if json {
        return output::json(&listed);
    }
    match &daemon {
        Some(client) => {
            say!("daemon at {}", client.url())?;
            if let Some(failure) = store_failure(client)? {
                say!("its store {failure}")?;
            }
        }
        None => say!("no daemon at {}; without one there are:", config.listen)?,
    }
    if listed.is_empty() {
        return say!("no device: plug a board in, or name one in the configuration");
    }
    for device in &listed {
        let (name, address) = (one_line(&device.name), one_line(&device.address));
        let state = device.state.unwrap_or("-");
        say!(
            "{name:<16} {address:<28} {state:<15} {}",
            one_line(&device.detail)
        )?;
    }
    Ok(())
}

/// Text of the failure of the daemon's store; `None` while it takes everything.
pub(super) fn store_failure(client: &ApiClient) -> Result<Option<String>> {
    let failure = client.health(HEALTH_WITHIN)?.store_failure;
    Ok(failure.map(|failure| {
        let lost = failure.dropped.text();
        let (text, advice) = (failure.text, failure.advice);
        format!("does not take everything: {text}; lost so far: {lost}. {advice}")
    }))
}

/// Devices of the configuration, and boards on USB that it does not name.
fn without_daemon(config: &DaemonConfig) -> Vec<ListedDevice> {
    let mut listed: Vec<ListedDevice> = config
        .devices
        .iter()
        .map(|device| ListedDevice {
            name: device.name.clone(),
            address: device.address.to_string(),
            state: None,
            detail: "of the configuration".into(),
        })
        .collect();
    match usb::boards() {
        Ok(boards) => {
            for board in boards {
                let address = format!("usb:{}", board.serial);
                if let Some(known) = listed.iter_mut().find(|l| l.address == address) {
                    known.detail = format!("plugged in: {}", board.product);
                    continue;
                }
                listed.push(ListedDevice {
                    name: address.clone(),
                    address,
                    state: None,
                    detail: format!("plugged in: {}", board.product),
                });
            }
        }
        // A machine without USB has no boards on it.
        Err(error) => output::complain(format_args!("ihd: {error}")),
    }
    listed
}
