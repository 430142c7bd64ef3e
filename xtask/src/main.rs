//! `cargo xtask`: tasks of the project, so that a machine with cargo needs no manual set-up.

mod board;
mod budget;
mod call_graph;
mod cycles;
mod dashboard;
mod dist;
mod emulator;
mod fuzz;
mod guest;
mod images;
mod on_target;
mod pypi;
mod python;
mod seal;
mod setup;
mod steps;
mod toolchain;
mod under_load;
mod workspace;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::{Parser, Subcommand};

use steps::{TestSession, Tier};
use workspace::Workspace;

/// Tasks of ihd: set-up, tests, fuzzing, the firmware's images and their limits.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", version)]
#[command(after_help = "Example:\n  cargo xtask test")]
struct Cli {
    #[command(subcommand)]
    chore: Chore,
}

#[derive(Subcommand)]
enum Chore {
    /// Run every check of the project's quick tier; CI runs exactly this.
    ///
    /// Installs what it needs first. All steps run even when one fails; a table of them comes last. How many tests
    /// passed stands where the tests ran.
    #[command(after_help = "Examples:\n  \
        cargo xtask test\n  \
        cargo xtask test --only fmt --only tests\n  \
        cargo xtask test --skip usb --fail-fast\n  \
        cargo xtask test --full\n  \
        cargo xtask test --under-load")]
    Test {
        /// Run only this step, of whatever tier (repeatable)
        #[arg(long, value_name = "STEP", value_parser = steps::parse)]
        only: Vec<&'static str>,
        /// Leave this step out (repeatable)
        #[arg(long, value_name = "STEP", value_parser = steps::parse)]
        skip: Vec<&'static str>,
        /// Stop at the first step that fails
        #[arg(long)]
        fail_fast: bool,
        /// Also every variant, soaks, long fuzzing, documentation: hours
        #[arg(long)]
        full: bool,
        /// Three times beside two endless loops, and once on a single core
        #[arg(long)]
        under_load: bool,
    },
    /// Build the firmware's images: for the board, and to count instructions.
    #[command(after_help = "Examples:\n  \
        cargo xtask firmware\n  \
        cargo xtask firmware --board boards/120v.toml")]
    Firmware {
        /// Board file (docs/board.md); default: boards/reference.toml
        #[arg(long, value_name = "TOML")]
        board: Option<PathBuf>,
    },
    /// Make a release in target/dist: archive and .deb for this machine's Linux, archive and installer for Windows,
    /// firmware, SBOM, checksums.
    Dist,
    /// Make one book of the documents, to search in a browser: target/book/html/index.html.
    Docs,
    /// Flash an image through a debug probe and show its log, until ^C: what `cargo run` in firmware/ does.
    ///
    /// Seals a copy first, as an image without its CRC heats nothing, and hands it to `probe-rs run`.
    #[command(after_help = "Example:\n  \
        cd firmware && cargo run --target thumbv7em-none-eabihf --profile firmware --features stm32g474")]
    Run {
        /// The image, as cargo has linked it
        image: PathBuf,
    },
    /// Count the firmware's instructions on an emulated Cortex-M4F, against firmware/budget.toml.
    #[command(after_help = "Example:\n  cargo xtask cycles --write")]
    Cycles {
        /// Write the table into docs/performance.md
        #[arg(long)]
        write: bool,
    },
    /// Run the tests that are for the controller itself (firmware/on-target): in QEMU, and on a board behind a debug probe.
    ///
    /// The board's part comes last, and fails without probe-rs or a board. It overwrites the board's program: `ihd flash`
    /// brings it back.
    TargetTests,
    /// Run the board's image on an emulated STM32G474 with the simulated power stage, its link on TCP.
    ///
    /// Every `ihd` command then works against the very bytes that are flashed: `--device tcp:ADDRESS`. It is slower than
    /// real time and reports by how much. Arguments after `--` go to it: `-- --help` lists its options.
    #[command(after_help = "Examples:\n  \
        cargo xtask hob\n  \
        cargo xtask hob --image old.elf -- --listen 127.0.0.1:4712 --pot aluminium")]
    Hob {
        /// The image; default: built from this checkout
        #[arg(long, value_name = "ELF")]
        image: Option<PathBuf>,
        /// Options of the emulated hob
        #[arg(last = true, value_name = "OPTIONS")]
        options: Vec<String>,
    },
    /// Fuzz the targets of fuzz/Cargo.toml with coverage feedback: one of them, or all in turn.
    ///
    /// Starts from fuzz/corpus/TARGET and the seeds named in fuzz/Cargo.toml. What reaches new code is kept in
    /// target/fuzz-corpus, what fails in target/fuzz-artifacts; the committed corpus stays as it is.
    #[command(after_help = "Examples:\n  \
        cargo xtask fuzz\n  \
        cargo xtask fuzz import --seconds 300")]
    Fuzz {
        /// The target; default: all in turn
        target: Option<String>,
        /// Time for each target, 0 until interrupted
        #[arg(long, default_value_t = 10)]
        seconds: u64,
    },
}

fn main() -> ExitCode {
    let Err(error) = run(Cli::parse()) else {
        return ExitCode::SUCCESS;
    };
    eprintln!("error: {error:#}");
    ExitCode::FAILURE
}

fn run(cli: Cli) -> anyhow::Result<()> {
    let mut workspace = Workspace::find()?;
    if let Chore::Firmware { board: Some(board) } = &cli.chore {
        let found = board.canonicalize();
        workspace.board = Some(found.with_context(|| board.display().to_string())?);
    }
    let tier = match cli.chore {
        Chore::Test { full: true, .. } => Tier::Full,
        _ => Tier::Quick,
    };
    let session = TestSession { workspace, tier };
    match cli.chore {
        Chore::Test {
            only,
            skip,
            fail_fast,
            under_load,
            ..
        } => {
            let steps = steps::select(tier, &only, &skip)?;
            let all = || steps::run_all(&session, &steps, fail_fast);
            match under_load {
                true => under_load::run(all),
                false => all(),
            }
        }
        Chore::Firmware { .. } => session.images(),
        Chore::Dist => session.dist(),
        Chore::Docs => dist::book(&session.workspace),
        Chore::Run { image } => images::run_on_board(&session.workspace, &image),
        Chore::Cycles { write } => session.cycles(write),
        Chore::TargetTests => session.target_tests(),
        Chore::Hob { image, options } => session.hob(image, &options),
        Chore::Fuzz { target, seconds } => {
            fuzz::fuzz(&session.workspace, target.as_deref(), seconds)
        }
    }
}
