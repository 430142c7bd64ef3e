//! Recording by this process: everything that the device streams, in a capture file.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use anyhow::{Context, Result};
use ihd_capture::mcap::SessionRecorder;
use ihd_capture::mcap::topics::LinkCounters;
use ihd_link::{Client, Event, KEEPALIVE_PERIOD};
use ihd_shared::wire::messages::{Status, Utilisation};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use crate::cli::{interrupt, output};
use crate::report::utilisation;

/// Time limit of waiting for an event before limits and Ctrl-C are checked.
const POLL_PERIOD: Duration = Duration::from_millis(100);

/// Recording of a device that is open.
#[derive(Debug)]
pub(super) struct SessionRecording {
    /// The capture file, which must not exist.
    pub out: PathBuf,
    /// Time limit in s.
    pub duration: Option<f64>,
    /// Limit of the file's size in bytes.
    pub max_size: Option<f64>,
    /// Power to request in watt; `None` if the device's is not to be changed.
    pub power: Option<u16>,
    /// Half-cycles per telemetry; 0 for none.
    pub telemetry_every: u8,
    /// Half-cycles per window; 0 for none.
    pub windows_every: u8,
    /// Print the report as JSON.
    pub json: bool,
}

/// Summary of a recording.
#[derive(Debug, Serialize)]
struct Report {
    file: PathBuf,
    device: String,
    v_full_scale_v: f64,
    i_full_scale_a: f64,
    bits: u8,
    /// Reason of the end: duration, size, interrupt or error.
    ended_by: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
    seconds: f64,
    bytes: u64,
    faults: u32,
    link: LinkCounters,
    /// Windows dropped by the device; `None` if it did not answer.
    device_windows_dropped: Option<u32>,
    device_telemetry_dropped: Option<u32>,
    /// Processor load during the recording.
    processor: serde_json::Value,
    #[serde(skip)]
    processor_line: String,
}

impl SessionRecording {
    /// Records and prints the report; flushes by wall time if the device has no simulated clock.
    ///
    /// # Errors
    /// If the device or the file fails; the data recorded until then are in the file.
    pub(super) fn run(&self, mut client: Client, has_wall_clock: bool) -> Result<()> {
        let stop = interrupt::flag().context("cannot catch ^C")?;
        let mut recorder = SessionRecorder::create(&self.out, client.hello(), client.front_end())?;
        if has_wall_clock {
            recorder = recorder.with_wall_clock_flush();
        }
        let size = recorder.size();
        client.record_to(recorder);
        let bar = spinner()?;
        let mut report = self.report(&client);
        let recorded = self.record(&mut client, stop, &size, &bar, &mut report);
        if recorded.is_err() {
            // An error of the recording must not keep the device from being switched off.
            let _ = client.finish_recording();
        }
        let left = self.leave(&mut client);
        let closed = client.finish_recording();
        bar.finish_and_clear();
        report.link = ihd_capture::mcap::link_counters(&client.counters());
        report.bytes = std::fs::metadata(&self.out).map_or(0, |m| m.len());
        if let Ok((status, used)) = &left {
            report.device_windows_dropped = Some(status.windows_dropped);
            report.device_telemetry_dropped = Some(status.telemetry_dropped);
            report.processor = utilisation::json(used.as_ref());
            report.processor_line = utilisation::line(used.as_ref());
        }
        let done = recorded.and(left.map(drop)).and(closed.map_err(Into::into));
        if let Err(error) = &done {
            report.ended_by = "error";
            report.error = Some(crate::cli::message(error));
        }
        // The report is printed in any case.
        let printed = self.print(&report);
        done.and(printed)
    }

    /// Report before anything was recorded.
    fn report(&self, client: &Client) -> Report {
        let front_end = client.front_end();
        Report {
            file: self.out.clone(),
            device: format!("{} ({})", client.describe(), client.hello().build),
            v_full_scale_v: front_end.scales().v_full_scale_v(),
            i_full_scale_a: front_end.scales().i_full_scale_a(),
            bits: front_end.bits,
            ended_by: "error",
            error: None,
            seconds: 0.0,
            bytes: 0,
            faults: 0,
            link: LinkCounters::default(),
            device_windows_dropped: None,
            device_telemetry_dropped: None,
            processor: utilisation::json(None),
            processor_line: utilisation::line(None),
        }
    }

    fn record(
        &self,
        client: &mut Client,
        stop: &AtomicBool,
        size: &AtomicU64,
        bar: &ProgressBar,
        report: &mut Report,
    ) -> Result<()> {
        client.read_lookup()?;
        client.stream(self.telemetry_every, self.windows_every)?;
        if let Some(power_w) = self.power {
            client.set_power(power_w)?;
        }
        // Resets the device's counts.
        client.utilisation()?;
        let began = client.clock();
        let mut heard = began;
        report.ended_by = loop {
            let elapsed = client.clock().saturating_sub(began);
            report.seconds = elapsed.as_secs_f64();
            if stop.load(Ordering::Relaxed) {
                break "interrupt";
            }
            if self.duration.is_some_and(|s| elapsed.as_secs_f64() >= s) {
                break "duration";
            }
            let bytes = size.load(Ordering::Relaxed);
            if self.max_size.is_some_and(|max| bytes as f64 >= max) {
                break "size";
            }
            if let Some(Event::Fault(_)) = client.next_event(POLL_PERIOD)? {
                report.faults += 1;
            }
            if client.clock().saturating_sub(heard) >= KEEPALIVE_PERIOD {
                heard = client.clock();
                client.status()?;
            }
            show(bar, elapsed, bytes, client);
        };
        Ok(())
    }

    /// Stops the stream, switches the device off if it was switched on here, and processes remaining data.
    fn leave(&self, client: &mut Client) -> Result<(Status, Option<Utilisation>)> {
        let used = client.utilisation()?;
        if self.power.is_some() {
            client.set_power(0)?;
        }
        client.stream(0, 0)?;
        while client.next_event(POLL_PERIOD)?.is_some() {}
        Ok((client.status()?, Some(used)))
    }

    fn print(&self, r: &Report) -> Result<()> {
        if self.json {
            return output::json(r);
        }
        let dropped = |n: Option<u32>| n.map_or("?".to_owned(), |n| n.to_string());
        let (l, path) = (&r.link, r.file.display());
        say!(
            "recorded   {path}, {} bytes, {:.1} s, ended by {}",
            r.bytes,
            r.seconds,
            r.ended_by
        )?;
        say!("device     {}", r.device)?;
        say!(
            "scales     ±{} V, ±{} A, {} bits",
            r.v_full_scale_v,
            r.i_full_scale_a,
            r.bits
        )?;
        say!(
            "telemetry  {} received, {} missing, {} dropped by the device",
            l.telemetry,
            l.telemetry_missing,
            dropped(r.device_telemetry_dropped)
        )?;
        say!(
            "windows    {} received, {} missing, {} rejected, {} dropped by the device",
            l.windows,
            l.windows_missing,
            l.windows_rejected,
            dropped(r.device_windows_dropped)
        )?;
        say!(
            "frames     {} good, {} bad, {} lost; {} fault events",
            l.frames_good,
            l.frames_bad,
            l.frames_lost,
            r.faults
        )?;
        say!("processor  {}", r.processor_line)
    }
}

fn spinner() -> Result<ProgressBar> {
    let bar = ProgressBar::new_spinner();
    let style = ProgressStyle::with_template("{spinner} {wide_msg}").context("progress bar")?;
    bar.set_style(style);
    Ok(bar)
}

fn show(bar: &ProgressBar, elapsed: Duration, bytes: u64, client: &Client) {
    let c = client.counters();
    bar.set_message(format!(
        "{:.1} s, {:.2} MB, {} telemetry, {} windows; missing {} and {}, {} bad frames, ^C ends",
        elapsed.as_secs_f64(),
        bytes as f64 * 1e-6,
        c.telemetry.received,
        c.windows.received,
        c.telemetry.missing,
        c.windows.missing,
        c.frames_bad
    ));
    bar.tick();
}
