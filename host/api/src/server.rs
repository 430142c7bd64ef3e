//! Server: address, access, accepting connections, shutdown.

use std::io;
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::Router;
use ihd_daemon::Daemon;
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;

use crate::access::guard::Access;
use crate::access::hosts::AllowedHosts;
use crate::access::served_tokens::ServedTokens;
use crate::access::sessions::Sessions;
use crate::access::tokens::TokenError;
use crate::connection;
use crate::routes::health::HealthCache;
use crate::routes::{self, App, Counts, MAX_SUBSCRIBERS};
use crate::served::ServedTls;
use crate::slots::ConnectionSlots;
pub use crate::slots::MAX_CONNECTIONS;
use crate::tls::{Certificate, TlsError};

/// Pause after `accept` has failed, for example without a free file descriptor.
const ACCEPT_RETRY: Duration = Duration::from_millis(200);

/// Longest time until a renewed certificate is read; each connection reads it, too.
const RENEWAL_PERIOD: Duration = Duration::from_secs(3_600);

/// Configuration of a server.
#[derive(Clone, Debug)]
pub struct ServerOptions {
    /// Address to listen on, `HOST:PORT`; the system chooses the port if it is 0.
    pub listen: String,
    /// Host names accepted besides those of loopback and the address itself.
    pub allowed_hosts: Vec<String>,
    /// Token file, created if it is missing; `None`: no tokens.
    pub token_file: Option<PathBuf>,
    /// Certificate for TLS; `None`: plain HTTP.
    pub tls: Option<Certificate>,
    /// Folder for backups.
    pub backups: PathBuf,
}

/// Error of [`ApiServer::bind`].
#[derive(Debug, Error)]
pub enum ApiServerError {
    /// `listen` is not an address.
    #[error("listen = {listen:?} is no address: {source}; write HOST:PORT, as 127.0.0.1:8731")]
    Address {
        /// Configured address.
        listen: String,
        /// Error of the system.
        source: io::Error,
    },
    /// The address can be reached from other machines, and tokens or TLS are missing.
    #[error(
        "listen = {listen:?} can be reached from other machines, which needs tokens and TLS: \
         set token_file = \"PATH\" and [tls] (with certificate and key, or empty for a generated one), \
         or listen = \"127.0.0.1:8731\""
    )]
    Reachable {
        /// Configured address.
        listen: String,
    },
    /// The server listens on all addresses without `allowed_hosts`.
    #[error(
        "listen = {listen:?} is every address of this machine, so that its host name is unknown: set allowed_hosts = [\"NAME or ADDRESS\", …]"
    )]
    Nameless {
        /// Configured address.
        listen: String,
    },
    /// Another process uses the port.
    #[error(
        "another process has {listen}: is a daemon running already (`ihd device status` asks it)? \
         End it, or set another `listen`"
    )]
    InUse {
        /// Configured address.
        listen: String,
    },
    /// The system does not allow listening on the address.
    #[error("cannot listen on {listen}: {source}")]
    Bind {
        /// Configured address.
        listen: String,
        /// Error of the system.
        source: io::Error,
    },
    /// The token file cannot be used.
    #[error(transparent)]
    Token(#[from] TokenError),
    /// The certificate cannot be used.
    #[error("TLS: {0}")]
    Tls(#[from] TlsError),
}

/// Server that listens, but does not accept connections before [`ApiServer::run`].
pub struct ApiServer {
    listener: TcpListener,
    address: SocketAddr,
    tls: Option<ServedTls>,
    access: Access,
    backups: PathBuf,
    created_tokens: Option<PathBuf>,
}

impl ApiServer {
    /// Binds the port; reads tokens and certificate, or creates them.
    ///
    /// # Errors
    /// [`ApiServerError`], also for an address that other machines can reach without tokens and TLS.
    pub async fn bind(options: &ServerOptions) -> Result<Self, ApiServerError> {
        let listen = options.listen.clone();
        let requested = resolve(&listen)?;
        let loopback = requested.ip().is_loopback();
        if !loopback && (options.token_file.is_none() || options.tls.is_none()) {
            return Err(ApiServerError::Reachable { listen });
        }
        if requested.ip().is_unspecified() && options.allowed_hosts.is_empty() {
            return Err(ApiServerError::Nameless { listen });
        }
        let listener = TcpListener::bind(requested).await.map_err(|source| {
            let listen = listen.clone();
            match source.kind() {
                io::ErrorKind::AddrInUse => ApiServerError::InUse { listen },
                _ => ApiServerError::Bind { listen, source },
            }
        })?;
        let address = listener
            .local_addr()
            .map_err(|source| ApiServerError::Bind {
                listen: listen.clone(),
                source,
            })?;
        let mut created_tokens = None;
        let tokens = match &options.token_file {
            None => None,
            Some(path) => {
                let (tokens, made) = ServedTokens::load(path)?;
                created_tokens = made.then(|| path.clone());
                Some(tokens)
            }
        };
        Ok(Self {
            listener,
            address,
            tls: load_tls(options, requested)?,
            access: Access {
                hosts: AllowedHosts::new(requested.ip(), &options.allowed_hosts),
                tokens,
                sessions: Sessions::default(),
            },
            backups: options.backups.clone(),
            created_tokens,
        })
    }

    /// Returns the address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns its URL.
    pub fn url(&self) -> String {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        format!("{scheme}://{}", self.address)
    }

    /// Returns SHA-256 fingerprint and file of its certificate; `None` without TLS.
    pub fn certificate(&self) -> Option<(String, PathBuf)> {
        self.tls.as_ref().map(ServedTls::identity)
    }

    /// Returns the token file if [`ApiServer::bind`] has created it.
    pub fn created_tokens(&self) -> Option<&Path> {
        self.created_tokens.as_deref()
    }

    /// Serves a daemon until `stopping` is `true`; requests in progress then have one second to end.
    pub async fn run(self, daemon: Daemon, mut stopping: watch::Receiver<bool>) {
        let app = Arc::new(App {
            daemon,
            health: HealthCache::default(),
            access: Arc::new(self.access),
            tls: self.tls,
            backups: self.backups,
            stopping: stopping.clone(),
            subscribers: Arc::new(Semaphore::new(MAX_SUBSCRIBERS)),
            counts: Counts::default(),
            slots: ConnectionSlots::default(),
        });
        let router = routes::router(app.clone());
        let mut connections = JoinSet::new();
        let mut renewal = tokio::time::interval(RENEWAL_PERIOD);
        loop {
            let accepted = tokio::select! {
                accepted = self.listener.accept() => accepted,
                _ = stopping.wait_for(|stopping| *stopping) => break,
                _ = renewal.tick() => {
                    app.tls.as_ref().map(ServedTls::acceptor);
                    continue;
                }
            };
            while connections.try_join_next().is_some() {}
            let stream = match accepted {
                Ok((stream, _)) => stream,
                Err(error) => {
                    tracing::warn!(%error, "cannot accept a connection");
                    tokio::time::sleep(ACCEPT_RETRY).await;
                    continue;
                }
            };
            app.counts.connections.fetch_add(1, Ordering::Relaxed);
            let slot = app.slots.assign();
            let tls = app.tls.as_ref().map(ServedTls::acceptor);
            let (router, stopping): (Router, _) = (router.clone(), stopping.clone());
            connections.spawn(connection::serve(stream, slot, tls, router, stopping));
            // The connection's first byte is read before another one can evict it.
            tokio::task::yield_now().await;
        }
        drop(self.listener);
        while connections.join_next().await.is_some() {}
    }
}

fn resolve(listen: &str) -> Result<SocketAddr, ApiServerError> {
    let cannot = |source| ApiServerError::Address {
        listen: listen.into(),
        source,
    };
    let mut addresses = listen.to_socket_addrs().map_err(cannot)?;
    addresses
        .next()
        .ok_or_else(|| cannot(io::Error::other("the name has no address")))
}

fn load_tls(
    options: &ServerOptions,
    address: SocketAddr,
) -> Result<Option<ServedTls>, ApiServerError> {
    let Some(certificate) = &options.tls else {
        return Ok(None);
    };
    let mut names = options.allowed_hosts.clone();
    if !address.ip().is_unspecified() {
        names.push(address.ip().to_string());
    }
    Ok(Some(ServedTls::load(certificate.clone(), names)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(listen: &str) -> ServerOptions {
        ServerOptions {
            listen: listen.into(),
            allowed_hosts: Vec::new(),
            token_file: None,
            tls: None,
            backups: "backups".into(),
        }
    }

    async fn refused(options: &ServerOptions) -> String {
        ApiServer::bind(options).await.err().unwrap().to_string()
    }

    #[tokio::test]
    async fn what_others_can_reach_needs_tokens_and_tls() {
        let dir = tempfile::tempdir().unwrap();
        for listen in ["0.0.0.0:0", "[::]:0", "192.0.2.1:0"] {
            for (token, tls) in [(false, false), (true, false), (false, true)] {
                let mut options = options(listen);
                let file = dir.path().join("tokens");
                options.token_file = token.then(|| file.clone());
                options.tls = tls.then(|| Certificate::Generated {
                    folder: dir.path().into(),
                });
                let error = refused(&options).await;
                assert!(error.contains("token_file"), "{listen}: {error}");
                assert!(!file.exists(), "nothing is made for a refused address");
            }
        }
    }

    #[tokio::test]
    async fn every_address_needs_names() {
        let dir = tempfile::tempdir().unwrap();
        let mut options = options("0.0.0.0:0");
        options.token_file = Some(dir.path().join("tokens"));
        options.tls = Some(Certificate::Generated {
            folder: dir.path().into(),
        });
        let error = refused(&options).await;
        assert!(error.contains("allowed_hosts"), "{error}");
        options.allowed_hosts = vec!["hob.lan".into()];
        let server = ApiServer::bind(&options).await.unwrap();
        assert!(server.url().starts_with("https://"));
        assert!(server.created_tokens().is_some());
        assert!(server.certificate().is_some());
    }

    #[tokio::test]
    async fn a_port_in_use_and_no_address_say_what_to_do() {
        let first = ApiServer::bind(&options("127.0.0.1:0")).await.unwrap();
        let error = refused(&options(&first.address().to_string())).await;
        assert!(error.contains("running already"), "{error}");
        let error = refused(&options("8731")).await;
        assert!(error.contains("HOST:PORT"), "{error}");
    }
}
