//! `ihd trainer --daemon`: runs until stopped, and leaves the hobs off.

use std::io::IsTerminal;
use std::process::exit;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use ihd_api::ApiServer;
use ihd_daemon::config::DaemonConfig;
use ihd_daemon::fleet::FleetConfig;
use ihd_daemon::{Daemon, DaemonError};
use ihd_store::StoreError;
use tokio::runtime;
use tokio::sync::watch;
use tokio::time::timeout;
use tracing_subscriber::EnvFilter;

use super::demonstration::{self, Demonstration};
use super::global::Global;
use super::opener::opener;
use super::{configured, supervised, ui};

/// Time limit of an orderly end: a hob that does not answer switches itself off after 10 s.
const END_WITHIN: Duration = Duration::from_secs(30);

/// Time left for switching off after a second Ctrl-C; the first has started it.
const FORCED_STOP_TIME: Duration = Duration::from_secs(1);

/// Threads of the server: while one converts a recording or thins out a stream, the other answers.
const SERVER_THREADS: usize = 2;

/// Error after which a supervisor starts the daemon anew.
const SERVER_ENDED: &str = "the daemon's server has ended by an error of ihd";

/// Exit code after a second Ctrl-C, as used by shells.
const INTERRUPTED: i32 = 130;

/// Arguments of the daemon.
#[derive(Debug, Args)]
#[command(next_help_heading = "Daemon")]
pub struct ServeArgs {
    /// Run until told to stop: find devices, store, learn from whatever heating goes on, take commands (`ihd device`)
    #[arg(long, conflicts_with_all = ALONE)]
    daemon: bool,
    /// Open the daemon's page in a browser. Without --daemon, a demonstration: a daemon whose simulated hob heats with --power, again
    /// and again, until a client commands it
    #[arg(long, conflicts_with_all = ["replay", "follow"])]
    ui: bool,
    /// Format of log lines, on standard error
    #[arg(long, value_name = "FORMAT", default_value = "text")]
    log_format: LogFormat,
}

/// Options of `ihd trainer` that do not apply to the daemon, whose devices are in the configuration.
const ALONE: [&str; 8] = [
    "device", "power", "replay", "network", "store", "follow", "sim", "pot",
];

/// Format of log lines.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum LogFormat {
    /// One line of text per event.
    Text,
    /// One JSON object per event.
    Json,
}

/// Mode requested beside the trainer itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServeMode {
    /// None.
    None,
    /// Daemon.
    Daemon,
    /// Page with a hob that heats by itself.
    Demonstration,
}

impl ServeArgs {
    /// Returns the requested mode.
    ///
    /// # Errors
    /// If none is requested but the daemon's configuration is given.
    pub fn mode(&self, global: &Global) -> Result<ServeMode> {
        let mode = match self.daemon {
            true => ServeMode::Daemon,
            false if self.ui => ServeMode::Demonstration,
            false => ServeMode::None,
        };
        ensure_usage!(
            mode != ServeMode::None || global.config.is_none(),
            "--config is the daemon's, with --daemon or --ui; settings of the network stand in --network FILE"
        );
        ensure_usage!(
            mode == ServeMode::None || !global.json,
            "--json prints the report of a training run, which --daemon and --ui do not make"
        );
        Ok(mode)
    }

    /// Runs until stopped.
    ///
    /// # Errors
    /// An invalid configuration, a port in use, a store that cannot be opened.
    pub fn run(&self, global: &Global) -> Result<()> {
        let config = configured::config(global.config.as_deref())?;
        if self.ui
            && let Some(daemon) = configured::daemon(&config)?
        {
            say!("a daemon runs already: its page is {}/", daemon.url())?;
            ui::open(&format!("{}/", daemon.url()));
            return Ok(());
        }
        self.start(config, tracing::Level::INFO, None)
    }

    /// Runs a daemon with a hob that heats by itself until stopped.
    ///
    /// # Errors
    /// Any error of [`Self::run`].
    pub fn demonstrate(&self, demonstration: Demonstration, global: &Global) -> Result<()> {
        let of_file = global
            .config
            .as_deref()
            .map(DaemonConfig::read)
            .transpose()?;
        let config = demonstration.config(of_file);
        self.start(config, tracing::Level::WARN, Some(demonstration))
    }

    fn start(
        &self,
        mut config: DaemonConfig,
        level: tracing::Level,
        demonstration: Option<Demonstration>,
    ) -> Result<()> {
        let open = opener(&mut config)?;
        start_log(self.log_format, level)?;
        let runtime = runtime::Builder::new_multi_thread()
            .enable_all()
            .build()
            .context("cannot start the daemon's threads")?;
        // Threads of their own: a request to switch off waits behind no event of any device.
        let of_server = runtime::Builder::new_multi_thread()
            .worker_threads(SERVER_THREADS)
            .thread_name("ihd-server")
            .enable_all()
            .build()
            .context("cannot start the server's threads")?;
        let serving = serve(config, open, of_server.handle(), self.ui, demonstration);
        runtime.block_on(serving)
    }
}

/// Starts the log on standard error.
///
/// # Errors
/// If $RUST_LOG cannot be parsed.
pub fn start_log(format: LogFormat, level: tracing::Level) -> Result<()> {
    let filter = EnvFilter::builder()
        .with_default_directive(level.into())
        .from_env()
        .context("RUST_LOG")?;
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        // A reader of the log that is gone ends nothing: they would be printed where nothing can be.
        .log_internal_errors(false)
        .with_ansi(std::io::stderr().is_terminal());
    let started = match format {
        LogFormat::Text => log.with_target(false).try_init(),
        LogFormat::Json => log.json().flatten_event(true).try_init(),
    };
    started.map_err(|why| anyhow::anyhow!("cannot start the log: {why}"))
}

async fn serve(
    config: DaemonConfig,
    open: Arc<ihd_daemon::OpenDevice>,
    of_server: &runtime::Handle,
    shows: bool,
    demonstration: Option<Demonstration>,
) -> Result<()> {
    // Installed before anything heats or is opened, so that Ctrl-C ends in order.
    let mut signals = supervised::Signals::new().context("cannot catch ^C")?;
    let settings = configured::server_settings(&config);
    let (store, devices) = (config.store.clone(), config.devices.len());
    let fleet = config.fleet.clone();
    ensure_usage!(
        fleet.is_none() || cfg!(feature = "fleet"),
        "[fleet]: this ihd was built without it; `cargo build --features fleet`"
    );
    let binding = of_server.spawn(async move { ApiServer::bind(&settings).await });
    let server = binding.await.context("the server's threads")??;
    let started = Daemon::start(config, open).await;
    let daemon = started.map_err(|error| match &error {
        DaemonError::Store(StoreError::InUse { .. }) | DaemonError::Config(_) => {
            anyhow::Error::from(error)
        }
        _ => anyhow::Error::from(error).context(format!(
            "the store {}: set `store` to a folder that may be written, or mend it",
            store.display()
        )),
    })?;
    let url = server.url();
    let page = format!("{}/", configured::reached(&url, server.address()));
    tracing::info!(url, store = %store.display(), devices, "the daemon listens");
    log_secrets(&server);
    let edge = edge(&daemon, fleet).await;
    let (stop, stopping) = watch::channel(false);
    let mut serving = of_server.spawn(server.run(daemon.clone(), stopping));
    let watched = tokio::spawn(supervised::ready_and_alive(daemon.clone()));
    if shows {
        say!("{}", page_text(&page, demonstration.as_ref()))?;
        ui::open(&page);
    }
    let heating = demonstration.map(|d| tokio::spawn(heat_until_taken(daemon.clone(), d)));
    // Without the server no client could switch a hob off.
    let signal = tokio::select! {
        signal = signals.next() => Some(signal),
        _ = &mut serving => None,
    };
    if let Some(heating) = heating {
        heating.abort();
    }
    match signal {
        Some(signal) => tracing::info!(signal, "stopping: hobs off, windows under way stored"),
        None => tracing::error!("{SERVER_ENDED}: hobs off, windows under way stored"),
    }
    supervised::stopping();
    watched.abort();
    // Hobs first: they do not wait for connections.
    let ending = async {
        stop.send_replace(true);
        // Hobs do not wait for the fleet.
        tokio::join!(end(edge), daemon.stop());
        if signal.is_some() {
            let _ = serving.await;
        }
    };
    end_in_time(ending, &mut signals).await;
    anyhow::ensure!(signal.is_some(), SERVER_ENDED);
    Ok(())
}

/// Logs where certificate and tokens are.
fn log_secrets(server: &ApiServer) {
    if let Some((fingerprint, file)) = server.certificate() {
        tracing::info!(fingerprint, file = %file.display(), "TLS certificate (SHA-256)");
    }
    if let Some(file) = server.created_tokens() {
        tracing::info!(file = %file.display(), "a token of each role was made");
    }
}

/// Awaits an orderly end; ends the process where that takes too long, or after a second Ctrl-C.
async fn end_in_time(ending: impl Future<Output = ()>, signals: &mut supervised::Signals) {
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
            let _ = timeout(FORCED_STOP_TIME, ending).await;
            exit(INTERRUPTED);
        }
    }
}

/// Starts the daemon as an edge of a fleet, if configured. Hobs do not wait for the fleet: without a file of it the daemon runs alone, with an
/// alarm.
#[cfg(feature = "fleet")]
async fn edge(daemon: &Daemon, fleet: Option<FleetConfig>) -> Option<ihd_fleet::Edge> {
    let config = fleet?;
    match ihd_fleet::Edge::start(daemon.clone(), &config).await {
        Ok(edge) => Some(edge),
        Err(why) => {
            let alarm =
                format!("[fleet] of the configuration: {why}; mend it and start the daemon again");
            tracing::error!("the daemon runs without its fleet: {alarm}");
            daemon.fleet().set_report(ihd_model::FleetReport {
                server: ihd_daemon::fleet::without_secrets(&config.url),
                edge: config.edge_name(),
                why: why.to_string(),
                alarms: vec![alarm],
                ..ihd_model::FleetReport::default()
            });
            None
        }
    }
}

#[cfg(feature = "fleet")]
async fn end(edge: Option<ihd_fleet::Edge>) {
    if let Some(edge) = edge {
        edge.stop().await;
    }
}

#[cfg(not(feature = "fleet"))]
async fn edge(_: &Daemon, _: Option<FleetConfig>) -> Option<std::convert::Infallible> {
    None
}

#[cfg(not(feature = "fleet"))]
async fn end(_: Option<std::convert::Infallible>) {}

/// Text for a user who requested the page.
fn page_text(page: &str, demonstration: Option<&Demonstration>) -> String {
    match demonstration {
        None => format!("the page is {page}"),
        Some(_) => format!(
            "the page is {page} and shows a simulated hob that heats by itself until a client commands it; ^C ends it"
        ),
    }
}

async fn heat_until_taken(daemon: Daemon, d: Demonstration) {
    let somebody = demonstration::heat(daemon, demonstration::DEVICE, d.powers_w).await;
    // An error of the output is no reason to end.
    let _ = say!("{somebody} commands the hob now: it heats no more by itself");
}
