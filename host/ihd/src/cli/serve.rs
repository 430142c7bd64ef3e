//! `ihd trainer --daemon`: runs until told to stop, and leaves the hobs off.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::exit;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use ihd_api::{DaemonBackend, Server};
use ihd_daemon::Daemon;
use ihd_daemon::config::Config;
use tokio::runtime;
use tokio::sync::watch;
use tokio::time::timeout;
use tracing_subscriber::EnvFilter;

use super::opener::opener;
use super::{configured, supervised};

/// Longest that an orderly end may take: a hob that does not answer is switched off by itself after 10 s.
const END_WITHIN: Duration = Duration::from_secs(30);

/// What a second ^C leaves for switching off, which the first has begun.
const AT_ONCE: Duration = Duration::from_secs(1);

/// Exit code after a second ^C, as shells have it.
const INTERRUPTED: i32 = 130;

/// Where a daemon is asked for.
#[derive(Debug, Args)]
#[command(next_help_heading = "Daemon")]
pub struct ServeArgs {
    /// The same as --daemon.
    #[arg(value_name = "serve", conflicts_with_all = ALONE)]
    serve: Option<Serve>,
    /// Run until told to stop: find devices, store, learn from whatever heating goes on, take commands (`ihd device`)
    #[arg(long, conflicts_with_all = ALONE)]
    daemon: bool,
    /// Configuration of the daemon; without one ihd.toml of this folder, or what is built in (docs/daemon.md)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// How log lines are written, on standard error
    #[arg(long, value_name = "FORMAT", default_value = "text")]
    log_format: LogFormat,
}

/// Options of `ihd trainer` that say nothing to a daemon: devices have theirs in the configuration.
const ALONE: [&str; 11] = [
    "device", "power", "replay", "backend", "network", "store", "no_store", "follow", "json",
    "pot", "warming",
];

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Serve {
    Serve,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum LogFormat {
    /// A line an event, for people.
    Text,
    /// A JSON object an event.
    Json,
}

impl ServeArgs {
    /// Whether a daemon is asked for.
    ///
    /// # Errors
    /// When it is not, and its configuration is given all the same.
    pub fn asked(&self) -> Result<bool> {
        let asked = self.daemon || self.serve.is_some();
        ensure_usage!(
            asked || self.config.is_none(),
            "--config is the daemon's, with --daemon; settings of the network stand in --network FILE"
        );
        Ok(asked)
    }

    /// Runs until told to stop.
    ///
    /// # Errors
    /// A configuration that cannot work, a port in use, a store that cannot be opened.
    pub fn run(&self) -> Result<()> {
        let mut config = configured::config(self.config.as_deref())?;
        let open = opener(&mut config)?;
        start_log(self.log_format)?;
        let runtime = runtime::Builder::new_multi_thread()
            .enable_all()
            .build()
            .context("cannot start the daemon's threads")?;
        runtime.block_on(serve(config, open))
    }
}

fn start_log(format: LogFormat) -> Result<()> {
    let wanted = EnvFilter::builder()
        .with_default_directive(tracing::Level::INFO.into())
        .from_env()
        .context("RUST_LOG")?;
    let log = tracing_subscriber::fmt()
        .with_env_filter(wanted)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    let started = match format {
        LogFormat::Text => log.with_target(false).try_init(),
        LogFormat::Json => log.json().flatten_event(true).try_init(),
    };
    started.map_err(|why| anyhow::anyhow!("cannot start the log: {why}"))
}

async fn serve(config: Config, open: Arc<ihd_daemon::OpenDevice>) -> Result<()> {
    // Before anything heats or is opened: from here on ^C ends in order.
    let mut signals = supervised::Signals::new().context("cannot catch ^C")?;
    let settings = configured::server_settings(&config);
    let (store, devices) = (config.store.clone(), config.devices.len());
    let server = Server::bind(&settings).await?;
    let daemon = Daemon::start(config, open).await.with_context(|| {
        format!(
            "the store {}: set `store` to a folder that may be written, or mend it",
            store.display()
        )
    })?;
    let url = server.url();
    tracing::info!(url, store = %store.display(), devices, "the daemon listens");
    if let Some((fingerprint, file)) = server.certificate() {
        tracing::info!(fingerprint, file = %file.display(), "TLS certificate (SHA-256)");
    }
    if let Some(file) = server.made_tokens() {
        tracing::info!(file = %file.display(), "a token of each role was made");
    }
    let (stop, stopping) = watch::channel(false);
    let backend = Arc::new(DaemonBackend::new(daemon.clone()));
    let serving = tokio::spawn(server.run(backend, stopping));
    let watched = tokio::spawn(supervised::ready_and_alive(daemon.clone()));
    let signal = signals.next().await;
    tracing::info!(signal, "stopping: hobs off, windows under way stored");
    supervised::stopping();
    watched.abort();
    // Hobs first: nobody waits for a connection.
    let ending = async {
        stop.send_replace(true);
        daemon.stop().await;
        let _ = serving.await;
    };
    tokio::pin!(ending);
    tokio::select! {
        ended = timeout(END_WITHIN, &mut ending) => match ended {
            Ok(()) => tracing::info!("stopped"),
            Err(_) => {
                tracing::error!("not everything ended within {} s", END_WITHIN.as_secs());
                exit(1);
            }
        },
        signal = signals.next() => {
            tracing::warn!(signal, "once more: ending at once");
            let _ = timeout(AT_ONCE, ending).await;
            exit(INTERRUPTED);
        }
    }
    Ok(())
}
