//! `ihd watch`: the dashboard in a terminal, through the daemon.
//!
//! ```text
//! feed (threads: reports, events, off) ── FeedUpdate ─► Dashboard (state) ─► screen (one frame)
//! ```

mod dashboard;
mod device_panes;
mod feed;
mod screen;
mod trend;
mod trend_charts;

use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::Args;
use ihd_api::client::ClientError;
use ihd_model::CommandError;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event};

use self::dashboard::{Dashboard, KeyAction};
use self::feed::{Feed, FeedUpdate};
use super::global::Global;
use super::usage::Usage;
use super::{configured, device, interrupt};

/// Shortest time between two frames: a terminal over ssh is slow.
const FRAME: Duration = Duration::from_millis(100);

/// Period of polling keys and updates.
const POLL_PERIOD: Duration = Duration::from_millis(50);

/// Watch devices in a terminal: power, R and L over the last minutes, states, faults, events.
///
/// Through the daemon; it goes on when the daemon is restarted. Keys: arrows or 1 to 9 choose a device, o or Escape switches
/// it off (that needs no lease), p stops and resumes drawing, q ends.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd watch\n  \
    ihd watch bench --config ihd.toml\n  \
    ihd watch bench --lines --json\n  \
    ssh lab ihd watch\n\n\
    Exit codes: 0 ended, 2 no such device or not a terminal, 3 no daemon")]
pub struct WatchArgs {
    /// The device; without one, all that the daemon has
    #[arg(value_name = "DEV")]
    device: Option<String>,
    /// Print a line for each event of DEV until ^C, for programs and logs; with --json an object a line. Without a daemon, too
    #[arg(long, requires = "device")]
    lines: bool,
}

impl WatchArgs {
    /// Draws until q, Ctrl-C or a signal.
    ///
    /// # Errors
    /// Without --lines: if this is no terminal, no daemon answers at the beginning, or it has no such device.
    pub fn run(&self, global: &Global) -> Result<()> {
        let config = configured::config(global.config.as_deref())?;
        if let (true, Some(device)) = (self.lines, &self.device) {
            return device::lines(config, device, global.json);
        }
        ensure_usage!(
            !global.json,
            "--json goes with --lines: `ihd watch DEV --lines --json`"
        );
        if !(std::io::stdout().is_terminal() && std::io::stdin().is_terminal()) {
            let device = self.device.as_deref().unwrap_or("DEV");
            return Err(Usage(format!(
                "`ihd watch` draws on a terminal, and this is none: `ihd watch {device} --lines` writes lines"
            ))
            .into());
        }
        let client = configured::daemon(&config)?.ok_or_else(|| ClientError::Unreachable {
            url: config.listen.to_string(),
            why: "start one with `ihd trainer --daemon`, or look at a device itself: `ihd watch DEV --lines`".into(),
        })?;
        let devices = client.devices()?;
        if let Some(name) = &self.device
            && !devices.iter().any(|d| d.name == *name)
        {
            let name = name.clone();
            return Err(CommandError::NoDevice { name }.into());
        }
        let stop = interrupt::flag().context("cannot catch ^C")?;
        let mut dashboard = Dashboard::new(client.url(), self.device.clone());
        dashboard.apply(FeedUpdate::Devices(devices), device::now_ms());
        let (feed, updates) = Feed::start(client, self.device.clone());
        // From here on a panic restores the terminal before its message is printed.
        let mut terminal = ratatui::try_init().context("cannot set up this terminal")?;
        let ended = watch(&mut terminal, &mut dashboard, &feed, &updates, stop);
        ratatui::try_restore().context("cannot restore this terminal")?;
        ended
    }
}

fn watch(
    terminal: &mut DefaultTerminal,
    dashboard: &mut Dashboard,
    feed: &Feed,
    updates: &Receiver<FeedUpdate>,
    stop: &AtomicBool,
) -> Result<()> {
    let (mut due, mut drawn) = (true, None::<Instant>);
    let mut second = 0;
    while !stop.load(Ordering::Relaxed) {
        if event::poll(POLL_PERIOD).context("the terminal is gone")? {
            match event::read().context("the terminal is gone")? {
                Event::Key(key) => match dashboard.key(key) {
                    KeyAction::Nothing => {}
                    KeyAction::Draw => due = true,
                    KeyAction::Off(device) => {
                        feed.switch_off(device);
                        due = true;
                    }
                    KeyAction::End => return Ok(()),
                },
                Event::Resize(..) => due = true,
                _ => {}
            }
        }
        let now_ms = device::now_ms();
        let mut heard = now_ms / 1000 != second;
        second = now_ms / 1000;
        while let Ok(updates) = updates.try_recv() {
            dashboard.apply(updates, now_ms);
            heard = true;
        }
        due |= heard && !dashboard.paused();
        if due && drawn.is_none_or(|at| at.elapsed() >= FRAME) {
            terminal
                .draw(|frame| screen::draw(frame, dashboard, now_ms))
                .context("cannot draw on this terminal")?;
            (due, drawn) = (false, Some(Instant::now()));
        }
    }
    Ok(())
}
