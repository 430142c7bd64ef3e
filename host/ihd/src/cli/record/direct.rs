//! Recording by this process: everything that the device streams, in a capture file.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Duration;

use anyhow::{Context, Error, Result, bail, ensure};
use ihd_capture::mcap::topics::LinkCounters;
use ihd_capture::recording::{
    RecordSettings, RecordingLimit, RecordingOptions, RecordingPhase, RecordingSession,
    RecordingStatus, Trigger,
};
use ihd_daemon::states::device_state;
use ihd_link::{Client, DeviceEvent, KEEPALIVE_PERIOD};
use ihd_model::DeviceState;
use ihd_shared::wire::messages::{State, Status, Utilisation};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::{COMPLETE_WITHIN, NothingRecorded};
use crate::cli::device::DoesNotHeat;
use crate::cli::{interrupt, output};
use crate::report::utilisation;

/// Time limit of waiting for an event before limits and Ctrl-C are checked.
const POLL_PERIOD: Duration = Duration::from_millis(100);

/// Recording of a device that is open.
#[derive(Debug)]
pub(super) struct DirectRecording {
    /// The capture file, which must not exist.
    pub out: PathBuf,
    /// Trigger and limits.
    pub settings: RecordSettings,
    /// Power to request in watt; `None` if the device's is not to be changed.
    pub power: Option<u16>,
    /// Half-cycles per telemetry; 0 for none.
    pub telemetry_every: u8,
    /// Half-cycles per window; 0 for none.
    pub windows_every: u8,
    /// `true` for a simulated hob of this process.
    pub simulated: bool,
    /// Print the report as JSON.
    pub json: bool,
}

/// Summary of a recording.
#[derive(Debug, Serialize)]
struct Report {
    /// The capture file; `None` if its trigger did not come.
    file: Option<PathBuf>,
    device: String,
    v_full_scale_v: f64,
    i_full_scale_a: f64,
    bits: u8,
    /// Reason of the end: duration, size, interrupt or error.
    ended_by: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
    /// Reason for which the requested power was never delivered; `None` without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    does_not_heat: Option<String>,
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

/// Returns the reason for which a device does not heat; `None` if it does.
fn why_not_heating(status: &Status) -> Option<String> {
    if status.state == State::Heating {
        return None;
    }
    let (_, detail) = device_state(status, DeviceState::Connected);
    Some(match detail.as_str() {
        "" => format!("it is in state {}", status.state.name()),
        _ => detail,
    })
}

impl DirectRecording {
    /// Records and prints the report.
    ///
    /// # Errors
    /// If the device or the file fails; the data recorded until then are in the file.
    pub(super) fn run(&self, mut client: Client) -> Result<()> {
        // Found at the trigger, it would cost the recording.
        ensure_usage!(
            self.settings.trigger == Trigger::Now || !self.out.exists(),
            "{} is there already",
            self.out.display()
        );
        let stop = interrupt::flag().context("cannot catch ^C")?;
        let (publish, statuses) = mpsc::channel();
        let session = self.session(publish);
        let at = client.clock();
        let sink = session.connected(client.hello(), client.front_end(), at);
        client.record_to(sink);
        let started = session.start(self.settings, at).map_err(Error::msg)?;
        started.wait().map_err(Error::msg)?;
        let bar = spinner()?;
        if self.settings.trigger != Trigger::Now && !self.json {
            say!("{}; ^C ends it", started.text)?;
        }
        let mut report = self.report(&client);
        let recorded = self.record(&mut client, (&session, &statuses), stop, &bar, &mut report);
        // An error of the recording must not keep the device from being switched off.
        let left = self.leave(&mut client);
        let stopped = session.stop("ended by hand");
        let closed = stopped.and_then(|stopped| stopped.wait());
        bar.finish_and_clear();
        report.link = ihd_capture::mcap::link_counters(&client.counters());
        report.file = self.out.exists().then(|| self.out.clone());
        report.bytes = std::fs::metadata(&self.out).map_or(0, |m| m.len());
        if let Ok((status, used)) = &left {
            report.device_windows_dropped = Some(status.windows_dropped);
            report.device_telemetry_dropped = Some(status.telemetry_dropped);
            report.processor = utilisation::json(used.as_ref());
            report.processor_line = utilisation::line(used.as_ref());
        }
        let done = recorded.and(left.map(drop)).and(closed.map_err(Error::msg));
        if let Err(error) = &done {
            report.ended_by = "error";
            report.error = Some(crate::cli::message(error));
        }
        // The report is printed in any case.
        let printed = self.print(&report);
        done.and(printed)?;
        match (report.file, report.does_not_heat) {
            (None, _) => Err(NothingRecorded.into()),
            (Some(_), None) => Ok(()),
            (Some(_), Some(why)) => {
                let name = report.device;
                Err(DoesNotHeat { name, why }.into())
            }
        }
    }

    fn session(&self, publish: mpsc::Sender<RecordingStatus>) -> RecordingSession {
        let options = RecordingOptions {
            simulated_clock: self.simulated,
            ends_by_owner: true,
            free_bytes: None,
        };
        // A second file would follow a reconnect, and this link is opened once.
        let out = self.out.clone();
        let publish = move |status| drop(publish.send(status));
        RecordingSession::with_options(options, move |_| out.clone(), publish)
    }

    /// Report before anything was recorded.
    fn report(&self, client: &Client) -> Report {
        let front_end = client.front_end();
        Report {
            file: None,
            device: format!("{} ({})", client.describe(), client.hello().build),
            v_full_scale_v: front_end.scales().v_full_scale_v(),
            i_full_scale_a: front_end.scales().i_full_scale_a(),
            bits: front_end.bits,
            ended_by: "error",
            error: None,
            does_not_heat: None,
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
        (session, statuses): (&RecordingSession, &mpsc::Receiver<RecordingStatus>),
        stop: &AtomicBool,
        bar: &ProgressBar,
        report: &mut Report,
    ) -> Result<()> {
        client.read_lookup()?;
        client.stream(self.telemetry_every, self.windows_every)?;
        if let Some(power_w) = self.power {
            let granted = client.set_power(power_w)?;
            if granted.is_reduced() {
                bar.suspend(|| output::complain(format_args!("{granted}")));
            }
        }
        // Resets the device's counts.
        client.utilisation()?;
        session.count_from(client.clock());
        let mut heard = client.clock();
        let mut has_heated = false;
        report.ended_by = loop {
            let progress = session.progress(client.clock());
            // A recording that a full disk ended has no progress any more.
            report.seconds = progress.map_or(report.seconds, |now| now.elapsed_s);
            if stop.load(Ordering::Relaxed) {
                break "interrupt";
            }
            match progress.and_then(|now| now.limit) {
                Some(RecordingLimit::Duration) => break "duration",
                Some(RecordingLimit::Size) => break "size",
                None => {}
            }
            self.show_statuses(statuses, session.active().is_none())?;
            match client.next_event(POLL_PERIOD)? {
                Some(DeviceEvent::Fault(_)) => report.faults += 1,
                Some(DeviceEvent::Telemetry(t)) => has_heated |= t.state == State::Heating,
                _ => {}
            }
            if client.clock().saturating_sub(heard) >= KEEPALIVE_PERIOD {
                heard = client.clock();
                client.status()?;
            }
            show(
                bar,
                report.seconds,
                progress.map_or(0, |now| now.bytes),
                client,
            );
        };
        if self.power.is_some() && !has_heated && report.ended_by != "interrupt" {
            report.does_not_heat = why_not_heating(&client.status()?);
        }
        Ok(())
    }

    /// Prints the beginning of a triggered recording. A failure is the error; once the recording has `ended`, it is waited for.
    fn show_statuses(&self, statuses: &mpsc::Receiver<RecordingStatus>, ended: bool) -> Result<()> {
        let patience = if ended {
            COMPLETE_WITHIN
        } else {
            Duration::ZERO
        };
        while let Ok(status) = statuses.recv_timeout(patience) {
            let is_triggered = self.settings.trigger != Trigger::Now;
            match (status.phase, status.file) {
                (RecordingPhase::Failed, _) => bail!("{}", status.text),
                (RecordingPhase::Begun, Some(file)) if is_triggered && !self.json => {
                    say!("{}: recording into {}", status.text, file.display())?;
                }
                _ => {}
            }
        }
        ensure!(
            !ended,
            "{}: the recording has ended by itself",
            self.out.display()
        );
        Ok(())
    }

    /// Stops the stream, switches the device off if it was switched on here, and processes remaining data.
    fn leave(&self, client: &mut Client) -> Result<(Status, Option<Utilisation>)> {
        // First of all: whatever fails afterwards, it does not heat.
        if self.power.is_some() {
            client.set_power(0)?;
        }
        let used = client.utilisation()?;
        client.stream(0, 0)?;
        while client.next_event(POLL_PERIOD)?.is_some() {}
        Ok((client.status()?, Some(used)))
    }

    fn print(&self, r: &Report) -> Result<()> {
        if self.json {
            return output::json(r);
        }
        let dropped = |n: Option<u32>| n.map_or("?".to_owned(), |n| n.to_string());
        let Some(file) = &r.file else {
            return Ok(());
        };
        let (l, path) = (&r.link, file.display());
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

fn show(bar: &ProgressBar, seconds: f64, bytes: u64, client: &Client) {
    let c = client.counters();
    bar.set_message(format!(
        "{:.1} s, {:.2} MB, {} telemetry, {} windows; missing {} and {}, {} bad frames, ^C ends",
        seconds,
        bytes as f64 * 1e-6,
        c.telemetry.received,
        c.windows.received,
        c.telemetry.missing,
        c.windows.missing,
        c.frames_bad
    ));
    bar.tick();
}

/// Capture file of a device if none is named: `tcp-127.0.0.1-4711.mcap`.
#[cfg(feature = "daemon")]
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
