//! `ihd store export`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use ihd_store::clock::rfc3339;
use ihd_store::export::{self, ExportFormat};
use ihd_store::{ResultFilter, StoreError, StoreReader, WindowFilter};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

use super::super::output;
use super::place::{StorePlace, time};

/// Write windows, or the table of results, as files for other programs.
///
/// MCAP is one recording a device and boot, as `ihd record` writes it; CSV, NPZ and Parquet are one file a window.
/// Windows whose samples were not kept are counted.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd store export --format mcap --out windows\n  \
    ihd store export --format npz --device bench --since 2026-11-22 --out windows\n  \
    ihd store export --format csv --device bench --boot 99 --seq 4711 --out window.csv\n  \
    ihd store export --results --format csv --out results.csv")]
pub struct ExportArgs {
    /// Kind of files
    #[arg(long, value_enum, value_name = "FORMAT")]
    format: FormatArg,
    /// The folder to write to, or, where it has the format's ending, the one file
    #[arg(long, short, value_name = "PATH")]
    out: PathBuf,
    /// Windows of this device alone
    #[arg(long, value_name = "NAME")]
    device: Option<String>,
    /// Windows of this boot of the device alone
    #[arg(long, value_name = "NUMBER")]
    boot: Option<u32>,
    /// The window of this number alone
    #[arg(long, value_name = "NUMBER")]
    seq: Option<u32>,
    /// Windows stored from this day (UTC) or time on
    #[arg(long, value_name = "WHEN", value_parser = time)]
    since: Option<i64>,
    /// The table of results instead of windows; CSV alone
    #[arg(long, conflicts_with_all = ["boot", "seq"])]
    results: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FormatArg {
    Mcap,
    Csv,
    Npz,
    Parquet,
}

impl From<FormatArg> for ExportFormat {
    fn from(format: FormatArg) -> Self {
        match format {
            FormatArg::Mcap => Self::Mcap,
            FormatArg::Csv => Self::Csv,
            FormatArg::Npz => Self::Npz,
            FormatArg::Parquet => Self::Parquet,
        }
    }
}

impl ExportArgs {
    pub fn run(&self, place: &StorePlace, json: bool) -> Result<()> {
        ensure_usage!(
            !self.results || self.format == FormatArg::Csv,
            "--results are written as CSV alone: --format csv"
        );
        let reader = place.read_of(self.device.as_deref())?;
        if self.results {
            return self.results(&reader, json);
        }
        let bar = ProgressBar::new_spinner();
        bar.set_style(ProgressStyle::with_template("{spinner} {pos} windows")?);
        let filter = WindowFilter {
            device: self.device.clone(),
            since_ms: self.since,
            boot: self.boot,
            seq: self.seq,
        };
        let written = export::windows(&reader, &filter, self.format.into(), &self.out, &mut || {
            bar.inc(1);
        });
        bar.finish_and_clear();
        let written = written?;
        if let (0, Some(seq)) = (written.windows, self.seq) {
            bail!(
                "there is no window {seq} with samples; `ihd store ls` lists the results of windows"
            );
        }
        if json {
            return output::json(&written);
        }
        say!(
            "wrote {} windows in {} files; the samples of {} more were not kept",
            written.windows,
            written.files.len(),
            written.without_samples
        )?;
        for path in &written.files {
            say!("{}", path.display())?;
        }
        Ok(())
    }

    fn results(&self, reader: &StoreReader, json: bool) -> Result<()> {
        if self.out.exists() {
            let path = self.out.clone();
            return Err(StoreError::Exists { path }.into());
        }
        let rows = reader.results(&ResultFilter {
            device: self.device.clone(),
            since_ms: self.since,
            limit: Some(u32::MAX),
        })?;
        let mut table = csv::Writer::from_writer(Vec::new());
        table.write_record(HEADING)?;
        for r in &rows {
            let number = |x: f64| {
                if x.is_finite() {
                    x.to_string()
                } else {
                    String::new()
                }
            };
            table.write_record([
                r.id.to_string(),
                r.device.clone(),
                r.boot.to_string(),
                r.seq.to_string(),
                r.half_cycle.to_string(),
                rfc3339(r.at_ms),
                r.f_sw_hz.to_string(),
                number(r.i_crest_a),
                r.power_w.map_or(String::new(), number),
                number(r.r_ohm),
                number(r.l_h),
                number(r.sigma_r_pct),
                number(r.sigma_l_pct),
                r.pass.to_string(),
                r.why.clone(),
                r.changed_lookup.to_string(),
                r.iterations.to_string(),
            ])?;
        }
        let bytes = table.into_inner().map_err(|e| e.into_error())?;
        write(&self.out, &bytes)?;
        if json {
            return output::json(&json!({ "files": [self.out], "results": rows.len() }));
        }
        say!("wrote {} results to {}", rows.len(), self.out.display())
    }
}

const HEADING: [&str; 17] = [
    "id",
    "device",
    "boot",
    "seq",
    "half_cycle",
    "at",
    "f_sw_hz",
    "i_crest_a",
    "power_w",
    "r_ohm",
    "l_h",
    "sigma_r_pct",
    "sigma_l_pct",
    "pass",
    "why",
    "changed_lookup",
    "iterations",
];

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    ihd_store::atomic::write(path, bytes)
        .with_context(|| format!("cannot write {}", path.display()))
}
