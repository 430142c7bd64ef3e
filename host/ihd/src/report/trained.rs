//! Figure of the trainer: R(t) and L(t) of the last window, by every estimator.

use std::ops::Range;
use std::path::Path;

use ihd_link::Window;
use ihd_signal::truth::Truth;
use ihd_train::RunReport;

use ihd_plot::legend::header;
use ihd_plot::{
    self as plot, Area, Axis, BLUE, DrawResult, GREY, LegendEntry, Pen, PlotCurve, PlotPanel, RED,
    span,
};
use ihd_plot::{FigureError, file};

/// Writes an SVG with R above L. Nothing is written when the report has no window.
///
/// # Errors
/// [`FigureError`] if the file cannot be written.
pub fn write(report: &RunReport, path: &Path) -> Result<(), FigureError> {
    let Some((window, identified, truth)) = &report.last else {
        return Ok(());
    };
    let network = |values: &[f64], unit: f64| {
        let points = identified.t_s.iter().zip(values);
        points.map(|(t, x)| (t * 1e3, x / unit)).collect()
    };
    let r = curves(
        known(truth.as_ref(), |t| &t.r_ohm, 1.0),
        filter(window, |e| e.0),
        network(&identified.r_ohm, 1.0),
    );
    let l = curves(
        known(truth.as_ref(), |t| &t.l_h, 1e-6),
        filter(window, |e| e.1 * 1e6),
        network(&identified.l_h, 1e-6),
    );
    let title = format!(
        "Window {} at {:.2} kHz: identified load over one mains half-cycle",
        window.seq,
        f64::from(window.f_sw_hz) * 1e-3
    );
    let panels = [("R / Ω", r), ("L / µH", l)];
    // To a tenth of a millisecond, so that the last mark is there.
    let half_cycle_ms = 0.0..(f64::from(window.half_cycle_ns) * 1e-5).round() * 0.1;
    let figure = file::bytes(path, (900, 640), |root| {
        draw(root, &title, &half_cycle_ms, &panels)
    })?;
    ihd_signal::atomic::write(path, &figure).map_err(|why| FigureError::new(path, &why))
}

/// Curves of truth, filter and network: (ms, ohm or µH).
fn curves(
    truth: Vec<(f64, f64)>,
    filter: Vec<(f64, f64)>,
    network: Vec<(f64, f64)>,
) -> Vec<PlotCurve> {
    let mut curves = vec![
        PlotCurve::new("firmware's EKF", BLUE, Pen::Dots, filter),
        PlotCurve::new("PINN", RED, Pen::Line(2), network),
    ];
    if !truth.is_empty() {
        curves.insert(0, PlotCurve::new("truth", GREY, Pen::Line(5), truth));
    }
    curves
}

fn filter(window: &Window, value: fn((f64, f64)) -> f64) -> Vec<(f64, f64)> {
    let entries = window.trajectory.iter().enumerate();
    entries
        .map(|(k, e)| {
            (
                window.trajectory_time_s(k) * 1e3,
                value((e.r.ohm(), e.l.henry())),
            )
        })
        .collect()
}

fn known(truth: Option<&Truth>, values: fn(&Truth) -> &Vec<f64>, unit: f64) -> Vec<(f64, f64)> {
    truth.map_or(Vec::new(), |t| {
        let points = t.t_s.iter().zip(values(t));
        points.map(|(t, x)| (t * 1e3, x / unit)).collect()
    })
}

fn draw(
    root: &Area<'_>,
    title: &str,
    half_cycle_ms: &Range<f64>,
    panels: &[(&str, Vec<PlotCurve>)],
) -> DrawResult {
    let entries: Vec<LegendEntry> = panels.first().map_or(Vec::new(), |(_, curves)| {
        curves.iter().map(LegendEntry::from_curve).collect()
    });
    let below = header(root, title, &entries)?;
    for (area, (label, curves)) in below.split_evenly((panels.len(), 1)).iter().zip(panels) {
        let panel = PlotPanel {
            x: Axis::linear(
                "time after the mains zero crossing / ms",
                half_cycle_ms.clone(),
            ),
            y: Axis::linear(label, range(curves)),
        };
        plot::draw(area, &panel, curves)?;
    }
    Ok(())
}

/// Range of all values, extended by a twentieth on either side.
fn range(curves: &[PlotCurve]) -> Range<f64> {
    let values = curves.iter().flat_map(PlotCurve::points).map(|p| p.1);
    let (low, high) = span(values).unwrap_or((0.0, 1.0));
    let air = 0.05 * (high - low).max(1e-6);
    low - air..high + air
}
