//! `cargo xtask`: the project's own chores, so that a machine with cargo needs nothing else done by hand.

mod arrows;
mod budget;
mod call_graph;
mod count;
mod cycles;
mod emulator;
mod house;
mod images;
mod licences;
mod limits;
mod setup;
mod source;
mod steps;
mod stream;
mod summary;
mod toolchain;
mod workspace;

use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};

use images::Image;
use setup::Wanted;
use steps::{Session, Step};
use workspace::Workspace;

/// ihd's chores: set-up, tests, the firmware's images and what they may take.
#[derive(Parser)]
#[command(
    name = "cargo xtask",
    bin_name = "cargo xtask",
    version,
    after_help = "Example:\n  cargo xtask test"
)]
struct Cli {
    #[command(subcommand)]
    chore: Chore,
}

#[derive(Subcommand)]
enum Chore {
    Test(TestArgs),
    Setup(SetupArgs),
    /// Build the firmware's images: for the board, for the emulator, and to count instructions.
    #[command(after_help = "Example:\n  cargo xtask firmware")]
    Firmware(SetupArgs),
    /// Print the flash and RAM that each module of the image takes, and check firmware/budget.toml.
    ///
    /// Also shows that no call from the sampling path leads to a panic.
    #[command(after_help = "Example:\n  cargo xtask budget")]
    Budget(SetupArgs),
    Cycles(CyclesArgs),
}

/// Count the firmware's instructions on an emulated Cortex-M4F, against firmware/budget.toml.
#[derive(Args)]
#[command(after_help = "Example:\n  cargo xtask cycles --write")]
struct CyclesArgs {
    /// Put the table into docs/performance.md
    #[arg(long)]
    write: bool,
    #[command(flatten)]
    firmware: SetupArgs,
}

/// Run every check of the project; CI runs exactly this.
///
/// Installs what it needs first. All steps run even when one fails; the last line printed is `N passed, N failed`, and
/// a step that fails for another reason than a failing test counts there as one failure.
#[derive(Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask test\n  \
    cargo xtask test --only fmt --only clippy\n  \
    cargo xtask test --skip firmware --fail-fast")]
struct TestArgs {
    /// Run only this step (repeatable)
    #[arg(long, value_name = "STEP")]
    only: Vec<Step>,
    /// Leave this step out (repeatable)
    #[arg(long, value_name = "STEP", hide_possible_values = true)]
    skip: Vec<Step>,
    /// Stop at the first step that fails
    #[arg(long)]
    fail_fast: bool,
    #[command(flatten)]
    firmware: SetupArgs,
}

/// Find or install what the build needs, and say what was done.
///
/// The firmware is built by rustup's toolchain with the target thumbv7em-none-eabihf; where rustup cannot download
/// that target, by Debian's rustc-web and rust-web-src, which are installed when this runs as root on Debian.
#[derive(Args)]
#[command(after_help = "Examples:\n  \
    cargo xtask setup\n  \
    cargo xtask setup --toolchain debian-web")]
struct SetupArgs {
    /// Which compiler builds the firmware
    #[arg(long, value_name = "WHICH", default_value = "auto")]
    toolchain: Wanted,
}

fn main() -> ExitCode {
    let done = match Cli::parse().chore {
        Chore::Test(args) => test(&args),
        Chore::Setup(args) => set_up(&args),
        Chore::Firmware(args) => build_firmware(&args),
        Chore::Budget(args) => check_budget(&args),
        Chore::Cycles(args) => count_cycles(&args),
    };
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn test(args: &TestArgs) -> anyhow::Result<bool> {
    let chosen = steps::select(&args.only, &args.skip)?;
    let mut session = Session::new(Workspace::find()?, args.firmware.toolchain);
    let outcomes = steps::run_all(&mut session, &chosen, args.fail_fast);
    print!("{}", summary::render(&outcomes));
    Ok(outcomes.iter().all(|outcome| !outcome.failed()))
}

fn build_firmware(args: &SetupArgs) -> anyhow::Result<bool> {
    let mut session = Session::new(Workspace::find()?, args.toolchain);
    for image in Image::ALL {
        println!("{}: {}", image.name(), session.image(image)?.display());
    }
    Ok(true)
}

fn check_budget(args: &SetupArgs) -> anyhow::Result<bool> {
    Session::new(Workspace::find()?, args.toolchain).budget()?;
    Ok(true)
}

fn count_cycles(args: &CyclesArgs) -> anyhow::Result<bool> {
    Session::new(Workspace::find()?, args.firmware.toolchain).cycles(args.write)?;
    Ok(true)
}

fn set_up(args: &SetupArgs) -> anyhow::Result<bool> {
    setup::run(&Workspace::find()?, args.toolchain)?;
    Ok(true)
}
