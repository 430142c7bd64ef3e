//! `ihd device DEV record`: by the daemon into its store, or here.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use ihd_daemon::model::Command;
use serde_json::json;

use super::hob::Hob;
use super::text::one_line;
use crate::cli::{interrupt, output, record};

/// Between two looks at ^C and the time.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Records until ^C or the time is over.
pub(super) fn record(
    mut hob: Hob,
    out: Option<&Path>,
    duration_s: Option<f64>,
    json: bool,
) -> Result<()> {
    ensure_usage!(
        duration_s.is_none_or(|s| s.is_finite() && s > 0.0),
        "--duration must be more than 0 s"
    );
    if let Hob::Direct(direct) = hob {
        let name = direct.name().to_owned();
        let out = out.map_or_else(
            || PathBuf::from(format!("{}.mcap", file_name(&name))),
            Path::to_owned,
        );
        return record::RecordArgs::of_device(out, duration_s, json)?
            .record_from(direct.into_client(), true);
    }
    if let Some(out) = out {
        ensure_usage!(!out.exists(), "{} is there already", out.display());
    }
    let stop = interrupt::flag().context("cannot catch ^C")?;
    let began = hob.command(&Command::RecordStart)?;
    if let (Some(file), false) = (&began.file, json) {
        say!("recording into {}; ^C ends it", one_line(file))?;
    }
    wait(stop, duration_s);
    let done = hob.command(&Command::RecordStop)?;
    let file = done.file.or(began.file).unwrap_or_default();
    let shown = match out {
        None => file,
        Some(out) => {
            copy_new(Path::new(&file), out).with_context(|| {
                format!(
                    "{file} is recorded, but cannot be copied to {}",
                    out.display()
                )
            })?;
            out.display().to_string()
        }
    };
    if json {
        return output::json(&json!({"file": shown}));
    }
    say!("recorded {}", one_line(&shown))
}

fn wait(stop: &AtomicBool, duration_s: Option<f64>) {
    let began = Instant::now();
    while !stop.load(Ordering::Relaxed)
        && duration_s.is_none_or(|s| began.elapsed().as_secs_f64() < s)
    {
        sleep(LOOK_EVERY);
    }
}

/// Copies to a file that is not there yet.
fn copy_new(from: &Path, to: &Path) -> std::io::Result<()> {
    let mut source = fs::File::open(from)?;
    let mut target = fs::File::create_new(to)?;
    std::io::copy(&mut source, &mut target)?;
    target.sync_all()
}

/// An address as the name of a file.
fn file_name(name: &str) -> String {
    let plain = |c: char| {
        if c.is_ascii_alphanumeric() || "-_.".contains(c) {
            c
        } else {
            '-'
        }
    };
    name.chars().map(plain).collect()
}
