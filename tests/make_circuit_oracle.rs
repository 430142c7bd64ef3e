//! Runs ngspice on every case of tests/circuit_oracle.rs and compares the simulation with it:
//! `cargo run --release -p ihd-tests --example make_circuit_oracle` (Debian's ngspice; half a minute).
//!
//! Writes tests/circuit-oracle/values.csv, which the test `circuit_oracle` holds the simulation to, and the figures of
//! docs/simulator.md; prints the table there.

use std::path::Path;

use ihd_plot::legend::header;
use ihd_plot::{Axis, BLUE, DrawResult, GREY, LegendEntry, Pen, PlotCurve, PlotPanel, RED, draw};
use ihd_tests::circuit_oracle::{CASES, Case, Values, Waveform, folder};
use plotters::prelude::*;

/// Integration steps per point of a waveform: 5 MS/s at 45 kHz.
const EVERY: usize = 4;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scratch = tempfile::tempdir()?;
    let mut csv = format!("case,{}\n", Values::NAMES.join(","));
    let mut stops = Vec::new();
    println!("| case | {} |", Values::NAMES.join(" | "));
    println!("|---|{}", "---|".repeat(Values::NAMES.len()));
    for case in &CASES {
        let (spice, spice_waveform) = case.ngspice(scratch.path())?;
        let (ours, waveform) = case.simulate(EVERY);
        let numbers = spice.numbers().map(|x| format!("{x:.6e}"));
        csv += &format!("\"{}\",{}\n", case.name, numbers.join(","));
        let cells = spice.numbers().into_iter().zip(ours.numbers());
        let cells: Vec<String> = cells.map(|(spice, ours)| cell(spice, ours)).collect();
        println!("| {} | {} |", case.name, cells.join(" | "));
        if case.opens() {
            stops.push((*case, spice_waveform, waveform));
        }
    }
    std::fs::write(folder().join("values.csv"), csv)?;
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    figure(&docs.join("stop-at-the-crest.svg"), &stops)?;
    crossing_figure(&docs.join("dc-link.svg"))
}

/// Capacitances of the DC link that are compared, in farad, and their colours.
const LINKS: [(f64, RGBColor); 4] = [
    (0.0, GREY),
    (1e-6, RGBColor(44, 160, 44)),
    (4.7e-6, BLUE),
    (10e-6, RED),
];

/// Bus, coil current and power through a zero crossing for several links, at full and at little power.
fn crossing_figure(path: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::new(path, (1200, 760)).into_drawing_area();
    root.fill(&WHITE)?;
    let [_, _, full, _, light, ..] = CASES;
    for (area, (case, title)) in root.split_evenly((1, 2)).iter().zip([
        (full, "4 ohm, 24 µH, 50 kHz"),
        (light, "2.2 ohm, 32 µH, 80 kHz (pot of 12 cm)"),
    ]) {
        let mut curves: [Vec<PlotCurve>; 3] = Default::default();
        for (link_capacitance_f, colour) in LINKS {
            let supply = case.supply.with(Some(link_capacitance_f), None);
            let (_, waveform) = Case { supply, ..case }.simulate(EVERY);
            let mut points: [Vec<(f64, f64)>; 3] = Default::default();
            // A point each 5 periods: bus at its end, crest and mean square of the current within.
            let count = (5.0 / case.f_sw_hz / (waveform[1].0 - waveform[0].0)) as usize;
            for part in waveform.chunks(count) {
                let t_ms = part[0].0 * 1e3;
                if !(7.0..13.0).contains(&t_ms) {
                    continue;
                }
                let mean = |value: fn(&(f64, f64, f64)) -> f64| {
                    part.iter().map(value).sum::<f64>() / part.len() as f64
                };
                points[0].push((t_ms, mean(|p| p.1)));
                points[1].push((t_ms, part.iter().map(|p| p.2.abs()).fold(0.0, f64::max)));
                points[2].push((t_ms, case.r_ohm * mean(|p| p.2 * p.2) * 1e-3));
            }
            let name = format!("{} µF", link_capacitance_f * 1e6);
            for (curves, points) in curves.iter_mut().zip(points) {
                curves.push(PlotCurve::new(&name, colour, Pen::Line(1), points));
            }
        }
        let labels = ["bus / V", "crest of the current / A", "power / kW"];
        for (n, (part, curves)) in area.split_evenly((3, 1)).iter().zip(&curves).enumerate() {
            let most = curves
                .iter()
                .flat_map(PlotCurve::points)
                .fold(0.0, |m, p| p.1.max(m));
            let entries: Vec<LegendEntry> = curves.iter().map(LegendEntry::from_curve).collect();
            let below = match n {
                0 => header(part, title, &entries)?,
                _ => part.clone(),
            };
            let panel = PlotPanel {
                x: Axis::linear(if n == 2 { "t / ms" } else { "" }, 7.0..13.0),
                y: Axis::linear(labels[n], 0.0..1.08 * most),
            };
            draw(&below, &panel, curves)?;
        }
    }
    Ok(())
}

/// Value of ngspice and the simulation's difference in percent; small ones have none.
fn cell(spice: f64, ours: f64) -> String {
    if spice.abs() < 1e-2 {
        return "0".to_owned();
    }
    format!("{spice:.4} ({:+.2} %)", 100.0 * (ours / spice - 1.0))
}

/// Bus and current through a stop at the crest, a column for each case.
fn figure(
    path: &Path,
    stops: &[(Case, Waveform, Waveform)],
) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::new(path, (1200, 560)).into_drawing_area();
    root.fill(&WHITE)?;
    for (area, (case, spice, ours)) in root.split_evenly((1, stops.len())).iter().zip(stops) {
        let (bus, current) = area.split_vertically(300);
        let part = |waveform: &Waveform, value: fn(&(f64, f64, f64)) -> f64| {
            // A point each 0.2 µs is enough for the figure.
            let mut last_s = 0.0;
            let mut points = Vec::new();
            for point in waveform.iter().filter(|p| (4.9e-3..5.5e-3).contains(&p.0)) {
                if point.0 - last_s >= 0.8e-6 {
                    last_s = point.0;
                    points.push((point.0 * 1e3, value(point)));
                }
            }
            points
        };
        let curves = |value: fn(&(f64, f64, f64)) -> f64| {
            [
                PlotCurve::new("ngspice", RED, Pen::Line(3), part(spice, value)),
                PlotCurve::new("ihd", BLUE, Pen::Line(1), part(ours, value)),
            ]
        };
        panel(&bus, case.name, "bus / V", 300.0..560.0, &curves(|p| p.1))?;
        panel(
            &current,
            "",
            "coil current / A",
            -60.0..60.0,
            &curves(|p| p.2),
        )?;
    }
    Ok(())
}

fn panel(
    area: &ihd_plot::Area<'_>,
    title: &str,
    label: &str,
    range: std::ops::Range<f64>,
    curves: &[PlotCurve],
) -> DrawResult {
    let entries: Vec<LegendEntry> = curves.iter().map(LegendEntry::from_curve).collect();
    let below = match title {
        "" => area.clone(),
        title => header(area, title, &entries)?,
    };
    let panel = PlotPanel {
        x: Axis::linear(if title.is_empty() { "t / ms" } else { "" }, 4.9..5.5),
        y: Axis::linear(label, range),
    };
    draw(&below, &panel, curves)?;
    Ok(())
}
