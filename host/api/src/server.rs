//! The server: where it listens, whom it lets in, how it ends.

use std::io;
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::Router;
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;
use tokio_rustls::TlsAcceptor;

use crate::access::guard::Access;
use crate::access::hosts::AllowedHosts;
use crate::access::sessions::Sessions;
use crate::access::tokens::{TokenError, Tokens};
use crate::backend::Backend;
use crate::connection;
pub use crate::places::MAX_CONNECTIONS;
use crate::places::Places;
use crate::routes::{self, App, Counts, MAX_WATCHERS};
use crate::tls::{Certificate, ServerTls, TlsError};

/// Rest after the system refused to accept (no more descriptors).
const AFTER_REFUSAL: Duration = Duration::from_millis(200);

/// How the server is set up.
#[derive(Clone, Debug)]
pub struct Settings {
    /// `HOST:PORT`; port 0 lets the system choose.
    pub listen: String,
    /// Names beside loopback's and the address itself by which it may be called.
    pub allowed_hosts: Vec<String>,
    /// The token file; made where it is not there.
    pub token_file: Option<PathBuf>,
    /// TLS, where it is spoken.
    pub tls: Option<Certificate>,
    /// Folder for backups.
    pub backups: PathBuf,
}

/// Why there is no server.
#[derive(Debug, Error)]
pub enum ServerError {
    /// The address is none.
    #[error("listen = {listen:?} is no address: {source}; write HOST:PORT, as 127.0.0.1:8731")]
    Address {
        /// As configured.
        listen: String,
        /// Why.
        source: io::Error,
    },
    /// The address can be reached from elsewhere.
    #[error(
        "listen = {listen:?} can be reached from other machines, which needs tokens and TLS: \
         set token_file = \"PATH\" and [tls] (with certificate and key, or empty for a generated one), \
         or listen = \"127.0.0.1:8731\""
    )]
    Reachable {
        /// As configured.
        listen: String,
    },
    /// Nobody could call it.
    #[error(
        "listen = {listen:?} is every address of this machine, so that nobody knows by which name \
         it may be called: set allowed_hosts = [\"NAME or ADDRESS\", …]"
    )]
    Nameless {
        /// As configured.
        listen: String,
    },
    /// Somebody else has the port.
    #[error(
        "another process has {listen}: is a daemon running already (`ihd device list` asks it)? \
         End it, or set another `listen`"
    )]
    InUse {
        /// As configured.
        listen: String,
    },
    /// The address cannot be listened on.
    #[error("cannot listen on {listen}: {source}")]
    Bind {
        /// As configured.
        listen: String,
        /// Why.
        source: io::Error,
    },
    /// The token file.
    #[error(transparent)]
    Token(#[from] TokenError),
    /// The certificate.
    #[error("TLS: {0}")]
    Tls(#[from] TlsError),
}

/// A server that listens, and does not serve yet.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    tls: Option<ServerTls>,
    access: Access,
    backups: PathBuf,
    made_tokens: Option<PathBuf>,
}

impl Server {
    /// Takes the port, reads or makes tokens and certificate.
    ///
    /// # Errors
    /// [`ServerError`]: an address that others can reach without tokens and TLS among them.
    pub async fn bind(settings: &Settings) -> Result<Self, ServerError> {
        let listen = settings.listen.clone();
        let wanted = resolve(&listen)?;
        let loopback = wanted.ip().is_loopback();
        if !loopback && (settings.token_file.is_none() || settings.tls.is_none()) {
            return Err(ServerError::Reachable { listen });
        }
        if wanted.ip().is_unspecified() && settings.allowed_hosts.is_empty() {
            return Err(ServerError::Nameless { listen });
        }
        let listener = TcpListener::bind(wanted).await.map_err(|source| {
            let listen = listen.clone();
            match source.kind() {
                io::ErrorKind::AddrInUse => ServerError::InUse { listen },
                _ => ServerError::Bind { listen, source },
            }
        })?;
        let address = listener.local_addr().map_err(|source| ServerError::Bind {
            listen: listen.clone(),
            source,
        })?;
        let mut made_tokens = None;
        let tokens = match &settings.token_file {
            None => None,
            Some(path) => {
                let (tokens, made) = Tokens::read_or_make(path)?;
                made_tokens = made.then(|| path.clone());
                Some(tokens)
            }
        };
        Ok(Self {
            listener,
            address,
            tls: load_tls(settings, wanted)?,
            access: Access {
                hosts: AllowedHosts::new(wanted.ip(), &settings.allowed_hosts),
                tokens,
                sessions: Sessions::default(),
            },
            backups: settings.backups.clone(),
            made_tokens,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Its address as a client writes it.
    pub fn url(&self) -> String {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        format!("{scheme}://{}", self.address)
    }

    /// SHA-256 and file of its certificate, where it speaks TLS.
    pub fn certificate(&self) -> Option<(&str, &Path)> {
        let tls = self.tls.as_ref()?;
        Some((&tls.fingerprint, &tls.certificate))
    }

    /// The token file, where it was made just now.
    pub fn made_tokens(&self) -> Option<&Path> {
        self.made_tokens.as_deref()
    }

    /// Serves until `stopping` is true, then gives requests under way a second.
    pub async fn run(self, backend: Arc<dyn Backend>, mut stopping: watch::Receiver<bool>) {
        let app = Arc::new(App {
            backend,
            access: self.access,
            tls: self.tls.is_some(),
            backups: self.backups,
            stopping: stopping.clone(),
            watchers: Arc::new(Semaphore::new(MAX_WATCHERS)),
            counts: Counts::default(),
            places: Places::default(),
        });
        let router = routes::router(app.clone());
        let tls = self.tls.map(|tls| TlsAcceptor::from(tls.config));
        let mut connections = JoinSet::new();
        loop {
            let accepted = tokio::select! {
                accepted = self.listener.accept() => accepted,
                _ = stopping.wait_for(|stopping| *stopping) => break,
            };
            while connections.try_join_next().is_some() {}
            let stream = match accepted {
                Ok((stream, _)) => stream,
                Err(error) => {
                    tracing::warn!(%error, "cannot accept a connection");
                    tokio::time::sleep(AFTER_REFUSAL).await;
                    continue;
                }
            };
            app.counts.connections.fetch_add(1, Ordering::Relaxed);
            let place = app.places.take();
            let (router, tls, stopping): (Router, _, _) =
                (router.clone(), tls.clone(), stopping.clone());
            connections.spawn(connection::serve(stream, place, tls, router, stopping));
            // It shows what it has brought before others push it out.
            tokio::task::yield_now().await;
        }
        drop(self.listener);
        while connections.join_next().await.is_some() {}
    }
}

fn resolve(listen: &str) -> Result<SocketAddr, ServerError> {
    let cannot = |source| ServerError::Address {
        listen: listen.into(),
        source,
    };
    let mut found = listen.to_socket_addrs().map_err(cannot)?;
    found
        .next()
        .ok_or_else(|| cannot(io::Error::other("the name has no address")))
}

fn load_tls(settings: &Settings, address: SocketAddr) -> Result<Option<ServerTls>, ServerError> {
    let Some(certificate) = &settings.tls else {
        return Ok(None);
    };
    let mut names = settings.allowed_hosts.clone();
    if !address.ip().is_unspecified() {
        names.push(address.ip().to_string());
    }
    Ok(Some(certificate.load(&names)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(listen: &str) -> Settings {
        Settings {
            listen: listen.into(),
            allowed_hosts: Vec::new(),
            token_file: None,
            tls: None,
            backups: "backups".into(),
        }
    }

    async fn refused(settings: &Settings) -> String {
        Server::bind(settings).await.err().unwrap().to_string()
    }

    #[tokio::test]
    async fn what_others_can_reach_needs_tokens_and_tls() {
        let dir = tempfile::tempdir().unwrap();
        for listen in ["0.0.0.0:0", "[::]:0", "192.0.2.1:0"] {
            for (token, tls) in [(false, false), (true, false), (false, true)] {
                let mut settings = settings(listen);
                let file = dir.path().join("tokens");
                settings.token_file = token.then(|| file.clone());
                settings.tls = tls.then(|| Certificate::Made {
                    folder: dir.path().into(),
                });
                let error = refused(&settings).await;
                assert!(error.contains("token_file"), "{listen}: {error}");
                assert!(!file.exists(), "nothing is made for a refused address");
            }
        }
    }

    #[tokio::test]
    async fn every_address_needs_names() {
        let dir = tempfile::tempdir().unwrap();
        let mut settings = settings("0.0.0.0:0");
        settings.token_file = Some(dir.path().join("tokens"));
        settings.tls = Some(Certificate::Made {
            folder: dir.path().into(),
        });
        let error = refused(&settings).await;
        assert!(error.contains("allowed_hosts"), "{error}");
        settings.allowed_hosts = vec!["hob.lan".into()];
        let server = Server::bind(&settings).await.unwrap();
        assert!(server.url().starts_with("https://"));
        assert!(server.made_tokens().is_some());
        assert!(server.certificate().is_some());
    }

    #[tokio::test]
    async fn a_port_in_use_and_no_address_say_what_to_do() {
        let first = Server::bind(&settings("127.0.0.1:0")).await.unwrap();
        let error = refused(&settings(&first.address().to_string())).await;
        assert!(error.contains("running already"), "{error}");
        let error = refused(&settings("8731")).await;
        assert!(error.contains("HOST:PORT"), "{error}");
    }
}
