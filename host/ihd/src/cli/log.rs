//! `ihd log`: a board's log as text.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result};
use clap::Args;
use ihd_flash::log::find::Places;
use ihd_flash::log::follow::{LogOpener, follow};
use ihd_flash::log::image_cache::ImageCache;
use ihd_flash::log::over_link::LinkLogOpener;

use self::screen::Screen;
use super::global::Global;
use super::interrupt;

mod screen;
mod way;

/// Show a board's log until ^C: over the link, or over a debug probe (RTT) without resetting it.
///
/// Texts and places come from the image that runs, found by its build id: the one that this program carries, the
/// checkout's, or one that `ihd flash` has flashed from here. A board that goes away is waited for.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd log                              (the board on USB, else the debug probe)\n  \
    ihd log serial:/dev/ttyACM0\n  \
    ihd log --probe                      (needs the feature `probe`; the release archive has it)\n  \
    ihd log usb --json | jq 'select(.level == \"error\")'\n  \
    ihd log usb --image stm32g474.elf\n\n\
    With --json each line is an object: t, level, message, module, location, dropped, lost_bytes, malformed; or t and event.\n\n\
    Exit codes: 0 ended by ^C, 1 failed, 2 wrong usage, 3 device, link or probe")]
pub struct LogArgs {
    /// The device: a name of the configuration, usb, usb:SERIAL, serial:PATH or tcp:HOST:PORT [default: the board on
    /// USB, else the debug probe]
    #[arg(value_name = "DEV", conflicts_with = "probe")]
    device: Option<String>,
    /// Listen through a debug probe: the one that is plugged in, or the one with this VID:PID or VID:PID:SERIAL
    #[arg(long, value_name = "PROBE", num_args = 0..=1, default_missing_value = "")]
    probe: Option<String>,
    /// The image whose texts are to be used; refused unless it is what runs
    #[arg(long, value_name = "ELF")]
    image: Option<PathBuf>,
}

impl LogArgs {
    /// Shows the log until Ctrl-C.
    ///
    /// # Errors
    /// A device, probe or image that is missing or does not fit; standard output that cannot be written.
    pub fn run(&self, global: &Global) -> Result<()> {
        let stop = interrupt::flag().context("cannot catch ^C")?;
        let mut way = self.way(global)?;
        self.show(way.as_mut(), stop, global.json)
    }

    fn show(&self, way: &mut dyn LogOpener, stop: &AtomicBool, json: bool) -> Result<()> {
        let places = Places {
            given: self.image.as_deref(),
            cache: ImageCache::of_user(),
        };
        let coloured = std::io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none();
        let mut screen = Screen::new(json, coloured);
        let ended = follow::<anyhow::Error>(way, &places, stop, |what| screen.show(what));
        let printed = screen.end();
        ended.and(printed)
    }

    fn way(&self, global: &Global) -> Result<Box<dyn LogOpener>> {
        if let Some(probe) = &self.probe {
            return way::by_probe(Some(probe.as_str()).filter(|probe| !probe.is_empty()));
        }
        if let Some(device) = &self.device {
            return self.by_link(device, global);
        }
        match way::only_board()? {
            Some(address) => self.by_link(&address, global),
            None => way::by_probe(None),
        }
    }

    fn by_link(&self, device: &str, global: &Global) -> Result<Box<dyn LogOpener>> {
        #[cfg(feature = "daemon")]
        let open = super::device::direct_opener(global.config.as_deref(), device)?;
        #[cfg(not(feature = "daemon"))]
        let (open, _) = (way::opener(device)?, global);
        Ok(Box::new(LinkLogOpener::new(open)))
    }
}
