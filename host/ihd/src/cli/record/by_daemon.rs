//! Recording by the daemon into its store, and download of the files.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use ihd_api::ApiClient;
use ihd_capture::recording::RecordSettings;
use ihd_model::{Command, CommandReply};
use serde_json::json;

use super::{COMPLETE_WITHIN, NothingRecorded};
use crate::cli::device::one_line;
use crate::cli::{interrupt, output};

/// Period of polling for Ctrl-C, the time and the daemon.
const POLL_PERIOD: Duration = Duration::from_millis(200);

/// Records until Ctrl-C or the end of the time.
pub(super) fn record(
    client: &ApiClient,
    name: &str,
    out: Option<&Path>,
    settings: &RecordSettings,
    json: bool,
) -> Result<()> {
    if let Some(out) = out {
        ensure_usage!(!out.exists(), "{} is there already", out.display());
        let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty());
        ensure_usage!(
            folder.is_none_or(Path::is_dir),
            "{}: its folder does not exist",
            out.display()
        );
    }
    let stop = interrupt::flag().context("cannot catch ^C")?;
    let before: BTreeSet<String> = files(client, name)?.into_iter().map(|f| f.0).collect();
    let began = client.command(name, &Command::RecordStart(*settings))?;
    let watched = watch(client, name, &began, stop, json);
    let stopped = match watched.is_err() || stop.load(Ordering::Relaxed) {
        true => client.command(name, &Command::RecordStop).map(drop),
        false => Ok(()),
    };
    watched?;
    // If it has ended by itself, there was nothing to stop.
    if client.device(name)?.recording_now.is_some() {
        stopped?;
    }
    let recorded = complete(client, name, &before)?;
    if let Some(why) = client.device(name)?.recording_failure {
        bail!(
            "{name}: the recording failed: {why}. {}",
            left_text(&recorded)
        );
    }
    let shown = match out {
        None => {
            let folder = began
                .file
                .as_deref()
                .and_then(|file| Path::new(file).parent());
            let at = |file: &String| folder.map_or_else(|| file.into(), |f| f.join(file));
            recorded.iter().map(at).collect()
        }
        Some(out) => download(client, &recorded, out)?,
    };
    print(&shown, json)
}

/// Waits until the recording has ended, or for Ctrl-C.
fn watch(
    client: &ApiClient,
    name: &str,
    began: &CommandReply,
    stop: &AtomicBool,
    json: bool,
) -> Result<()> {
    if !json {
        match &began.file {
            Some(file) => say!("recording into {}; ^C ends it", one_line(file))?,
            None => say!("{}; ^C ends it", one_line(&began.text))?,
        }
    }
    let mut known = began.file.is_some();
    while !stop.load(Ordering::Relaxed) {
        sleep(POLL_PERIOD);
        let Some(now) = client.device(name)?.recording_now else {
            break;
        };
        if let (Some(file), false) = (&now.file, std::mem::replace(&mut known, now.file.is_some()))
            && !json
        {
            say!("its trigger came: recording into {}", one_line(file))?;
        }
    }
    Ok(())
}

/// Text of what a failed recording has left.
fn left_text(recorded: &[String]) -> String {
    match recorded {
        [] => "Nothing was recorded".to_owned(),
        files => format!(
            "What was written until then is in the store's folder recordings: {}",
            files.join(", ")
        ),
    }
}

/// Recordings of a device, each with `true` if it is complete.
fn files(client: &ApiClient, device: &str) -> Result<Vec<(String, bool)>> {
    let mut all = client.recordings()?;
    all.retain(|recording| recording.device == device);
    Ok(all.into_iter().map(|r| (r.file, !r.under_way)).collect())
}

/// New files compared with `before`, once they are complete; oldest first.
fn complete(client: &ApiClient, device: &str, before: &BTreeSet<String>) -> Result<Vec<String>> {
    let began = Instant::now();
    loop {
        let mut new = files(client, device)?;
        new.retain(|(file, _)| !before.contains(file));
        if new.iter().all(|(_, complete)| *complete) {
            let mut names: Vec<String> = new.into_iter().map(|(file, _)| file).collect();
            names.sort();
            return Ok(names);
        }
        if began.elapsed() > COMPLETE_WITHIN {
            bail!("{device}: its recording is still being written; the daemon's disk is slow");
        }
        sleep(POLL_PERIOD);
    }
}

/// Downloads recordings: the first one with the given name, the others with a number.
fn download(client: &ApiClient, recorded: &[String], out: &Path) -> Result<Vec<PathBuf>> {
    let mut here = Vec::new();
    for (k, file) in recorded.iter().enumerate() {
        let path = numbered(out, k as u32 + 1);
        let what = || {
            format!(
                "{file} is recorded, but cannot be copied to {}",
                path.display()
            )
        };
        let target = fs::File::create_new(&path).with_context(what)?;
        if let Err(error) = copy(client, file, target) {
            // A part of it would pass for the recording.
            let _ = fs::remove_file(&path);
            return Err(error).with_context(what);
        }
        here.push(path);
    }
    Ok(here)
}

fn copy(client: &ApiClient, file: &str, mut to: fs::File) -> Result<()> {
    client.download_recording(file, &mut to)?;
    Ok(to.sync_all()?)
}

fn print(files: &[PathBuf], json: bool) -> Result<()> {
    if json {
        output::json(&json!({"file": files.first(), "files": files}))?;
    } else {
        for file in files {
            say!("recorded {}", one_line(&file.display().to_string()))?;
        }
    }
    ensure!(!files.is_empty(), NothingRecorded);
    Ok(())
}

/// `a.mcap`, `a-2.mcap`, `a-3.mcap`.
fn numbered(path: &Path, part: u32) -> PathBuf {
    if part < 2 {
        return path.to_owned();
    }
    let text =
        |part: Option<&std::ffi::OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
    let (stem, ending) = (text(path.file_stem()), text(path.extension()));
    path.with_file_name(format!("{stem}-{part}.{ending}"))
}
