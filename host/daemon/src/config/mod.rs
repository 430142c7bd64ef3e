//! Configuration file `ihd.toml`. Unknown keys and invalid values are errors.

mod device;
pub(crate) mod fleet;

use std::collections::BTreeSet;
use std::fs;
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};

use ihd_link::DeviceSpec;
use ihd_store::Retention;
use ihd_train::NetworkConfig;
use serde::Deserialize;

pub use self::device::{Address, DeviceConfig};
use self::fleet::FleetConfig;

/// Default folder of the store.
pub const DEFAULT_STORE: &str = "ihd-store";

/// Longest name of a device, an edge or a worker, in characters.
pub const MAX_NAME: usize = 64;

/// Configuration of the daemon. Paths are relative to the working folder.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DaemonConfig {
    /// Folder of the store.
    #[serde(default = "default_store")]
    pub store: PathBuf,
    /// Address of API and dashboard.
    #[serde(default = "default_listen")]
    pub listen: SocketAddr,
    /// Host names, besides those of the loopback, that a browser may use for the API.
    #[serde(default)]
    pub allowed_hosts: Vec<String>,
    /// File with one token per role; required to listen beyond the loopback.
    pub token_file: Option<PathBuf>,
    /// Certificate and key; required to listen beyond the loopback.
    pub tls: Option<TlsConfig>,
    /// Retention of windows.
    #[serde(default)]
    pub keep: RetentionConfig,
    /// Configuration of training.
    #[serde(default)]
    pub learning: LearningConfig,
    /// Settings of the network, as for `ihd trainer --network`; defaults if `None`.
    pub network: Option<toml::Table>,
    /// Discovery of boards on USB; if `None`, only when no device is listed.
    pub discover_usb: Option<bool>,
    /// Fleet that the daemon is an edge of; `None` without one.
    pub fleet: Option<FleetConfig>,
    /// Configured devices.
    #[serde(default, rename = "device")]
    pub devices: Vec<DeviceConfig>,
}

fn default_store() -> PathBuf {
    DEFAULT_STORE.into()
}

/// Address of API and dashboard where the file has none.
fn default_listen() -> SocketAddr {
    SocketAddr::from(([127, 0, 0, 1], 8731))
}

/// Certificate and key of the API.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TlsConfig {
    /// PEM file of the certificate chain; if `None`, a certificate is generated and stored in the store.
    pub certificate: Option<PathBuf>,
    /// PEM file of the private key; `None` exactly if `certificate` is.
    pub key: Option<PathBuf>,
}

/// Retention of windows.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RetentionConfig {
    /// Windows stored with their samples: `all`, `one-in-N`, or `telling` (refused, or with an effect on the lookup).
    pub windows: ihd_store::SamplePolicy,
    /// Days of use after which windows are deleted; if `None`, never.
    pub max_age_days: Option<u32>,
    /// Size of all windows in bytes beyond which older ones are thinned, at least 1 000 000.
    pub max_bytes: u64,
}

impl Default for RetentionConfig {
    fn default() -> Self {
        Self {
            windows: ihd_store::SamplePolicy::All,
            max_age_days: None,
            max_bytes: Retention::default().max_bytes,
        }
    }
}

/// Configuration of training.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LearningConfig {
    /// Number of training threads, 1 to 64.
    pub threads: usize,
    /// Windows that may wait for training, 1 to 1024; a window takes 70 kB.
    pub queue: usize,
}

impl Default for LearningConfig {
    fn default() -> Self {
        Self {
            threads: 1,
            queue: 64,
        }
    }
}

/// Error in the configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {path}: {source}")]
    Read {
        /// Path of the file.
        path: String,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The file is no TOML, has an unknown key, or a value of the wrong type.
    #[error("the configuration {path}: {why}")]
    Parse {
        /// Path of the file.
        path: String,
        /// Error with its position, without secrets.
        why: String,
    },
    /// Invalid value.
    #[error("the configuration {path}: {why}")]
    Value {
        /// Path of the file.
        path: String,
        /// Key, value and remedy.
        why: String,
    },
}

/// Returns the text of an error without the lines of the file that it quotes, if these may have the secret of an address.
fn without_secret_lines(error: &toml::de::Error) -> String {
    let text = error.to_string();
    if !text.contains('@') {
        return text;
    }
    let lines = text.lines().filter(|line| !line.contains('|'));
    lines.collect::<Vec<_>>().join(": ")
}

impl Default for DaemonConfig {
    fn default() -> Self {
        Self {
            store: default_store(),
            listen: default_listen(),
            allowed_hosts: Vec::new(),
            token_file: None,
            tls: None,
            keep: RetentionConfig::default(),
            learning: LearningConfig::default(),
            network: None,
            discover_usb: None,
            fleet: None,
            devices: Vec::new(),
        }
    }
}

impl DaemonConfig {
    /// Reads the configuration from a file.
    ///
    /// # Errors
    /// [`ConfigError`] naming the file, the key and the value.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let name = path.display().to_string();
        match fs::read_to_string(path) {
            Ok(text) => Self::parse(&text, &name),
            Err(source) => Err(ConfigError::Read { path: name, source }),
        }
    }

    /// Parses the configuration from text; `path` is its name in errors.
    ///
    /// # Errors
    /// As [`DaemonConfig::read`].
    pub fn parse(text: &str, path: &str) -> Result<Self, ConfigError> {
        let config: Self = toml::from_str(text).map_err(|error| ConfigError::Parse {
            path: path.to_owned(),
            why: without_secret_lines(&error),
        })?;
        config.check().map_err(|why| ConfigError::Value {
            path: path.to_owned(),
            why,
        })?;
        Ok(config)
    }

    /// Returns `true` if boards on USB are discovered.
    pub fn discovers_usb(&self) -> bool {
        self.discover_usb.unwrap_or(self.devices.is_empty())
    }

    fn check(&self) -> Result<(), String> {
        let mut names = BTreeSet::new();
        let mut places = BTreeSet::new();
        for device in &self.devices {
            check_name(&device.name)?;
            if !names.insert(&device.name) {
                return Err(format!("name = {:?} stands twice", device.name));
            }
            let place = device.address.to_string();
            if device.address.spec != DeviceSpec::Sim && !places.insert(place.clone()) {
                return Err(format!(
                    "address = {place:?} stands twice: a device has one host"
                ));
            }
        }
        self.check_values()
    }

    fn check_values(&self) -> Result<(), String> {
        self.network()?;
        self.fleet.as_ref().map_or(Ok(()), FleetConfig::check)?;
        if self.store.as_os_str().is_empty() {
            return Err("store = \"\" names no folder".to_owned());
        }
        let is_host = |name: &str| name.parse::<IpAddr>().is_ok() || !name.contains([':', '/']);
        if let Some(name) = self.allowed_hosts.iter().find(|name| !is_host(name)) {
            return Err(format!(
                "allowed_hosts = [{name:?}]: a name or an address stands there, without https://, port and brackets"
            ));
        }
        if !(1..=64).contains(&self.learning.threads) {
            return Err(format!(
                "learning.threads = {} is not 1 to 64",
                self.learning.threads
            ));
        }
        if !(1..=1024).contains(&self.learning.queue) {
            return Err(format!(
                "learning.queue = {} is not 1 to 1024",
                self.learning.queue
            ));
        }
        if self.keep.max_bytes < 1_000_000 {
            return Err(format!(
                "keep.max_bytes = {} is less than 1000000, some twenty windows",
                self.keep.max_bytes
            ));
        }
        if self.keep.max_age_days == Some(0) {
            return Err("keep.max_age_days = 0 keeps nothing; leave it out for ever".to_owned());
        }
        match &self.tls {
            Some(tls) if tls.certificate.is_some() != tls.key.is_some() => Err(
                "tls.certificate and tls.key belong together; without both a certificate is made"
                    .to_owned(),
            ),
            _ => Ok(()),
        }
    }

    /// Returns the settings of the network.
    ///
    /// # Errors
    /// Key and value of the invalid entry in `[network]`.
    pub fn network(&self) -> Result<NetworkConfig, String> {
        let Some(table) = &self.network else {
            return Ok(NetworkConfig::default());
        };
        let wrong = |why: String| format!("[network]: {why}");
        let text = toml::to_string(table).map_err(|error| wrong(error.to_string()))?;
        let network = NetworkConfig::from_toml(&text).map_err(|error| wrong(error.to_string()))?;
        network
            .validate()
            .map_err(|error| wrong(error.to_string()))?;
        Ok(network)
    }

    /// Returns the options of the store.
    pub fn store_settings(&self) -> ihd_store::StoreOptions {
        ihd_store::StoreOptions {
            retention: Retention {
                max_age_days: self.keep.max_age_days,
                max_bytes: self.keep.max_bytes,
            },
            keep: self.keep.windows,
        }
    }
}

/// Returns `true` if the name is valid in files, URLs, log lines, subjects and keys.
pub fn is_name(name: &str) -> bool {
    (1..=MAX_NAME).contains(&name.len()) && name.chars().all(is_name_letter)
}

/// Returns `true` if a name may contain the character.
pub(crate) fn is_name_letter(c: char) -> bool {
    matches!(c, 'a'..='z' | '0'..='9' | '-' | '_')
}

fn check_name(name: &str) -> Result<(), String> {
    if !is_name(name) {
        return Err(format!(
            "name = {name:?}: a name has 1 to {MAX_NAME} of a-z, 0-9, - and _"
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
