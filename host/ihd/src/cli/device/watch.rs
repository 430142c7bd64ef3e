//! `ihd watch DEV --lines`: events as they occur.

use std::sync::atomic::Ordering;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result};
use ihd_api::client::ClientError;
use ihd_api::client::events::StreamItem;
use ihd_link::DeviceEvent;
use ihd_model::{DaemonEvent, EventKind};

use super::direct::Direct;
use super::hob::Hob;
use super::text::{of_live, one_line};
use crate::cli::{interrupt, output};

/// Number of half-cycles of which one is shown.
const HALF_CYCLES_PER_LINE: u32 = 100;

/// Prints a line for each event: JSON or text.
pub(super) fn watch(hob: &mut Hob, json: bool) -> Result<()> {
    match hob {
        Hob::Direct(direct) => watch_directly(direct, json),
        Hob::Daemon { client, name } => {
            // Not by a flag: the next event may be a while off.
            interrupt::ends().context("cannot catch ^C")?;
            let mut shown_ms = i64::MIN;
            for event in client.events(Some(name.as_str()))? {
                let cut = |e: std::io::Error| ClientError::Unreachable {
                    url: client.url().to_owned(),
                    why: format!("the events were cut off: {e}"),
                };
                match event.map_err(cut)? {
                    StreamItem::Heartbeat => {}
                    StreamItem::Unknown(text) if json => say!("{text}")?,
                    StreamItem::Unknown(_) => {}
                    StreamItem::Missed(n) if json => {
                        output::json_line(&serde_json::json!({"event": "missed", "missed": n}))?
                    }
                    StreamItem::Missed(n) => say!("{n} events missed: this reader was too slow")?,
                    StreamItem::Event(notice) if json => output::json_line(&notice)?,
                    StreamItem::Event(notice) => show(&notice, &mut shown_ms)?,
                }
            }
            match json {
                true => output::json_line(&serde_json::json!({"event": "ended"})),
                false => say!("the daemon has ended"),
            }
        }
    }
}

/// Prints half-cycles once a second, everything else at once.
fn show(notice: &DaemonEvent, shown_ms: &mut i64) -> Result<()> {
    let text = match &notice.kind {
        EventKind::Telemetry { .. } if notice.at_ms.saturating_sub(*shown_ms) < 1_000 => {
            return Ok(());
        }
        EventKind::Telemetry { live } => {
            *shown_ms = notice.at_ms;
            of_live(live)
        }
        what => event_text(what).unwrap_or_default(),
    };
    say!("{}", one_line(&text))
}

/// Text of an event; `None` for a half-cycle, which is not shown as an event.
pub(in crate::cli) fn event_text(what: &EventKind) -> Option<String> {
    Some(match what {
        EventKind::Telemetry { .. } => return None,
        EventKind::State { state: now, detail } if detail.is_empty() => now.as_str().to_owned(),
        EventKind::State { state: now, detail } => format!("{}: {detail}", now.as_str()),
        EventKind::WindowStored { seq, .. } => format!("window {seq} stored"),
        EventKind::WindowRefused { seq, why } => format!("window {seq} refused: {why}"),
        EventKind::ResultStored {
            seq,
            f_sw_hz,
            r_ohm,
            l_h,
            pass,
            why,
            ..
        } => {
            let verdict = if *pass {
                String::new()
            } else {
                format!(", unfit: {why}")
            };
            format!(
                "window {seq}: R {r_ohm:.4} ohm, L {:.3} µH at {:.2} kHz{verdict}",
                l_h * 1e6,
                f64::from(*f_sw_hz) * 1e-3
            )
        }
        EventKind::LookupActive {
            version,
            observed_cells,
        } => {
            format!("lookup {version} active, {observed_cells} cells known")
        }
        EventKind::LookupRefused { version, why } => format!("lookup {version} refused: {why}"),
        EventKind::Fault { fault: 0, .. } => "fault cleared".to_owned(),
        EventKind::Fault { fault, text } => format!("fault {fault}: {text}"),
        EventKind::Pot { text, .. } | EventKind::PotTemperature { text, .. } => {
            format!("pot {text}")
        }
        EventKind::Lease { holder, why, .. } if holder.is_empty() => match why.as_str() {
            "" => "nobody commands it now".to_owned(),
            why => format!("nobody commands it now: {why}"),
        },
        EventKind::Lease {
            holder, taken_from, ..
        } if taken_from.is_empty() => {
            format!("{holder} commands it")
        }
        EventKind::Lease {
            holder, taken_from, ..
        } => {
            format!("{holder} has taken command from {taken_from}")
        }
        EventKind::Command { holder, text, ok } => {
            format!(
                "{holder}: {text}{}",
                if *ok { "" } else { ", not carried out" }
            )
        }
        EventKind::Recording {
            text,
            file: Some(file),
            ..
        } => format!("recording {file}: {text}"),
        EventKind::Recording { text, .. } => format!("recording: {text}"),
        EventKind::Store { text, .. } => format!("store: {text}"),
    })
}

fn watch_directly(direct: &mut Direct, json: bool) -> Result<()> {
    let stop = interrupt::flag().context("cannot catch ^C")?;
    direct.stream(true)?;
    let mut shown_ms = i64::MIN;
    while !stop.load(Ordering::Relaxed) {
        let event = direct.client().next_event(Duration::from_millis(200))?;
        let Some(event) = event else { continue };
        let due =
            matches!(&event, DeviceEvent::Telemetry(t) if t.half_cycle % HALF_CYCLES_PER_LINE == 0);
        let kind = match event {
            DeviceEvent::Fault(event) => Some(EventKind::Fault {
                fault: event.fault.number(),
                text: event.fault.text().to_owned(),
            }),
            _ if due => (direct.report()?.live).map(|live| EventKind::Telemetry { live }),
            _ => None,
        };
        let Some(kind) = kind else { continue };
        let event = DaemonEvent {
            at_ms: now_ms(),
            device: direct.name().to_owned(),
            kind,
        };
        match json {
            true => output::json_line(&event)?,
            false => show(&event, &mut shown_ms)?,
        }
    }
    direct.stream(false)
}

/// Time of this machine in milliseconds since 1970, UTC.
pub(in crate::cli) fn now_ms() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| since.as_millis() as i64)
}
