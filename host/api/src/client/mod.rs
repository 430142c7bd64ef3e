//! Blocking client, used by `ihd device` and `ihd watch`.

mod error;
pub mod events;
mod history;
mod names;
mod pinned;

use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::time::Duration;

use ihd_model::{
    BackupMade, BackupRequest, Command, CommandReply, DeviceReport, FleetReport, HOLDER_HEADER,
    Health, Lease, LeaseRequest, Problem, RecordingFile, StoredLookup, StoredResult,
};
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use serde::Serialize;
use serde::de::DeserializeOwned;
use ureq::http::Response;
use ureq::typestate::{WithBody, WithoutBody};
use ureq::unversioned::resolver::DefaultResolver;
use ureq::unversioned::transport::{Connector, TcpConnector};
use ureq::{Agent, Body, RequestBuilder};

pub use self::error::ClientError;
use self::events::Events;
use self::names::{device, encoded, printable_ascii};
use self::pinned::PinnedConnector;
use crate::access::guard;

/// Time that a response may take beyond the daemon's own limit.
const MARGIN: Duration = Duration::from_secs(5);

/// Maximum response time.
const TIMEOUT: Duration = guard::REQUEST_TIMEOUT.saturating_add(MARGIN);

/// Maximum duration of a backup.
const BACKUP_TIMEOUT: Duration = guard::BACKUP_TIMEOUT.saturating_add(MARGIN);

/// Time without an event or comment after which the connection counts as lost: three heartbeats.
const SILENCE_TIMEOUT: Duration = Duration::from_secs(45);

/// Maximum size of a response, in bytes.
const MAX_RESPONSE_BYTES: u64 = 64 << 20;

/// Number of bytes of a recording that are copied at once.
const COPIED_BYTES: usize = 1 << 16;

/// Client of one daemon.
#[derive(Clone)]
pub struct ApiClient {
    agent: Agent,
    url: String,
    holder: String,
    token: Option<String>,
}

impl ApiClient {
    /// Creates a client for the daemon at `url` (`http://127.0.0.1:8731`) with the name `holder`. With `https` it trusts the certificates in
    /// `certificates` alone, by their bytes: whatever their dates and names. Nothing is sent yet.
    ///
    /// # Errors
    /// [`ClientError::Certificate`] if none of `certificates` can be read.
    pub fn new(
        url: &str,
        holder: &str,
        token: Option<String>,
        certificates: &[PathBuf],
    ) -> Result<Self, ClientError> {
        let connector = PinnedConnector::new(read_certificates(certificates)?).map_err(|e| {
            ClientError::Unreachable {
                url: url.to_owned(),
                why: e.to_string(),
            }
        })?;
        let config = Agent::config_builder()
            // A proxy of the environment must not see the token.
            .proxy(None)
            .max_redirects(0)
            .http_status_as_error(false)
            .timeout_connect(Some(Duration::from_secs(5)))
            .timeout_global(Some(TIMEOUT))
            .build();
        let connector = TcpConnector::default().chain(connector);
        let agent = Agent::with_parts(config, connector, DefaultResolver::default());
        Ok(Self {
            agent,
            url: url.trim_end_matches('/').to_owned(),
            holder: printable_ascii(holder),
            token,
        })
    }

    /// Returns the URL of the daemon.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Returns the name of this client.
    pub fn holder(&self) -> &str {
        &self.holder
    }

    /// Returns the health of the daemon, with `within` as the time limit.
    ///
    /// # Errors
    /// [`ClientError::Unreachable`] if there is no response, [`ClientError::UnexpectedResponse`] if another program uses the port.
    pub fn health(&self, within: Duration) -> Result<Health, ClientError> {
        let request = self
            .agent
            .get(format!("{}/healthz", self.url))
            .config()
            .timeout_global(Some(within))
            .build();
        let response = request.call().map_err(|e| self.unreachable(&e))?;
        // The status is ignored: a daemon with a failed store responds with 503.
        let text = read_text(response).map_err(|why| self.unexpected(&why))?;
        let health: Health =
            serde_json::from_str(&text).map_err(|e| self.unexpected(&e.to_string()))?;
        if health.service != "ihd" {
            return Err(self.unexpected("its health is another service's"));
        }
        Ok(health)
    }

    /// Returns the reports of all devices.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn devices(&self) -> Result<Vec<DeviceReport>, ClientError> {
        self.get("/devices")
    }

    /// Returns the report of a device.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn device(&self, name: &str) -> Result<DeviceReport, ClientError> {
        self.get(&device(name, ""))
    }

    /// Returns the last report of the fleet.
    ///
    /// # Errors
    /// [`ClientError`]; [`ClientError::Refused`] with status 404 if the daemon is not an edge of one.
    pub fn fleet(&self) -> Result<FleetReport, ClientError> {
        self.get("/fleet")
    }

    /// Returns the lookups of a device, newest first.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn lookups(&self, name: &str) -> Result<Vec<StoredLookup>, ClientError> {
        self.get(&device(name, "/lookups"))
    }

    /// Returns at most `limit` results of a device, newest first, none before `since_ms` (milliseconds since 1970, UTC).
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

    /// Returns the recordings, newest first.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn recordings(&self) -> Result<Vec<RecordingFile>, ClientError> {
        self.get("/recordings")
    }

    /// Downloads a recording to `to`, without a time limit, and returns its length in bytes.
    ///
    /// # Errors
    /// [`ClientError`]; `to` then has the part before the error.
    pub fn download_recording(
        &self,
        file: &str,
        to: &mut impl std::io::Write,
    ) -> Result<u64, ClientError> {
        let answer = self.stream(&format!("/recordings/{}", encoded(file)))?;
        let mut body = answer.into_body().into_reader();
        let (mut part, mut length) = (vec![0; COPIED_BYTES], 0);
        loop {
            let read = match body.read(&mut part) {
                Ok(0) => return Ok(length),
                Ok(read) => read,
                Err(e) if e.kind() == ErrorKind::Interrupted => continue,
                Err(e) => {
                    return Err(ClientError::Unreachable {
                        url: self.url.clone(),
                        why: format!("{file} was not copied whole: {e}"),
                    });
                }
            };
            to.write_all(&part[..read])
                .map_err(|e| ClientError::Write {
                    file: file.to_owned(),
                    why: e.to_string(),
                })?;
            length += read as u64;
        }
    }

    /// Sends a command to a device.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn command(&self, name: &str, command: &Command) -> Result<CommandReply, ClientError> {
        self.post(&device(name, "/commands"), command, TIMEOUT)
    }

    /// Acquires or renews the lease of a device; `force` revokes that of another client.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn take_lease(&self, name: &str, force: bool) -> Result<Lease, ClientError> {
        let request = self
            .agent
            .put(self.path(&device(name, "/lease")))
            .header(HOLDER_HEADER, &self.holder);
        self.json(self.send(request, &LeaseRequest { force })?)
    }

    /// Releases the lease of a device.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn release_lease(&self, name: &str) -> Result<(), ClientError> {
        let request = self
            .agent
            .delete(self.path(&device(name, "/lease")))
            .header(HOLDER_HEADER, &self.holder);
        self.call(request).map(drop)
    }

    /// Copies the store to a new backup named `to`.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn backup(&self, to: &str) -> Result<BackupMade, ClientError> {
        let request = BackupRequest { to: to.into() };
        self.post("/store/backup", &request, BACKUP_TIMEOUT)
    }

    /// Subscribes to the events of one device, or of all if `of` is `None`.
    ///
    /// # Errors
    /// [`ClientError`].
    pub fn events(&self, of: Option<&str>) -> Result<Events, ClientError> {
        let query = of.map_or(String::new(), |name| format!("?device={}", encoded(name)));
        let answer = self.stream(&format!("/events{query}"))?;
        Ok(Events::new(answer.into_body().into_reader()))
    }

    /// Requests a response of any duration; it ends only after [`SILENCE_TIMEOUT`].
    fn stream(&self, path: &str) -> Result<Response<Body>, ClientError> {
        let request = self
            .agent
            .get(self.path(path))
            .config()
            .timeout_global(None)
            .timeout_recv_response(Some(TIMEOUT))
            .timeout_per_read(Some(SILENCE_TIMEOUT))
            .build();
        self.call(request)
    }

    fn path(&self, path: &str) -> String {
        format!("{}/api/v1{path}", self.url)
    }

    /// Adds the token to a request, if there is one.
    fn authorised<B>(&self, request: RequestBuilder<B>) -> RequestBuilder<B> {
        match &self.token {
            Some(token) => request.header("authorization", format!("Bearer {token}")),
            None => request,
        }
    }

    /// Sends a request without a body; returns a successful response.
    fn call(&self, request: RequestBuilder<WithoutBody>) -> Result<Response<Body>, ClientError> {
        let response = self.authorised(request).call();
        self.checked(response.map_err(|e| self.unreachable(&e))?)
    }

    /// Sends a request with a body; returns a successful response.
    fn send(
        &self,
        request: RequestBuilder<WithBody>,
        body: &impl Serialize,
    ) -> Result<Response<Body>, ClientError> {
        let response = self.authorised(request).send_json(body);
        self.checked(response.map_err(|e| self.unreachable(&e))?)
    }

    fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, ClientError> {
        self.json(self.call(self.agent.get(self.path(path)))?)
    }

    fn post<T: DeserializeOwned>(
        &self,
        path: &str,
        body: &impl Serialize,
        within: Duration,
    ) -> Result<T, ClientError> {
        let request = self
            .agent
            .post(self.path(path))
            .config()
            .timeout_global(Some(within))
            .build()
            .header(HOLDER_HEADER, &self.holder);
        self.json(self.send(request, body)?)
    }

    /// Deserialises the body of a successful response.
    fn json<T: DeserializeOwned>(&self, response: Response<Body>) -> Result<T, ClientError> {
        let text = read_text(response).map_err(|why| self.unexpected(&why))?;
        serde_json::from_str(&text).map_err(|e| self.unexpected(&e.to_string()))
    }

    fn checked(&self, response: Response<Body>) -> Result<Response<Body>, ClientError> {
        let status = response.status();
        if status.is_success() {
            return Ok(response);
        }
        let text = read_text(response).map_err(|why| self.unexpected(&why))?;
        let problem: Problem = serde_json::from_str(&text)
            .map_err(|_| self.unexpected(&format!("HTTP status {}", status.as_u16())))?;
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

    fn unexpected(&self, why: &str) -> ClientError {
        ClientError::UnexpectedResponse {
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
        .take(MAX_RESPONSE_BYTES)
        .read_to_string(&mut text);
    read.map(|_| text).map_err(|e| e.to_string())
}

/// Returns the certificates in the files; the error of the first file if none of them has any.
fn read_certificates(paths: &[PathBuf]) -> Result<Vec<CertificateDer<'static>>, ClientError> {
    let mut certificates = Vec::new();
    let mut failure = None;
    for path in paths {
        match read_pem(path) {
            Ok(read) => certificates.extend(read),
            Err(error) => failure = failure.or(Some(error)),
        }
    }
    match failure {
        Some(error) if certificates.is_empty() => Err(error),
        _ => Ok(certificates),
    }
}

fn read_pem(path: &Path) -> Result<Vec<CertificateDer<'static>>, ClientError> {
    let error = |why: String| ClientError::Certificate {
        path: path.display().to_string(),
        why,
    };
    let pem = std::fs::read(path).map_err(|e| error(e.to_string()))?;
    let read: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&pem).collect();
    let certificates = read.map_err(|e| error(e.to_string()))?;
    match certificates.is_empty() {
        true => Err(error("it holds no certificate in PEM".into())),
        false => Ok(certificates),
    }
}
