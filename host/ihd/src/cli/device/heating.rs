//! Heating in the foreground: renews the lease, shows the hob, and switches it off at the end in any case.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use ihd_daemon::LEASE_S;
use ihd_model::{Command, CommandError, DeviceReport, DeviceState};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use thiserror::Error;

use super::hob::{Hob, is_leased_elsewhere};
use super::text::{of_live, one_line};
use crate::cli::{interrupt, output};

/// Period of renewing the lease: three times while it lasts.
pub const RENEW_PERIOD: Duration = Duration::from_secs(LEASE_S / 3);

/// Polling period.
const POLL_PERIOD: Duration = Duration::from_millis(500);

/// Time without an answer after which heating ends; the lease ends after 10 s.
const SILENCE_TIMEOUT: Duration = Duration::from_secs(8);

/// Period of output lines if standard output is no terminal.
const LINE_PERIOD: Duration = Duration::from_secs(10);

/// Duration of each power of a sweep without a daemon, which would wait for windows.
const STEP: Duration = Duration::from_secs(5);

/// Error of a device that was commanded to heat and does not.
#[derive(Debug, Error)]
#[error("{name} did not heat as asked: {why}")]
pub struct DoesNotHeat {
    /// Name of the device.
    pub name: String,
    /// Reason, as the device gives it.
    pub why: String,
}

/// End of heating by another client, the hob's panel or a cut link.
const ELSEWHERE: &str = "elsewhere";

/// Summary of a heating.
#[derive(Debug, Default, Serialize)]
struct HeatingSummary {
    device: String,
    asked_w: Vec<u16>,
    /// Power that the hob took of the first.
    granted_w: Option<u16>,
    seconds: f64,
    heating_seconds: f64,
    energy_wh: f64,
    ended_by: &'static str,
    last: Option<DeviceReport>,
}

/// Time limit for the device to show a command's effect.
const SHOWN_WITHIN: Duration = Duration::from_secs(2);

/// Heats with one power until Ctrl-C or the end of the time.
pub(super) fn power(hob: &mut Hob, power_w: u16, time: Option<Duration>, json: bool) -> Result<()> {
    let command = Command::Power { power_w };
    let mut end = |elapsed: Duration, hob: &mut Hob, report: &DeviceReport| {
        if elapsed > SHOWN_WITHIN && asked_w(hob, report) == 0 {
            return Ok(Some(ELSEWHERE));
        }
        Ok(time.is_some_and(|time| elapsed >= time).then_some("time"))
    };
    run(hob, &command, &[power_w], &mut end, json)
}

/// Power that this client has requested of the device, in watt.
fn asked_w(hob: &Hob, report: &DeviceReport) -> u16 {
    match hob {
        Hob::Daemon { .. } => report.asked_by_daemon_w,
        Hob::Direct(_) => report.live.as_ref().map_or(0, |live| live.asked_w),
    }
}

/// Heats with the powers in turn.
pub(super) fn sweep(hob: &mut Hob, powers_w: &[u16], json: bool) -> Result<()> {
    if let Hob::Direct(_) = hob {
        return sweep_directly(hob, powers_w, json);
    }
    let command = Command::Sweep {
        powers_w: powers_w.to_vec(),
    };
    // The daemon has started the sweep when it answers.
    let mut end = |_: Duration, _: &mut Hob, report: &DeviceReport| {
        if !report.sweep_left_w.is_empty() || report.asked_by_daemon_w > 0 {
            return Ok(None);
        }
        let is_complete = report.sweep_is_complete;
        Ok(Some(if is_complete { "sweep" } else { ELSEWHERE }))
    };
    run(hob, &command, powers_w, &mut end, json)
}

/// Sweeps without a daemon: nothing is learned, and R and L are the device's own.
fn sweep_directly(hob: &mut Hob, powers_w: &[u16], json: bool) -> Result<()> {
    let mut next = 1;
    let mut end = |elapsed: Duration, hob: &mut Hob, report: &DeviceReport| {
        if elapsed < STEP * next {
            return Ok(None);
        }
        if let (Some(live), false) = (&report.live, json) {
            say!("{}", one_line(&of_live(live)))?;
        }
        let power_w = powers_w.get(next as usize).copied();
        next += 1;
        match power_w {
            None => Ok(Some("sweep")),
            Some(power_w) => begin(hob, &Command::Power { power_w }).map(|_| None),
        }
    };
    if !json {
        say!("without a daemon nothing is learned from a sweep; the device's own results:")?;
    }
    let first = Command::Power {
        power_w: powers_w.first().copied().unwrap_or(0),
    };
    run(hob, &first, powers_w, &mut end, json)
}

type End<'a> = dyn FnMut(Duration, &mut Hob, &DeviceReport) -> Result<Option<&'static str>> + 'a;

fn run(
    hob: &mut Hob,
    command: &Command,
    powers_w: &[u16],
    end: &mut End<'_>,
    json: bool,
) -> Result<()> {
    let stop = interrupt::flag().context("cannot catch ^C")?;
    hob.take_lease(false)?;
    let mut summary = HeatingSummary {
        device: hob.name().to_owned(),
        asked_w: powers_w.to_vec(),
        ..HeatingSummary::default()
    };
    let bar = bar(json);
    let ended = begin(hob, command).and_then(|granted_w| {
        summary.granted_w = granted_w;
        hold(hob, stop, end, &mut summary, &bar, json)
    });
    // If another client has taken the lease, the heating is its own, too.
    let off = match &ended {
        Err(error) if is_leased_elsewhere(error) => Ok(()),
        _ => switch_off(hob),
    };
    bar.finish_and_clear();
    let is_off = off.is_ok() && ended.is_ok();
    let outcome = match (ended, off) {
        // What is on matters more than who reads of it.
        (Err(ended), Err(off)) if ended.is::<output::OutputClosed>() => Err(off),
        (Err(ended), Err(off)) => Err(ended.context(off.to_string())),
        (ended, off) => ended.and(off).and_then(|()| check_heated(&summary)),
    };
    outcome.and(show(&summary, is_off, json))
}

fn show(summary: &HeatingSummary, is_off: bool, json: bool) -> Result<()> {
    if json {
        return output::json(summary);
    }
    say!(
        "{}: {} after {:.0} s, of which it heated {:.0} s, {:.1} Wh",
        summary.device,
        if is_off { "off" } else { "ended" },
        summary.seconds,
        summary.heating_seconds,
        summary.energy_wh
    )
}

/// Sends a command; returns the power that the hob took, and says so where it is less than was asked for.
fn begin(hob: &mut Hob, command: &Command) -> Result<Option<u16>> {
    if let Hob::Direct(direct) = hob {
        direct.stream(true)?;
    }
    let reply = hob.command(command)?;
    if let (Command::Power { power_w }, Some(granted_w)) = (command, reply.granted_w)
        && granted_w < *power_w
    {
        output::complain(format_args!("{}: {}", hob.name(), reply.text));
    }
    Ok(reply.granted_w)
}

/// Switches off and releases the lease; an unanswered request to switch off is repeated.
///
/// # Errors
/// Also if another client has the lease by now: the heating is its own then, and goes on.
fn switch_off(hob: &mut Hob) -> Result<()> {
    if let Err(error) = hob.take_lease(false)
        && is_leased_elsewhere(&error)
    {
        return Err(error);
    }
    let off = hob
        .command(&Command::Off)
        .or_else(|_| hob.command(&Command::Off))
        .context("cannot be switched off from here: it ends by itself within 10 s");
    if let Hob::Direct(direct) = hob {
        // Restores the stream for the next client.
        let _ = direct.stream(false);
    }
    let given_back = hob.release_lease();
    off?;
    given_back
}

/// Runs until the heating ends; a lasting error is returned.
fn hold(
    hob: &mut Hob,
    stop: &AtomicBool,
    end: &mut End<'_>,
    summary: &mut HeatingSummary,
    bar: &ProgressBar,
    json: bool,
) -> Result<()> {
    let began = Instant::now();
    let (mut renewed, mut heard, mut printed, mut polled) = (began, began, None::<Instant>, began);
    loop {
        if stop.load(Ordering::Relaxed) {
            summary.ended_by = "interrupt";
            return Ok(());
        }
        let now = Instant::now();
        let turn = poll(hob, now.duration_since(renewed) >= RENEW_PERIOD);
        match turn.and_then(connected) {
            Ok((report, again)) => {
                heard = now;
                if again {
                    renewed = now;
                }
                count(summary, &report, began, now.duration_since(polled));
                let line = status_line(&report, began.elapsed());
                if !json && bar.is_hidden() && printed.is_none_or(|at| now - at >= LINE_PERIOD) {
                    printed = Some(now);
                    say!("{line}")?;
                }
                bar.set_message(line);
                let over = end(began.elapsed(), hob, &report)?;
                summary.last = Some(report);
                if let Some(by) = over {
                    summary.ended_by = by;
                    return Ok(());
                }
            }
            Err(error) if lasts(&error, heard.elapsed()) => {
                summary.ended_by = "error";
                return Err(error);
            }
            Err(error) => bar.set_message(one_line(&crate::cli::message(&error))),
        }
        polled = now;
        sleep(POLL_PERIOD.saturating_sub(now.elapsed()));
    }
}

/// Returns `true` if an error ends the heating: another client holds the lease, or nothing was received for longer than
/// [`SILENCE_TIMEOUT`].
fn lasts(error: &anyhow::Error, silent: Duration) -> bool {
    is_leased_elsewhere(error) || silent > SILENCE_TIMEOUT
}

/// Reads the hob's report, and renews the lease; the second result is `true` if it was renewed.
fn poll(hob: &mut Hob, renew: bool) -> Result<(DeviceReport, bool)> {
    if renew {
        hob.take_lease(false)?;
    }
    Ok((hob.report()?, renew))
}

/// Passes the report of a hob that answers; the daemon reports one that it has lost, too.
fn connected((report, renewed): (DeviceReport, bool)) -> Result<(DeviceReport, bool)> {
    match report.state {
        DeviceState::Searching | DeviceState::Suspended | DeviceState::Incompatible => {
            Err(CommandError::NotConnected {
                name: report.name,
                detail: report.detail,
            }
            .into())
        }
        _ => Ok((report, renewed)),
    }
}

fn count(summary: &mut HeatingSummary, report: &DeviceReport, began: Instant, since: Duration) {
    summary.seconds = began.elapsed().as_secs_f64();
    let power_w = report.live.as_ref().map_or(0.0, |live| live.power_w);
    if power_w > 0.0 {
        summary.heating_seconds += since.as_secs_f64();
        summary.energy_wh += power_w * since.as_secs_f64() / 3_600.0;
    }
}

fn status_line(report: &DeviceReport, elapsed: Duration) -> String {
    let now = report.live.as_ref().map_or(String::new(), of_live);
    let sweep = match report.sweep_left_w.len() {
        0 => String::new(),
        n => format!(", {n} powers to come"),
    };
    one_line(&format!(
        "{}: {:.0} s, {now}{sweep}",
        report.name,
        elapsed.as_secs_f64()
    ))
}

fn check_heated(summary: &HeatingSummary) -> Result<()> {
    let early = summary.ended_by == ELSEWHERE;
    if !early && (summary.heating_seconds > 0.0 || summary.ended_by == "interrupt") {
        return Ok(());
    }
    let why = summary.last.as_ref().map_or(String::new(), |report| {
        let live = report.live.as_ref().map_or(String::new(), of_live);
        one_line(&format!("{} ({live})", report.detail))
    });
    let why = if early {
        format!("switched off elsewhere, or its link was cut: {why}")
    } else {
        why
    };
    let name = summary.device.clone();
    Err(DoesNotHeat { name, why }.into())
}

fn bar(json: bool) -> ProgressBar {
    if json || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{spinner} {wide_msg}  (^C switches off)") {
        bar.set_style(style);
    }
    bar
}

#[cfg(test)]
mod tests {
    use ihd_api::client::ClientError;

    use super::*;

    #[test]
    fn lost_answers_end_it_after_eight_seconds_and_another_ones_lease_at_once() {
        let lost = anyhow::anyhow!("no answer");
        assert!(!lasts(&lost, Duration::from_secs(8)));
        assert!(lasts(&lost, Duration::from_millis(8_001)));
        let leased = CommandError::Leased {
            name: "bench".into(),
            holder: "Ada".into(),
            expires_in_s: 9,
        };
        assert!(lasts(&ClientError::Command(leased).into(), Duration::ZERO));
    }
}
