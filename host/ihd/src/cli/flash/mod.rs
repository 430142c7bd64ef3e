//! `ihd flash`: installation of the firmware's image on a board.

mod board_link;
mod dfu;
mod report;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use clap::Args;
use ihd_flash::install::{InstallPlan, install};
use ihd_flash::log::image_cache::ImageCache;
use ihd_flash::{Erase, Image, Programmer};
use ihd_link::DeviceSpec;

use self::board_link::BoardLink;
use self::report::Screen;
use super::global::Global;
use super::output::complain;
use super::usage::Usage;

/// Time limit from reset to hello: a board takes 65 ms, and the system a second or two to list its USB.
const HELLO_WITHIN: Duration = Duration::from_secs(10);

/// Put the firmware on a board, through a debug probe or the chip's own USB.
///
/// The chip is identified, what is on it is named, and nothing is written while it heats. The image is written, read back and
/// compared, the board is reset, and its hello has to be that of the image. The learned lookup stays, unless --erase-all. What
/// an interruption leaves, the same command mends.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd flash                                    (the only probe, the image of this release or checkout)\n  \
    ihd flash --set-option-bytes                 (a new board: RAM parity, brown-out level)\n  \
    ihd flash --image target/firmware/images/stm32g474.elf --device serial:/dev/ttyACM0\n  \
    ihd flash --probe 0483:374e:004200343137510D39383538 --json\n  \
    ihd flash --dfu                              (no probe: USB at the chip's own pins)\n  \
    ihd flash --erase-all                        (lookup as well: back to the built-in one)\n\n\
    Exit codes: 0 flashed, verified and heard (or no link found: the report says so), 1 no fit image, 2 wrong usage,\n\
    3 probe, chip or link, or the board heats")]
pub struct FlashArgs {
    /// The image, an ELF file as `cargo xtask firmware` writes it; without it the one inside this program, else the one of the
    /// checkout
    #[arg(long, value_name = "ELF")]
    image: Option<PathBuf>,
    /// The debug probe, as VID:PID or VID:PID:SERIAL; without it the only one
    #[arg(long, value_name = "PROBE")]
    probe: Option<String>,
    /// Through the chip's own bootloader over USB instead of a probe: the one that is plugged in (0483:df11), or the one with this
    /// serial number; where there is none, the firmware of the board on USB is sent there first, and that behind --device always
    #[arg(long, value_name = "SERIAL", num_args = 0..=1, require_equals = true, conflicts_with = "probe")]
    dfu: Option<Option<String>>,
    /// The board's link, on which its hello is waited for: usb, usb:SERIAL or serial:PATH; without it USB and the probe's own
    /// serial port are tried
    #[arg(long, value_name = "DEVICE")]
    device: Option<DeviceSpec>,
    /// Erase the whole flash, with the learned lookup
    #[arg(long)]
    erase_all: bool,
    /// Set option bytes that differ from the firmware's requirement; without it they are only reported
    #[arg(long)]
    set_option_bytes: bool,
}

impl FlashArgs {
    /// Flashes the board and prints the report.
    ///
    /// # Errors
    /// Any error that keeps the image from running on the board.
    pub fn run(&self, global: &Global) -> Result<()> {
        ensure_usage!(
            !matches!(self.device, Some(DeviceSpec::Sim | DeviceSpec::Tcp(_))),
            "--device names a simulated hob, which has no flash; a board's link is usb, usb:SERIAL or serial:PATH"
        );
        let image = Image::choose(self.image.as_deref())?;
        let (mut programmer, serial) = match &self.dfu {
            Some(serial) => (
                dfu::programmer(serial.as_deref(), self.device.as_ref())?,
                None,
            ),
            None => self.programmer()?,
        };
        let plan = InstallPlan {
            image: &image,
            erase: if self.erase_all {
                Erase::All
            } else {
                Erase::Image
            },
            set_options: self.set_option_bytes,
            hello_within: HELLO_WITHIN,
            hello_required: self.device.is_some(),
        };
        let mut link = BoardLink::new(self.device.clone(), serial.as_deref());
        let mut screen = Screen::new(global.json)?;
        screen.begin(&programmer.describe(), &image)?;
        keep(&image);
        let begun = Instant::now();
        let done = install(&mut *programmer, Some(&mut link), plan, &mut |step| {
            screen.on(&step)
        });
        screen.end(&image, &done?, begun.elapsed())
    }

    /// Access to the chip, and the probe's serial number.
    #[cfg(feature = "probe")]
    fn programmer(&self) -> Result<(Box<dyn Programmer>, Option<String>)> {
        let probes = ihd_flash::probe::Probes::default();
        let attached = probes.attach(self.probe.as_deref())?;
        let serial = attached.probe().serial.clone();
        Ok((Box::new(attached), serial))
    }

    #[cfg(not(feature = "probe"))]
    fn programmer(&self) -> Result<(Box<dyn Programmer>, Option<String>)> {
        Err(no_probes().into())
    }
}

/// Stores a copy by build id, in which `ihd log` finds the texts of the board's log.
fn keep(image: &Image) {
    let Some(cache) = ImageCache::of_user() else {
        return;
    };
    if let Err(why) = cache.keep(image) {
        complain(format_args!(
            "warning: no copy of the image in {} ({why}): `ihd log` will want it as --image",
            cache.folder().display()
        ));
    }
}

/// Remedy for a build without probes.
#[cfg_attr(
    feature = "probe",
    expect(dead_code, reason = "this program knows them")
)]
fn no_probes() -> Usage {
    Usage(
        "this ihd was built without debug probes: take the one of a release archive, or run `cargo run --release --features \
         probe -- flash`, which compiles 130 more crates; without a probe, `ihd flash --dfu` flashes through the chip's own USB"
            .into(),
    )
}
