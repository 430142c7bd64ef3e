//! `ihd-fleet init`.

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand};
use ihd::cli::global::Global;
use ihd::{ensure_usage, say};
use ihd_daemon::config::is_name;
use ihd_fleet::jetstream::{self, FleetLimits};
use ihd_fleet::server_config::EdgeAccount;
use ihd_fleet::{claims, names};

use super::{AccessArgs, server_config, up};

/// Make what a fleet needs on the server: streams, consumers, buckets, with their limits; again after limits or hobs have changed
///
/// Nothing is deleted: a limit below what is there is refused. A limit that is not given stays as the server has it.
#[derive(Debug, Args)]
#[command(
    after_help = "Example: ihd-fleet init --url nats://lab:4222 --threads 8 --edge lab-1=bench,kitchen"
)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct InitArgs {
    #[command(subcommand)]
    server: Option<ServerCommand>,
    /// Threads of all workers together: twice as many windows may be with workers [new fleet: 64]
    #[arg(long, value_name = "N")]
    threads: Option<u32>,
    /// Bytes of windows that may wait for a worker; beyond them edges keep theirs [new fleet: 4000000000]
    #[arg(long, value_name = "BYTES")]
    windows_bytes: Option<i64>,
    /// Bytes of results [new fleet: 2000000000]
    #[arg(long, value_name = "BYTES")]
    results_bytes: Option<i64>,
    /// Days that results are kept [new fleet: 30]
    #[arg(long, value_name = "DAYS")]
    results_days: Option<u32>,
    /// Bytes of captures [new fleet: 2000000000]
    #[arg(long, value_name = "BYTES")]
    captures_bytes: Option<i64>,
    /// Copies of everything in a cluster: 1, 3 or 5 [new fleet: 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=5))]
    replicas: Option<u8>,
    /// An edge and its hobs, where its key may not make its own consumer (docs/fleet.md); may be given again
    #[arg(long = "edge", value_name = "EDGE=HOB,…")]
    edges: Vec<EdgeAccount>,
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

impl InitArgs {
    /// Returns the server's limits with those that are given.
    fn limits(&self, there: FleetLimits) -> FleetLimits {
        FleetLimits {
            threads: self.threads.unwrap_or(there.threads),
            windows_bytes: self.windows_bytes.unwrap_or(there.windows_bytes),
            results_bytes: self.results_bytes.unwrap_or(there.results_bytes),
            results_days: self.results_days.unwrap_or(there.results_days),
            captures_bytes: self.captures_bytes.unwrap_or(there.captures_bytes),
            replicas: self.replicas.unwrap_or(there.replicas),
            ..there
        }
    }

    pub(super) fn run(&self, access: &AccessArgs, global: &Global) -> Result<()> {
        match &self.server {
            Some(ServerCommand::Up(args)) => return args.run(),
            Some(ServerCommand::ServerConfig(args)) => return args.run(),
            None => {}
        }
        if let Some(replicas) = self.replicas {
            ensure_usage!(
                replicas % 2 == 1,
                "--replicas {replicas}: 1, 3 or 5, else half a cluster cannot decide"
            );
        }
        access.with(global, async |access, context| {
            let limits = self.limits(jetstream::limits(&context).await?.unwrap_or_default());
            jetstream::init(&context, &limits).await?;
            for edge in &self.edges {
                jetstream::init_edge(&context, &edge.name, &edge.hobs).await?;
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
                "{} is a fleet: windows up to {:.1} GB, results {} days and {:.1} GB",
                access.shown(),
                1e-9 * limits.windows_bytes as f64,
                limits.results_days,
                1e-9 * limits.results_bytes as f64
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        init: InitArgs,
    }

    #[test]
    fn a_limit_that_is_not_given_stays_and_the_help_says_what_a_new_fleet_has() {
        let there = FleetLimits {
            results_bytes: 300_000_000,
            captures_bytes: 3_000_000,
            ..FleetLimits::default()
        };
        let given = Cli::parse_from(["init", "--threads", "8", "--edge", "new=hob"]);
        let limits = given.init.limits(there.clone());
        assert_eq!(
            limits,
            FleetLimits {
                threads: 8,
                ..there
            }
        );
        let help = <Cli as clap::CommandFactory>::command()
            .render_long_help()
            .to_string();
        let new = FleetLimits::default();
        for (option, number) in [
            ("--threads", i64::from(new.threads)),
            ("--windows-bytes", new.windows_bytes),
            ("--results-bytes", new.results_bytes),
            ("--results-days", i64::from(new.results_days)),
            ("--captures-bytes", new.captures_bytes),
            ("--replicas", i64::from(new.replicas)),
        ] {
            let after = help.split(&format!("{option} <")).nth(1).unwrap();
            let text = after.split("\n      --").next().unwrap();
            // Lines are as wide as the terminal.
            let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(
                text.contains(&format!("[new fleet: {number}]")),
                "{option}: {text}"
            );
        }
    }
}
