//! Certificate in use: read again when its files change, and watched for its end.

use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, SystemTime};

use ihd_daemon::locking::lock;
use tokio::time::Instant;
use tokio_rustls::TlsAcceptor;

use crate::stamp::{Stamp, stamp};
use crate::tls::{Certificate, RENEWAL_TIME, ServerTls, TlsError, write_new};

/// Period of the warning of a certificate that ends soon.
const WARNING_PERIOD: Duration = Duration::from_secs(86_400);

/// Stamps of certificate and key.
type Stamps = [Stamp; 2];

/// TLS of a running server.
pub(crate) struct ServedTls {
    source: Certificate,
    names: Vec<String>,
    state: Mutex<State>,
}

struct State {
    tls: ServerTls,
    /// Files as last read; `None` if one was missing.
    stamps: Option<Stamps>,
    warned: Option<Instant>,
}

impl ServedTls {
    /// Reads the certificate, or generates it for `names`.
    ///
    /// # Errors
    /// As [`Certificate::load`].
    pub(crate) fn load(source: Certificate, names: Vec<String>) -> Result<Self, TlsError> {
        // Before the files are read, so that a later change is seen; generated ones are not there yet.
        let read = stamps(&source);
        let tls = source.load(&names)?;
        let stamps = read.or_else(|| stamps(&source));
        note_in_use(&source, &tls);
        let state = State {
            tls,
            stamps,
            warned: None,
        };
        Ok(Self {
            source,
            names,
            state: Mutex::new(state),
        })
    }

    /// Returns SHA-256 fingerprint and file of the certificate.
    pub(crate) fn identity(&self) -> (String, PathBuf) {
        let state = self.state();
        (state.tls.fingerprint.clone(), state.tls.certificate.clone())
    }

    /// Returns the end of the certificate in seconds since 1970, UTC; `None` if it has none.
    pub(crate) fn expires_s(&self) -> Option<i64> {
        self.state().tls.expires_s
    }

    /// Returns the acceptor of the next connection; reads changed files first. Where they cannot be used, the certificate read before stays.
    pub(crate) fn acceptor(&self) -> TlsAcceptor {
        let mut state = self.state();
        let now = stamps(&self.source);
        if now.is_some() && now != state.stamps {
            state.stamps = now;
            match self.source.load(&self.names) {
                Ok(tls) => {
                    let (fingerprint, file) = (&tls.fingerprint, tls.certificate.display());
                    tracing::info!(fingerprint, %file, "TLS certificate (SHA-256), read again");
                    note_in_use(&self.source, &tls);
                    state.tls = tls;
                    state.warned = None;
                }
                Err(error) => {
                    tracing::warn!(%error, "the changed TLS certificate cannot be used; the one before stays in use");
                }
            }
        }
        state.warn();
        TlsAcceptor::from(state.tls.config.clone())
    }

    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}

impl State {
    /// Warns once a day of a certificate that ends soon or has ended.
    fn warn(&mut self) {
        let Some(left_s) = self.tls.expires_s.map(|end_s| end_s - now_s()) else {
            return;
        };
        if left_s > RENEWAL_TIME.as_secs().cast_signed()
            || self.warned.is_some_and(|at| at.elapsed() < WARNING_PERIOD)
        {
            return;
        }
        self.warned = Some(Instant::now());
        let (days, file) = (left_s / 86_400, self.tls.certificate.display());
        match left_s < 0 {
            true => {
                tracing::warn!(%file, "the TLS certificate has expired: browsers refuse it; renew it")
            }
            false => tracing::warn!(%file, days, "the TLS certificate ends soon: renew it"),
        }
    }
}

/// Writes the certificate in use to its file, which `ihd device` trusts.
fn note_in_use(source: &Certificate, tls: &ServerTls) {
    let path = source.in_use();
    let written = match path.parent() {
        Some(folder) => std::fs::create_dir_all(folder).map_err(|source| TlsError::Io {
            path: folder.into(),
            source,
        }),
        None => Ok(()),
    };
    if let Err(error) = written.and_then(|()| write_new(&path, &tls.pem)) {
        tracing::warn!(%error, "the TLS certificate in use is not noted: once its files are renewed, `ihd device` may not reach this daemon");
    }
}

fn stamps(source: &Certificate) -> Option<Stamps> {
    let (certificate, key) = source.files();
    Some([stamp(&certificate)?, stamp(&key)?])
}

fn now_s() -> i64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    since.map_or(0, |time| time.as_secs().cast_signed())
}
