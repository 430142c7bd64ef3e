//! Figure of a survey: the whole capture, a few periods, the spectra, the findings.

use std::ops::Range;
use std::path::Path;

use ihd_signal::Capture;
use ihd_survey::spectrum::amplitude_db;
use ihd_survey::{Severity, Span, Survey};
use plotters::prelude::*;

use ihd_plot::legend::header;
use ihd_plot::two_axes::{self, Side, Trace, Underlay, Zero};
use ihd_plot::{
    self as plot, Area, Axis, BLUE, DrawResult, LegendEntry, Pen, PlotCurve, PlotPanel, RED,
    envelope, scale,
};
use ihd_plot::{FigureError, file};

use super::wrapped;

/// Switching periods in the close-up.
const CLOSE_UP_PERIODS: f64 = 2.0;

/// Lower end of the spectrum as a share of the switching frequency: below it are mains and drift.
const SPECTRUM_FROM: f64 = 0.05;

/// Columns of a panel of full width, and of one of half width.
const COLUMNS: (usize, usize) = (1040, 470);

/// Number of letters in a line of findings, without its indent.
const LINE: usize = 147;

/// Height of the panels in pixels.
const WAVES_PX: u32 = 660;

/// Height of the overview among them, in pixels.
const OVERVIEW_PX: u32 = 310;

/// Height of a line of text in pixels.
const LINE_PX: u32 = 19;

const LEFT_OUT: RGBColor = RGBColor(225, 225, 225);

/// Writes the figure: SVG, PDF or PNG by the name's ending.
///
/// # Errors
/// [`FigureError`] if the file cannot be written.
pub fn write(capture: &Capture, survey: &Survey, path: &Path) -> Result<(), FigureError> {
    let text = lines(survey);
    let height = WAVES_PX + LINE_PX * (text.len() as u32 + 1);
    file::write(path, (1200, height), |root| {
        draw(root, capture, survey, &text)
    })
}

fn draw(
    root: &Area<'_>,
    capture: &Capture,
    survey: &Survey,
    text: &[(RGBColor, String)],
) -> DrawResult {
    let (waves, below) = root.split_vertically(WAVES_PX);
    let (overview, details) = waves.split_vertically(OVERVIEW_PX);
    let (close_up, spectrum) = details.split_horizontally(600);
    overview_panel(&overview, capture, survey)?;
    if let Some((span, peak)) = strongest(capture, survey) {
        close_up_panel(&close_up, capture, span, peak)?;
        spectrum_panel(&spectrum, capture, span)?;
    }
    findings(&below, text)
}

/// Span with the largest current, and the index of its sample.
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

/// Voltage and current of a range of samples; `period` in samples, if there are more of those than columns.
fn waves(
    capture: &Capture,
    range: Range<usize>,
    most: usize,
    period: f64,
    at: impl Fn(usize) -> f64,
) -> [Side; 2] {
    let side = |label: &str, colour, x: &[f32]| {
        let value = |k: usize| x.get(k).map_or(f64::NAN, |x| f64::from(*x));
        let trace = if range.len() > 2 * most {
            Trace::Band(envelope::columns(range.clone(), most, period, &at, value))
        } else {
            Trace::Line(range.clone().map(|k| (at(k), value(k))).collect())
        };
        Side {
            label: label.into(),
            colour,
            trace,
        }
    };
    [
        side("v / V", BLUE, &capture.v_v),
        side("i / A", RED, &capture.i_a),
    ]
}

/// Names and signs of the two channels.
fn names(dense: bool) -> Vec<LegendEntry> {
    let entry = |name: &str, colour: RGBColor| {
        if dense {
            let RGBColor(r, g, b) = colour;
            // Colour of the band's fill on white.
            let pale = |c: u8| (0.45 * f64::from(c) + 0.55 * 255.0) as u8;
            LegendEntry::shade(name, RGBColor(pale(r), pale(g), pale(b)))
        } else {
            LegendEntry::line(name, colour, Pen::Line(1))
        }
    };
    vec![entry("voltage (left)", BLUE), entry("current (right)", RED)]
}

fn overview_panel(area: &Area<'_>, capture: &Capture, survey: &Survey) -> DrawResult {
    let at = |k: usize| capture.time.at(k).unwrap_or(f64::NAN) * 1e3;
    let (from_s, to_s) = (survey.start_s, survey.start_s + survey.duration_s);
    let mut shaded = Vec::new();
    let mut at_s = from_s;
    for span in &survey.spans {
        shaded.push((at_s * 1e3, span.t0_s * 1e3, LEFT_OUT));
        at_s = span.end_s();
    }
    shaded.push((at_s * 1e3, to_s * 1e3, LEFT_OUT));
    shaded.retain(|(a, b, _)| b > a);
    let mut marks = survey.mains.crossings_s(from_s, to_s);
    marks.iter_mut().for_each(|t| *t *= 1e3);
    // More would fill the area.
    if marks.len() > 200 {
        marks.clear();
    }
    // Longest of the periods: shorter ones are complete in its columns, too.
    let periods = survey.spans.iter().map(|s| 1.0 / (s.f_sw_hz * s.dt_s));
    let period = periods.filter(|p| p.is_finite()).fold(0.0, f64::max);
    let sides = waves(capture, 0..capture.len(), COLUMNS.0, period, at);
    let mut entries = names(matches!(sides[0].trace, Trace::Band(_)));
    if !shaded.is_empty() {
        entries.push(LegendEntry::shade("left out", LEFT_OUT));
    }
    if !marks.is_empty() {
        entries.push(LegendEntry::line(
            "mains zero crossing",
            BLACK,
            Pen::Broken(1),
        ));
    }
    let title = format!(
        "{}: {} samples at {:.4} MS/s",
        survey.name,
        survey.samples,
        survey.rate_hz * 1e-6
    );
    let below = header(area, &title, &entries)?;
    let under = Underlay {
        shaded,
        marks,
        alarms: Vec::new(),
    };
    two_axes::draw(&below, "t / ms", Zero::Middle, &sides, &under)
}

fn close_up_panel(area: &Area<'_>, capture: &Capture, span: &Span, peak: usize) -> DrawResult {
    let half = (0.5 * CLOSE_UP_PERIODS / (span.f_sw_hz * span.dt_s)).ceil() as usize;
    let end = span.first + span.samples;
    let range = peak.saturating_sub(half).max(span.first)..(peak + half + 1).min(end);
    let first = range.start;
    let at = |k: usize| (k - first) as f64 * span.dt_s * 1e6;
    // No envelope: two periods are wider than that.
    let sides = waves(capture, range, COLUMNS.1, 0.0, at);
    let at_ms = span.run().t_s(first) * 1e3;
    let title = format!(
        "Two periods from {at_ms:.3} ms, {:.3} kHz",
        span.f_sw_hz * 1e-3
    );
    let below = header(area, &title, &names(false))?;
    two_axes::draw(&below, "t / µs", Zero::Middle, &sides, &Underlay::default())
}

/// Both spectra up to half the sampling rate: in each column of pixels the largest and the smallest line.
fn spectrum_panel(area: &Area<'_>, capture: &Capture, span: &Span) -> DrawResult {
    let to_hz = 0.5 / span.dt_s;
    let range = span.first..span.first + span.samples;
    let lines = |x: &[f32]| amplitude_db(x.get(range.clone()).unwrap_or(&[]), span.dt_s, to_hz);
    let all = [lines(&capture.v_v), lines(&capture.i_a)];
    let first_hz = all.iter().filter_map(|x| Some(x.first()?.0));
    let from_hz = first_hz.fold(SPECTRUM_FROM * span.f_sw_hz, f64::max);
    let label = format!("f / Hz, to half the sampling rate, {}Hz", mega(to_hz));
    let panel = PlotPanel {
        x: Axis::decades(&label, from_hz..to_hz),
        y: Axis::linear("dB of the largest line", -120.0..5.0),
    };
    let curve = |name: &str, colour, points: &[(f64, f64)]| {
        let x = &panel.x.scale;
        let columns = envelope::of_points(points, COLUMNS.1, |f| x.unit(f), |u| x.value(u));
        // From minimum to maximum and on to the next column: noise becomes a band.
        let points = columns.iter().flat_map(|c| [(c.at, c.min), (c.at, c.max)]);
        PlotCurve::new(name, colour, Pen::Line(1), points.collect())
    };
    let curves = [
        curve("voltage", BLUE, &all[0]),
        curve("current", RED, &all[1]),
    ];
    let entries: Vec<LegendEntry> = curves.iter().map(LegendEntry::from_curve).collect();
    let below = header(area, "Spectra", &entries)?;
    plot::draw(&below, &panel, &curves)?;
    Ok(())
}

/// Frequency before its unit: `25 M`, `312.5 k`.
fn mega(hz: f64) -> String {
    let rounded = |x: f64| scale::plain((x * 1e3).round() / 1e3);
    if hz >= 1e6 {
        format!("{} M", rounded(hz * 1e-6))
    } else {
        format!("{} k", rounded(hz * 1e-3))
    }
}

/// Numbers and findings as text.
fn findings(area: &Area<'_>, text: &[(RGBColor, String)]) -> DrawResult {
    for (row, (colour, text)) in text.iter().enumerate() {
        let style = ("sans-serif", 14).into_font().color(colour);
        area.draw_text(text, &style, (16, LINE_PX as i32 * row as i32 + 8))?;
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
            Severity::Error => RED,
        };
        let text = format!("{}: {finding}", finding.severity());
        out.extend(
            wrapped(&text, LINE, "    ")
                .into_iter()
                .map(|line| (colour, line)),
        );
    }
    if survey.findings.is_empty() {
        out.push((BLACK, "nothing found wrong".to_owned()));
    }
    out
}
