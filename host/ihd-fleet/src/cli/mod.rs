//! `ihd-fleet`: many hobs and many workers over NATS JetStream.

mod access;
mod captures;
mod dead;
mod init;
mod lookups;
mod server_config;
mod status;
mod up;
mod worker;

use anyhow::Result;
use clap::{Parser, Subcommand};
use ihd::cli::exit::{self, Exit};
use ihd::cli::global::Global;
use ihd::ensure_usage;

pub use access::AccessArgs;

/// Many hobs, many workers: set up a fleet on a NATS server, identify its windows, show its state, bring back what was given up.
///
/// A daemon with `[fleet] url = "nats://…"` is an edge: its windows go to the fleet, results and lookups come back. `ihd-fleet worker`
/// identifies. docs/fleet.md has a fleet in four commands.
#[derive(Debug, Parser)]
#[command(
    name = "ihd-fleet",
    version,
    about,
    after_help = "Examples:\n  \
    ihd-fleet init up --edge lab-1=bench\n  \
    ihd-fleet init --url nats://lab:4222\n  \
    ihd-fleet worker --url nats://lab:4222 --threads 4\n  \
    ihd-fleet status --json\n  \
    ihd-fleet status devices --outdated\n  \
    ihd-fleet status dead\n  \
    ihd-fleet retry --hob bench\n  \
    ihd-fleet lookup push bench lookup-v7.bin\n\n\
    Exit codes: 0 done, 1 failed, 2 wrong usage, 3 the server cannot be reached or says no, 7 `status --check` found something amiss"
)]
pub struct Cli {
    #[command(flatten)]
    access: AccessArgs,
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Worker(worker::WorkerArgs),
    Init(Box<init::InitArgs>),
    Status(status::StatusArgs),
    Retry(dead::RetryArgs),
    Lookup(lookups::LookupArgs),
    Capture(captures::FleetCaptureArgs),
}

/// Error of `ihd-fleet status --check`: the fleet needs attention.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct StatusCheckFailed(pub String);

impl Cli {
    /// Runs the command.
    ///
    /// # Errors
    /// The server cannot be reached or refuses; wrong usage.
    pub fn run(&self) -> Result<()> {
        let (access, global) = (&self.access, &self.global);
        let prints_json = match &self.command {
            Command::Status(_) => true,
            Command::Lookup(args) => args.prints_json(),
            Command::Capture(args) => args.prints_json(),
            Command::Worker(_) | Command::Init(_) | Command::Retry(_) => false,
        };
        ensure_usage!(
            prints_json || !global.json,
            "--json: this command prints none"
        );
        match &self.command {
            Command::Worker(args) => args.run(access, global),
            Command::Init(args) => args.run(access, global),
            Command::Status(args) => args.run(access, global),
            Command::Retry(args) => args.run(access, global),
            Command::Lookup(args) => args.run(access, global),
            Command::Capture(args) => args.run(access, global),
        }
    }
}

/// Returns the exit of an error: [`Exit::Unfit`] for a fleet that needs attention, else that of `ihd`.
pub fn exit_of(error: &anyhow::Error) -> Exit {
    match error.is::<StatusCheckFailed>() {
        true => Exit::Unfit,
        false => exit::exit_of(error),
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
