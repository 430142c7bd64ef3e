//! `--config`: which configuration, and how the daemon that it describes is asked.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Result;
use ihd_api::access::{Role, tokens::Tokens};
use ihd_api::client::ClientError;
use ihd_api::{ApiClient, Settings, tls::Certificate};
use ihd_daemon::config::Config;

/// The configuration that is read when none is named and it is there.
const HERE: &str = "ihd.toml";

/// Where nobody takes the call within this, no daemon is there.
const THERE_WITHIN: Duration = Duration::from_millis(300);

/// Who took the call has this long to say that he is a daemon: a busy one holds devices too, which must not be taken from it.
const ANSWERS_WITHIN: Duration = Duration::from_secs(5);

/// Token for a daemon whose token file cannot be read from here.
const TOKEN: &str = "IHD_TOKEN";

/// The configuration of `--config`, else that of `ihd.toml` in the working folder, else the built-in one.
///
/// # Errors
/// When it cannot be read, or a key or value is none.
pub fn config(path: Option<&Path>) -> Result<Config> {
    let here = Path::new(HERE);
    let path = path.or_else(|| here.exists().then_some(here));
    Ok(match path {
        Some(path) => Config::read(path)?,
        None => Config::default(),
    })
}

/// Folder of what belongs to TLS.
fn tls_folder(config: &Config) -> PathBuf {
    config.store.join("tls")
}

/// How the daemon's API is set up.
pub fn server_settings(config: &Config) -> Settings {
    let tls = config
        .tls
        .as_ref()
        .map(|tls| match (&tls.certificate, &tls.key) {
            (Some(certificate), Some(key)) => Certificate::Files {
                certificate: certificate.clone(),
                key: key.clone(),
            },
            _ => Certificate::Made {
                folder: tls_folder(config),
            },
        });
    Settings {
        listen: config.listen.to_string(),
        allowed_hosts: config.allowed_hosts.clone(),
        token_file: config.token_file.clone(),
        tls,
        backups: config.store.join(ihd_store::folder::BACKUPS),
    }
}

/// A client of the daemon that the configuration describes, where one answers.
///
/// # Errors
/// When somebody is there who does not say who he is, or the certificate or token cannot be read.
pub fn daemon(config: &Config) -> Result<Option<ApiClient>> {
    let reached = reached_at(config.listen);
    if std::net::TcpStream::connect_timeout(&reached, THERE_WITHIN).is_err() {
        return Ok(None);
    }
    let scheme = if config.tls.is_some() {
        "https"
    } else {
        "http"
    };
    let ca = config.tls.as_ref().map(|tls| match &tls.certificate {
        Some(path) => path.clone(),
        None => tls_folder(config).join("certificate.pem"),
    });
    let url = format!("{scheme}://{reached}");
    let client = ApiClient::new(&url, &holder(), token(config)?, ca.as_deref())?;
    match client.health(ANSWERS_WITHIN) {
        Ok(_) => Ok(Some(client)),
        Err(error @ ClientError::Strange { .. }) => {
            super::output::complain(format_args!("ihd: {error}; going without a daemon"));
            Ok(None)
        }
        Err(error) => Err(error.into()),
    }
}

/// The URL of a daemon of this machine that says it listens at `url`, as a browser here reaches it.
pub fn reached(url: &str, listen: SocketAddr) -> String {
    let scheme = url.split_once(':').map_or("http", |(scheme, _)| scheme);
    format!("{scheme}://{}", reached_at(listen))
}

/// Where a daemon on this machine that listens there is reached.
fn reached_at(listen: SocketAddr) -> SocketAddr {
    let ip = match listen.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        ip => ip,
    };
    SocketAddr::new(ip, listen.port())
}

/// The lowest token that may command, else one that may look; none where the daemon has no tokens.
fn token(config: &Config) -> Result<Option<String>> {
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

/// Who asks: the person, and the process, for one person may have two terminals.
fn holder() -> String {
    let person = ["USER", "LOGNAME", "USERNAME"]
        .iter()
        .find_map(|name| std::env::var(name).ok())
        .unwrap_or_else(|| "somebody".into());
    format!("{person} (ihd device, process {})", std::process::id())
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
        let config = Config::parse("store = \"s\"\n[tls]\n", "ihd.toml").unwrap();
        let made = Certificate::Made {
            folder: "s/tls".into(),
        };
        assert_eq!(server_settings(&config).tls, Some(made));
        assert_eq!(server_settings(&Config::default()).tls, None);
    }
}
