//! Certificate of the server: the user's own, or a generated one.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use ihd_daemon::private_file::create_private;
use rustls::client::WebPkiServerVerifier;
use rustls::client::danger::ServerCertVerifier;
use rustls::crypto::ring::{cipher_suite, default_provider};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use rustls::{CertificateError, RootCertStore, ServerConfig};
use thiserror::Error;

/// ALPN name of HTTP/2.
pub(crate) const HTTP2: &[u8] = b"h2";

/// Source of certificate and key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Certificate {
    /// PEM files of the user.
    Files {
        /// Certificate, with the chain to its issuer.
        certificate: PathBuf,
        /// Private key of the certificate.
        key: PathBuf,
        /// Folder for the certificate in use.
        folder: PathBuf,
    },
    /// Self-signed, generated once and stored as `certificate.pem` and `key.pem`.
    Generated {
        /// The folder.
        folder: PathBuf,
    },
}

/// Error of certificate or key.
#[derive(Debug, Error)]
pub enum TlsError {
    /// A file cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// A file contains no PEM section of the kind.
    #[error("{} holds no {what} in PEM: {why}", path.display())]
    Pem {
        /// The file.
        path: PathBuf,
        /// Kind of the expected section.
        what: &'static str,
        /// Reason.
        why: String,
    },
    /// Certificate and key do not match, or one is unusable.
    #[error("certificate {} and key {} cannot be used: {source}", certificate.display(), key.display())]
    Unusable {
        /// The certificate.
        certificate: PathBuf,
        /// The key.
        key: PathBuf,
        /// Error of rustls.
        source: rustls::Error,
    },
    /// No certificate can be generated.
    #[error("no certificate can be generated for {names:?}: {source}")]
    Generate {
        /// Host names of the certificate.
        names: Vec<String>,
        /// Error of rcgen.
        source: rcgen::Error,
    },
}

/// Time before the end of a certificate from which on the daemon and `ihd doctor` warn.
pub const RENEWAL_TIME: Duration = Duration::from_secs(30 * 86_400);

/// TLS configuration of a server.
pub struct ServerTls {
    /// Configuration of the acceptor.
    pub config: Arc<ServerConfig>,
    /// SHA-256 fingerprint of the certificate, in hexadecimal with colons, for comparison by a client.
    pub fingerprint: String,
    /// File of the certificate.
    pub certificate: PathBuf,
    /// End of the certificate in seconds since 1970, UTC; `None` if it has none.
    pub expires_s: Option<i64>,
    /// Certificates as in the file.
    pub(crate) pem: Vec<u8>,
}

impl Certificate {
    /// Returns the files of certificate and key.
    pub fn files(&self) -> (PathBuf, PathBuf) {
        match self {
            Self::Files {
                certificate, key, ..
            } => (certificate.clone(), key.clone()),
            Self::Generated { folder } => (folder.join("certificate.pem"), folder.join("key.pem")),
        }
    }

    /// Returns the file with the certificate that the running server uses. It differs from [`Certificate::files`] once those were renewed
    /// and cannot be used.
    pub fn in_use(&self) -> PathBuf {
        let (Self::Files { folder, .. } | Self::Generated { folder }) = self;
        folder.join("in-use.pem")
    }

    /// Reads certificate and key; generates missing ones for `names` if the source is [`Certificate::Generated`].
    ///
    /// # Errors
    /// [`TlsError`].
    pub fn load(&self, names: &[String]) -> Result<ServerTls, TlsError> {
        let (certificate, key) = self.files();
        if let Self::Generated { folder } = self
            && (!certificate.exists() || !key.exists())
        {
            generate(folder, &certificate, &key, names)?;
        }
        let pem = read(&certificate)?;
        let chain = parse_chain(&certificate, &pem)?;
        let fingerprint = chain.first().map(fingerprint).unwrap_or_default();
        let expires_s = chain.first().and_then(expires_s);
        let secret = PrivateKeyDer::from_pem_slice(&read(&key)?).map_err(|e| TlsError::Pem {
            path: key.clone(),
            what: "private key",
            why: e.to_string(),
        })?;
        let unusable = |source| TlsError::Unusable {
            certificate: certificate.clone(),
            key: key.clone(),
            source,
        };
        let mut config = ServerConfig::builder_with_provider(Arc::new(default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(unusable)?
            .with_no_client_auth()
            .with_single_cert(chain, secret)
            .map_err(unusable)?;
        config.alpn_protocols = vec![HTTP2.to_vec(), b"http/1.1".to_vec()];
        Ok(ServerTls {
            config: Arc::new(config),
            fingerprint,
            certificate,
            expires_s,
            pem,
        })
    }
}

fn read(path: &Path) -> Result<Vec<u8>, TlsError> {
    fs::read(path).map_err(|source| TlsError::Io {
        path: path.into(),
        source,
    })
}

/// Returns the end of the first certificate of a file in seconds since 1970, UTC; `None` if it has none.
///
/// # Errors
/// [`TlsError`] if the file cannot be read.
pub fn file_expires_s(path: &Path) -> Result<Option<i64>, TlsError> {
    Ok(parse_chain(path, &read(path)?)?.first().and_then(expires_s))
}

fn parse_chain(path: &Path, text: &[u8]) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let pem = |why| TlsError::Pem {
        path: path.into(),
        what: "certificate",
        why,
    };
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(text).collect();
    let chain = chain.map_err(|e| pem(e.to_string()))?;
    if chain.is_empty() {
        return Err(pem("there is none".into()));
    }
    Ok(chain)
}

/// Returns the end of a certificate: rustls tells it of one that has expired, which each has in the year 9999.
fn expires_s(certificate: &CertificateDer<'static>) -> Option<i64> {
    let last = UnixTime::since_unix_epoch(Duration::from_secs(253_402_300_799));
    let mut roots = RootCertStore::empty();
    roots.add(certificate.clone()).ok()?;
    let provider = Arc::new(default_provider());
    let verifier = WebPkiServerVerifier::builder_with_provider(Arc::new(roots), provider);
    let name = ServerName::try_from("localhost").ok()?;
    let verified = verifier
        .build()
        .ok()?
        .verify_server_cert(certificate, &[], &name, &[], last);
    match verified {
        Err(rustls::Error::InvalidCertificate(CertificateError::ExpiredContext {
            not_after,
            ..
        })) => i64::try_from(not_after.as_secs()).ok(),
        _ => None,
    }
}

/// Generates certificate and key. The key is written first, so that there is never a certificate without one.
fn generate(
    folder: &Path,
    certificate: &Path,
    key: &Path,
    names: &[String],
) -> Result<(), TlsError> {
    let mut all: Vec<String> = ["localhost", "127.0.0.1", "::1"].map(Into::into).into();
    all.extend(
        names
            .iter()
            .filter(|name| !all.contains(name))
            .cloned()
            .collect::<Vec<_>>(),
    );
    let generated = rcgen::generate_simple_self_signed(all.clone())
        .map_err(|source| TlsError::Generate { names: all, source })?;
    fs::create_dir_all(folder).map_err(|source| TlsError::Io {
        path: folder.into(),
        source,
    })?;
    write_new(key, generated.signing_key.serialize_pem().as_bytes())?;
    write_new(certificate, generated.cert.pem().as_bytes())
}

/// Writes a file for its owner only, under another name first, so that no incomplete file is ever visible.
pub(crate) fn write_new(path: &Path, text: &[u8]) -> Result<(), TlsError> {
    let temporary = path.with_extension("new");
    let write = || {
        match fs::remove_file(&temporary) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => {}
        }
        let mut file = create_private(&temporary)?;
        file.write_all(text)?;
        file.sync_all()?;
        fs::rename(&temporary, path)
    };
    write().map_err(|source| TlsError::Io {
        path: path.into(),
        source,
    })
}

/// Returns the SHA-256 fingerprint of a certificate.
fn fingerprint(certificate: &CertificateDer<'_>) -> String {
    let Some(suite) = cipher_suite::TLS13_AES_128_GCM_SHA256.tls13() else {
        return String::new();
    };
    let hash = suite.common.hash_provider.hash(certificate);
    let bytes: Vec<String> = hash.as_ref().iter().map(|b| format!("{b:02x}")).collect();
    bytes.join(":")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_certificate_is_made_once_and_its_key_is_its_owners() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("tls");
        let source = Certificate::Generated {
            folder: folder.clone(),
        };
        let first = source.load(&["hob.lan".into()]).unwrap();
        assert_eq!(first.fingerprint.split(':').count(), 32);
        assert_eq!(source.load(&[]).unwrap().fingerprint, first.fingerprint);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let key = fs::metadata(folder.join("key.pem")).unwrap();
            assert_eq!(key.permissions().mode() & 0o777, 0o600);
        }
        let names: Vec<_> = fs::read_dir(&folder).unwrap().collect();
        assert_eq!(names.len(), 2, "{names:?}");
    }

    #[test]
    fn files_that_are_wrong_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = |name: &str| dir.path().join(name);
        Certificate::Generated { folder: path("a") }
            .load(&[])
            .unwrap();
        fs::write(path("empty.pem"), "").unwrap();
        for (certificate, key, word) in [
            ("gone.pem", "a/key.pem", "gone.pem"),
            ("empty.pem", "a/key.pem", "no certificate"),
            ("a/certificate.pem", "a/certificate.pem", "no private key"),
        ] {
            let files = Certificate::Files {
                certificate: path(certificate),
                key: path(key),
                folder: path("in-use"),
            };
            let error = files.load(&[]).err().unwrap().to_string();
            assert!(error.contains(word), "{error}");
        }
        // A key of another certificate.
        Certificate::Generated { folder: path("b") }
            .load(&[])
            .unwrap();
        let mixed = Certificate::Files {
            certificate: path("a/certificate.pem"),
            key: path("b/key.pem"),
            folder: path("in-use"),
        };
        assert!(matches!(mixed.load(&[]), Err(TlsError::Unusable { .. })));
    }

    #[test]
    fn the_end_of_a_certificate_is_read_from_it() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.pem");
        let key = rcgen::KeyPair::generate().unwrap();
        for is_ca in [
            rcgen::IsCa::NoCa,
            rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained),
        ] {
            let mut params = rcgen::CertificateParams::new(vec!["hob.lan".into()]).unwrap();
            params.is_ca = is_ca;
            // 2001-09-09 is in the middle of a billion seconds' day.
            params.not_after = rcgen::date_time_ymd(2001, 9, 9);
            fs::write(&path, params.self_signed(&key).unwrap().pem()).unwrap();
            assert_eq!(file_expires_s(&path).unwrap(), Some(1_000_000_000 - 6_400));
        }
    }
}
