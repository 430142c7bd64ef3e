//! `ihd convert`: conversion of a capture to another format.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use ihd_capture::format;
use ihd_signal::{Capture, TimeBase};
use indicatif::{ProgressBar, ProgressStyle};

use super::capture_args::CaptureArgs;
use super::global::Global;
use super::output;
use super::usage::Usage;

/// Convert a capture: what scopes write to MCAP, CSV, NPZ or Parquet.
///
/// Formats are recognised by content when reading, by the ending when writing. docs/captures.md lists them,
/// what is detected and what --input states.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd convert scope.csv --out capture.mcap\n  \
    ihd convert coil_voltage.wfm coil_current.wfm --out capture.mcap\n  \
    ihd convert scope.csv --input channels=CH1,CH3,probe=100,10,invert=i --out capture.npz\n  \
    ihd convert table.csv --input columns=1,4,2,units=V,mA --out capture.mcap --json\n\n\
    Exit codes: 0 converted, 1 failed, 2 wrong usage, 7 the file is empty or a cut MCAP (what could be\n\
    read is converted)")]
pub struct ConvertArgs {
    #[command(flatten)]
    capture: CaptureArgs,
    /// File to write; its ending names the format: .mcap, .csv, .npz or .parquet
    #[arg(long, short)]
    out: PathBuf,
}

impl ConvertArgs {
    /// Reads and writes the capture, and reports the conversion.
    ///
    /// # Errors
    /// [`ihd_capture::CaptureError`] or [`ihd_capture::exports::ExportError`].
    pub fn run(&self, global: &Global) -> Result<()> {
        // A wrong ending is rejected before a long file is read.
        format::check(&self.out).map_err(Usage::from_error)?;
        let unused = ["fsw", "mains", "zero-crossing", "resonance-capacitance"];
        self.capture.input()?.refuse(&unused)?;
        self.capture.ensure_not_read([self.out.as_path()])?;
        let bar = ProgressBar::new(1000);
        let style = "{msg:8} {bar:40} {percent:>3} %  {eta} left";
        bar.set_style(ProgressStyle::with_template(style)?);
        let mut at = |share: f64| bar.set_position((share * 1000.0) as u64);
        bar.set_message("reading");
        let loaded = self.capture.open_with(&mut at)?;
        bar.set_message("writing");
        format::write(&loaded.capture, &self.out, &mut at)?;
        bar.finish_and_clear();
        loaded.finish(self.report(&loaded.capture, global.json))
    }

    fn report(&self, capture: &Capture, json: bool) -> Result<()> {
        let samples = capture.len();
        let rate_hz = match capture.time {
            TimeBase::Even { dt_s, .. } => Some(1.0 / dt_s),
            TimeBase::Stamps(_) => None,
        };
        let ends = capture
            .time
            .at(0)
            .zip(capture.time.at(samples.saturating_sub(1)));
        let duration_s = ends.map_or(0.0, |(first, last)| last - first);
        let range = |x: &[f32]| {
            let pair = |(low, high): (f32, f32), x: &f32| (low.min(*x), high.max(*x));
            x.iter().fold((f32::INFINITY, f32::NEG_INFINITY), pair)
        };
        let (v, i) = (range(&capture.v_v), range(&capture.i_a));
        let first = self.capture.paths().next().context("no file")?;
        // An MCAP keeps what it was converted from, a reader of another format says more than its name.
        let recognised = format::name(first)?;
        let format = match recognised {
            "MCAP" => recognised,
            _ => (capture.metadata.get("format")).map_or(recognised, String::as_str),
        };
        if json {
            let summary = serde_json::json!({
                "in": self.capture.paths().collect::<Vec<_>>(),
                "format": format,
                "out": self.out,
                "samples": samples,
                "rate_hz": rate_hz,
                "duration_s": duration_s,
                "v_V": [v.0, v.1],
                "i_A": [i.0, i.1],
            });
            return output::json(&summary);
        }
        let rate = rate_hz.map_or("uneven times".to_owned(), |hz| {
            format!("{} MS/s", hz * 1e-6)
        });
        say!("read     {} ({format})", capture.name)?;
        say!(
            "samples  {samples} of each channel, {rate}, {} ms",
            duration_s * 1e3
        )?;
        say!("voltage  {} to {} V", v.0, v.1)?;
        say!("current  {} to {} A", i.0, i.1)?;
        say!("wrote    {}", self.out.display())
    }
}
