//! `--config`: choice of the configuration, and connection to the daemon that it describes.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Result;
use ihd_api::access::tokens::Tokens;
use ihd_api::client::ClientError;
use ihd_api::{ApiClient, ServerOptions, tls::Certificate};
use ihd_daemon::config::DaemonConfig;
use ihd_model::Role;

/// Configuration that is read if none is named and it exists.
const DEFAULT_FILE: &str = "ihd.toml";

/// Time limit for connecting to a daemon; after it none is running.
const THERE_WITHIN: Duration = Duration::from_millis(300);

/// Time limit for the daemon's answer: a busy daemon holds devices too, which must not be taken from it.
const ANSWERS_WITHIN: Duration = Duration::from_secs(5);

/// Environment variable with the token of a daemon whose token file cannot be read.
const TOKEN: &str = "IHD_TOKEN";

/// Reads the configuration of `--config`, else `ihd.toml` in the working folder, else uses the built-in one.
///
/// # Errors
/// If it cannot be read, or has an invalid key or value.
pub fn config(path: Option<&Path>) -> Result<DaemonConfig> {
    let here = Path::new(DEFAULT_FILE);
    let path = path.or_else(|| here.exists().then_some(here));
    Ok(match path {
        Some(path) => DaemonConfig::read(path)?,
        None => DaemonConfig::default(),
    })
}

/// Folder of the TLS files.
fn tls_folder(config: &DaemonConfig) -> PathBuf {
    config.store.join("tls")
}

/// Options of the daemon's API server.
pub fn server_settings(config: &DaemonConfig) -> ServerOptions {
    let tls = config
        .tls
        .as_ref()
        .map(|tls| match (&tls.certificate, &tls.key) {
            (Some(certificate), Some(key)) => Certificate::Files {
                certificate: certificate.clone(),
                key: key.clone(),
                folder: tls_folder(config),
            },
            _ => Certificate::Generated {
                folder: tls_folder(config),
            },
        });
    ServerOptions {
        listen: config.listen.to_string(),
        allowed_hosts: config.allowed_hosts.clone(),
        token_file: config.token_file.clone(),
        tls,
        backups: config.store.join(ihd_store::folder::BACKUPS),
    }
}

/// Connects to the daemon that the configuration describes; `None` if none is running.
///
/// # Errors
/// If the address is in use by a program that does not identify itself, or certificate or token cannot be read.
pub fn daemon(config: &DaemonConfig) -> Result<Option<ApiClient>> {
    let reached = reached_at(config.listen);
    if std::net::TcpStream::connect_timeout(&reached, THERE_WITHIN).is_err() {
        return Ok(None);
    }
    let scheme = if config.tls.is_some() {
        "https"
    } else {
        "http"
    };
    let tls = server_settings(config).tls;
    let trusted = tls.map_or(Vec::new(), |tls| vec![tls.files().0, tls.in_use()]);
    let url = format!("{scheme}://{reached}");
    let client = ApiClient::new(&url, &holder(), token(config)?, &trusted)?;
    match client.health(ANSWERS_WITHIN) {
        Ok(_) => Ok(Some(client)),
        Err(error @ ClientError::UnexpectedResponse { .. }) => {
            super::output::complain(format_args!("ihd: {error}; going without a daemon"));
            Ok(None)
        }
        Err(error) => Err(error.into()),
    }
}

/// URL at which a browser on this machine reaches a daemon that listens at `url`.
pub fn reached(url: &str, listen: SocketAddr) -> String {
    let scheme = url.split_once(':').map_or("http", |(scheme, _)| scheme);
    format!("{scheme}://{}", reached_at(listen))
}

/// Address at which a daemon on this machine that listens there is reached.
fn reached_at(listen: SocketAddr) -> SocketAddr {
    let ip = match listen.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        ip => ip,
    };
    SocketAddr::new(ip, listen.port())
}

/// Token of the lowest role that may command, else of one that may read; `None` if the daemon has no tokens.
fn token(config: &DaemonConfig) -> Result<Option<String>> {
    if let Ok(token) = std::env::var(TOKEN) {
        return Ok(Some(token));
    }
    let Some(path) = &config.token_file else {
        return Ok(None);
    };
    let tokens = Tokens::read(path)?;
    let token = tokens
        .at_least(Role::Operate)
        .or(tokens.at_least(Role::Read));
    Ok(token.map(str::to_owned))
}

/// Name of the client: user and process, since a user may have two terminals.
fn holder() -> String {
    let person = ["USER", "LOGNAME", "USERNAME"]
        .iter()
        .find_map(|name| std::env::var(name).ok())
        .unwrap_or_else(|| "somebody".into());
    format!("{person} (ihd, process {})", std::process::id())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_daemon_that_listens_everywhere_is_asked_on_loopback() {
        let at = |text: &str| reached_at(text.parse().unwrap()).to_string();
        assert_eq!(at("0.0.0.0:8731"), "127.0.0.1:8731");
        assert_eq!(at("[::]:1"), "[::1]:1");
        assert_eq!(at("192.168.1.5:8731"), "192.168.1.5:8731");
    }

    #[test]
    fn an_empty_tls_table_means_a_certificate_of_its_own() {
        let config = DaemonConfig::parse("store = \"s\"\n[tls]\n", "ihd.toml").unwrap();
        let made = Certificate::Generated {
            folder: "s/tls".into(),
        };
        assert_eq!(server_settings(&config).tls, Some(made));
        assert_eq!(server_settings(&DaemonConfig::default()).tls, None);
    }
}
