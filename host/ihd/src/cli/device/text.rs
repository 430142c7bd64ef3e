//! Texts about devices. Strings of a device or a daemon are escaped at output.

use anyhow::Result;
use ihd_model::{ActiveRecording, DeviceReport, Live, LookupReport, PotTemperature, WindowCounts};

use crate::cli::output;

/// Prints a report.
pub(super) fn print(report: &DeviceReport, json: bool) -> Result<()> {
    if json {
        return output::json(report);
    }
    output::text(&of_report(report))
}

/// Text of a half-cycle.
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
    if live.limit != "None" && !live.limit.is_empty() {
        text += &format!(", limited by {}", live.limit);
    }
    if live.glass_hot {
        text += ", glass hot";
    }
    if live.fault != 0 {
        text += &format!(", fault {} ({})", live.fault, live.fault_text);
    }
    text
}

/// Text of a pot's temperature.
pub(in crate::cli) fn of_pot(pot: &PotTemperature) -> String {
    let mut text = format!(
        "{:+.0} ± {:.0} K since it was put on (by its heat alone {:+.0} ± {:.0} K)",
        pot.rise_k, pot.sigma_k, pot.prior_k, pot.prior_sigma_k
    );
    let states = [
        (pot.overheats, "overheats"),
        (pot.boils, "boils"),
        (pot.bubbles && !pot.boils, "bubbles at its base"),
    ];
    for (_, word) in states.iter().filter(|(is, _)| *is) {
        text += &format!(", {word}");
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
    line("state", format!("{}{detail}", r.state.as_str()));
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
    // If the update is the reason for being disconnected, the state has it.
    if !r.updates_needed.is_empty() && r.updates_needed != r.detail {
        line("update", r.updates_needed.clone());
    }
    if let Some(live) = &r.live {
        line("now", of_live(live));
    }
    if let Some(pot) = &r.pot_temperature {
        line("pot", of_pot(pot));
    }
    line("lookup", of_lookup(&r.lookup));
    if r.windows.announced > 0 {
        line("windows", of_windows(&r.windows));
    }
    if r.frames_beyond > 0 {
        let text = format!("{} frames more than a hob sends: dropped", r.frames_beyond);
        line("floods", text);
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
    if let Some(recording) = of_recording(r) {
        line("recording", recording);
    }
    text
}

fn of_lookup(lookup: &LookupReport) -> String {
    let on_device = match lookup.on_device {
        None => "not known yet".into(),
        Some(0) => "the built-in one".into(),
        Some(v) => format!("version {v}, {} cells known", lookup.observed_cells),
    };
    match lookup.pending {
        None => on_device,
        Some(v) => format!("{on_device}, version {v} pending"),
    }
}

fn of_windows(w: &WindowCounts) -> String {
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
    )
}

/// The recording's file, the trigger that it waits for, or its failure.
fn of_recording(r: &DeviceReport) -> Option<String> {
    let waits = |now: &ActiveRecording| format!("waits for {}", now.settings.trigger);
    let failed = |why: &String| format!("failed: {why}");
    r.recording
        .clone()
        .or_else(|| r.recording_now.as_ref().map(waits))
        .or_else(|| r.recording_failure.as_ref().map(failed))
}

/// Joins the text to one line.
pub(in crate::cli) fn one_line(text: &str) -> String {
    output::escaped(text)
        .replace('\n', "\\n")
        .replace('\t', "\\t")
}

#[cfg(test)]
mod tests {
    use ihd_model::{DeviceState, LookupReport, WindowCounts};

    use super::*;

    #[test]
    fn a_pots_temperature_is_a_rise_with_its_deviation() {
        let mut pot = PotTemperature {
            since_ms: 0,
            rise_k: 62.6,
            sigma_k: 7.8,
            prior_k: 81.0,
            prior_sigma_k: 41.0,
            lift_mm: 0.0,
            lift_sigma_mm: 0.1,
            bubbles: true,
            boils: false,
            overheats: false,
        };
        assert_eq!(
            of_pot(&pot),
            "+63 ± 8 K since it was put on (by its heat alone +81 ± 41 K), bubbles at its base"
        );
        pot.boils = true;
        assert!(of_pot(&pot).ends_with("K), boils"));
    }

    #[test]
    fn what_a_daemon_says_commands_no_terminal_and_makes_no_line() {
        let evil = "a\u{1b}]0;owned\u{7}\nstate      idle";
        let report = DeviceReport {
            name: evil.into(),
            address: evil.into(),
            serial: evil.into(),
            updates_needed: evil.into(),
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
            sweep_is_complete: false,
            recording: Some(evil.into()),
            recording_now: None,
            recording_failure: Some(evil.into()),
            pot_temperature: None,
            connections: 0,
            frames_beyond: 0,
        };
        let text = of_report(&report);
        assert!(
            text.chars().all(|c| c == '\n' || !c.is_control()),
            "{text:?}"
        );
        assert_eq!(text.lines().filter(|l| l.starts_with("state")).count(), 1);
    }
}
