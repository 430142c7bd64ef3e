//! `ihd-fleet init`.

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand};
use ihd::cli::global::Global;
use ihd::{ensure_usage, say};
use ihd_daemon::config::is_name;
use ihd_fleet::jetstream::{self, FleetLimits};
use ihd_fleet::{claims, names};

use super::{AccessArgs, server_config, up};

/// Make what a fleet needs on the server: streams, consumers, buckets, with their limits; again after limits or hobs have changed
///
/// Nothing is deleted. What is already there gets the limits that are given, or those built in.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: ihd-fleet init --url nats://lab:4222 --threads 8 --edge lab-1=bench,kitchen"
)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct InitArgs {
    #[command(subcommand)]
    server: Option<ServerCommand>,
    /// Threads of all workers together: twice as many windows may be with workers
    #[arg(long, value_name = "N", default_value_t = FleetLimits::default().threads)]
    threads: u32,
    /// Bytes of windows that may wait for a worker; beyond them edges keep theirs
    #[arg(long, value_name = "BYTES", default_value_t = FleetLimits::default().windows_bytes)]
    windows_bytes: i64,
    /// Bytes of results
    #[arg(long, value_name = "BYTES", default_value_t = FleetLimits::default().results_bytes)]
    results_bytes: i64,
    /// Days that results are kept
    #[arg(long, value_name = "DAYS", default_value_t = FleetLimits::default().results_days)]
    results_days: u32,
    /// Bytes of captures
    #[arg(long, value_name = "BYTES", default_value_t = FleetLimits::default().captures_bytes)]
    captures_bytes: i64,
    /// Copies of everything in a cluster: 1, 3 or 5
    #[arg(long, value_name = "N", default_value_t = FleetLimits::default().replicas, value_parser = clap::value_parser!(u8).range(1..=5))]
    replicas: u8,
    /// An edge and its hobs, where its key may not make its own consumer (docs/fleet.md); may be given again
    #[arg(long = "edge", value_name = "EDGE=HOB,…", value_parser = edge)]
    edges: Vec<(String, Vec<String>)>,
    /// An edge whose store is gone for good: the next daemon of that name has it; may be given again
    #[arg(long = "free", value_name = "EDGE", value_parser = edge_name)]
    freed: Vec<String>,
    /// The firmware's build that hobs should have: others are shown as outdated. Empty: what most hobs of a board have
    #[arg(long, value_name = "BUILD")]
    build: Option<String>,
}

/// The server itself.
#[derive(Debug, Subcommand)]
enum ServerCommand {
    Up(up::UpArgs),
    ServerConfig(server_config::ServerConfigArgs),
}

fn edge_name(text: &str) -> Result<String, String> {
    match is_name(text) {
        true => Ok(text.to_owned()),
        false => Err(format!("{text:?} is no edge's name: a-z, 0-9, - and _")),
    }
}

/// Parses `EDGE=HOB,HOB`.
fn edge(text: &str) -> Result<(String, Vec<String>), String> {
    let wrong = || format!("{text:?} is not EDGE=HOB,HOB: names have a-z, 0-9, - and _");
    let (edge, hobs) = text.split_once('=').ok_or_else(wrong)?;
    let hobs: Vec<String> = hobs.split(',').map(str::to_owned).collect();
    let named = is_name(edge) && hobs.iter().all(|hob| is_name(hob));
    match named {
        true => Ok((edge.to_owned(), hobs)),
        false => Err(wrong()),
    }
}

impl InitArgs {
    pub(super) fn run(&self, access: &AccessArgs, global: &Global) -> Result<()> {
        match &self.server {
            Some(ServerCommand::Up(args)) => return args.run(),
            Some(ServerCommand::ServerConfig(args)) => return args.run(),
            None => {}
        }
        ensure_usage!(
            self.replicas % 2 == 1,
            "--replicas {}: 1, 3 or 5, else half a cluster cannot decide",
            self.replicas
        );
        let limits = FleetLimits {
            threads: self.threads,
            windows_bytes: self.windows_bytes,
            results_bytes: self.results_bytes,
            results_days: self.results_days,
            captures_bytes: self.captures_bytes,
            replicas: self.replicas,
            ..FleetLimits::default()
        };
        access.with(global, async |access, context| {
            jetstream::init(&context, &limits).await?;
            for (edge, hobs) in &self.edges {
                jetstream::init_edge(&context, edge, hobs).await?;
            }
            for edge in &self.freed {
                match claims::free(&context, edge).await? {
                    Some(claim) => say!(
                        "{edge} is free: it was of the store {} on host {}",
                        claim.store,
                        claim.host
                    )?,
                    None => say!("{edge} was free")?,
                }
            }
            if let Some(build) = &self.build {
                let settings = jetstream::bucket(&context, names::SETTINGS).await?;
                match build.is_empty() {
                    true => settings
                        .delete(names::BUILD)
                        .await
                        .map_err(anyhow::Error::from),
                    false => {
                        let put = settings.put(names::BUILD, build.clone().into()).await;
                        put.map(drop).map_err(anyhow::Error::from)
                    }
                }
                .context("the build that hobs should have")?;
            }
            say!(
                "{} is a fleet: windows up to {:.1} GB, results {} days and {:.1} GB, {} edges",
                access.shown(),
                1e-9 * self.windows_bytes as f64,
                self.results_days,
                1e-9 * self.results_bytes as f64,
                self.edges.len()
            )
        })
    }
}
