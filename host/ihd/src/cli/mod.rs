//! The `ihd` command.

#[macro_use]
pub mod output;
#[macro_use]
pub mod usage;

pub mod calibrate;
pub mod capture_args;
#[cfg(feature = "daemon")]
pub mod configured;
pub mod convert;
#[cfg(feature = "daemon")]
pub mod demonstration;
#[cfg(feature = "daemon")]
pub mod device;
pub mod doctor;
pub mod exit;
pub mod flash;
pub mod global;
pub mod hob;
pub mod identify;
pub mod input_options;
pub mod inspect;
pub mod interrupt;
pub mod keys;
#[cfg(feature = "log")]
pub mod log;
pub mod moved;
#[cfg(feature = "pinn")]
pub mod network_args;
#[cfg(feature = "daemon")]
pub mod opener;
pub mod pages;
pub mod record;
pub mod recording_file;
pub mod replay;
pub mod sensor_args;
#[cfg(feature = "daemon")]
pub mod serve;
pub mod simulate;
pub mod simulated;
mod start;
#[cfg(feature = "daemon")]
pub mod store;
#[cfg(feature = "daemon")]
pub mod supervised;
#[cfg(feature = "pinn")]
pub mod trainer;
#[cfg(feature = "daemon")]
pub mod ui;
#[cfg(feature = "daemon")]
pub mod watch;

use anyhow::Result;
use clap::{Parser, Subcommand};
use ihd_flash::Image;
use ihd_shared::wire::{PROTOCOL_MAJOR, PROTOCOL_MINOR};

/// Identifies an induction hob's load and teaches its controller.
#[derive(Debug, Parser)]
#[command(name = "ihd", version, about)]
pub struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    global: global::Global,
}

/// Lines of `ihd --version` below the program's own: protocol, and the firmware's image in this program. Reading the image takes
/// time that no other command needs.
pub fn version_details() -> String {
    let image = match Image::built_in() {
        Some(Ok(image)) => format!("{}, build {}", image.build, image.build_id),
        Some(Err(error)) => error.to_string(),
        None => "none in this build".into(),
    };
    format!("protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}\nimage    {image}\n")
}

#[derive(Debug, Subcommand)]
enum Command {
    Calibrate(Box<calibrate::CalibrateArgs>),
    #[cfg(feature = "pinn")]
    Trainer(trainer::TrainerArgs),
    Convert(Box<convert::ConvertArgs>),
    #[cfg(feature = "daemon")]
    Device(Box<device::DeviceArgs>),
    Doctor(doctor::DoctorArgs),
    Flash(flash::FlashArgs),
    Hob(hob::HobArgs),
    Identify(Box<identify::IdentifyArgs>),
    Inspect(Box<inspect::InspectArgs>),
    #[cfg(feature = "log")]
    Log(log::LogArgs),
    Record(Box<record::RecordArgs>),
    Replay(Box<replay::ReplayArgs>),
    Simulate(Box<simulate::SimulateArgs>),
    #[cfg(feature = "daemon")]
    Store(Box<store::StoreArgs>),
    #[cfg(feature = "daemon")]
    Watch(watch::WatchArgs),
}

impl Cli {
    /// Runs the chosen subcommand; without one prints the next commands.
    ///
    /// # Errors
    /// Any error that ends it early, with its context.
    pub fn run(&self) -> Result<()> {
        let global = &self.global;
        let Some(command) = &self.command else {
            return start::print(global);
        };
        command.check(global)?;
        match command {
            Command::Calibrate(args) => args.run(global),
            #[cfg(feature = "pinn")]
            Command::Trainer(args) => args.run(global),
            Command::Convert(args) => args.run(global),
            #[cfg(feature = "daemon")]
            Command::Device(args) => args.run(global),
            Command::Doctor(args) => args.run(global),
            Command::Flash(args) => args.run(global),
            Command::Hob(args) => args.run(),
            Command::Identify(args) => args.run(global),
            Command::Inspect(args) => args.run(global),
            #[cfg(feature = "log")]
            Command::Log(args) => args.run(global),
            Command::Record(args) => args.run(global),
            Command::Replay(args) => args.run(global),
            Command::Simulate(args) => args.run(global),
            #[cfg(feature = "daemon")]
            Command::Store(args) => args.run(global),
            #[cfg(feature = "daemon")]
            Command::Watch(args) => args.run(global),
        }
    }
}

impl Command {
    /// Refuses the options of every command where they have no meaning.
    fn check(&self, global: &global::Global) -> Result<()> {
        let prints_json = !matches!(self, Self::Hob(_));
        ensure_usage!(
            prints_json || !global.json,
            "--json: this command prints none"
        );
        let reads_config = match self {
            Self::Doctor(_) | Self::Record(_) => true,
            #[cfg(feature = "log")]
            Self::Log(_) => true,
            // Says itself where its configuration is read.
            #[cfg(feature = "pinn")]
            Self::Trainer(_) => true,
            #[cfg(feature = "daemon")]
            Self::Device(_) | Self::Store(_) | Self::Watch(_) => true,
            _ => false,
        };
        ensure_usage!(
            reads_config || global.config.is_none(),
            "--config: this command reads no configuration of the daemon{}",
            match self {
                Self::Identify(_) => "; the estimators' settings are --settings FILE",
                _ => "",
            }
        );
        Ok(())
    }
}

/// Error and its causes in one line, each once: many messages quote their cause already.
pub fn message(error: &anyhow::Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}
