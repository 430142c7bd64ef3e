//! Section `[fleet]` of the configuration.

use std::path::PathBuf;

use serde::Deserialize;

use super::{MAX_NAME, is_name, is_name_letter};

/// Server of the fleet, and name and credentials of this edge (docs/fleet.md).
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FleetConfig {
    /// Address of the server: `nats://HOST:PORT` or `tls://HOST:PORT`; several are separated by commas.
    pub url: String,
    /// Name of the edge in the fleet; `None` for the host's name.
    pub edge: Option<String>,
    /// File with the seed of an NKey.
    pub nkey_file: Option<PathBuf>,
    /// File with a token.
    pub token_file: Option<PathBuf>,
    /// PEM file of the certificate authority; `None` for those of the system.
    pub ca: Option<PathBuf>,
    /// `true` to copy finished recordings to the fleet's object store.
    #[serde(default)]
    pub captures: bool,
}

impl FleetConfig {
    /// Checks the values.
    ///
    /// # Errors
    /// Key, value and reason of an invalid one.
    pub fn check(&self) -> Result<(), String> {
        let schemes = ["nats://", "tls://"];
        for url in self.url.split(',') {
            if !schemes.iter().any(|scheme| url.trim().starts_with(scheme)) {
                return Err(format!(
                    "fleet.url = {:?}: an address begins with nats:// or tls://",
                    self.url
                ));
            }
        }
        if self.nkey_file.is_some() && self.token_file.is_some() {
            return Err("fleet.nkey_file and fleet.token_file: one of them, not both".to_owned());
        }
        self.edge.as_deref().map_or(Ok(()), check_name)
    }

    /// Returns the configured name of the edge, or else [`host_name`].
    pub fn edge_name(&self) -> String {
        self.edge.clone().unwrap_or_else(host_name)
    }
}

fn check_name(name: &str) -> Result<(), String> {
    match is_name(name) {
        true => Ok(()),
        false => Err(format!(
            "fleet.edge = {name:?}: a name has 1 to {MAX_NAME} of a-z, 0-9, - and _"
        )),
    }
}

/// Returns the host's name with characters replaced that a subject does not allow; `edge` if it is empty.
pub fn host_name() -> String {
    let name = ["/proc/sys/kernel/hostname", "/etc/hostname"]
        .iter()
        .find_map(|path| std::fs::read_to_string(path).ok())
        .or_else(|| std::env::var("COMPUTERNAME").ok())
        .unwrap_or_default();
    let name = name.trim().to_lowercase();
    let name: String = name
        .chars()
        .map(|c| if is_name_letter(c) { c } else { '-' })
        .take(MAX_NAME)
        .collect();
    match name.is_empty() {
        true => "edge".to_owned(),
        false => name,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(text: &str) -> FleetConfig {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn what_cannot_work_is_named() {
        assert_eq!(
            config("url = \"nats://h:4222, tls://i:4222\"").check(),
            Ok(())
        );
        for (text, word) in [
            ("url = \"http://h\"", "nats://"),
            ("url = \"nats://h\"\nedge = \"a.b\"", "fleet.edge"),
            ("url = \"nats://h\"\nedge = \"\"", "fleet.edge"),
            (
                "url = \"tls://h\"\nnkey_file = \"a\"\ntoken_file = \"b\"",
                "not both",
            ),
        ] {
            let why = config(text).check().unwrap_err();
            assert!(why.contains(word), "{why}");
        }
        assert!(toml::from_str::<FleetConfig>("url = \"nats://h\"\ntoken = \"x\"").is_err());
    }

    #[test]
    fn without_a_name_an_edge_has_one_that_may_stand_in_a_subject() {
        let name = config("url = \"nats://h\"").edge_name();
        assert!(check_name(&name).is_ok(), "{name:?}");
    }
}
