//! `ihd hob`: the simulated hob as a process of its own.

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use clap::Args;
use ihd_sim::hob::SimHob;
use ihd_sim::server::{Server, ServerEvent};

use super::interrupt;
use super::simulated::SimulatedHobArgs;

/// Runs a simulated hob, controlled by the firmware itself, behind a TCP port.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd hob --listen 127.0.0.1:4711\n  \
    ihd trainer --device tcp:127.0.0.1:4711      (in another terminal)\n  \
    ihd hob --listen 127.0.0.1:4711 --pot aluminium")]
pub struct HobArgs {
    /// Address and port to listen on; port 0 lets the system choose.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:4711")]
    listen: String,
    /// How much faster than real time the hob runs.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    speed: f64,
    #[command(flatten)]
    simulated: SimulatedHobArgs,
}

impl HobArgs {
    /// Runs until interrupted.
    pub fn run(&self) -> Result<()> {
        ensure_usage!(
            self.speed.is_finite() && self.speed > 0.0 && self.speed <= 100.0,
            "--speed is {}, but must lie between 0 and 100",
            self.speed
        );
        let hob = SimHob::new(&self.simulated.config()?);
        let mut server = Server::bind(&self.listen, hob)?;
        say!(
            "simulated hob with {} on tcp:{}; stop with ^C",
            self.simulated.pot(),
            server.address()
        )?;
        let stop: &AtomicBool = interrupt::flag().context("cannot catch ^C")?;
        server.run(self.speed, stop, |event| match event {
            ServerEvent::Connected(from) => println!("{from} connected"),
            ServerEvent::Disconnected => println!("disconnected"),
            ServerEvent::TurnedAway(from) => println!("{from} turned away: one host at a time"),
        })?;
        debug_assert!(stop.load(Ordering::Relaxed));
        Ok(())
    }
}
