//! `ihd fleet`: many hobs and many workers over NATS JetStream.

mod access;
mod captures;
mod dead;
mod init;
mod lookups;
mod server_config;
mod status;
mod up;

use anyhow::Result;
use clap::{Args, Subcommand};

pub use access::AccessArgs;

/// Many hobs, many workers: set up a fleet on a NATS server, show its state, bring back what was given up.
///
/// A daemon with `[fleet] url = "nats://…"` is an edge: its windows go to the fleet, results and lookups come back. `ihd worker` identifies.
/// docs/fleet.md has a fleet in four commands.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd fleet up --edge lab-1=bench\n  \
    ihd fleet init --url nats://lab:4222\n  \
    ihd fleet status --json\n  \
    ihd fleet devices --outdated\n  \
    ihd fleet dead\n  \
    ihd fleet replay --hob bench\n  \
    ihd fleet lookups push bench lookup-v7.json\n\n\
    Exit codes: 0 done, 1 failed, 2 wrong usage, 3 the server cannot be reached or says no, 7 `status --check` found something amiss")]
pub struct FleetArgs {
    #[command(flatten)]
    access: AccessArgs,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Up(up::UpArgs),
    Init(init::InitArgs),
    Status(status::StatusArgs),
    Devices(status::DevicesArgs),
    Backlog(status::BacklogArgs),
    Dead(dead::DeadArgs),
    Replay(dead::ReplayArgs),
    Lookups(lookups::LookupsArgs),
    Captures(captures::CapturesArgs),
    ServerConfig(server_config::ServerConfigArgs),
}

/// Error of `ihd fleet status --check`: the fleet needs attention.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct StatusCheckFailed(pub String);

impl FleetArgs {
    /// Runs the command.
    ///
    /// # Errors
    /// The server cannot be reached or refuses; wrong usage.
    pub fn run(&self) -> Result<()> {
        let access = &self.access;
        match &self.command {
            Command::Up(args) => args.run(),
            Command::Init(args) => args.run(access),
            Command::Status(args) => args.run(access),
            Command::Devices(args) => args.run(access),
            Command::Backlog(args) => args.run(access),
            Command::Dead(args) => args.run(access),
            Command::Replay(args) => args.run(access),
            Command::Lookups(args) => args.run(access),
            Command::Captures(args) => args.run(access),
            Command::ServerConfig(args) => args.run(),
        }
    }
}

/// Text of the time since something.
fn ago(at_ms: i64) -> String {
    if at_ms == 0 {
        return "never".to_owned();
    }
    let now_ms = jiff::Timestamp::now().as_millisecond();
    let seconds = now_ms.saturating_sub(at_ms).max(0) / 1_000;
    match seconds {
        0..120 => format!("{seconds} s"),
        120..7_200 => format!("{} min", seconds / 60),
        7_200..172_800 => format!("{} h", seconds / 3_600),
        _ => format!("{} d", seconds / 86_400),
    }
}
