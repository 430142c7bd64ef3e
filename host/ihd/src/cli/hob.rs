//! `ihd hob`: simulated hob as a process of its own.

use std::io::BufRead;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, channel};
use std::thread;

use anyhow::{Context, Result};
use clap::Args;
use ihd_sim::hob::{PanelEvent, SimHob};
use ihd_sim::scenario::ScenarioError;
use ihd_sim::scenario::file::Scenario;
use ihd_sim::scenario::script::ScenarioScript;
use ihd_sim::server::{DisconnectReason, HobServer, ServerEvent};

use super::interrupt;
use super::output::complain;
use super::simulated::SimulatedHobArgs;

/// Name of standard input as a script.
const STDIN: &str = "-";

/// Limit of the speed; the machine may not reach it, which the hob reports.
const MAX_SPEED: f64 = 1000.0;

/// Runs a simulated hob, controlled by the firmware itself, behind a TCP port.
///
/// One host at a time, as on a cable. A host that does not say hello within 5 s or sends no frame for 30 s is let
/// go; after 10 s without a frame another one may take its place. What a host leaves unread the hob drops and
/// counts, as a board does.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd hob --listen 127.0.0.1:4711\n  \
    ihd trainer --device tcp:127.0.0.1:4711      (in another terminal)\n  \
    ihd hob --listen 127.0.0.1:4711 --pot aluminium\n  \
    ihd hob --panel 6 --sim warming              (heats by itself)\n  \
    ihd hob --panel 6 --sim contents=water-1.5   (and boils)\n  \
    ihd hob --script kitchen.toml --sim seed=2\n\n\
A script is a file as of `ihd simulate` without events of a host; when its duration is over it begins anew:\n  \
    duration_s = 60\n  \
    load = \"behavioural\"\n  \
    [[event]]\n  \
    at_s = 1\n  \
    panel = 6\n  \
    [[event]]\n  \
    at_s = 20\n  \
    pot = { name = \"none\", for_s = 3 }\n  \
    [[event]]\n  \
    at_s = 40\n  \
    mains = { v_rms = 160, for_s = 0.3 }\n\n\
With --script - a line is an event of such a script, without its time:\n  \
    pot = \"none\"\n  \
    pot = \"ferritic-21\"\n  \
    panel = 6\n  \
    mains = { v_rms = 160, for_s = 0.3 }")]
pub struct HobArgs {
    /// Address and port to listen on; port 0 lets the system choose. Nothing but loopback is safe: who connects may
    /// heat
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:4711")]
    listen: String,
    /// Speed of the hob relative to real time, up to 1000. Where the machine is too slow for it, the hob says so
    /// once a minute
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    speed: f64,
    /// Switch it on at its panel at the start: power level 1 to 9
    #[arg(long, value_name = "LEVEL", value_parser = clap::value_parser!(u8).range(1..=9))]
    panel: Option<u8>,
    /// Events of pot, mains and panel, repeated; the file's head also describes the hob, and only --sim seed=N goes with it. With
    /// `-` they are read from standard input, one per line, as they come; both by giving it again
    #[arg(long, value_name = "FILE.toml|-")]
    script: Vec<PathBuf>,
    #[command(flatten)]
    simulated: SimulatedHobArgs,
}

impl HobArgs {
    /// Runs until interrupted.
    ///
    /// # Errors
    /// An invalid script, or a port that cannot be listened on.
    pub fn run(&self) -> Result<()> {
        ensure_usage!(
            self.speed.is_finite() && self.speed > 0.0 && self.speed <= MAX_SPEED,
            "--speed is {}, but must lie between 0 and {MAX_SPEED}",
            self.speed
        );
        let (mut hob, script) = self.hob()?;
        if let Some(level) = self.panel {
            hob.panel(PanelEvent::Level(level));
        }
        let pot = hob.pot();
        let mut server = HobServer::bind(&self.listen, hob)?;
        if let Some(script) = script {
            server.set_script(script);
        }
        // Before it says how it is stopped.
        let stop = interrupt::flag().context("cannot catch ^C")?;
        say!(
            "simulated hob with {pot} on tcp:{}; stop with ^C",
            server.address()
        )?;
        if !server.address().ip().is_loopback() {
            complain(format_args!(
                "warning: {} is not loopback, and there is no authentication: any host that reaches this port can command the hob",
                server.address()
            ));
        }
        if self.script.iter().any(|file| file == Path::new(STDIN)) {
            server.receive_scenarios(stdin_scenarios());
        }
        let speed = self.speed;
        server.run(speed, stop, |event| print_event(speed, event))?;
        Ok(())
    }

    fn hob(&self) -> Result<(SimHob, Option<ScenarioScript>)> {
        let mut files = self.script.iter().filter(|file| *file != Path::new(STDIN));
        let options = self.simulated.options()?;
        let Some(path) = files.next() else {
            return Ok((SimHob::new(&options.config()?.with_unique_boot()), None));
        };
        ensure_usage!(
            files.next().is_none(),
            "--script: one file, and `-` beside it"
        );
        ensure_usage!(
            self.simulated.is_seed_only(),
            "--script {}: its head describes the hob; only --sim seed=N goes with it",
            path.display()
        );
        let of_script = || format!("script {}", path.display());
        let scenario = Scenario::read(path).with_context(of_script)?;
        let mut config = scenario.file.hob();
        config.seed = options.seed().unwrap_or(config.seed);
        let mut hob = SimHob::assemble(&config.with_unique_boot()).with_context(of_script)?;
        let script = ScenarioScript::new(&scenario, &mut hob).with_context(of_script)?;
        Ok((hob, Some(script)))
    }
}

/// Receives scenarios from standard input; the thread ends with it or with the process.
fn stdin_scenarios() -> Receiver<Scenario> {
    let (sender, scenarios) = channel();
    thread::spawn(move || {
        for line in std::io::stdin().lock().lines() {
            let line = match line {
                Ok(line) => line,
                Err(why) => {
                    complain(format_args!(
                        "warning: standard input is read no more: {why}"
                    ));
                    return;
                }
            };
            if line.trim().is_empty() {
                continue;
            }
            match event(&line) {
                Ok(event) => {
                    if sender.send(event).is_err() {
                        return;
                    }
                }
                Err(why) => complain(format_args!(
                    "warning: `{line}` is no event of a script: {why}"
                )),
            }
        }
    });
    scenarios
}

/// Parses a scenario of one immediate event.
fn event(line: &str) -> Result<Scenario, ScenarioError> {
    let text = format!("duration_s = 1\n[[event]]\nat_s = 0\n{line}\n");
    Scenario::parse(&text, PathBuf::new())
}

/// Prints one line per event; errors of the output are ignored.
fn print_event(speed: f64, event: ServerEvent) {
    let _ = match event {
        ServerEvent::Connected(from) => say!("{from} connected"),
        ServerEvent::TurnedAway(from) => say!("{from} turned away: one host at a time"),
        ServerEvent::Disconnected { why, asked_w } => {
            let why = match why {
                DisconnectReason::Left => "",
                DisconnectReason::NoHello => ": no hello that fits within 5 s",
            };
            match asked_w {
                0 => say!("disconnected{why}"),
                _ => say!(
                    "disconnected{why}; {asked_w} W stay asked for until 10 s pass or another host says hello"
                ),
            }
        }
        ServerEvent::Impossible(why) => {
            complain(format_args!("warning: {why}"));
            Ok(())
        }
        ServerEvent::Lagging(share) => say!(
            "this machine is too slow for {speed} times real time: {:.0} % of the last minute was left out",
            100.0 * share
        ),
    };
}
