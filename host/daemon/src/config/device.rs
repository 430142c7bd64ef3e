//! Table `[[device]]` of the configuration.

use std::str::FromStr;

use ihd_link::DeviceSpec;
use serde::{Deserialize, Deserializer};

/// Configuration of a device.
#[derive(Clone, Debug, Deserialize)]
#[serde(try_from = "RawDevice")]
pub struct DeviceConfig {
    /// Name of the device.
    pub name: String,
    /// Address of the device.
    pub address: Address,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDevice {
    name: String,
    #[serde(deserialize_with = "spec")]
    address: DeviceSpec,
    sim: Option<toml::Table>,
}

fn spec<'de, D: Deserializer<'de>>(d: D) -> Result<DeviceSpec, D::Error> {
    let text = String::deserialize(d)?;
    DeviceSpec::from_str(&text).map_err(serde::de::Error::custom)
}

impl TryFrom<RawDevice> for DeviceConfig {
    type Error = String;

    fn try_from(raw: RawDevice) -> Result<Self, String> {
        let RawDevice { name, address, sim } = raw;
        if sim.is_some() && address != DeviceSpec::Sim {
            return Err(format!(
                "device {name:?}: the table `sim` belongs to address = \"sim\", not to \"{address}\""
            ));
        }
        let sim = sim.unwrap_or_default();
        Ok(Self {
            name,
            address: Address { spec: address, sim },
        })
    }
}

/// Address of a device.
#[derive(Clone, Debug, PartialEq)]
pub struct Address {
    /// Kind of link, and host, port or serial number.
    pub spec: DeviceSpec,
    /// Options of the simulator; empty except for `sim`.
    pub sim: toml::Table,
}

impl From<DeviceSpec> for Address {
    fn from(spec: DeviceSpec) -> Self {
        Self {
            spec,
            sim: toml::Table::new(),
        }
    }
}

impl std::fmt::Display for Address {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.spec.fmt(f)
    }
}
