//! Figure of `ihd identify`: R(t), L(t) and the waveforms, by every method.

use std::ops::Range;
use std::path::Path;

use ihd_identify::accuracy::fundamental;
use ihd_identify::{Estimate, Method};
use ihd_signal::Segment;
use ihd_signal::truth::PeriodTruth;
use plotters::prelude::*;

use ihd_plot::legend::header;
use ihd_plot::{self as plot, Axis, Curve, DrawResult, Entry, GREY, Panel, Pen, span};
use ihd_plot::{Area, FigureError, file};

/// Number of switching periods in the close-up.
const CLOSE_UP_PERIODS: f64 = 3.0;

/// Share of the values at either end that may lie outside the frame: the initial transient of a filter and the estimates at zero
/// crossings must not flatten everything else.
const OUTLIERS: f64 = 0.02;

/// Range in which a reconstructed waveform is shown beyond the measured one, in spans of it.
const REACH: f64 = 1.0;

/// Pen of known or measured curves: wide, so that they show under the estimates.
const KNOWN: Pen = Pen::Line(5);

/// Colours of the methods in the order of [`Method::ALL`], then of further ones.
const COLOURS: [RGBColor; 10] = [
    RGBColor(148, 103, 189),
    RGBColor(31, 119, 180),
    RGBColor(188, 189, 34),
    RGBColor(23, 190, 207),
    RGBColor(44, 160, 44),
    RGBColor(214, 39, 40),
    RGBColor(255, 127, 14),
    RGBColor(140, 86, 75),
    RGBColor(227, 119, 194),
    RGBColor(127, 127, 127),
];

fn colour(method: Method) -> RGBColor {
    COLOURS[method as usize % COLOURS.len()]
}

/// Draws R and L over time with the truth where there is one, and a close-up of the measured and
/// reconstructed waveforms at the largest current.
///
/// [`FigureError`] if there is nothing to draw or the file cannot be written.
pub fn draw(
    name: &str,
    segments: &[Segment],
    estimates: &[&Estimate],
    truth: &[PeriodTruth],
    path: &Path,
) -> Result<(), FigureError> {
    file::write(path, (1100, 800), |root| {
        draw_all(root, name, segments, estimates, truth)
    })
}

fn draw_all(
    root: &Area<'_>,
    name: &str,
    segments: &[Segment],
    estimates: &[&Estimate],
    truth: &[PeriodTruth],
) -> DrawResult {
    let drawn = estimates.iter().any(|e| !e.t_s.is_empty());
    if !drawn {
        return Err("no method found anything".into());
    }
    let panels = panels(segments, estimates, truth);
    let beyond = panels.iter().any(FramedPanel::has_more);
    let below = header(root, name, &entries(estimates, !truth.is_empty(), beyond))?;
    let places = below.split_evenly((2, 2));
    for (area, framed) in places.iter().zip(&panels) {
        let below = header(area, framed.title, &[])?;
        plot::draw(&below, &framed.panel, &framed.curves)?;
    }
    Ok(())
}

/// Panel with its axes.
struct FramedPanel {
    title: &'static str,
    panel: Panel,
    curves: Vec<Curve>,
}

impl FramedPanel {
    fn new(
        title: &'static str,
        label: &str,
        curves: Vec<Curve>,
        y: impl Fn(&[Curve]) -> Option<Range<f64>>,
    ) -> Option<Self> {
        let (from, to) = span(curves.iter().flat_map(Curve::points).map(|p| p.0))?;
        let panel = Panel {
            x: Axis::linear("t / ms", from..to),
            y: Axis::linear(label, y(&curves)?),
        };
        Some(Self {
            title,
            panel,
            curves,
        })
    }

    /// Returns `true` if a curve extends beyond the frame.
    fn has_more(&self) -> bool {
        let frame = self.panel.y.scale.ends();
        let mut points = self.curves.iter().flat_map(Curve::points);
        points.any(|p| p.1 < frame.start || p.1 > frame.end)
    }
}

/// Panels of R, L and, if there is a segment, the waveforms.
fn panels(
    segments: &[Segment],
    estimates: &[&Estimate],
    truth: &[PeriodTruth],
) -> Vec<FramedPanel> {
    let truth = fundamental(truth);
    let curves = |values: fn(&Estimate) -> &Vec<f64>, known: &[f64], unit: f64| {
        let mut curves = Vec::new();
        let points = |t: &[f64], x: &[f64]| {
            let both = t.iter().zip(x);
            both.map(|(t, x)| (t * 1e3, x / unit)).collect::<Vec<_>>()
        };
        if !truth.t_s.is_empty() {
            curves.push(Curve::new("truth", GREY, KNOWN, points(&truth.t_s, known)));
        }
        for method in Method::ALL {
            let of_method = estimates.iter().filter(|e| e.method == method);
            let runs: Vec<_> = of_method.map(|e| points(&e.t_s, values(e))).collect();
            if !runs.is_empty() {
                curves.push(Curve {
                    name: method.name().into(),
                    colour: colour(method),
                    pen: Pen::Line(1),
                    runs,
                });
            }
        }
        curves
    };
    let r = curves(|e| &e.r_ohm, &truth.r_ohm, 1.0);
    let l = curves(|e| &e.l_h, &truth.l_h, 1e-6);
    let mut all = vec![
        FramedPanel::new("Resistance", "R / Ω", r, frame),
        FramedPanel::new("Inductance", "L / µH", l, frame),
    ];
    if let Some((segment, range)) = close_up(segments) {
        let v = waves(segment, &range, estimates, &segment.v_v, |e| &e.v_hat_v);
        let i = waves(segment, &range, estimates, &segment.i_a, |e| &e.i_hat_a);
        all.push(FramedPanel::new(
            "Voltage, reconstructed",
            "v / V",
            v,
            whole,
        ));
        all.push(FramedPanel::new(
            "Current, reconstructed",
            "i / A",
            i,
            whole,
        ));
    }
    all.into_iter().flatten().collect()
}

/// Measured waveforms and their reconstructions.
fn waves(
    segment: &Segment,
    range: &Range<usize>,
    estimates: &[&Estimate],
    measured: &[f64],
    reconstruction: fn(&Estimate) -> &Vec<f32>,
) -> Vec<Curve> {
    let at = |k: usize| segment.t_s(k) * 1e3;
    let points = range.clone().map(|k| (at(k), measured[k])).collect();
    let mut curves = vec![Curve::new("measured", GREY, KNOWN, points)];
    for estimate in estimates {
        let x = reconstruction(estimate);
        if estimate.f_sw_hz == segment.f_sw_hz && x.len() == segment.len() {
            let points = range.clone().map(|k| (at(k), f64::from(x[k]))).collect();
            let (name, colour) = (estimate.method.name(), colour(estimate.method));
            curves.push(Curve::new(name, colour, Pen::Line(1), points));
        }
    }
    curves
}

/// Longest segment, and its samples around the largest current.
fn close_up(segments: &[Segment]) -> Option<(&Segment, Range<usize>)> {
    let segment = segments.iter().max_by_key(|s| s.len())?;
    // In the second half, after the filters have settled.
    let half = segment.len() / 2;
    let late = segment.i_a[half..].iter().enumerate();
    let largest = late.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?.0 + half;
    let reach = (0.5 * CLOSE_UP_PERIODS * segment.samples_per_period()).ceil() as usize;
    let from = largest.saturating_sub(reach);
    Some((segment, from..(largest + reach).min(segment.len())))
}

/// Range of the values without the outermost.
fn frame(curves: &[Curve]) -> Option<Range<f64>> {
    // The paper's literal preset diverges; arrows at the frame's edge show that.
    let literal = |c: &&Curve| c.name == Method::EkfPaper.name();
    let alone = curves.iter().all(|c| literal(&c));
    let framed = curves.iter().filter(|c| alone || !literal(c));
    let mut y: Vec<f64> = framed
        .flat_map(Curve::points)
        .map(|p| p.1)
        .filter(|y| y.is_finite())
        .collect();
    y.sort_unstable_by(f64::total_cmp);
    let cut = (OUTLIERS * y.len() as f64) as usize;
    let (mut low, mut high) = (*y.get(cut)?, *y.get(y.len() - 1 - cut)?);
    // Known curves are shown completely.
    if let Some(known) = known(curves) {
        (low, high) = (low.min(known.0), high.max(known.1));
    }
    Some(with_air(low, high))
}

/// Range of all values; a diverging one is limited to the neighbourhood of the measurement.
fn whole(curves: &[Curve]) -> Option<Range<f64>> {
    let (low, high) = known(curves)?;
    let reach = REACH * (high - low);
    let all = span(curves.iter().flat_map(Curve::points).map(|p| p.1))?;
    Some(with_air(all.0.max(low - reach), all.1.min(high + reach)))
}

/// Range of known and measured values.
fn known(curves: &[Curve]) -> Option<(f64, f64)> {
    let known = curves.iter().filter(|c| c.pen == KNOWN);
    span(known.flat_map(Curve::points).map(|p| p.1))
}

fn with_air(low: f64, high: f64) -> Range<f64> {
    let air = 0.08 * (high - low).max(1e-9 * high.abs().max(1e-9));
    low - air..high + air
}

/// Names and colours in one line above the panels.
fn entries(estimates: &[&Estimate], truth: bool, beyond: bool) -> Vec<Entry> {
    let grey = if truth { "truth, measured" } else { "measured" };
    let mut entries = vec![Entry::line(grey, GREY, KNOWN)];
    for method in Method::ALL {
        if estimates.iter().any(|e| e.method == method) {
            entries.push(Entry::line(method.name(), colour(method), Pen::Line(2)));
        }
    }
    if beyond {
        entries.push(Entry::text_only("▲▼ goes on outside"));
    }
    entries
}

#[cfg(test)]
mod tests {
    use super::*;
    use ihd_plot::svg::Picture;

    /// A segment at 50 kHz, and a reconstruction that overshoots by half at every edge, once by a thousand.
    fn overshooting(by: f32) -> (Segment, Estimate) {
        let (n, dt_s, f_sw_hz) = (5_000, 1e-7, 50e3);
        let wave = |k: usize| (std::f64::consts::TAU * f_sw_hz * k as f64 * dt_s).sin();
        let v_v: Vec<f64> = (0..n).map(|k| 300.0 * wave(k)).collect();
        let i_a: Vec<f64> = (0..n).map(|k| 40.0 * wave(k)).collect();
        let mut estimate = Estimate::new(Method::LeastSquares, f_sw_hz);
        estimate.t_s = vec![0.0, 1e-4];
        (estimate.r_ohm, estimate.l_h) = (vec![2.0, 2.1], vec![20e-6, 21e-6]);
        estimate.v_hat_v = v_v.iter().map(|v| *v as f32 * by).collect();
        estimate.i_hat_a = i_a.iter().map(|i| *i as f32).collect();
        let segment = Segment {
            v_v: v_v.into(),
            i_a: i_a.into(),
            t0_s: 0.0,
            dt_s,
            f_sw_hz,
            mains_hz: 50.0,
            zero_crossing_s: 0.0,
        };
        (segment, estimate)
    }

    #[test]
    fn a_reconstruction_that_overshoots_is_shown_whole() {
        let (segment, estimate) = overshooting(1.5);
        let all = panels(&[segment], &[&estimate], &[]);
        let voltage = &all[2];
        let frame = voltage.panel.y.scale.ends();
        // 450 V and some air, no more.
        assert!((450.0..540.0).contains(&frame.end), "{frame:?}");
        assert!(!voltage.has_more());
        assert!(!all[3].has_more());
    }

    #[test]
    fn a_runaway_is_marked_and_does_not_flatten_what_was_measured() {
        let (segment, estimate) = overshooting(1e3);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.svg");
        draw("a", &[segment], &[&estimate], &[], &path).unwrap();
        let picture = Picture::read(&path);
        assert!(
            picture
                .texts()
                .iter()
                .any(|t| t.contains("goes on outside"))
        );
        // The colour of least squares: arrows at both edges of the voltage's panel.
        assert!(picture.polygons("#D62728").len() >= 2);
    }
}
