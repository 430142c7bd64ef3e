//! The figure of a survey: the whole capture, a few periods, the spectra, what was found.

use std::ops::Range;
use std::path::Path;

use ihd_signal::Capture;
use ihd_survey::spectrum::amplitude_db;
use ihd_survey::{Severity, Span, Survey};
use plotters::coord::Shift;
use plotters::prelude::*;

use super::FigureError;
use crate::report::recording::extremes;

/// Switching periods in the close-up.
const CLOSE_UP_PERIODS: f64 = 2.0;

/// Highest harmonic in the spectrum.
const HARMONICS: f64 = 12.0;

/// Letters in a line of findings.
const LINE: usize = 160;

/// Height of the panels in pixels.
const WAVES_PX: u32 = 520;

/// Height of a line of text in pixels.
const LINE_PX: u32 = 18;

const VOLTAGE: RGBColor = RGBColor(31, 119, 180);
const CURRENT: RGBColor = RGBColor(214, 39, 40);
const LEFT_OUT: RGBColor = RGBColor(235, 235, 235);

type Panel<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

/// A curve against the left or the right axis.
struct Curve {
    name: &'static str,
    colour: RGBColor,
    points: Vec<(f64, f64)>,
}

/// Writes the figure as SVG.
///
/// # Errors
/// [`FigureError`] when the file cannot be written.
pub fn write(capture: &Capture, survey: &Survey, path: &Path) -> Result<(), FigureError> {
    draw(capture, survey, path).map_err(|why| FigureError::new(path, &why))
}

fn draw(capture: &Capture, survey: &Survey, path: &Path) -> Drawn {
    let text = lines(survey);
    let height = WAVES_PX + LINE_PX * (text.len() as u32 + 1);
    let root = SVGBackend::new(path, (1200, height)).into_drawing_area();
    root.fill(&WHITE)?;
    let (waves, below) = root.split_vertically(WAVES_PX);
    let (overview, details) = waves.split_vertically(250);
    let (close_up, spectrum) = details.split_horizontally(600);
    overview_panel(&overview, capture, survey)?;
    if let Some((span, peak)) = strongest(capture, survey) {
        close_up_panel(&close_up, capture, span, peak)?;
        spectrum_panel(&spectrum, capture, span)?;
    }
    findings(&below, text)?;
    root.present()?;
    Ok(())
}

/// The span with the largest current, and the sample of it.
fn strongest<'a>(capture: &Capture, survey: &'a Survey) -> Option<(&'a Span, usize)> {
    let peak = |span: &Span| {
        let range = span.first..span.first + span.samples;
        let size = |k: &usize| capture.i_a.get(*k).map_or(0.0, |i| i.abs());
        range
            .max_by(|a, b| size(a).total_cmp(&size(b)))
            .unwrap_or(span.first)
    };
    let all = survey.spans.iter().map(|span| (span, peak(span)));
    let size = |k: usize| capture.i_a.get(k).map_or(0.0, |i| i.abs());
    all.max_by(|a, b| size(a.1).total_cmp(&size(b.1)))
}

/// Voltage and current of a range of samples, times in `unit` seconds.
fn waves(
    capture: &Capture,
    range: Range<usize>,
    t_s: impl Fn(usize) -> f64 + Copy,
    unit: f64,
) -> [Curve; 2] {
    let curve = |name, colour, x: &[f32]| {
        let value = |k: usize| x.get(k).map_or(f64::NAN, |x| f64::from(*x));
        let mut points = extremes(|k| t_s(k) / unit, value, range.clone());
        points.retain(|p| p.0.is_finite() && p.1.is_finite());
        Curve {
            name,
            colour,
            points,
        }
    };
    [
        curve("v / V", VOLTAGE, &capture.v_v),
        curve("i / A", CURRENT, &capture.i_a),
    ]
}

fn overview_panel(area: &Panel<'_>, capture: &Capture, survey: &Survey) -> Drawn {
    let t_s = |k: usize| capture.time.at(k).unwrap_or(f64::NAN);
    let curves = waves(capture, 0..capture.len(), t_s, 1e-3);
    let title = format!(
        "{}: {} samples at {:.4} MS/s; grey: left out; dashed: mains zero crossings",
        survey.name,
        survey.samples,
        survey.rate_hz * 1e-6
    );
    let (from_s, to_s) = (survey.start_s, survey.start_s + survey.duration_s);
    let mut out = Vec::new();
    let mut at_s = from_s;
    for span in &survey.spans {
        out.push((at_s * 1e3, span.t0_s * 1e3));
        at_s = span.end_s();
    }
    out.push((at_s * 1e3, to_s * 1e3));
    out.retain(|(a, b)| b > a);
    let marks: Vec<f64> = survey
        .mains
        .crossings_s(from_s, to_s)
        .iter()
        .map(|t| t * 1e3)
        .collect();
    // More than this would be a wall.
    let marks = if marks.len() > 200 { &[] } else { &marks[..] };
    panel(area, &title, "t / ms", &curves, &out, marks)
}

fn close_up_panel(area: &Panel<'_>, capture: &Capture, span: &Span, peak: usize) -> Drawn {
    let half = (0.5 * CLOSE_UP_PERIODS / (span.f_sw_hz * span.dt_s)).ceil() as usize;
    let end = span.first + span.samples;
    let range = peak.saturating_sub(half).max(span.first)..(peak + half + 1).min(end);
    let first = range.start;
    let t_s = |k: usize| (k - first) as f64 * span.dt_s;
    let curves = waves(capture, range, t_s, 1e-6);
    let at_ms = span.run().t_s(first) * 1e3;
    let title = format!(
        "Two periods from {at_ms:.3} ms, {:.3} kHz",
        span.f_sw_hz * 1e-3
    );
    panel(area, &title, "t / µs", &curves, &[], &[])
}

/// Two axes: voltage left, current right, both with zero in the middle.
fn panel(
    area: &Panel<'_>,
    title: &str,
    x_label: &str,
    curves: &[Curve; 2],
    left_out: &[(f64, f64)],
    marks: &[f64],
) -> Drawn {
    let xs = || curves[0].points.iter().map(|p| p.0);
    let (from, to) = (
        xs().fold(f64::INFINITY, f64::min),
        xs().fold(f64::NEG_INFINITY, f64::max),
    );
    let size = |c: &Curve| c.points.iter().map(|p| p.1.abs()).fold(1e-9, f64::max) * 1.08;
    let (v, i) = (size(&curves[0]), size(&curves[1]));
    if from >= to {
        return Ok(());
    }
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 15))
        .margin(8)
        .x_label_area_size(32)
        .y_label_area_size(60)
        .right_y_label_area_size(60)
        .build_cartesian_2d(from..to, -v..v)?
        .set_secondary_coord(from..to, -i..i);
    chart
        .configure_mesh()
        .x_desc(x_label)
        .y_desc(curves[0].name)
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .draw()?;
    chart
        .configure_secondary_axes()
        .y_desc(curves[1].name)
        .draw()?;
    let grey = |(a, b): &(f64, f64)| Rectangle::new([(*a, -v), (*b, v)], LEFT_OUT.filled());
    chart.draw_series(left_out.iter().map(grey))?;
    chart.draw_series(marks.iter().flat_map(|t| {
        (0..24).step_by(2).map(move |k| {
            let y = |k: i32| v * (f64::from(k) / 12.0 - 1.0);
            PathElement::new([(*t, y(k)), (*t, y(k + 1))], BLACK.mix(0.4))
        })
    }))?;
    // Where a carrier becomes a band, the one behind has to show.
    let dense = curves[0].points.len() > 1000;
    let opacity = if dense { 0.6 } else { 1.0 };
    let line = |c: &Curve| LineSeries::new(c.points.clone(), c.colour.mix(opacity).stroke_width(1));
    chart.draw_series(line(&curves[0]))?;
    chart.draw_secondary_series(line(&curves[1]))?;
    Ok(())
}

fn spectrum_panel(area: &Panel<'_>, capture: &Capture, span: &Span) -> Drawn {
    let to_hz = (HARMONICS * span.f_sw_hz).min(0.5 / span.dt_s);
    let range = span.first..span.first + span.samples;
    let curve = |name, colour, x: &[f32]| {
        let x = x.get(range.clone()).unwrap_or(&[]);
        let all = amplitude_db(x, span.dt_s, to_hz);
        Curve {
            name,
            colour,
            points: extremes(|k| all[k].0 * 1e-3, |k| all[k].1, 0..all.len()),
        }
    };
    let curves = [
        curve("voltage", VOLTAGE, &capture.v_v),
        curve("current", CURRENT, &capture.i_a),
    ];
    let mut chart = ChartBuilder::on(area)
        .caption("Spectra / dB of the largest line", ("sans-serif", 15))
        .margin(8)
        .x_label_area_size(32)
        .y_label_area_size(46)
        .build_cartesian_2d(0.0..to_hz * 1e-3, -120.0..5.0)?;
    chart
        .configure_mesh()
        .x_desc("f / kHz")
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .draw()?;
    for curve in curves {
        let colour = curve.colour;
        chart
            .draw_series(LineSeries::new(curve.points, colour.stroke_width(1)))?
            .label(curve.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .draw()?;
    Ok(())
}

/// Numbers and findings as text.
fn findings(area: &Panel<'_>, text: Vec<(RGBColor, String)>) -> Drawn {
    for (row, (colour, text)) in text.into_iter().enumerate() {
        let style = ("sans-serif", 14).into_font().color(&colour);
        area.draw_text(&text, &style, (16, LINE_PX as i32 * row as i32 + 8))?;
    }
    Ok(())
}

fn lines(survey: &Survey) -> Vec<(RGBColor, String)> {
    let db = |snr_db: Option<f64>| snr_db.map_or("?".to_owned(), |db| format!("{db:.0} dB"));
    let mut out = vec![(
        BLACK,
        format!(
            "mains {:.2} Hz, {} whole half-cycles; SNR of the voltage {}, of the current {}; {}",
            survey.mains.hz,
            survey.half_cycles_s.len(),
            db(survey.voltage.snr_db),
            db(survey.current.snr_db),
            survey.skew_note().unwrap_or_default()
        ),
    )];
    for finding in &survey.findings {
        let colour = match finding.severity() {
            Severity::Info => BLACK,
            Severity::Warning => RGBColor(180, 95, 0),
            Severity::Error => CURRENT,
        };
        let text = format!("{}: {finding}", finding.severity());
        out.extend(wrapped(&text).into_iter().map(|line| (colour, line)));
    }
    if survey.findings.is_empty() {
        out.push((BLACK, "nothing found wrong".to_owned()));
    }
    out
}

/// Breaks between words; what goes on is indented.
fn wrapped(text: &str) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let last = lines.len() - 1;
        let line = &mut lines[last];
        if line.chars().count() + word.chars().count() > LINE {
            lines.push(format!("    {word}"));
        } else {
            if !line.is_empty() {
                line.push(' ');
            }
            line.push_str(word);
        }
    }
    lines
}
