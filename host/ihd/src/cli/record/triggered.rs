//! Recording by this process from a trigger on, with the daemon's recorder.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use ihd_daemon::model::{RecordSettings, RecordingPhase};
use ihd_daemon::recording::{Recorder, RecordingStatus};
use ihd_link::{Client, KEEPALIVE_PERIOD};
use ihd_train::WINDOWS_EVERY;

use super::by_daemon::{numbered, print};
use crate::cli::device::{Direct, one_line};
use crate::cli::interrupt;

/// Period of polling for Ctrl-C and the time.
const POLL_PERIOD: Duration = Duration::from_millis(200);

/// Time limit for an ended file to be complete.
const COMPLETE_WITHIN: Duration = Duration::from_secs(10);

/// Records from the trigger on, until Ctrl-C or the end of the time.
pub(super) fn record(
    direct: Direct,
    out: &Path,
    settings: &RecordSettings,
    json: bool,
) -> Result<()> {
    ensure_usage!(!out.exists(), "{} is there already", out.display());
    let stop = interrupt::flag().context("cannot catch ^C")?;
    let (tell, told) = mpsc::channel();
    let first = out.to_owned();
    let recorder = Recorder::new(
        move |part| numbered(&first, part),
        move |what: RecordingStatus| drop(tell.send(what)),
    );
    let mut client = direct.into_client();
    let at = client.clock();
    let sink = recorder.connected(client.hello(), client.front_end(), at);
    client.record_to(sink);
    client.read_lookup()?;
    client.stream(1, WINDOWS_EVERY)?;
    let started = recorder.start(*settings, client.clock());
    let started = started.map_err(anyhow::Error::msg)?;
    if !json {
        say!("{}; ^C ends it", started.text)?;
    }
    let mut progress = RecorderProgress::default();
    let listened = listen(&mut client, &recorder, stop, || progress.take(&told, json));
    // If it has ended by itself, there is nothing to stop.
    let _ = recorder.stop("ended by hand");
    let left = client.stream(0, 0);
    let began = Instant::now();
    while !recorder.incomplete().is_empty() && began.elapsed() < COMPLETE_WITHIN {
        sleep(POLL_PERIOD);
    }
    progress.take(&told, true)?;
    print(&progress.files, json)?;
    listened?;
    if let Some(why) = progress.failed {
        bail!("{why}");
    }
    Ok(left?)
}

/// Prints progress until Ctrl-C, or until the recording has ended.
fn listen(
    client: &mut Client,
    recorder: &Recorder,
    stop: &AtomicBool,
    mut look: impl FnMut() -> Result<()>,
) -> Result<()> {
    let mut contact = client.clock();
    while !stop.load(Ordering::Relaxed) && recorder.active().is_some() {
        client.next_event(POLL_PERIOD)?;
        recorder.tick();
        look()?;
        if client.clock().saturating_sub(contact) >= KEEPALIVE_PERIOD {
            contact = client.clock();
            client.status()?;
        }
    }
    Ok(())
}

/// Status reports of the recorder.
#[derive(Default)]
struct RecorderProgress {
    files: Vec<PathBuf>,
    failed: Option<String>,
}

impl RecorderProgress {
    fn take(&mut self, told: &mpsc::Receiver<RecordingStatus>, silently: bool) -> Result<()> {
        while let Ok(what) = told.try_recv() {
            match (what.phase, what.file) {
                (RecordingPhase::Ended, file) => self.files.extend(file),
                (RecordingPhase::Failed, _) => self.failed = Some(what.text),
                (RecordingPhase::Begun, Some(file)) if !silently => {
                    let file = one_line(&file.display().to_string());
                    say!("{}: recording into {file}", one_line(&what.text))?;
                }
                _ => {}
            }
        }
        Ok(())
    }
}

/// File of a device's recording if none is named: `tcp-127.0.0.1-4711.mcap`.
pub(super) fn file_of(device: &str) -> PathBuf {
    let plain = |c: char| {
        if c.is_ascii_alphanumeric() || "-_.".contains(c) {
            c
        } else {
            '-'
        }
    };
    let name: String = device.chars().map(plain).collect();
    PathBuf::from(format!("{name}.mcap"))
}
