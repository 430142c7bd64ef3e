//! Curves of the figure: R, L and their errors by every method, and the waveforms.

use std::ops::Range;

use ihd_identify::{Estimate, Method};
use ihd_plot::{GREY, Pen, PlotCurve};
use ihd_signal::Segment;
use ihd_signal::truth::Truth;
use plotters::prelude::RGBColor;

/// Pen of known or measured curves: wide, so that they show under the estimates.
pub const KNOWN: Pen = Pen::Line(5);

/// Half width of a band, in standard deviations.
const BAND_SIGMA: f64 = 2.0;

/// Number of switching periods in the close-up.
const CLOSE_UP_PERIODS: f64 = 3.0;

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

/// Colour of a method's curves.
pub fn colour(method: Method) -> RGBColor {
    COLOURS[method as usize % COLOURS.len()]
}

/// Quantity over time that every method estimates.
#[derive(Clone, Copy)]
pub enum CurveQuantity {
    /// R in ohm.
    Resistance,
    /// L in microhenry.
    Inductance,
}

impl CurveQuantity {
    /// Extracts an estimate's values and standard deviations, in the unit of the axis; without σ the second is empty.
    fn extract(self, estimate: &Estimate) -> (Vec<f64>, Vec<f64>) {
        let scaled = |values: &[f64], unit: f64| values.iter().map(|x| x / unit).collect();
        match self {
            Self::Resistance => (estimate.r_ohm.clone(), estimate.r_sigma_ohm.clone()),
            Self::Inductance => (
                scaled(&estimate.l_h, 1e-6),
                scaled(&estimate.l_sigma_h, 1e-6),
            ),
        }
    }

    /// True value, in the unit of the axis.
    fn truth(self, truth: &Truth, t_s: f64) -> Option<f64> {
        let (r_ohm, l_h) = truth.at(t_s)?;
        Some(match self {
            Self::Resistance => r_ohm,
            Self::Inductance => l_h * 1e6,
        })
    }
}

/// Value of an estimate with its standard deviation, if it has one.
#[derive(Clone, Copy)]
struct Point {
    t_ms: f64,
    value: f64,
    sigma: Option<f64>,
}

fn points(estimate: &Estimate, quantity: CurveQuantity) -> impl Iterator<Item = Point> {
    let (values, sigmas) = quantity.extract(estimate);
    let t_s = estimate.t_s.clone();
    values
        .into_iter()
        .zip(t_s)
        .enumerate()
        .map(move |(k, (value, t_s))| Point {
            t_ms: t_s * 1e3,
            value,
            sigma: sigmas.get(k).copied().filter(|s| s.is_finite()),
        })
}

/// Truth and estimates of a quantity, above bands of ± 2σ.
pub fn over_time(
    quantity: CurveQuantity,
    estimates: &[&Estimate],
    truth: &Truth,
) -> Vec<PlotCurve> {
    let known = truth.t_s.iter();
    let known: Vec<_> = known
        .filter_map(|&t| Some((t * 1e3, quantity.truth(truth, t)?)))
        .collect();
    let mut curves = by_method(estimates, |e| points(e, quantity).collect());
    if !known.is_empty() {
        let under = curves.partition_point(|c| c.pen == Pen::Area);
        curves.insert(under, PlotCurve::new("truth", GREY, KNOWN, known));
    }
    curves
}

/// Errors of a quantity in percent of the truth, above bands of ± 2σ; none outside the truth's times.
pub fn errors(quantity: CurveQuantity, estimates: &[&Estimate], truth: &Truth) -> Vec<PlotCurve> {
    let ends = (truth.t_s.first(), truth.t_s.last());
    let (Some(&first), Some(&last)) = ends else {
        return Vec::new();
    };
    by_method(estimates, |e| {
        let inside = points(e, quantity).filter(|p| (first..=last).contains(&(p.t_ms / 1e3)));
        let of_truth = inside.filter_map(|p| {
            let known = quantity.truth(truth, p.t_ms / 1e3)?;
            let percent = 100.0 / known;
            Some(Point {
                value: (p.value - known) * percent,
                sigma: p.sigma.map(|s| s * percent),
                ..p
            })
        });
        of_truth.collect()
    })
}

/// Bands of all methods, then their lines.
fn by_method(estimates: &[&Estimate], points: impl Fn(&Estimate) -> Vec<Point>) -> Vec<PlotCurve> {
    let (mut bands, mut lines) = (Vec::new(), Vec::new());
    for method in Method::ALL {
        let of_method = estimates.iter().filter(|e| e.method == method);
        let runs: Vec<_> = of_method.map(|e| points(e)).collect();
        if runs.is_empty() {
            continue;
        }
        let curve = |pen, runs| PlotCurve {
            name: method.name().into(),
            colour: colour(method),
            pen,
            runs,
        };
        let outlines: Vec<_> = runs.iter().flat_map(|run| outlines(run)).collect();
        if !outlines.is_empty() {
            bands.push(curve(Pen::Area, outlines));
        }
        let line = |run: &Vec<Point>| run.iter().map(|p| (p.t_ms, p.value)).collect();
        lines.push(curve(Pen::Line(1), runs.iter().map(line).collect()));
    }
    bands.append(&mut lines);
    bands
}

/// Closed outlines of ± 2σ, one for each stretch of points that have a σ.
fn outlines(run: &[Point]) -> Vec<Vec<(f64, f64)>> {
    let with_sigma = |p: &Point| p.value.is_finite() && p.sigma.is_some();
    let stretches = run.chunk_by(|a, b| with_sigma(a) == with_sigma(b));
    let edge = |p: &Point, side: f64| {
        let width = BAND_SIGMA * p.sigma.unwrap_or(0.0);
        (p.t_ms, p.value + side * width)
    };
    let stretches = stretches.filter(|s| s.len() > 1 && with_sigma(&s[0]));
    let outline = stretches.map(|s| {
        let above = s.iter().map(|p| edge(p, 1.0));
        let below = s.iter().rev().map(|p| edge(p, -1.0));
        above.chain(below).collect()
    });
    outline.collect()
}

/// Measured waveforms and their reconstructions.
pub fn waves(
    segment: &Segment,
    range: &Range<usize>,
    estimates: &[&Estimate],
    measured: &[f64],
    reconstruction: fn(&Estimate) -> &Vec<f32>,
) -> Vec<PlotCurve> {
    let at = |k: usize| segment.t_s(k) * 1e3;
    let points = range.clone().map(|k| (at(k), measured[k])).collect();
    let mut curves = vec![PlotCurve::new("measured", GREY, KNOWN, points)];
    for estimate in estimates {
        let x = reconstruction(estimate);
        if estimate.f_sw_hz == segment.f_sw_hz && x.len() == segment.len() {
            let points = range.clone().map(|k| (at(k), f64::from(x[k]))).collect();
            let (name, colour) = (estimate.method.name(), colour(estimate.method));
            curves.push(PlotCurve::new(name, colour, Pen::Line(1), points));
        }
    }
    curves
}

/// Longest segment, and its samples around the largest current.
pub fn close_up(segments: &[Segment]) -> Option<(&Segment, Range<usize>)> {
    let segment = segments.iter().max_by_key(|s| s.len())?;
    // In the second half, after the filters have settled.
    let half = segment.len() / 2;
    let late = segment.i_a[half..].iter().enumerate();
    let largest = late.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?.0 + half;
    let reach = (0.5 * CLOSE_UP_PERIODS * segment.samples_per_period()).ceil() as usize;
    let from = largest.saturating_sub(reach);
    Some((segment, from..(largest + reach).min(segment.len())))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Estimate of 2.1 ohm ± .02 ohm where the truth is 2 ohm, without σ at its third point.
    fn estimate_and_truth() -> (Estimate, Truth) {
        let mut estimate = Estimate::new(Method::LeastSquares, 50e3);
        estimate.t_s = vec![0.0, 1e-3, 2e-3, 3e-3, 4e-3, 9e-3];
        estimate.r_ohm = vec![2.1; 6];
        estimate.l_h = vec![20e-6; 6];
        estimate.r_sigma_ohm = vec![0.02, 0.02, f64::NAN, 0.02, 0.02, 0.02];
        let truth = Truth {
            t_s: vec![0.0, 5e-3],
            r_ohm: vec![2.0; 2],
            l_h: vec![20e-6; 2],
            ..Truth::default()
        };
        (estimate, truth)
    }

    #[test]
    fn errors_are_percent_of_the_truth_within_bands_of_two_sigma() {
        let (estimate, truth) = estimate_and_truth();
        let curves = errors(CurveQuantity::Resistance, &[&estimate], &truth);
        let [band, line] = curves.as_slice() else {
            panic!("{curves:?}");
        };
        assert_eq!((band.pen, line.pen), (Pen::Area, Pen::Line(1)));
        // The point after the truth's end has no error; 5 % of the truth, ± 2 % of it.
        assert_eq!(line.points().count(), 5);
        assert!(line.points().all(|p| (p.1 - 5.0).abs() < 1e-9), "{line:?}");
        assert_eq!(band.runs.len(), 2, "no band where σ is unknown");
        let [above, .., below] = band.runs[0].as_slice() else {
            panic!("{band:?}");
        };
        assert!((above.1 - 7.0).abs() < 1e-9 && (below.1 - 3.0).abs() < 1e-9);
    }

    #[test]
    fn without_sigma_and_truth_there_are_only_estimates() {
        let (mut estimate, truth) = estimate_and_truth();
        estimate.r_sigma_ohm.clear();
        let nothing = Truth::default();
        assert!(errors(CurveQuantity::Resistance, &[&estimate], &nothing).is_empty());
        let curves = over_time(CurveQuantity::Resistance, &[&estimate], &truth);
        let names: Vec<_> = curves.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["truth", "least-squares"]);
    }
}
