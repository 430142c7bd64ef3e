//! Configuration file `ihd.toml`. Unknown keys and invalid values are errors.

pub(crate) mod fleet;

use std::collections::BTreeSet;
use std::fs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use ihd_link::DeviceSpec;
use ihd_store::Retention;
use ihd_train::NetworkConfig;
use serde::{Deserialize, Deserializer};

use self::fleet::FleetConfig;

/// Default folder of the store.
pub const DEFAULT_STORE: &str = "ihd-store";

/// Longest name of a device, an edge or a worker, in characters.
pub const LONGEST_NAME: usize = 64;

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
    #[error("the configuration {path}: {source}")]
    Parse {
        /// Path of the file.
        path: String,
        /// Error with its position.
        source: Box<toml::de::Error>,
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
        let config: Self = toml::from_str(text).map_err(|source| ConfigError::Parse {
            path: path.to_owned(),
            source: Box::new(source),
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
    (1..=LONGEST_NAME).contains(&name.len()) && name.chars().all(is_name_letter)
}

/// Returns `true` if a name may contain the character.
pub(crate) fn is_name_letter(c: char) -> bool {
    matches!(c, 'a'..='z' | '0'..='9' | '-' | '_')
}

fn check_name(name: &str) -> Result<(), String> {
    if !is_name(name) {
        return Err(format!(
            "name = {name:?}: a name has 1 to {LONGEST_NAME} of a-z, 0-9, - and _"
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const ISSUE: &str = r#"
        store = "ihd-store"
        listen = "127.0.0.1:8731"
        [[device]]
        name = "bench"
        address = "tcp:127.0.0.1:4711"
    "#;

    fn refused(text: &str) -> String {
        DaemonConfig::parse(text, "ihd.toml")
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn the_example_of_the_issue_is_read() {
        let config = DaemonConfig::parse(ISSUE, "ihd.toml").unwrap();
        assert_eq!(config.store, Path::new("ihd-store"));
        assert_eq!(config.listen.to_string(), "127.0.0.1:8731");
        assert_eq!(config.devices.len(), 1);
        assert_eq!(config.devices[0].name, "bench");
        assert_eq!(config.devices[0].address.to_string(), "tcp:127.0.0.1:4711");
        assert!(!config.discovers_usb());
    }

    #[test]
    fn nothing_at_all_is_a_configuration_that_looks_for_boards() {
        let config = DaemonConfig::parse("", "ihd.toml").unwrap();
        assert!(config.discovers_usb());
        assert_eq!(config.keep.max_bytes, 2_000_000_000);
    }

    #[test]
    fn every_key_is_read() {
        let config = DaemonConfig::parse(
            r#"
            store = "/var/lib/ihd"
            listen = "[::1]:9000"
            allowed_hosts = ["hob.lan"]
            token_file = "tokens"
            discover_usb = true
            tls = { certificate = "c.pem", key = "k.pem" }
            keep = { windows = "one-in-10", max_age_days = 30, max_bytes = 5000000 }
            learning = { threads = 2, queue = 8 }
            network = { preset = "hybrid", seed = 7 }
            [[device]]
            name = "a"
            address = "usb:1234"
            [[device]]
            name = "b"
            address = "sim"
            sim = { pot = "aluminium", warming = true }
            "#,
            "ihd.toml",
        )
        .unwrap();
        assert_eq!(
            config.store_settings().keep,
            ihd_store::SamplePolicy::OneIn(10)
        );
        assert_eq!(config.learning.threads, 2);
        assert_eq!(config.network().unwrap().seed, 7);
        assert!(config.discovers_usb());
        assert_eq!(config.devices[1].address.sim.len(), 2);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let device = |name: &str, address: &str| {
            format!("[[device]]\nname = \"{name}\"\naddress = \"{address}\"\n")
        };
        let twice = device("a", "sim") + &device("a", "usb");
        let place = device("a", "tcp:h:1") + &device("b", "tcp:h:1");
        for (text, words) in [
            ("stor = \"x\"", &["stor", "store"][..]),
            ("[keep]\nwindow = 1", &["window"]),
            (
                "[keep]\nwindows = \"some\"",
                &["windows", "some", "telling"],
            ),
            ("[keep]\nwindows = \"one-in-0\"", &["one-in-0"]),
            ("[keep]\nmax_bytes = 1", &["keep.max_bytes = 1"]),
            ("[learning]\nthreads = 0", &["learning.threads = 0"]),
            ("[network]\nsead = 1", &["[network]", "sead"]),
            ("listen = \"here\"", &["listen"]),
            ("[tls]\nkey = \"k\"", &["tls.certificate"]),
            (&device("A", "sim"), &["\"A\"", "a-z"]),
            (&device("", "sim"), &["name = \"\""]),
            (&device("a", "bus:1"), &["bus:1", "tcp:HOST:PORT"]),
            (&twice, &["\"a\" stands twice"]),
            (&place, &["tcp:h:1", "twice"]),
            (
                "[[device]]\nname = \"a\"\naddress = \"usb\"\nsim = {}",
                &["sim", "usb"],
            ),
            ("[[device]]\nname = \"a\"", &["address"]),
        ] {
            let why = refused(text);
            for word in words {
                assert!(why.contains(word), "{text}: {why}");
            }
            assert!(why.contains("ihd.toml"), "{why}");
        }
    }
}
