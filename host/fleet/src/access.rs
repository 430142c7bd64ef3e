//! Connection to the server: addresses, credentials, version check.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::Duration;

use async_nats::jetstream::{self, Context};
use async_nats::{Client, ConnectOptions, Event, ServerAddr};
use ihd_daemon::fleet::{FleetConfig, is_encrypted, without_secrets};

use crate::server_config::{KeyError, UserKey, refuse_if_open_to_others};

/// Time-out of a connection and of a request.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(5);

/// Oldest supported server: it has several filters of a consumer, and streams that refuse a second message of a subject.
const MIN_SERVER_VERSION: (u64, u64, u64) = (2, 10, 23);

/// Period of pings on an idle connection; three without an answer end it.
const PING_EVERY: Duration = Duration::from_secs(5);

/// Most published messages without acknowledgement.
const MAX_UNACKNOWLEDGED: usize = 256;

/// Address and credentials.
#[derive(Clone, Debug, Default)]
pub struct Access {
    /// Addresses of one server or of a cluster's, with commas between.
    pub url: String,
    /// File with an NKey's seed.
    pub nkey_file: Option<PathBuf>,
    /// File with a token.
    pub token_file: Option<PathBuf>,
    /// PEM file of the authority that signed the server's certificate; `None` for those of the system.
    pub ca: Option<PathBuf>,
}

impl From<&FleetConfig> for Access {
    fn from(config: &FleetConfig) -> Self {
        Self {
            url: config.url.clone(),
            nkey_file: config.nkey_file.clone(),
            token_file: config.token_file.clone(),
            ca: config.ca.clone(),
        }
    }
}

/// Error of a connection.
#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    /// Invalid address.
    #[error(
        "{url:?} is no address of a NATS server: nats://HOST:PORT or tls://HOST:PORT; `,` and `@` of a password are %2C and %40"
    )]
    Address {
        /// The given address, without secrets.
        url: String,
    },
    /// Authority of a certificate, and an address without encryption.
    #[error("{url}: only tls:// is encrypted, and {} names whose certificate the server has; write tls://", ca.display())]
    Unencrypted {
        /// The given address, without secrets.
        url: String,
        /// The authority's file.
        ca: PathBuf,
    },
    /// Unreadable file of credentials.
    #[error("cannot read {}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// Unusable key.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// No answer, or a refusal.
    #[error("{url} cannot be reached: {source}")]
    Connect {
        /// The address, without secrets.
        url: String,
        /// Error of the client.
        source: async_nats::ConnectError,
    },
    /// Server that is too old.
    #[error(
        "{url} is nats-server {version}: ihd needs 2.10.23 or later, 2.12 is recommended (docs/fleet.md)"
    )]
    Old {
        /// The address, without secrets.
        url: String,
        /// Version that the server reports.
        version: String,
    },
}

impl AccessError {
    /// Returns `true` if nobody listens at the address.
    pub fn is_refused_connection(&self) -> bool {
        let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(self);
        while let Some(error) = cause {
            let error_kind = error.downcast_ref::<std::io::Error>().map(|e| e.kind());
            if error_kind == Some(std::io::ErrorKind::ConnectionRefused) {
                return true;
            }
            cause = error.source();
        }
        false
    }
}

/// Callback for events of the connection.
pub type OnEvent = dyn Fn(Event) + Send + Sync;

impl Access {
    /// Returns the addresses without user, password and token.
    pub fn shown(&self) -> String {
        without_secrets(&self.url)
    }

    fn addresses(&self) -> Result<Vec<ServerAddr>, AccessError> {
        let parse = |url: &str| {
            url.trim()
                .parse()
                .map_err(|_| AccessError::Address { url: self.shown() })
        };
        self.url.split(',').map(parse).collect()
    }

    fn options(&self, name: &str) -> Result<ConnectOptions, AccessError> {
        if let Some(ca) = &self.ca
            && !is_encrypted(&self.url)
        {
            return Err(AccessError::Unencrypted {
                url: self.shown(),
                ca: ca.clone(),
            });
        }
        let mut options = ConnectOptions::new()
            .name(name)
            .connection_timeout(TIMEOUT)
            .request_timeout(Some(TIMEOUT))
            .ping_interval(PING_EVERY)
            .custom_inbox_prefix(format!("_INBOX_{name}"))
            .require_tls(self.url.contains("tls://"));
        if let Some(path) = &self.nkey_file {
            options = options.nkey(UserKey::read(path)?.seed().to_owned());
        }
        if let Some(path) = &self.token_file {
            options = options.token(read_secret(path)?.trim().to_owned());
        }
        if let Some(path) = &self.ca {
            // Read here: the client would only report that the connection failed.
            read(path)?;
            options = options.add_root_certificates(path.clone());
        }
        Ok(options)
    }

    /// Connects once; `name` names the connection and the inbox of its answers.
    ///
    /// # Errors
    /// [`AccessError`].
    pub async fn connect(&self, name: &str) -> Result<Context, AccessError> {
        let client = self.options(name)?.connect(self.addresses()?);
        let client = client.await.map_err(|source| AccessError::Connect {
            url: self.shown(),
            source,
        })?;
        self.check(&client)?;
        Ok(context(client))
    }

    /// Connects as soon as the server answers, and again whenever the connection ends; `on_event` receives each event.
    ///
    /// # Errors
    /// [`AccessError`] if a file or an address is unusable.
    pub async fn keep_connected(
        &self,
        name: &str,
        on_event: Box<OnEvent>,
    ) -> Result<Context, AccessError> {
        let on_event = std::sync::Arc::new(on_event);
        let options = self.options(name)?.retry_on_initial_connect();
        let options = options.event_callback(move |event| {
            let on_event = std::sync::Arc::clone(&on_event);
            async move { on_event(event) }
        });
        let client = options.connect(self.addresses()?).await;
        let client = client.map_err(|source| AccessError::Connect {
            url: self.shown(),
            source,
        })?;
        Ok(context(client))
    }

    /// Checks that the server is new enough.
    ///
    /// # Errors
    /// [`AccessError::Old`].
    pub fn check(&self, client: &Client) -> Result<(), AccessError> {
        let version = client.server_info().version;
        match is_at_least(&version, MIN_SERVER_VERSION) {
            true => Ok(()),
            false => Err(AccessError::Old {
                url: self.shown(),
                version,
            }),
        }
    }
}

fn context(client: Client) -> Context {
    jetstream::ContextBuilder::new()
        .timeout(TIMEOUT)
        .ack_timeout(TIMEOUT)
        .max_ack_inflight(MAX_UNACKNOWLEDGED)
        .build(client)
}

fn is_at_least(version: &str, oldest: (u64, u64, u64)) -> bool {
    let number = |part: &str| {
        let digits: String = part.chars().take_while(char::is_ascii_digit).collect();
        digits.parse().unwrap_or(0)
    };
    let mut parts = version.split('.').map(number);
    let mut next = || parts.next().unwrap_or(0);
    (next(), next(), next()) >= oldest
}

/// Reads a file that its owner alone may read.
fn read_secret(path: &Path) -> Result<String, AccessError> {
    let failed = |source| AccessError::File {
        path: path.to_owned(),
        source,
    };
    let mut file = File::open(path).map_err(failed)?;
    refuse_if_open_to_others(&file, path)?;
    let mut text = String::new();
    file.read_to_string(&mut text).map_err(failed)?;
    Ok(text)
}

fn read(path: &Path) -> Result<String, AccessError> {
    std::fs::read_to_string(path).map_err(|source| AccessError::File {
        path: path.to_owned(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_in_an_address_are_not_shown() {
        let access = |url: &str| Access {
            url: url.into(),
            ..Access::default()
        };
        let shown = access("nats://me:pass@h:4222, tls://token@i:4222").shown();
        assert_eq!(shown, "nats://h:4222,tls://i:4222");
        assert_eq!(access("nats://h").shown(), "nats://h");
        for url in ["nats://me:se,cret@h", "user:geheim@h:4x"] {
            let error = access(url).addresses().unwrap_err().to_string();
            assert!(
                !error.contains("cret") && !error.contains("geheim"),
                "{error}"
            );
        }
    }

    #[tokio::test]
    async fn an_authority_needs_encryption_and_a_token_its_owner() {
        let folder = tempfile::tempdir().unwrap();
        let token = folder.path().join("token");
        std::fs::write(&token, "geheim").unwrap();
        let access = Access {
            url: "nats://127.0.0.1:9".into(),
            ca: Some("ca.pem".into()),
            ..Access::default()
        };
        let why = access.connect("me").await.unwrap_err();
        assert!(!why.is_refused_connection());
        let why = why.to_string();
        assert!(why.contains("tls://") && why.contains("ca.pem"), "{why}");
        // A port that was free a moment ago.
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("nats://{}", port.local_addr().unwrap());
        drop(port);
        let nobody = Access {
            url,
            ..Access::default()
        };
        let why = nobody.connect("me").await.unwrap_err();
        assert!(why.is_refused_connection(), "{why}");
        #[cfg(unix)]
        {
            let open = std::os::unix::fs::PermissionsExt::from_mode(0o666);
            std::fs::set_permissions(&token, open).unwrap();
            let access = Access {
                url: "nats://127.0.0.1:9".into(),
                token_file: Some(token),
                ..Access::default()
            };
            let why = access.connect("me").await.unwrap_err().to_string();
            assert!(why.contains("mode 666") && !why.contains("geheim"), "{why}");
        }
    }

    #[test]
    fn versions_are_compared_by_their_numbers() {
        for (version, enough) in [
            ("2.9.10", false),
            ("2.10.22", false),
            ("2.10.23", true),
            ("2.10.23-RC.1", true),
            ("2.15.1", true),
            ("3.0", true),
            ("", false),
        ] {
            assert_eq!(
                is_at_least(version, MIN_SERVER_VERSION),
                enough,
                "{version}"
            );
        }
    }
}
