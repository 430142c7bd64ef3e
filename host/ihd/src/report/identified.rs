//! The figure of `ihd identify`: R(t), L(t) and the waveforms, by every method.

use std::ops::Range;
use std::path::Path;

use ihd_identify::accuracy::fundamental;
use ihd_identify::{Estimate, Method};
use ihd_signal::Segment;
use ihd_signal::truth::PeriodTruth;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::FigureError;

/// Switching periods of the close-up.
const CLOSE_UP_PERIODS: f64 = 3.0;

/// Share of the values at either end that may lie outside the frame: a filter's first steps, and
/// what an estimator makes of the zero crossings, must not flatten everything else.
const OUTLIERS: f64 = 0.02;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

struct Curve {
    name: String,
    style: ShapeStyle,
    /// Runs of points; the line breaks between them.
    runs: Vec<Vec<(f64, f64)>>,
}

fn colour(method: Method) -> RGBColor {
    match method {
        Method::Kf => RGBColor(148, 103, 189),
        Method::Ekf => RGBColor(31, 119, 180),
        Method::EkfPaper => RGBColor(188, 189, 34),
        Method::Rts => RGBColor(23, 190, 207),
        Method::Lockin => RGBColor(44, 160, 44),
        Method::LeastSquares => RGBColor(214, 39, 40),
        Method::Rls => RGBColor(255, 127, 14),
        Method::Firmware => RGBColor(140, 86, 75),
        Method::Pinn => RGBColor(227, 119, 194),
    }
}

const GREY: RGBColor = RGBColor(150, 150, 150);

/// Draws R and L over time with the truth where there is one, and a close-up of the measured and
/// reconstructed waveforms at the largest current.
///
/// # Errors
/// [`FigureError`] when there is nothing to draw or the file cannot be written.
pub fn draw(
    name: &str,
    segments: &[Segment],
    estimates: &[&Estimate],
    truth: &[PeriodTruth],
    path: &Path,
) -> Result<(), FigureError> {
    draw_all(name, segments, estimates, truth, path).map_err(|e| FigureError::new(path, &e))
}

fn draw_all(
    name: &str,
    segments: &[Segment],
    estimates: &[&Estimate],
    truth: &[PeriodTruth],
    path: &Path,
) -> Drawn {
    let drawn = estimates.iter().any(|e| !e.t_s.is_empty());
    if !drawn {
        return Err("no method found anything".into());
    }
    let root = SVGBackend::new(path, (1100, 760)).into_drawing_area();
    root.fill(&WHITE)?;
    let root = root.titled(name, ("sans-serif", 18))?;
    let (strip, root) = root.split_vertically(24);
    legend(&strip, estimates, !truth.is_empty())?;
    let panels = root.split_evenly((2, 2));
    let truth = fundamental(truth);
    let curves = |values: fn(&Estimate) -> &Vec<f64>, known: &[f64], unit: f64| {
        let mut curves = Vec::new();
        if !truth.t_s.is_empty() {
            let points = truth.t_s.iter().zip(known);
            curves.push(Curve {
                name: "truth".into(),
                style: GREY.stroke_width(5),
                runs: vec![points.map(|(t, x)| (t * 1e3, x / unit)).collect()],
            });
        }
        for method in Method::ALL {
            let of_method = estimates.iter().filter(|e| e.method == method);
            let run = |e: &&Estimate| {
                let points = e.t_s.iter().zip(values(e));
                points.map(|(t, x)| (t * 1e3, x / unit)).collect()
            };
            let runs: Vec<Vec<_>> = of_method.map(run).collect();
            if !runs.is_empty() {
                curves.push(Curve {
                    name: method.name().into(),
                    style: colour(method).stroke_width(1),
                    runs,
                });
            }
        }
        curves
    };
    panel(
        &panels[0],
        "Resistance",
        "R / Ω",
        &curves(|e| &e.r_ohm, &truth.r_ohm, 1.0),
    )?;
    panel(
        &panels[1],
        "Inductance",
        "L / µH",
        &curves(|e| &e.l_h, &truth.l_h, 1e-6),
    )?;
    let Some((segment, range)) = close_up(segments) else {
        return Ok(root.present()?);
    };
    let waves = |measured: &[f64], found: fn(&Estimate) -> &Vec<f32>| {
        let at = |k: usize| segment.t_s(k) * 1e3;
        let mut curves = vec![Curve {
            name: "measured".into(),
            style: GREY.stroke_width(5),
            runs: vec![range.clone().map(|k| (at(k), measured[k])).collect()],
        }];
        for estimate in estimates {
            let x = found(estimate);
            if estimate.f_sw_hz == segment.f_sw_hz && x.len() == segment.len() {
                let points = range.clone().map(|k| (at(k), f64::from(x[k])));
                curves.push(Curve {
                    name: estimate.method.name().into(),
                    style: colour(estimate.method).stroke_width(1),
                    runs: vec![points.collect()],
                });
            }
        }
        curves
    };
    let (v, i) = (
        waves(&segment.v_v, |e| &e.v_hat_v),
        waves(&segment.i_a, |e| &e.i_hat_a),
    );
    panel(&panels[2], "Voltage, reconstructed", "v / V", &v)?;
    panel(&panels[3], "Current, reconstructed", "i / A", &i)?;
    root.present()?;
    Ok(())
}

/// The longest segment and its samples around the largest current.
fn close_up(segments: &[Segment]) -> Option<(&Segment, Range<usize>)> {
    let segment = segments.iter().max_by_key(|s| s.len())?;
    // In the second half, where filters have settled.
    let half = segment.len() / 2;
    let late = segment.i_a[half..].iter().enumerate();
    let largest = late.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?.0 + half;
    let reach = (0.5 * CLOSE_UP_PERIODS * segment.samples_per_period()).ceil() as usize;
    let from = largest.saturating_sub(reach);
    Some((segment, from..(largest + reach).min(segment.len())))
}

/// The range of the values without the outermost.
fn frame(curves: &[Curve]) -> Option<Range<f64>> {
    // The paper's literal preset runs away, which shows as a line along the frame's edge.
    let literal = |c: &&Curve| c.name == Method::EkfPaper.name();
    let alone = curves.iter().all(|c| literal(&c));
    let framed = curves.iter().filter(|c| alone || !literal(c));
    let points = framed.flat_map(|c| c.runs.iter().flatten());
    let mut y: Vec<f64> = points.map(|p| p.1).filter(|y| y.is_finite()).collect();
    y.sort_unstable_by(f64::total_cmp);
    let cut = (OUTLIERS * y.len() as f64) as usize;
    let (mut low, mut high) = (*y.get(cut)?, *y.get(y.len() - 1 - cut)?);
    // What is known or measured is shown whole.
    let known = curves.iter().filter(|c| c.style.stroke_width > 1);
    for (_, y) in known.flat_map(|c| c.runs.iter().flatten()) {
        (low, high) = (low.min(*y), high.max(*y));
    }
    let air = 0.08 * (high - low).max(1e-9 * high.abs().max(1e-9));
    Some(low - air..high + air)
}

fn panel(area: &Area<'_>, title: &str, label: &str, curves: &[Curve]) -> Drawn {
    let Some(y) = frame(curves) else {
        return Ok(());
    };
    let points = || curves.iter().flat_map(|c| c.runs.iter().flatten());
    let x = points().fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p.0), b.max(p.0)));
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 16))
        .margin(10)
        .x_label_area_size(34)
        .y_label_area_size(52)
        .build_cartesian_2d(x.0..x.1.max(x.0 + 1e-9), y.clone())?;
    chart
        .configure_mesh()
        .x_desc("t / ms")
        .y_desc(label)
        .light_line_style(WHITE)
        .draw()?;
    for curve in curves {
        let style = curve.style;
        for run in &curve.runs {
            let inside = run.iter().map(|p| (p.0, p.1.clamp(y.start, y.end)));
            chart.draw_series(LineSeries::new(inside, style))?;
        }
    }
    Ok(())
}

/// Names and colours in one line above the panels.
fn legend(strip: &Area<'_>, estimates: &[&Estimate], truth: bool) -> Drawn {
    const STEP: i32 = 110;
    let grey = if truth { "truth, measured" } else { "measured" };
    let mut entries = vec![(grey, GREY.stroke_width(5))];
    for method in Method::ALL {
        if estimates.iter().any(|e| e.method == method) {
            entries.push((method.name(), colour(method).stroke_width(2)));
        }
    }
    for (k, (name, style)) in entries.into_iter().enumerate() {
        let x = 20 + STEP * k as i32 + if k > 0 { 20 } else { 0 };
        strip.draw(&PathElement::new([(x, 12), (x + 16, 12)], style))?;
        strip.draw(&Text::new(name, (x + 22, 6), ("sans-serif", 12)))?;
    }
    Ok(())
}
