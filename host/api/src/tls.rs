//! Certificate of the server: the user's own, or a generated one.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustls::ServerConfig;
use rustls::crypto::ring::{cipher_suite, default_provider};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
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

/// TLS configuration of a server.
pub struct ServerTls {
    /// Configuration of the acceptor.
    pub config: Arc<ServerConfig>,
    /// SHA-256 fingerprint of the certificate, in hexadecimal with colons, for comparison by a client.
    pub fingerprint: String,
    /// File of the certificate, for a client's `--ca`.
    pub certificate: PathBuf,
}

impl Certificate {
    /// Reads certificate and key; generates missing ones for `names` if the source is [`Certificate::Generated`].
    ///
    /// # Errors
    /// [`TlsError`].
    pub fn load(&self, names: &[String]) -> Result<ServerTls, TlsError> {
        let (certificate, key) = match self {
            Self::Files { certificate, key } => (certificate.clone(), key.clone()),
            Self::Generated { folder } => {
                let paths = (folder.join("certificate.pem"), folder.join("key.pem"));
                if !paths.0.exists() || !paths.1.exists() {
                    generate(folder, &paths.0, &paths.1, names)?;
                }
                paths
            }
        };
        let chain = read_chain(&certificate)?;
        let fingerprint = chain.first().map(fingerprint).unwrap_or_default();
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
        })
    }
}

fn read(path: &Path) -> Result<Vec<u8>, TlsError> {
    fs::read(path).map_err(|source| TlsError::Io {
        path: path.into(),
        source,
    })
}

fn read_chain(path: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let pem = |why| TlsError::Pem {
        path: path.into(),
        what: "certificate",
        why,
    };
    let text = read(path)?;
    let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&text).collect();
    let chain = chain.map_err(|e| pem(e.to_string()))?;
    if chain.is_empty() {
        return Err(pem("there is none".into()));
    }
    Ok(chain)
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
    write_new(key, &generated.signing_key.serialize_pem())?;
    write_new(certificate, &generated.cert.pem())
}

/// Writes a file for its owner only, under another name first, so that no incomplete file is ever visible.
fn write_new(path: &Path, text: &str) -> Result<(), TlsError> {
    let temporary = path.with_extension("new");
    let write = || {
        match fs::remove_file(&temporary) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => {}
        }
        let mut options = fs::OpenOptions::new();
        options.write(true).create_new(true);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let mut file = options.open(&temporary)?;
        file.write_all(text.as_bytes())?;
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
        };
        assert!(matches!(mixed.load(&[]), Err(TlsError::Unusable { .. })));
    }
}
