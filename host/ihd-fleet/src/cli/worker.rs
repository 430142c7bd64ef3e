//! `ihd-fleet worker`: identifies windows of a fleet.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use anyhow::{Context, Result};
use clap::Args;
use ihd::cli::global::Global;
use ihd::cli::serve::{LogFormat, start_log};
use ihd::cli::supervised::Signals;
use ihd::ensure_usage;
use ihd_daemon::config::is_name;
use ihd_daemon::fleet::host_name;
use ihd_daemon::learning::WorkerAnswer;
use ihd_fleet::worker::{self, WorkerCounts, WorkerSettings};
use ihd_train::NetworkConfig;
use tokio::sync::watch;

use super::AccessArgs;

/// Identify windows of a fleet, until told to stop: takes them from the queue, publishes what it finds
///
/// Several may run, on as many machines; each may be killed at any moment. A window that was given to workers five times goes to the dead
/// (`ihd-fleet status dead`).
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd-fleet worker --url nats://lab:4222 --threads 4\n  \
    ihd-fleet worker --url tls://lab:4222 --ca ca.pem --nkey-file lab-worker-1.nk --name worker-1\n\n\
    Exit codes: 0 told to stop, 2 wrong usage, 3 the server cannot be reached, or has no fleet")]
pub struct WorkerArgs {
    /// Threads that identify; as many as the machine has without
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Its name in the fleet; that of the host with the process's number without
    #[arg(long)]
    name: Option<String>,
    /// TOML file with the network's settings, as of `ihd trainer`
    #[arg(long, value_name = "FILE")]
    network: Option<PathBuf>,
    /// Format of log lines, on standard error
    #[arg(long, value_name = "FORMAT", default_value = "text")]
    log_format: LogFormat,
}

impl WorkerArgs {
    pub(super) fn run(&self, access: &AccessArgs, global: &Global) -> Result<()> {
        let name = self.name.clone();
        let name = name.unwrap_or_else(|| format!("{}-{}", host_name(), std::process::id()));
        ensure_usage!(
            is_name(&name),
            "--name {name:?}: a name has 1 to 64 of a-z, 0-9, - and _"
        );
        let network = match &self.network {
            None => NetworkConfig::default(),
            Some(path) => {
                let text = std::fs::read_to_string(path);
                let text = text.with_context(|| format!("cannot read {}", path.display()))?;
                let wrong = || path.display().to_string();
                let network = NetworkConfig::from_toml(&text).with_context(wrong)?;
                network.validate().with_context(wrong)?;
                network
            }
        };
        let all = || std::thread::available_parallelism().map_or(1, usize::from);
        let settings = WorkerSettings {
            threads: self.threads.map_or_else(all, usize::from),
            network,
            identify: WorkerAnswer::compute,
            name,
        };
        let access = access.access(global)?;
        start_log(self.log_format, tracing::Level::INFO)?;
        let runtime =
            tokio::runtime::Runtime::new().context("cannot start the worker's threads")?;
        runtime.block_on(async {
            let mut signals = Signals::new().context("cannot catch ^C")?;
            let context = access.connect(&settings.name).await?;
            let (name, threads) = (settings.name.clone(), settings.threads);
            tracing::info!(name, threads, server = access.shown(), "works");
            let (stop, stopped) = watch::channel(false);
            let counts = Arc::new(WorkerCounts::default());
            let working = worker::run(context, settings, Arc::clone(&counts), stopped);
            tokio::pin!(working);
            let ended = tokio::select! {
                ended = &mut working => ended,
                signal = signals.next() => {
                    tracing::info!(signal, "stopping: what it is at is finished");
                    stop.send_replace(true);
                    tokio::select! {
                        ended = &mut working => ended,
                        // Another worker gets the windows under way.
                        _ = signals.next() => Ok(()),
                    }
                }
            };
            let (done, known, failed, dead) = (
                counts.done.load(Relaxed),
                counts.known.load(Relaxed),
                counts.failed.load(Relaxed),
                counts.dead.load(Relaxed),
            );
            tracing::info!(done, known, failed, dead, "stopped");
            Ok(ended?)
        })
    }
}
