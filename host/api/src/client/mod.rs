//! The client, blocking: what `ihd device` asks a daemon with.

pub mod events;
mod history;

use std::io::Read;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use ihd_daemon::model::{
    Command, CommandError, DeviceReport, Done, FleetReport, Lease, RecordingFile,
};
use rustls::crypto::ring;
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;
use ureq::http::Response;
use ureq::tls::{Certificate, RootCerts, TlsConfig, parse_pem};
use ureq::{Agent, Body};

use crate::model::{
    BackupMade, BackupRequest, HOLDER_HEADER, Health, LeaseRequest, Problem, StoredLookup,
    StoredResult,
};
use crate::percent;
use events::Events;

/// Longest that an answer may take; the daemon gives up earlier.
const TIMEOUT: Duration = Duration::from_secs(25);

/// Longest that a backup may take.
const BACKUP_TIMEOUT: Duration = Duration::from_secs(610);

/// Silence after which events are taken for cut off: three heartbeats.
const SILENCE: Duration = Duration::from_secs(45);

/// Largest answer, in bytes.
const MAX_ANSWER: u64 = 64 << 20;

/// Why a daemon did not do what was asked.
#[derive(Debug, Error)]
pub enum ClientError {
    /// It said why.
    #[error("{0}")]
    Command(CommandError),
    /// The server in front of it refused.
    #[error("the daemon at {url} refused: {}", problem.message)]
    Refused {
        /// The daemon.
        url: String,
        /// HTTP status.
        status: u16,
        /// What it said.
        problem: Problem,
    },
    /// Nobody answers.
    #[error("no answer from the daemon at {url}: {why}")]
    Unreachable {
        /// Its address.
        url: String,
        /// Why.
        why: String,
    },
    /// What answers speaks otherwise.
    #[error("{url} does not answer as a daemon of this version: {why}")]
    Strange {
        /// Its address.
        url: String,
        /// Why.
        why: String,
    },
    /// The certificate file cannot be used.
    #[error("certificate {path}: {why}")]
    Certificate {
        /// The file.
        path: String,
        /// Why.
        why: String,
    },
}

/// A daemon.
#[derive(Clone)]
pub struct ApiClient {
    agent: Agent,
    url: String,
    holder: String,
    token: Option<String>,
}

impl ApiClient {
    /// A client for the daemon at `url` (`http://127.0.0.1:8731`), which asks as `holder`. `ca` is the certificate that is trusted
    /// with `https`: the daemon's own, or its issuer's.
    ///
    /// # Errors
    /// [`ClientError::Certificate`] when `ca` cannot be read. Nothing is sent yet.
    pub fn new(
        url: &str,
        holder: &str,
        token: Option<String>,
        ca: Option<&Path>,
    ) -> Result<Self, ClientError> {
        // Nobody but `ca` is trusted: no authority of the web vouches for a hob.
        let roots = ca.map_or(Ok(Vec::new()), read_roots)?;
        let tls = TlsConfig::builder()
            .unversioned_rustls_crypto_provider(Arc::new(ring::default_provider()))
            .root_certs(RootCerts::Specific(Arc::new(roots)));
        let agent = Agent::config_builder()
            .tls_config(tls.build())
            // Nobody between: a proxy of the environment must not see the token.
            .proxy(None)
            .max_redirects(0)
            .http_status_as_error(false)
            .timeout_connect(Some(Duration::from_secs(5)))
            .timeout_global(Some(TIMEOUT))
            .build()
            .new_agent();
        Ok(Self {
            agent,
            url: url.trim_end_matches('/').to_owned(),
            holder: printable_ascii(holder),
            token,
        })
    }

    /// Where the daemon is.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Who asks.
    pub fn holder(&self) -> &str {
        &self.holder
    }

    /// Whether a daemon answers within `within`.
    ///
    /// # Errors
    /// [`ClientError::Unreachable`] when nobody does, [`ClientError::Strange`] when somebody else has the port.
    pub fn health(&self, within: Duration) -> Result<Health, ClientError> {
        let request = self
            .agent
            .get(format!("{}/healthz", self.url))
            .config()
            .timeout_global(Some(within))
            .build();
        let response = request.call().map_err(|e| self.unreachable(&e))?;
        // A daemon whose store is dead says so with a status of its own: it is a daemon.
        let text = read_text(response).map_err(|why| self.strange(&why))?;
        let health: Health =
            serde_json::from_str(&text).map_err(|e| self.strange(&e.to_string()))?;
        if health.service != "ihd" {
            return Err(self.strange("its health is another service's"));
        }
        Ok(health)
    }

    /// Every device.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn devices(&self) -> Result<Vec<DeviceReport>, ClientError> {
        self.get("/devices")
    }

    /// One device.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn device(&self, name: &str) -> Result<DeviceReport, ClientError> {
        self.get(&device(name, ""))
    }

    /// The fleet, as the daemon knew it last.
    ///
    /// # Errors
    /// [`ClientError`]; [`ClientError::Refused`] with status 404 where the daemon is no edge of one.
    pub fn fleet(&self) -> Result<FleetReport, ClientError> {
        self.get("/fleet")
    }

    /// Lookups of a device, newest first.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn lookups(&self, name: &str) -> Result<Vec<StoredLookup>, ClientError> {
        self.get(&device(name, "/lookups"))
    }

    /// Results of a device, newest first.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn results(
        &self,
        name: &str,
        limit: u32,
        since_ms: Option<i64>,
    ) -> Result<Vec<StoredResult>, ClientError> {
        let since = since_ms.map_or(String::new(), |ms| format!("&since={ms}"));
        self.get(&device(name, &format!("/results?limit={limit}{since}")))
    }

    /// Recordings, newest first.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn recordings(&self) -> Result<Vec<RecordingFile>, ClientError> {
        self.get("/recordings")
    }

    /// Writes a recording, as it is on disk, to `to`, however long that takes; its length in bytes.
    ///
    /// # Errors
    /// [`ClientError`]; what was written until then is in `to`.
    pub fn download_recording(
        &self,
        file: &str,
        to: &mut impl std::io::Write,
    ) -> Result<u64, ClientError> {
        let answer = self.stream(&format!("/recordings/{}", encoded(file)))?;
        let mut body = answer.into_body().into_reader();
        std::io::copy(&mut body, to).map_err(|e| ClientError::Unreachable {
            url: self.url.clone(),
            why: format!("{file} was not copied whole: {e}"),
        })
    }

    /// Asks something of a device.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn command(&self, name: &str, command: &Command) -> Result<Done, ClientError> {
        self.post(&device(name, "/commands"), command, TIMEOUT)
    }

    /// Takes the lease of a device, or renews it.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn take_lease(&self, name: &str, force: bool) -> Result<Lease, ClientError> {
        let mut request = self
            .agent
            .put(self.path(&device(name, "/lease")))
            .header(HOLDER_HEADER, &self.holder);
        if let Some(bearer) = self.bearer() {
            request = request.header("authorization", bearer);
        }
        let answer = request.send_json(LeaseRequest { force });
        self.json(answer.map_err(|e| self.unreachable(&e))?)
    }

    /// Gives the lease of a device back.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn release_lease(&self, name: &str) -> Result<(), ClientError> {
        let mut request = self
            .agent
            .delete(self.path(&device(name, "/lease")))
            .header(HOLDER_HEADER, &self.holder);
        if let Some(bearer) = self.bearer() {
            request = request.header("authorization", bearer);
        }
        let response = request.call().map_err(|e| self.unreachable(&e))?;
        self.checked(response).map(drop)
    }

    /// Copies the store under a name in its folder `backups`.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn backup(&self, to: &str) -> Result<BackupMade, ClientError> {
        let wanted = BackupRequest { to: to.into() };
        self.post("/store/backup", &wanted, BACKUP_TIMEOUT)
    }

    /// Everything that happens from now on, of one device or of all.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn events(&self, of: Option<&str>) -> Result<Events, ClientError> {
        let query = of.map_or(String::new(), |name| format!("?device={}", encoded(name)));
        let answer = self.stream(&format!("/events{query}"))?;
        Ok(Events::new(answer.into_body().into_reader()))
    }

    /// An answer that may take as long as it likes, as long as something comes.
    fn stream(&self, path: &str) -> Result<Response<Body>, ClientError> {
        let mut request = self
            .agent
            .get(self.path(path))
            .config()
            .timeout_global(None)
            .timeout_recv_response(Some(TIMEOUT))
            .timeout_per_read(Some(SILENCE))
            .build();
        if let Some(bearer) = self.bearer() {
            request = request.header("authorization", bearer);
        }
        let response = request.call().map_err(|e| self.unreachable(&e))?;
        self.checked(response)
    }

    fn path(&self, path: &str) -> String {
        format!("{}/api/v1{path}", self.url)
    }

    fn bearer(&self) -> Option<String> {
        self.token.as_ref().map(|token| format!("Bearer {token}"))
    }

    fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, ClientError> {
        let mut request = self.agent.get(self.path(path));
        if let Some(bearer) = self.bearer() {
            request = request.header("authorization", bearer);
        }
        self.json(request.call().map_err(|e| self.unreachable(&e))?)
    }

    fn post<T: DeserializeOwned>(
        &self,
        path: &str,
        body: &impl Serialize,
        within: Duration,
    ) -> Result<T, ClientError> {
        let mut request = self
            .agent
            .post(self.path(path))
            .config()
            .timeout_global(Some(within))
            .build()
            .header(HOLDER_HEADER, &self.holder);
        if let Some(bearer) = self.bearer() {
            request = request.header("authorization", bearer);
        }
        let answer = request.send_json(body);
        self.json(answer.map_err(|e| self.unreachable(&e))?)
    }

    /// The answer where it is a success.
    fn json<T: DeserializeOwned>(&self, response: Response<Body>) -> Result<T, ClientError> {
        let text = read_text(self.checked(response)?).map_err(|why| self.strange(&why))?;
        serde_json::from_str(&text).map_err(|e| self.strange(&e.to_string()))
    }

    fn checked(&self, response: Response<Body>) -> Result<Response<Body>, ClientError> {
        let status = response.status();
        if status.is_success() {
            return Ok(response);
        }
        let text = read_text(response).map_err(|why| self.strange(&why))?;
        let problem: Problem = serde_json::from_str(&text)
            .map_err(|_| self.strange(&format!("HTTP status {}", status.as_u16())))?;
        Err(match problem.command_error() {
            Some(error) => ClientError::Command(error),
            None => ClientError::Refused {
                url: self.url.clone(),
                status: status.as_u16(),
                problem,
            },
        })
    }

    fn unreachable(&self, why: &ureq::Error) -> ClientError {
        ClientError::Unreachable {
            url: self.url.clone(),
            why: why.to_string(),
        }
    }

    fn strange(&self, why: &str) -> ClientError {
        ClientError::Strange {
            url: self.url.clone(),
            why: why.into(),
        }
    }
}

fn read_text(response: Response<Body>) -> Result<String, String> {
    let mut text = String::new();
    let read = response
        .into_body()
        .into_reader()
        .take(MAX_ANSWER)
        .read_to_string(&mut text);
    read.map(|_| text).map_err(|e| e.to_string())
}

fn read_roots(path: &Path) -> Result<Vec<Certificate<'static>>, ClientError> {
    let wrong = |why: String| ClientError::Certificate {
        path: path.display().to_string(),
        why,
    };
    let pem = std::fs::read(path).map_err(|e| wrong(e.to_string()))?;
    let mut roots = Vec::new();
    for item in parse_pem(&pem) {
        if let ureq::tls::PemItem::Certificate(root) = item.map_err(|e| wrong(e.to_string()))? {
            roots.push(root);
        }
    }
    if roots.is_empty() {
        return Err(wrong("it holds no certificate in PEM".into()));
    }
    Ok(roots)
}

/// The path of a device.
fn device(name: &str, rest: &str) -> String {
    format!("/devices/{}{rest}", encoded(name))
}

/// A name as one segment of a path, which a dot could make another one.
fn encoded(name: &str) -> String {
    percent::encoded(name, b"-_~")
}

/// What a header may hold.
fn printable_ascii(name: &str) -> String {
    let kept = name.chars().map(|c| {
        if c == ' ' || c.is_ascii_graphic() {
            c
        } else {
            '?'
        }
    });
    let name: String = kept.take(64).collect();
    match name.trim() {
        "" => "somebody".into(),
        name => name.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_segment() {
        assert_eq!(device("bench", ""), "/devices/bench");
        assert_eq!(
            device("serial:/dev/tty ä", "/lease"),
            "/devices/serial%3A%2Fdev%2Ftty%20%C3%A4/lease"
        );
        // A dot alone would be the folder itself to a browser or proxy.
        assert_eq!(device("..", ""), "/devices/%2E%2E");
    }

    #[test]
    fn a_holder_fits_a_header() {
        assert_eq!(printable_ascii("Ada @ bench"), "Ada @ bench");
        assert_eq!(printable_ascii("Zoë\r\nx: y"), "Zo???x: y");
        assert_eq!(printable_ascii("  "), "somebody");
        assert_eq!(printable_ascii(&"x".repeat(99)).len(), 64);
    }
}
