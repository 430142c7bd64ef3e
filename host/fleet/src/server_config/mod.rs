//! Configuration of a NATS server for sites of a fleet: rights, TLS, limits, MQTT.
//!
//! A site's data are in one account, with its operator. Every edge and every worker has a small account of its own beside
//! it, without JetStream, which imports the subjects that it may use (`rights`). Only the passwords of MQTT are secret.

mod keys;
mod rights;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::PathBuf;
use std::str::FromStr;

use ihd_daemon::config::is_name;

pub(crate) use keys::refuse_if_open_to_others;
pub use keys::{KeyError, UserKey, read_or_make};
pub use rights::Rights;

/// Largest message of a key's account in bytes; windows are far smaller.
const MAX_PAYLOAD_BYTES: u32 = 1 << 20;

/// Connections of one key: the present one, and former ones whose end the server has not yet detected.
const CONNECTIONS_A_KEY: u32 = 8;

/// Error of a configuration.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ServerConfigError {
    /// Name that would change a subject.
    #[error("{what} {name:?}: a name has 1 to 64 of a-z, 0-9, - and _")]
    Name {
        /// Kind of the named object.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// Two objects of one name.
    #[error("{what} {name:?} is there twice: one name, one {what}")]
    Twice {
        /// Kind of the named object.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// Edge without hobs, or of another form.
    #[error("{0:?}: an edge is written NAME=HOB,HOB with at least one hob")]
    Edge(String),
    /// Missing key.
    #[error("no key called {0:?}")]
    NoKey(String),
    /// Path that a configuration cannot represent.
    #[error("{0:?}: a path in the server's configuration is text without control characters")]
    Path(PathBuf),
}

/// Addresses, folder and certificate of the server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServerSettings {
    /// Its name, which MQTT needs.
    pub name: String,
    /// Address for clients of NATS, as `0.0.0.0:4222`.
    pub listen: String,
    /// Address for clients of MQTT, as `0.0.0.0:8883`; `None` without MQTT.
    pub mqtt_listen: Option<String>,
    /// Folder of JetStream.
    pub store: PathBuf,
    /// Certificate and key; `None` for an unencrypted connection, on which only the proof of the keys is safe.
    pub tls: Option<TlsFiles>,
}

/// PEM files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// The certificate chain.
    pub certificate: PathBuf,
    /// Its private key.
    pub key: PathBuf,
}

/// Site (a lab, a plant, a customer), whose data no other site can read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Site {
    /// Its name.
    pub name: String,
    /// Its daemons.
    pub edges: Vec<EdgeAccount>,
    /// Names of its workers.
    pub workers: Vec<String>,
    /// Disk space in bytes.
    pub disk_bytes: u64,
    /// Memory in bytes.
    pub memory_bytes: u64,
}

impl Site {
    /// Creates a site with workers `worker-1` to `worker-N`, 12 GB of disk and 256 MB of memory: `ihd-fleet init` reserves 8.5 GB
    /// by default.
    pub fn new(name: impl Into<String>, edges: Vec<EdgeAccount>, workers: u32) -> Self {
        Self {
            name: name.into(),
            edges,
            workers: (1..=workers).map(|k| format!("worker-{k}")).collect(),
            disk_bytes: 12_000_000_000,
            memory_bytes: 256 << 20,
        }
    }

    /// Returns the names of the keys that [`server_config`] requires: `SITE-operator`, `SITE-edge-NAME`, `SITE-worker-NAME`, and
    /// with MQTT `SITE-mqtt` (reads) and `SITE-home-assistant` (also publishes its start).
    pub fn key_names(&self, mqtt: bool) -> Vec<String> {
        let mut roles = vec!["operator".to_owned()];
        roles.extend(self.edges.iter().map(|edge| format!("edge-{}", edge.name)));
        roles.extend(self.workers.iter().map(|name| format!("worker-{name}")));
        if mqtt {
            roles.extend(["mqtt", "home-assistant"].map(str::to_owned));
        }
        let of_site = |role: String| format!("{}-{role}", self.name);
        roles.into_iter().map(of_site).collect()
    }
}

/// A daemon and its hobs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EdgeAccount {
    /// Its name.
    pub name: String,
    /// Names of its hobs.
    pub hobs: Vec<String>,
    /// `true` if it may read the cards of the whole fleet and the length of the queue, for the dashboard's page.
    pub sees_fleet: bool,
}

/// Parses `lab-1=hob-a,hob-b`.
impl FromStr for EdgeAccount {
    type Err = ServerConfigError;

    fn from_str(text: &str) -> Result<Self, ServerConfigError> {
        let (name, hobs) = text
            .split_once('=')
            .filter(|(_, hobs)| !hobs.is_empty())
            .ok_or_else(|| ServerConfigError::Edge(text.to_owned()))?;
        let edge = Self {
            name: name.to_owned(),
            hobs: hobs.split(',').map(str::to_owned).collect(),
            sees_fleet: false,
        };
        check("edge", &edge.name)?;
        edge.hobs.iter().try_for_each(|hob| check("hob", hob))?;
        Ok(edge)
    }
}

/// Returns the configuration of a server with the users of `sites`. `keys` are by the names of [`Site::key_names`].
///
/// # Errors
/// [`ServerConfigError`] for an invalid or repeated name, an edge without hobs, a missing key.
pub fn server_config(
    server: &ServerSettings,
    sites: &[Site],
    keys: &BTreeMap<String, UserKey>,
) -> Result<String, ServerConfigError> {
    unique("site", sites.iter().map(|site| &site.name))?;
    let mut text = head(server, sites)?;
    text += "\naccounts {\n";
    for site in sites {
        check_site(site)?;
        text += &site_account(site, server.mqtt_listen.is_some(), keys)?;
        for edge in &site.edges {
            let name = format!("edge-{}", edge.name);
            text += &key_account(site, &name, &rights::edge(edge), keys)?;
        }
        for worker in &site.workers {
            let name = format!("worker-{worker}");
            text += &key_account(site, &name, &rights::worker(worker), keys)?;
        }
    }
    text += "}\n";
    Ok(text)
}

/// Returns the server's own settings: addresses, TLS, JetStream with the space of all `sites`, MQTT.
fn head(server: &ServerSettings, sites: &[Site]) -> Result<String, ServerConfigError> {
    check("server", &server.name)?;
    let tls = match &server.tls {
        Some(TlsFiles { certificate, key }) => {
            let (certificate, key) = (path(certificate)?, path(key)?);
            format!("tls {{ cert_file: {certificate}, key_file: {key}, min_version: \"1.2\" }}")
        }
        None => String::new(),
    };
    let mut text = String::from(
        "# Made by `ihd-fleet init server-config`, which also changes it; docs/fleet.md says what it means.\n\
         # Passwords of MQTT are in it: for the server alone (chmod 600).\n",
    );
    let _ = writeln!(text, "server_name: {}", server.name);
    let _ = writeln!(text, "listen: {:?}", server.listen);
    let _ = writeln!(text, "max_payload: {MAX_PAYLOAD_BYTES}");
    if !tls.is_empty() {
        let _ = writeln!(text, "{tls}");
    }
    // On the disk before the acknowledgement: after it the edge does not send the window again. Without `max_file_store` the
    // limit is three quarters of the space that is free at its start: once it holds more than that, it takes no message
    // after a restart.
    let store = path(&server.store)?;
    let disk_bytes: u64 = sites.iter().map(|site| site.disk_bytes).sum();
    let memory_bytes: u64 = sites.iter().map(|site| site.memory_bytes).sum();
    let _ = writeln!(
        text,
        "jetstream {{\n  store_dir: {store}\n  sync_interval: always\n  max_file_store: {disk_bytes}\n  \
         max_memory_store: {memory_bytes}\n}}"
    );
    if let Some(listen) = &server.mqtt_listen {
        let _ = writeln!(text, "mqtt {{\n  listen: {listen:?}\n  {tls}\n}}");
    }
    Ok(text)
}

/// Returns the account of the site's data, with its operator and its users of MQTT.
fn site_account(
    site: &Site,
    mqtt: bool,
    keys: &BTreeMap<String, UserKey>,
) -> Result<String, ServerConfigError> {
    let Site {
        name,
        disk_bytes,
        memory_bytes,
        ..
    } = site;
    let operator = key(keys, &format!("{name}-operator"))?.public();
    let mut text = format!(
        "  {} {{\n    jetstream: {{ max_file: {disk_bytes}, max_memory: {memory_bytes} }}\n    users: [\n      \
         {{ nkey: {operator} }}\n",
        account(site, None)
    );
    if mqtt {
        // In MQTT `homeassistant/#` is `homeassistant`, too.
        let reads = format!(
            "{:?}, \"homeassistant\", \"homeassistant.>\"",
            crate::names::state("*").as_str()
        );
        for (role, publish) in [
            ("mqtt", "{ deny: \">\" }".to_owned()),
            (
                "home-assistant",
                format!("{{ allow: {:?} }}", rights::HOME_ASSISTANT_STATUS),
            ),
        ] {
            let user = format!("{name}-{role}");
            let password = key(keys, &user)?.seed();
            let _ = writeln!(
                text,
                "      {{ user: {user:?}, password: {password:?}, allowed_connection_types: [MQTT],\n        permissions: \
                 {{ publish: {publish}, subscribe: {{ allow: [{reads}] }} }} }}"
            );
        }
    }
    text += "    ]\n    exports: [\n";
    let (services, streams) = rights::offered();
    for subject in services {
        let _ = writeln!(text, "      {{ service: {subject:?} }}");
    }
    let many = rights::offered_with_many_answers();
    let _ = writeln!(text, "      {{ service: {many:?}, response_type: stream }}");
    for subject in streams {
        let _ = writeln!(text, "      {{ stream: {subject:?} }}");
    }
    text += "    ]\n  }\n";
    Ok(text)
}

/// Returns the account of one key: no JetStream, only the imports of `rights`.
fn key_account(
    site: &Site,
    role: &str,
    rights: &Rights,
    keys: &BTreeMap<String, UserKey>,
) -> Result<String, ServerConfigError> {
    let user = key(keys, &format!("{}-{role}", site.name))?.public();
    let (own, from) = (account(site, Some(role)), account(site, None));
    let mut text = format!(
        "  {own} {{\n    users: [ {{ nkey: {user} }} ]\n    limits: {{ max_connections: {CONNECTIONS_A_KEY} }}\n    \
         imports: [\n"
    );
    for (kind, subjects) in [("service", &rights.services), ("stream", &rights.streams)] {
        for subject in subjects {
            let _ = writeln!(
                text,
                "      {{ {kind}: {{ account: {from}, subject: {subject:?} }} }}"
            );
        }
    }
    text += "    ]\n  }\n";
    Ok(text)
}

/// Returns the name of an account; names have no dots, so it is unique.
fn account(site: &Site, role: Option<&str>) -> String {
    match role {
        Some(role) => format!("\"{}.{role}\"", site.name),
        None => format!("\"{}\"", site.name),
    }
}

fn key<'a>(
    keys: &'a BTreeMap<String, UserKey>,
    name: &str,
) -> Result<&'a UserKey, ServerConfigError> {
    let missing = || ServerConfigError::NoKey(name.to_owned());
    keys.get(name).ok_or_else(missing)
}

/// Quotes a path for the server's configuration, with single quotes because backslashes of a Windows path are no escapes.
fn path(path: &std::path::Path) -> Result<String, ServerConfigError> {
    let refused = || ServerConfigError::Path(path.into());
    let text = path.to_str().ok_or_else(refused)?;
    if text.is_empty() || text.contains(|c: char| c.is_control() || c == '\'') {
        return Err(refused());
    }
    Ok(format!("'{text}'"))
}

/// Checks that the names of a site are valid tokens of subjects and unique.
///
/// # Errors
/// [`ServerConfigError`] of the first wrong name.
pub fn check_site(site: &Site) -> Result<(), ServerConfigError> {
    check("site", &site.name)?;
    for edge in &site.edges {
        check("edge", &edge.name)?;
        if edge.hobs.is_empty() {
            return Err(ServerConfigError::Edge(edge.name.clone()));
        }
        edge.hobs.iter().try_for_each(|hob| check("hob", hob))?;
    }
    site.workers.iter().try_for_each(|w| check("worker", w))?;
    unique("edge", site.edges.iter().map(|edge| &edge.name))?;
    unique("worker", &site.workers)?;
    // Two edges with one hob would receive each other's results.
    unique("hob", site.edges.iter().flat_map(|edge| &edge.hobs))
}

/// Checks a name, a token of subjects: a dot or a star in it would change a right.
fn check(what: &'static str, name: &str) -> Result<(), ServerConfigError> {
    match is_name(name) {
        true => Ok(()),
        false => Err(ServerConfigError::Name {
            what,
            name: name.to_owned(),
        }),
    }
}

fn unique<'a>(
    what: &'static str,
    names: impl IntoIterator<Item = &'a String>,
) -> Result<(), ServerConfigError> {
    let mut seen = BTreeSet::new();
    match names.into_iter().find(|name| !seen.insert(*name)) {
        Some(name) => Err(ServerConfigError::Twice {
            what,
            name: name.clone(),
        }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
