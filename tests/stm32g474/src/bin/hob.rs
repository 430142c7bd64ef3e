//! Emulated board as a process: `cargo xtask hob`.

use std::net::TcpListener;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Context;
use clap::{Parser, ValueEnum};
use ihd_sim::behavioural::PotKind;
use ihd_sim::mains::SimulatedMains;
use ihd_sim::plant::Plant;
use ihd_sim::recording::settings::LoadKind;
use ihd_stm32g474::chip::random::Random;
use ihd_stm32g474::machine::Machine;
use ihd_stm32g474::pins::front_end;
use ihd_stm32g474::server;

/// Runs the controller's flash image on an emulated STM32G474 with the simulated power stage on its pins, its serial
/// port behind a TCP port.
#[derive(Parser)]
#[command(after_help = "Example:\n  \
    cargo xtask hob\n  \
    ihd record --device tcp:127.0.0.1:4711 --power 1200 --windows 3 out.mcap")]
struct Arguments {
    /// Flash image of the controller
    #[arg(long, value_name = "ELF")]
    image: PathBuf,
    /// Address to listen on for a host
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:4711")]
    listen: String,
    /// Pot on the coil
    #[arg(long, value_enum, default_value_t = Pot::Ferromagnetic)]
    pot: Pot,
    /// Mains frequency in hertz; default: the board's
    #[arg(long)]
    mains_hz: Option<f64>,
    /// Field model of the load, slower and more accurate than the behavioural one
    #[arg(long)]
    field: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Pot {
    Ferromagnetic,
    Aluminium,
    None,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let pot = match arguments.pot {
        Pot::Ferromagnetic => PotKind::Ferromagnetic,
        Pot::Aluminium => PotKind::Aluminium,
        Pot::None => PotKind::None,
    };
    let load = if arguments.field {
        LoadKind::Field
    } else {
        LoadKind::Behavioural
    };
    let mut mains = SimulatedMains::of_board();
    if let Some(hz) = arguments.mains_hz {
        mains = mains.changed(0.0, mains.v_rms_v(), hz);
    }
    let plant = Plant::with_load(mains, pot, load, front_end(1));
    let mut machine = Machine::new(&arguments.image, plant)?;
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH);
    let seed = since_1970.map_or(0, |t| t.as_micros() as u64);
    machine.chip().random = Random::new(seed);
    let listener = TcpListener::bind(&arguments.listen)
        .with_context(|| format!("cannot listen on {}", arguments.listen))?;
    println!(
        "{} on an emulated STM32G474, link on tcp:{}; stop with ^C",
        arguments.image.display(),
        listener.local_addr()?
    );
    Ok(server::serve(machine, &listener)?)
}
