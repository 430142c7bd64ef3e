//! Heating in the foreground: the lease is renewed, the hob is shown, and off at the end, whatever ends it.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use ihd_daemon::model::{Command, DeviceReport};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use thiserror::Error;

use super::hob::{Hob, is_somebody_elses};
use super::text::{of_live, one_line};
use crate::cli::usage::Usage;
use crate::cli::{interrupt, output};

/// Between two renewals; the lease lasts 10 s.
const RENEW_EVERY: Duration = Duration::from_secs(3);

/// Between two looks.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// A lost answer is no end; the lease is, after 10 s.
const SILENCE: Duration = Duration::from_secs(8);

/// Between two lines where nobody looks at a terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// How long each power of a sweep lasts without a daemon, which would wait for windows.
const STEP: Duration = Duration::from_secs(5);

/// The device was asked to heat, and did not.
#[derive(Debug, Error)]
#[error("{name} did not heat as asked: {why}")]
pub struct DoesNotHeat {
    name: String,
    why: String,
}

/// How heating ended that nobody here ended.
const ELSEWHERE: &str = "switched off elsewhere, or its link was cut";

/// What became of it.
#[derive(Debug, Default, Serialize)]
struct Heated {
    device: String,
    asked_w: Vec<u16>,
    seconds: f64,
    heating_seconds: f64,
    energy_wh: f64,
    ended_by: &'static str,
    last: Option<DeviceReport>,
}

/// After a command until its device shows it.
const SHOWN_WITHIN: Duration = Duration::from_secs(2);

/// Heats with one power until ^C or the time is over.
pub(super) fn power(hob: &mut Hob, power_w: u16, for_s: Option<f64>, json: bool) -> Result<()> {
    let time = for_s.map(Duration::try_from_secs_f64).transpose();
    let time = time.map_err(|_| Usage("--for is longer than anybody waits".into()))?;
    let command = Command::Power { power_w };
    let mut end = |elapsed: Duration, hob: &mut Hob, report: &DeviceReport| {
        if elapsed > SHOWN_WITHIN && asked_w(hob, report) == 0 {
            return Ok(Some(ELSEWHERE));
        }
        Ok(time.is_some_and(|time| elapsed >= time).then_some("time"))
    };
    run(hob, &command, &[power_w], &mut end, json)
}

/// What is asked of the device by whoever commands it from here.
fn asked_w(hob: &Hob, report: &DeviceReport) -> u16 {
    match hob {
        Hob::Daemon { .. } => report.asked_by_daemon_w,
        Hob::Direct(_) => report.live.as_ref().map_or(0, |live| live.asked_w),
    }
}

/// Heats with one power after the other.
pub(super) fn sweep(hob: &mut Hob, powers_w: &[u16], json: bool) -> Result<()> {
    if let Hob::Direct(_) = hob {
        return sweep_directly(hob, powers_w, json);
    }
    let command = Command::Sweep {
        powers_w: powers_w.to_vec(),
    };
    // The daemon has begun it when it answers; the last power is the last that is left.
    let mut left = powers_w.len();
    let mut end = |_: Duration, _: &mut Hob, report: &DeviceReport| {
        let before = std::mem::replace(&mut left, report.sweep_left_w.len());
        if left > 0 || report.asked_by_daemon_w > 0 {
            return Ok(None);
        }
        Ok(Some(if before <= 1 { "sweep" } else { ELSEWHERE }))
    };
    run(hob, &command, powers_w, &mut end, json)
}

/// Nobody learns from it; R and L are the device's own.
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
            Some(power_w) => hob.command(&Command::Power { power_w }).map(|_| None),
        }
    };
    if !json {
        say!("without a daemon nobody learns from a sweep; what the device itself finds:")?;
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
    let mut heated = Heated {
        device: hob.name().to_owned(),
        asked_w: powers_w.to_vec(),
        ..Heated::default()
    };
    let bar = bar(json);
    let ended = begin(hob, command).and_then(|()| hold(hob, stop, end, &mut heated, &bar, json));
    // A lease that is somebody else's now: so is the heating.
    let off = match &ended {
        Err(error) if is_somebody_elses(error) => Ok(()),
        _ => switch_off(hob),
    };
    bar.finish_and_clear();
    if json {
        output::json(&heated)?;
    } else {
        say!(
            "{}: {} after {:.0} s, of which it heated {:.0} s, {:.1} Wh",
            heated.device,
            if off.is_ok() && ended.is_ok() {
                "off"
            } else {
                "ended"
            },
            heated.seconds,
            heated.heating_seconds,
            heated.energy_wh
        )?;
    }
    ended?;
    off?;
    did_it_heat(&heated)
}

fn begin(hob: &mut Hob, command: &Command) -> Result<()> {
    if let Hob::Direct(direct) = hob {
        direct.stream(true)?;
    }
    hob.command(command).map(drop)
}

/// Off, and the lease back; an off that is not answered is tried again, for it harms nobody.
fn switch_off(hob: &mut Hob) -> Result<()> {
    let off = hob
        .command(&Command::Off)
        .or_else(|_| hob.command(&Command::Off))
        .context("cannot be switched off from here: it ends by itself within 10 s");
    if let Hob::Direct(direct) = hob {
        // Silence is for who comes next.
        let _ = direct.stream(false);
    }
    let given_back = hob.release_lease();
    off?;
    given_back
}

/// Until it ends; an error is one that lasts.
fn hold(
    hob: &mut Hob,
    stop: &AtomicBool,
    end: &mut End<'_>,
    heated: &mut Heated,
    bar: &ProgressBar,
    json: bool,
) -> Result<()> {
    let began = Instant::now();
    let (mut renewed, mut heard, mut said, mut looked) = (began, began, None::<Instant>, began);
    loop {
        if stop.load(Ordering::Relaxed) {
            heated.ended_by = "interrupt";
            return Ok(());
        }
        let now = Instant::now();
        let turn = look(hob, now.duration_since(renewed) >= RENEW_EVERY);
        match turn {
            Ok((report, again)) => {
                heard = now;
                if again {
                    renewed = now;
                }
                count(heated, &report, began, now.duration_since(looked));
                let line = status_line(&report, began.elapsed());
                if !json && bar.is_hidden() && said.is_none_or(|at| now - at >= LINE_EVERY) {
                    said = Some(now);
                    say!("{line}")?;
                }
                bar.set_message(line);
                let over = end(began.elapsed(), hob, &report)?;
                heated.last = Some(report);
                if let Some(by) = over {
                    heated.ended_by = by;
                    return Ok(());
                }
            }
            Err(error) if lasts(&error, heard.elapsed()) => {
                heated.ended_by = "error";
                return Err(error);
            }
            Err(error) => bar.set_message(one_line(&crate::cli::message(&error))),
        }
        looked = now;
        sleep(LOOK_EVERY.saturating_sub(now.elapsed()));
    }
}

/// Returns `true` if an error ends the heating: the lease is somebody else's, or nothing was heard for longer than [`SILENCE`].
fn lasts(error: &anyhow::Error, silent: Duration) -> bool {
    is_somebody_elses(error) || silent > SILENCE
}

/// The hob now, and whether the lease was renewed.
fn look(hob: &mut Hob, renew: bool) -> Result<(DeviceReport, bool)> {
    if renew {
        hob.take_lease(false)?;
    }
    Ok((hob.report()?, renew))
}

fn count(heated: &mut Heated, report: &DeviceReport, began: Instant, since: Duration) {
    heated.seconds = began.elapsed().as_secs_f64();
    let power_w = report.live.as_ref().map_or(0.0, |live| live.power_w);
    if power_w > 0.0 {
        heated.heating_seconds += since.as_secs_f64();
        heated.energy_wh += power_w * since.as_secs_f64() / 3_600.0;
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

fn did_it_heat(heated: &Heated) -> Result<()> {
    let early = heated.ended_by == ELSEWHERE;
    if !early && (heated.heating_seconds > 0.0 || heated.ended_by == "interrupt") {
        return Ok(());
    }
    let why = heated.last.as_ref().map_or(String::new(), |report| {
        let live = report.live.as_ref().map_or(String::new(), of_live);
        format!("{} ({live})", report.detail)
    });
    let why = if early {
        format!("{ELSEWHERE}: {why}")
    } else {
        why
    };
    let name = heated.device.clone();
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
    use ihd_daemon::model::CommandError;

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
