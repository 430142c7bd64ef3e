//! `ihd replay`: a capture through a device's firmware, compared with the host's build of it.

use std::time::Duration;

use anyhow::{Context, Result};
use clap::Args;
use ihd_link::{Client, DeviceSpec};
use ihd_signal::Capture;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;
use ihd_survey::Survey;
use ihd_train::replay::{ReplayOptions, ReplayReport, board_segments, run};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::capture_args::CaptureArgs;
use super::global::Global;
use super::output;
use crate::report::table::TextTable;

/// Replay a capture in the loop: its samples go through a device's firmware in place of its ADCs.
///
/// R, L, windows and states that come back are compared bit for bit with the host-compiled
/// firmware. The device's power outputs are locked off meanwhile.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd replay half-cycle.mcap\n  \
    ihd replay coil_v.wfm coil_i.wfm --device usb --input fsw=45k\n  \
    ihd replay kitchen.mcap --device tcp:127.0.0.1:4711 --speed 1 --json\n\n\
    Exit codes: 0 identical, 1 failed, 2 wrong usage, 3 device or link, 6 the device differs,\n\
    7 the capture is empty or a cut MCAP (what could be read is replayed)")]
pub struct ReplayArgs {
    #[command(flatten)]
    capture: CaptureArgs,
    /// The device: sim, tcp:HOST:PORT, usb, usb:SERIAL or serial:PATH
    #[arg(long, value_name = "DEVICE", default_value = "sim")]
    device: DeviceSpec,
    /// Speed relative to the capture's own time; without it as fast as the link allows
    #[arg(long, value_name = "FACTOR")]
    speed: Option<f64>,
}

/// Error for a device whose results differ from this build's.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error(
    "the device differs from this build of its firmware in {0} values; is it the same version? \
     Flash the firmware that belongs to this host"
)]
pub struct ReplayDiffers(pub usize);

impl ReplayArgs {
    /// Replays, compares and prints the report.
    ///
    /// # Errors
    /// [`ReplayDiffers`] if the device's results differ; else the reason why they cannot be compared.
    pub fn run(&self, global: &Global) -> Result<()> {
        ensure_usage!(
            self.speed
                .is_none_or(|s| s.is_finite() && (1e-3..=1e3).contains(&s)),
            "--speed must lie between 0.001 and 1000"
        );
        self.capture.input()?.refuse(&["resonance-capacitance"])?;
        let loaded = self.capture.open_as_sampled()?;
        loaded.finish(self.replay(&loaded.capture, global.json))
    }

    fn replay(&self, capture: &Capture, json: bool) -> Result<()> {
        let survey = Survey::from_capture(capture, &self.capture.input()?.hints())?;
        let segments = board_segments(capture, survey.segments(capture));
        let settings = ReplayOptions {
            speed: self.speed,
            ..ReplayOptions::default()
        };
        let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
        let mut connect = || {
            let transport = self.device.open(|| Box::new(hob.clone()))?;
            let mut client = Client::connect(transport)?;
            // Lost answers are requested again: a short time limit suffices.
            client.set_timeout(Duration::from_secs(1));
            Ok(client)
        };
        let bar = ProgressBar::new(0);
        let style = ProgressStyle::with_template("{bar:40} {pos}/{len} blocks, {eta} left");
        bar.set_style(style.context("progress bar")?);
        let outcome = run(&segments, settings, &mut connect, &mut |blocks, of| {
            bar.set_length(of as u64);
            bar.set_position(blocks as u64);
        });
        bar.finish_and_clear();
        let outcome = outcome?;
        let surveyed: usize = survey.spans.iter().map(|span| span.samples).sum();
        let unassigned = survey.samples.saturating_sub(surveyed);
        if json {
            output::json(&JsonReport {
                outcome: &outcome,
                samples_without_frequency: unassigned,
            })?;
        } else {
            output::text(&text(&outcome, unassigned))?;
        }
        if outcome.is_identical() {
            Ok(())
        } else {
            Err(ReplayDiffers(outcome.differences).into())
        }
    }
}

/// Report as JSON.
#[derive(Serialize)]
struct JsonReport<'a> {
    #[serde(flatten)]
    outcome: &'a ReplayReport,
    /// Samples in no stretch of one switching frequency.
    samples_without_frequency: usize,
}

/// Report as text; `unassigned` samples are in no stretch of one switching frequency.
fn text(o: &ReplayReport, unassigned: usize) -> String {
    let counted = |c: ihd_train::replay::compare::MessageCounts| match c.lost {
        0 => format!("{} compared", c.compared),
        lost => format!("{} compared, {lost} lost on the link", c.compared),
    };
    let mut text = format!(
        "device     {}, power outputs locked off\n\
         replayed   {} blocks in {} stretches, {:.2} s\n\
         estimates  {} of R and L compared\n\
         windows    {}\n\
         telemetry  {}\n",
        o.device,
        o.blocks,
        o.stretches,
        o.seconds,
        o.estimates,
        counted(o.windows),
        counted(o.telemetry),
    );
    text += &not_replayed(o, unassigned);
    if o.repeats + o.reconnects > 0 {
        text += &format!(
            "link       {} messages repeated, {} times connected anew\n",
            o.repeats, o.reconnects
        );
    }
    if o.is_identical() && o.is_without_half_cycles() {
        let lost = o.windows.lost + o.telemetry.lost > 0;
        let why = match lost {
            true => "the link lost them",
            false => "nothing to compare: no whole half-cycle of the mains was replayed",
        };
        return text
            + &format!(
                "result     R and L identical, bit for bit; no window and no telemetry ({why})\n"
            );
    }
    if o.is_identical() {
        return text + "result     identical, bit for bit\n";
    }
    let mut table = TextTable::new(&["t/s", "what", "device", "this build"]);
    for d in &o.first {
        table.row([
            format!("{:.6}", d.t_s),
            d.what.clone(),
            d.device.clone(),
            d.host.clone(),
        ]);
    }
    text + &format!(
        "result     {} differences, the first {}:\n{}",
        o.differences,
        o.first.len(),
        table.render()
    )
}

/// Lines for what of the capture the device did not get as it is.
fn not_replayed(o: &ReplayReport, unassigned: usize) -> String {
    let mut parts = Vec::new();
    let mut count = |count: usize, what: &str| {
        if count > 0 {
            parts.push(format!("{count} {what}"));
        }
    };
    let stretches = o.omitted;
    count(
        stretches.out_of_range,
        "stretches at a frequency outside the hob's ratings",
    );
    count(stretches.short, "stretches shorter than a block");
    count(
        stretches.samples + unassigned,
        "samples in all, those without one switching frequency included",
    );
    let mut text = String::new();
    if !parts.is_empty() {
        text += &format!("omitted    {}\n", parts.join(", "));
    }
    if o.saturated > 0 {
        text += &format!(
            "saturated  {} pairs are beyond the range of the device's front end and were sent as its limit\n",
            o.saturated
        );
    }
    text
}
