//! Report of the trainer: a table as text, or JSON.

use std::fmt::Write;

use ihd_shared::lookup::grid::CELLS;
use ihd_shared::wire::messages::Status;
use ihd_signal::Load;
use ihd_signal::printable::printable;
use ihd_train::lookup::{BuiltLookup, CellErrors, LookupAccuracy};
use ihd_train::{PointReport, RunReport};
use serde::Serialize;

use super::table::TextTable;
use super::utilisation;

/// The report as text.
pub fn text(report: &RunReport) -> String {
    let mut out = String::new();
    let _ = writeln!(out, "{}\n", printable(&report.device));
    out.push_str(&points(&report.points));
    out.push('\n');
    if report.points.iter().any(|p| p.truth.is_some()) {
        out.push_str(&accuracy(&report.points));
        out.push('\n');
    }
    let built = report.built.as_ref();
    if let Some(s) = &report.status {
        out.push_str(&device(s, built));
    } else if let Some(built) = built {
        let _ = writeln!(
            out,
            "lookup   version {} was active last; the device was not asked at the end",
            built.lookup.version
        );
    }
    if let Some(error) = &report.map_error {
        let _ = writeln!(out, "map      {}", map_error(error));
    }
    let _ = writeln!(out, "link     {}", link(report));
    let used = utilisation::line(report.utilisation.as_ref());
    let _ = writeln!(out, "busy     {used}");
    if let Some(first_s) = report.first_lookup_s {
        let _ = writeln!(
            out,
            "time     {first_s:.2} s from start to the first lookup active, {:.2} s in all",
            report.total_s
        );
    }
    out
}

/// State of the device at the end.
fn device(s: &Status, built: Option<&BuiltLookup>) -> String {
    let known = built.map_or(0, |b| b.lookup.observed_cells());
    let seen = built.map_or(0, BuiltLookup::seen_cells);
    format!(
        "lookup   version {} active on the device; {known} of {CELLS} cells known: {seen} seen, the others follow \
         from the pot's physics\n\
         power    {} W asked, {:.0} W in the last half-cycle at {:.2} kHz\n\
         pot      {:?}; state {:?}, fault {:?}\n",
        s.lookup_version,
        s.asked_w,
        f64::from(s.delivered_mw) * 1e-3,
        f64::from(s.f_sw_hz) * 1e-3,
        s.pot,
        s.state,
        s.fault
    )
}

/// Errors of the lookup in the reached cells, in one line.
pub fn map_error(error: &LookupAccuracy) -> String {
    let of = |name: &str, e: &CellErrors| {
        let pair = |mean: Option<f64>, worst: Option<f64>| match (mean, worst) {
            (Some(mean), Some(worst)) => format!("{mean:.2} % mean, {worst:.2} % worst"),
            _ => "–".into(),
        };
        format!(
            "{} {name} cells R {}, L {}",
            e.cells,
            pair(e.r_mean_pct, e.r_worst_pct),
            pair(e.l_mean_pct, e.l_worst_pct)
        )
    };
    let z = error
        .z_rms
        .map_or(String::new(), |z| format!("; {z:.2} σ rms"));
    format!(
        "against the truth where the hob comes: {}; {}{z}",
        of("observed", &error.observed),
        of("unseen", &error.unseen)
    )
}

fn link(report: &RunReport) -> String {
    let c = &report.counters;
    format!(
        "{} windows and {} telemetry received; {} windows dropped by the device, {} rejected, {} \
         refused by the gate; frames bad {}, lost {}",
        c.windows.received,
        c.telemetry.received,
        c.windows.dropped_by_device,
        c.windows_rejected_total(),
        report.refused,
        c.frames_bad,
        c.frames_lost
    )
}

fn points(points: &[PointReport]) -> String {
    let mut t = TextTable::new(&[
        "asked W",
        "got W",
        "f_sw kHz",
        "I A",
        "R Ω: PINN",
        "EKF",
        "true",
        "L µH: PINN",
        "EKF",
        "true",
        "trained ms",
    ]);
    let cell = |at: Option<Load>, value: fn(Load) -> f64, digits: usize| {
        at.map_or("–".into(), |at| format!("{:.digits$}", value(at)))
    };
    let r = |at| cell(at, |at: Load| at.r_ohm, 3);
    let l = |at| cell(at, |at: Load| at.l_h * 1e6, 2);
    for p in points {
        t.row([
            p.asked_w.map_or("–".into(), |w| w.to_string()),
            p.delivered_w.map_or("–".into(), |w| format!("{w:.0}")),
            format!("{:.2}", f64::from(p.f_sw_hz) * 1e-3),
            format!("{:.1}", p.i_crest_a),
            r(Some(p.pinn)),
            r(p.ekf),
            r(p.truth),
            l(Some(p.pinn)),
            l(p.ekf),
            l(p.truth),
            format!("{:.0}", p.training_s * 1e3),
        ]);
    }
    format!("At the crest of the current:\n{}", t.render())
}

fn accuracy(points: &[PointReport]) -> String {
    let mut t = TextTable::new(&[
        "f_sw kHz",
        "PINN R",
        "PINN L",
        "mid 80 % R",
        "L",
        "EKF R",
        "EKF L",
        "mid 80 % R",
        "L",
    ]);
    for p in points {
        let errors = [p.pinn_errors, p.ekf_errors].map(|e| {
            e.map_or(["–"; 4].map(str::to_owned), |e| {
                [e.r_whole_pct, e.l_whole_pct, e.r_middle_pct, e.l_middle_pct]
                    .map(|x| format!("{x:.2}"))
            })
        });
        let f_sw = format!("{:.2}", f64::from(p.f_sw_hz) * 1e-3);
        t.row(std::iter::once(f_sw).chain(errors.into_iter().flatten()));
    }
    format!(
        "Mean relative error against the truth, %, whole half-cycle:\n{}",
        t.render()
    )
}

/// The report as one JSON object.
pub fn json(report: &RunReport) -> serde_json::Value {
    #[derive(Serialize)]
    struct Windows {
        received: u32,
        dropped_by_device: u32,
        rejected: u32,
        refused_by_gate: u32,
    }
    let s = report.status.as_ref();
    let built = report.built.as_ref();
    let c = &report.counters;
    serde_json::json!({
        "device": report.device,
        "points": report.points,
        "lookup_version": s.map(|s| s.lookup_version).or(built.map(|b| b.lookup.version)),
        "observed_cells": built.map_or(0, |b| b.lookup.observed_cells()),
        "seen_cells": built.map_or(0, BuiltLookup::seen_cells),
        "map_error": report.map_error,
        "asked_w": s.map(|s| s.asked_w),
        "delivered_w": s.map(|s| f64::from(s.delivered_mw) * 1e-3),
        "f_sw_hz": s.map(|s| s.f_sw_hz),
        "pot": s.map(|s| s.pot.name().to_lowercase()),
        "state": s.map(|s| s.state.name().to_lowercase()),
        "fault": s.map(|s| s.fault.number()),
        "processor": utilisation::json(report.utilisation.as_ref()),
        "windows": Windows {
            received: c.windows.received,
            dropped_by_device: c.windows.dropped_by_device,
            rejected: c.windows_rejected_total(),
            refused_by_gate: report.refused,
        },
        "frames": { "good": c.frames_good, "bad": c.frames_bad, "lost": c.frames_lost },
        "first_lookup_s": report.first_lookup_s,
        "total_s": report.total_s,
    })
}
