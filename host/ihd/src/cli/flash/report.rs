//! Output of `ihd flash`.

use std::time::Duration;

use anyhow::{Context, Result};
use ihd_flash::install::{InstallReport, InstallStep};
use ihd_flash::options::OptionDeviation;
use ihd_flash::{Image, WriteProgress};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use crate::cli::output;

/// Report as JSON.
#[derive(Serialize)]
struct Report<'a> {
    image: FlashedImage<'a>,
    #[serde(flatten)]
    installed: &'a InstallReport,
    took_s: f64,
}

#[derive(Serialize)]
struct FlashedImage<'a> {
    path: Option<&'a std::path::Path>,
    build: &'a str,
    build_id: ihd_flash::BuildId,
    protocol: (u16, u16),
    bytes: u32,
    crc: u32,
}

/// Output to the terminal.
pub struct Screen {
    bar: ProgressBar,
    json: bool,
}

impl Screen {
    /// Creates one; with `json` only the report is printed.
    ///
    /// # Errors
    /// Only for an internal defect.
    pub fn new(json: bool) -> Result<Self> {
        let bar = ProgressBar::new(0);
        let style =
            ProgressStyle::with_template("{msg:12} {bar:40} {bytes}/{total_bytes}, {eta} left");
        bar.set_style(style.context("progress bar")?);
        Ok(Self { bar, json })
    }

    /// Prints access and image, before the chip is accessed.
    ///
    /// # Errors
    /// If standard output cannot be written.
    pub fn begin(&self, way: &str, image: &Image) -> Result<()> {
        if self.json {
            return Ok(());
        }
        let from = image
            .path
            .as_ref()
            .map_or("part of this program".into(), |path| {
                path.display().to_string()
            });
        say!("through    {way}")?;
        say!(
            "image      {}, {} bytes, {from}",
            image.describe(),
            image.bytes
        )
    }

    /// Shows a step; an error of the output does not interrupt flashing.
    pub fn on(&mut self, step: &InstallStep<'_>) {
        if self.json {
            return;
        }
        let shown = match step {
            InstallStep::Identified(chip, before) => say!(
                "chip       STM32G474, {} KiB\nreplaces   {}",
                chip.flash_kib,
                before.describe()
            ),
            InstallStep::Options(deviations, set) => deviations
                .iter()
                .try_for_each(|one| say!("{}", deviation_text(one, *set))),
            InstallStep::Flash(progress) => {
                self.advance(*progress);
                Ok(())
            }
            InstallStep::Waiting => {
                self.bar.finish_and_clear();
                say!("verified; the board starts")
            }
        };
        drop(shown);
    }

    fn advance(&self, progress: WriteProgress) {
        let (what, done, total) = match progress {
            WriteProgress::Erasing { done, total } => ("erasing", done, total),
            WriteProgress::Programming { done, total } => ("programming", done, total),
            WriteProgress::Verifying { done, total } => ("verifying", done, total),
        };
        self.bar.set_message(what);
        self.bar.set_length(total.into());
        self.bar.set_position(done.into());
    }

    /// Prints the report.
    ///
    /// # Errors
    /// If standard output cannot be written.
    pub fn end(&self, image: &Image, installed: &InstallReport, took: Duration) -> Result<()> {
        self.bar.finish_and_clear();
        if self.json {
            return output::json(&Report {
                image: FlashedImage {
                    path: image.path.as_deref(),
                    build: &image.build,
                    build_id: image.build_id,
                    protocol: image.protocol,
                    bytes: image.bytes,
                    crc: image.crc,
                },
                installed,
                took_s: took.as_secs_f64(),
            });
        }
        output::text(&text(installed, took))
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

fn deviation_text(one: &OptionDeviation, set: bool) -> String {
    let then = match (set, one.needed) {
        (true, _) => "is set now".into(),
        (false, true) => format!(
            "the board does not heat without (fault 16): --set-option-bytes sets it; {}",
            one.why
        ),
        (false, false) => format!("--set-option-bytes sets it; {}", one.why),
    };
    format!(
        "option     {} is {}, should be {}: {then}",
        one.name, one.is, one.required
    )
}

fn text(done: &InstallReport, took: Duration) -> String {
    let lookup = if done.lookup_kept {
        "the learned lookup was kept"
    } else {
        "the whole chip was erased, the learned lookup too"
    };
    let mut text = format!("flashed    in {:.1} s; {lookup}\n", took.as_secs_f64());
    match (&done.heard, &done.silence) {
        (Some(heard), _) => {
            text += &format!(
                "heard      {} on {}: it is this image\n",
                heard.build, heard.link
            );
            if let Some((number, name)) = &heard.fault {
                text +=
                    &format!("fault      {number}, {name}: docs/bring-up.md says what it wants\n");
            }
        }
        (None, why) => {
            let why = why.as_deref().unwrap_or("no link");
            text += &format!(
                "not heard  ({why}); name the board's link with --device usb or serial:PATH to have its hello compared\n"
            );
        }
    }
    text
}
