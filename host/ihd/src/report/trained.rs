//! The trainer's figure: R(t) and L(t) of the last window, by everyone who estimates them.

use std::ops::Range;
use std::path::Path;

use ihd_link::Window;
use ihd_signal::truth::Truth;
use ihd_train::Report;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::FigureError;

/// One quantity over the half-cycle, in the figure's units: (ms, ohm or µH).
struct Panel<'a> {
    label: &'a str,
    network: Vec<(f64, f64)>,
    filter: Vec<(f64, f64)>,
    truth: Vec<(f64, f64)>,
}

/// Writes an SVG with R above L. Nothing is written when the report has no window.
///
/// # Errors
/// [`FigureError`] when the file cannot be written.
pub fn write(report: &Report, path: &Path) -> Result<(), FigureError> {
    let Some((window, identified, truth)) = &report.last else {
        return Ok(());
    };
    let network = |values: &[f64], unit: f64| {
        let points = identified.t_s.iter().zip(values);
        points.map(|(t, x)| (t * 1e3, x / unit)).collect()
    };
    let r = Panel {
        label: "R / Ω",
        network: network(&identified.r_ohm, 1.0),
        filter: filter(window, |e| e.0),
        truth: known(truth.as_ref(), |t| &t.r_ohm, 1.0),
    };
    let l = Panel {
        label: "L / µH",
        network: network(&identified.l_h, 1e-6),
        filter: filter(window, |e| e.1 * 1e6),
        truth: known(truth.as_ref(), |t| &t.l_h, 1e-6),
    };
    let title = format!(
        "Window {} at {:.2} kHz: identified load over one mains half-cycle",
        window.seq,
        f64::from(window.f_sw_hz) * 1e-3
    );
    let mut svg = String::new();
    draw(&mut svg, &title, &[r, l]).map_err(|why| FigureError::new(path, &why))?;
    ihd_signal::atomic::write(path, svg.as_bytes()).map_err(|why| FigureError::new(path, &why))
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

type Drawn = Result<(), Box<dyn std::error::Error>>;

fn draw(svg: &mut String, title: &str, panels: &[Panel<'_>]) -> Drawn {
    let root = SVGBackend::with_string(svg, (900, 640)).into_drawing_area();
    root.fill(&WHITE)?;
    let root = root.titled(title, ("sans-serif", 20))?;
    for (area, panel) in root.split_evenly((panels.len(), 1)).iter().zip(panels) {
        draw_panel(area, panel)?;
    }
    root.present()?;
    Ok(())
}

/// The range of all points, with a little air.
fn range(panel: &Panel<'_>, of: fn(&(f64, f64)) -> f64) -> Range<f64> {
    let all = [&panel.network, &panel.filter, &panel.truth];
    let values = all.into_iter().flatten().map(of);
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
    let air = 0.05 * (high - low).max(1e-6);
    low - air..high + air
}

fn draw_panel(area: &DrawingArea<SVGBackend<'_>, Shift>, panel: &Panel<'_>) -> Drawn {
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(36)
        .y_label_area_size(56)
        .build_cartesian_2d(range(panel, |p| p.0), range(panel, |p| p.1))?;
    chart
        .configure_mesh()
        .x_desc("time after the mains zero crossing / ms")
        .y_desc(panel.label)
        .light_line_style(WHITE)
        .draw()?;
    let grey = RGBColor(120, 120, 120);
    if !panel.truth.is_empty() {
        chart
            .draw_series(LineSeries::new(
                panel.truth.iter().copied(),
                grey.stroke_width(5),
            ))?
            .label("truth")
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], grey.stroke_width(5)));
    }
    chart
        .draw_series(
            panel
                .filter
                .iter()
                .map(|&p| Circle::new(p, 2, BLUE.filled())),
        )?
        .label("firmware's EKF")
        .legend(|(x, y)| Circle::new((x + 9, y), 3, BLUE.filled()));
    chart
        .draw_series(LineSeries::new(
            panel.network.iter().copied(),
            RED.stroke_width(2),
        ))?
        .label("PINN")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], RED.stroke_width(2)));
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperMiddle)
        .background_style(WHITE.mix(0.8))
        .border_style(grey)
        .draw()?;
    Ok(())
}
