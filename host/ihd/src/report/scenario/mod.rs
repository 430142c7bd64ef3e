//! Record of a scenario as text.

pub mod figure;

use std::fmt::Write;

use ihd_sim::scenario::limits::LimitCheck;
use ihd_sim::scenario::record::{PowerStep, Record, TrueHalfCycle};

use super::table::TextTable;

/// Limit of listed changes of state, pot, fault or request; a host that repeats itself makes many.
const ROWS: usize = 60;

/// Power steps, states with their largest values, faults, energy, and the limits of the file.
pub fn text(record: &Record, checked: &[LimitCheck]) -> String {
    let mut text = String::new();
    if !record.summary.steps.is_empty() {
        text += &steps(&record.summary.steps);
        text.push('\n');
    }
    text += &states(&record.half_cycles);
    text.push('\n');
    text += &events(record);
    for limit in checked {
        let verdict = if limit.ok { "met" } else { "MISSED" };
        let _ = writeln!(text, "limit {verdict}: {limit}");
    }
    text
}

fn number(value: Option<f64>, digits: usize) -> String {
    match value {
        Some(value) => format!("{value:.digits$}"),
        None => "–".to_owned(),
    }
}

/// Table of the steps of the requested power.
fn steps(steps: &[PowerStep]) -> String {
    let mut table = TextTable::new(&["at/s", "asked/W", "settled/s", "overshoot/%", "error/%"]);
    for step in steps {
        table.row([
            format!("{:.3}", step.at_s),
            format!("{:.0}", step.power_w),
            number(step.settled_after_s, 3),
            number(step.overshoot_pct, 1),
            number(step.error_pct, 2),
        ]);
    }
    table.render()
}

/// Table with a row for each stretch of half-cycles that are [alike].
fn states(half_cycles: &[TrueHalfCycle]) -> String {
    let mut table = TextTable::new(&[
        "from/s",
        "state",
        "pot",
        "fault",
        "asked/W",
        "power/W",
        "f_sw/kHz",
        "i_peak/A",
        "v_coil/V",
        "hard edges",
    ]);
    let stretches: Vec<_> = half_cycles.chunk_by(alike).collect();
    for stretch in stretches.iter().take(ROWS) {
        let mean = |of: fn(&TrueHalfCycle) -> f64| {
            stretch.iter().map(of).sum::<f64>() / stretch.len() as f64
        };
        let most = |of: fn(&TrueHalfCycle) -> f64| stretch.iter().map(of).fold(0.0, f64::max);
        let (first, last) = (&stretch[0], &stretch[stretch.len() - 1]);
        let hard: u32 = stretch.iter().map(|h| h.hard_edges).sum();
        table.row([
            format!("{:.3}", first.t_s),
            first.state.clone(),
            first.pot.clone(),
            first.fault.clone(),
            format!("{:.0}", first.asked_w),
            format!("{:.0}", mean(|h| h.power_w)),
            format!("{:.2}", last.f_sw_hz * 1e-3),
            format!("{:.1}", most(|h| h.i_peak_a)),
            format!("{:.0}", most(|h| h.v_coil_peak_v)),
            hard.to_string(),
        ]);
    }
    let mut text = table.render();
    if let Some(more) = stretches.len().checked_sub(ROWS + 1) {
        let _ = writeln!(text, "and {} more changes: --json has all", more + 1);
    }
    text
}

/// Faults, recoveries, resets by the watchdog and the energy, a line each.
fn events(record: &Record) -> String {
    let summary = &record.summary;
    let mut text = String::new();
    for fault in &record.faults {
        let _ = writeln!(
            text,
            "fault {} at {:.4} s, both switches open {} s later",
            fault.name,
            fault.t_s,
            number(fault.off_after_s, 4)
        );
    }
    for recovery in &summary.recoveries {
        let _ = writeln!(
            text,
            "mains or pot changed at {:.3} s, power as asked {} s later",
            recovery.at_s,
            number(recovery.after_s, 3)
        );
    }
    if summary.watchdog_bites > 0 {
        let bites = summary.watchdog_bites;
        let _ = writeln!(text, "the watchdog reset the controller {bites} times");
    }
    let latched = match summary.latched {
        true => ", switched off for good although power is asked for",
        false => "",
    };
    let _ = writeln!(
        text,
        "{:.1} kJ into the load{latched}",
        summary.energy_j * 1e-3
    );
    text
}

/// Returns `true` if two half-cycles share a row.
fn alike(a: &TrueHalfCycle, b: &TrueHalfCycle) -> bool {
    a.state == b.state && a.pot == b.pot && a.fault == b.fault && a.asked_w == b.asked_w
}
