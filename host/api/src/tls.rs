//! The certificate: its owner's, or one that is made here.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustls::ServerConfig;
use rustls::crypto::ring::{cipher_suite, default_provider};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use thiserror::Error;

/// HTTP/2 as two ends of TLS agree on it.
pub(crate) const HTTP2: &[u8] = b"h2";

/// Where certificate and key come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Certificate {
    /// PEM files of their owner.
    Files {
        /// The certificate, and those that lead to its issuer.
        certificate: PathBuf,
        /// Its private key.
        key: PathBuf,
    },
    /// Made once and kept in this folder, as `certificate.pem` and `key.pem`.
    Made {
        /// The folder.
        folder: PathBuf,
    },
}

/// Why TLS cannot be had.
#[derive(Debug, Error)]
pub enum TlsError {
    /// A file cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file holds no PEM of the kind.
    #[error("{} holds no {what} in PEM: {why}", path.display())]
    Pem {
        /// The file.
        path: PathBuf,
        /// What was looked for.
        what: &'static str,
        /// Why.
        why: String,
    },
    /// Certificate and key do not fit, or one is unusable.
    #[error("certificate {} and key {} cannot be used: {source}", certificate.display(), key.display())]
    Unusable {
        /// The certificate.
        certificate: PathBuf,
        /// The key.
        key: PathBuf,
        /// Why.
        source: rustls::Error,
    },
    /// No certificate can be made.
    #[error("no certificate can be made for {names:?}: {source}")]
    Make {
        /// The names that it should be good for.
        names: Vec<String>,
        /// Why.
        source: rcgen::Error,
    },
}

/// TLS as a server speaks it.
pub struct ServerTls {
    /// For the acceptor.
    pub config: Arc<ServerConfig>,
    /// SHA-256 of the certificate, in hexadecimal with colons: what a client compares.
    pub fingerprint: String,
    /// The certificate's file, which a client takes as `--ca`.
    pub certificate: PathBuf,
}

impl Certificate {
    /// Reads certificate and key; makes them for `names` where they are to be made and not there.
    ///
    /// # Errors
    /// [`TlsError`].
    pub fn load(&self, names: &[String]) -> Result<ServerTls, TlsError> {
        let (certificate, key) = match self {
            Self::Files { certificate, key } => (certificate.clone(), key.clone()),
            Self::Made { folder } => {
                let paths = (folder.join("certificate.pem"), folder.join("key.pem"));
                if !paths.0.exists() || !paths.1.exists() {
                    make(folder, &paths.0, &paths.1, names)?;
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

/// Makes certificate and key; the key first and for its owner alone, so that a certificate never stands without.
fn make(folder: &Path, certificate: &Path, key: &Path, names: &[String]) -> Result<(), TlsError> {
    let mut all: Vec<String> = ["localhost", "127.0.0.1", "::1"].map(Into::into).into();
    all.extend(
        names
            .iter()
            .filter(|name| !all.contains(name))
            .cloned()
            .collect::<Vec<_>>(),
    );
    let made = rcgen::generate_simple_self_signed(all.clone())
        .map_err(|source| TlsError::Make { names: all, source })?;
    fs::create_dir_all(folder).map_err(|source| TlsError::Io {
        path: folder.into(),
        source,
    })?;
    write_new(key, &made.signing_key.serialize_pem())?;
    write_new(certificate, &made.cert.pem())
}

/// Writes beside, for the owner alone, and renames: half a file is never seen.
fn write_new(path: &Path, text: &str) -> Result<(), TlsError> {
    let beside = path.with_extension("new");
    let write = || {
        match fs::remove_file(&beside) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => {}
        }
        let mut options = fs::OpenOptions::new();
        options.write(true).create_new(true);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let mut file = options.open(&beside)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&beside, path)
    };
    write().map_err(|source| TlsError::Io {
        path: path.into(),
        source,
    })
}

/// SHA-256 of a certificate.
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
        let made = Certificate::Made {
            folder: folder.clone(),
        };
        let first = made.load(&["hob.lan".into()]).unwrap();
        assert_eq!(first.fingerprint.split(':').count(), 32);
        assert_eq!(made.load(&[]).unwrap().fingerprint, first.fingerprint);
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
        Certificate::Made { folder: path("a") }.load(&[]).unwrap();
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
        Certificate::Made { folder: path("b") }.load(&[]).unwrap();
        let mixed = Certificate::Files {
            certificate: path("a/certificate.pem"),
            key: path("b/key.pem"),
        };
        assert!(matches!(mixed.load(&[]), Err(TlsError::Unusable { .. })));
    }
}
