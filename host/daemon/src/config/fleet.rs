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
                    "fleet.url = {:?}: an address begins with nats:// or tls://, and `,` of a password is %2C",
                    without_secrets(&self.url)
                ));
            }
        }
        if self.ca.is_some() && !is_encrypted(&self.url) {
            return Err(format!(
                "fleet.url = {:?} with fleet.ca: only tls:// is encrypted; write tls://, or no ca",
                without_secrets(&self.url)
            ));
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

/// Returns `true` if each of the addresses, with commas between, demands encryption.
pub fn is_encrypted(url: &str) -> bool {
    url.split(',').all(|url| url.trim().starts_with("tls://"))
}

/// Returns addresses, with commas between, without user, password and token. A wrong address has secrets, too: before an `@` only a
/// scheme is shown, and a comma ends an address only before the next scheme.
pub fn without_secrets(urls: &str) -> String {
    let mut addresses: Vec<String> = Vec::new();
    for part in urls.split(',') {
        match addresses.last_mut() {
            Some(before) if !part.contains("://") => *before += &format!(",{part}"),
            _ => addresses.push(part.to_owned()),
        }
    }
    let shown = |url: &String| match (url.split_once("://"), url.rsplit_once('@')) {
        (Some((scheme, _)), Some((_, host))) => format!("{}://{host}", scheme.trim()),
        (None, Some((_, host))) => host.to_owned(),
        (_, None) => url.trim().to_owned(),
    };
    addresses.iter().map(shown).collect::<Vec<_>>().join(",")
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
            ("url = \"nats://h\"\nca = \"ca.pem\"", "tls://"),
            ("url = \"tls://h,nats://i\"\nca = \"ca.pem\"", "tls://"),
        ] {
            let why = config(text).check().unwrap_err();
            assert!(why.contains(word), "{why}");
        }
        assert!(toml::from_str::<FleetConfig>("url = \"nats://h\"\ntoken = \"x\"").is_err());
    }

    #[test]
    fn no_message_shows_a_secret() {
        for (url, shown) in [
            ("nats://me:se,cret@h", "nats://h"),
            ("user:geheim@h:4x", "h:4x"),
            (
                "nats://u:geheim@a, tls://to,k@en@b:1,c",
                "nats://a,tls://b:1,c",
            ),
            ("nats://h:4222,i", "nats://h:4222,i"),
        ] {
            assert_eq!(without_secrets(url), shown);
        }
        for text in [
            "[fleet]\nurl = \"http://u:geheim@a\"",
            "[fleet]\nurl = \"nats://u:geheim@a",
            "[fleet]\nurl = [\"nats://u:geheim@a\"]",
            "[fleet]\nurl = \"nats://u:gehe,im@a\"",
        ] {
            let error = crate::DaemonConfig::parse(text, "ihd.toml").unwrap_err();
            let error = error.to_string();
            let is_shown = ["geheim", "gehe", "im@"]
                .iter()
                .any(|secret| error.contains(secret));
            assert!(!is_shown, "{error}");
        }
    }

    #[test]
    fn without_a_name_an_edge_has_one_that_may_stand_in_a_subject() {
        let name = config("url = \"nats://h\"").edge_name();
        assert!(check_name(&name).is_ok(), "{name:?}");
    }
}
