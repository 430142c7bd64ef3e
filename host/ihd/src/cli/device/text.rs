//! Devices in words. What a device or a daemon says is escaped where it is printed.

use anyhow::Result;
use ihd_daemon::model::{DeviceReport, Live};

use crate::cli::output;

/// Prints a report.
pub(super) fn print(report: &DeviceReport, json: bool) -> Result<()> {
    if json {
        return output::json(report);
    }
    output::text(&of_report(report))
}

/// A half-cycle in some words.
pub(super) fn of_live(live: &Live) -> String {
    let mut text = format!("{}, {:.0} W", live.state, live.power_w);
    if live.asked_w > 0 {
        text += &format!(" of {} W", live.asked_w);
    }
    if live.f_sw_hz > 0 {
        text += &format!(" at {:.2} kHz", f64::from(live.f_sw_hz) * 1e-3);
    }
    if live.f_sw_hz > 0 && live.r_ohm.is_finite() && live.l_h.is_finite() {
        let (r, l) = (live.r_ohm, live.l_h * 1e6);
        text += &format!(", R {r:.3} ohm, L {l:.2} µH");
    }
    text += &format!(", pot {}", live.pot);
    if live.fault != 0 {
        text += &format!(", fault {} ({})", live.fault, live.fault_text);
    }
    text
}

fn of_report(r: &DeviceReport) -> String {
    let mut text = format!(
        "device     {} ({})\n",
        one_line(&r.name),
        one_line(&r.address)
    );
    let mut line = |name: &str, what: String| {
        text += &format!("{name:<11}{}\n", one_line(&what));
    };
    let detail = if r.detail.is_empty() {
        String::new()
    } else {
        format!(": {}", r.detail)
    };
    line("state", format!("{}{detail}", r.state.word()));
    if let Some(who) = &r.identity {
        let (major, minor) = who.protocol;
        line(
            "firmware",
            format!(
                "{} on {}, protocol {major}.{minor}, boot {:08x}",
                who.build, who.board, who.boot_id
            ),
        );
    }
    if let Some(live) = &r.live {
        line("now", of_live(live));
    }
    let version = |version: Option<u32>| version.map_or("none".into(), |v| v.to_string());
    let lookup = match r.lookup.on_device {
        None => "not known yet".into(),
        Some(0) => "the built-in one".into(),
        Some(v) => format!("version {v}, {} cells observed", r.lookup.observed_cells),
    };
    let pending = match r.lookup.pending {
        None => String::new(),
        pending => format!(", version {} pending", version(pending)),
    };
    line("lookup", lookup + &pending);
    let w = &r.windows;
    if w.announced > 0 {
        line(
            "windows",
            format!(
                "{} announced: {} stored, {} refused, {} lost, {} dropped by the device, {} not stored; {} learned, {} unfit, {} unlearned",
                w.announced,
                w.stored,
                w.refused,
                w.lost,
                w.dropped_by_device,
                w.not_stored,
                w.learned,
                w.unfit,
                w.unlearned
            ),
        );
    }
    if let Some(lease) = &r.lease {
        line(
            "commanded",
            format!(
                "by {}, for {} s more unless it is renewed",
                lease.holder, lease.expires_in_s
            ),
        );
    }
    if !r.sweep_left_w.is_empty() {
        let left: Vec<String> = r.sweep_left_w.iter().map(u16::to_string).collect();
        line("sweep", format!("{} W to come", left.join(", ")));
    }
    if let Some(file) = &r.recording {
        line("recording", file.clone());
    }
    text
}

/// A line stays one, whatever it holds.
pub(super) fn one_line(text: &str) -> String {
    output::escaped(text)
        .replace('\n', "\\n")
        .replace('\t', "\\t")
}

#[cfg(test)]
mod tests {
    use ihd_daemon::model::{DeviceState, LookupReport, WindowCounts};

    use super::*;

    #[test]
    fn what_a_daemon_says_commands_no_terminal_and_makes_no_line() {
        let evil = "a\u{1b}]0;owned\u{7}\nstate      idle";
        let report = DeviceReport {
            name: evil.into(),
            address: evil.into(),
            state: DeviceState::Searching,
            since_s: 0,
            detail: evil.into(),
            identity: None,
            live: None,
            lookup: LookupReport::default(),
            windows: WindowCounts::default(),
            asked_by_daemon_w: 0,
            lease: None,
            sweep_left_w: vec![],
            recording: Some(evil.into()),
            connections: 0,
        };
        let text = of_report(&report);
        assert!(
            text.chars().all(|c| c == '\n' || !c.is_control()),
            "{text:?}"
        );
        assert_eq!(text.lines().filter(|l| l.starts_with("state")).count(), 1);
    }
}
