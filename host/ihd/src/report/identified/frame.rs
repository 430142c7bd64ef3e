//! Ranges of the panels' vertical axes.

use std::ops::Range;

use ihd_identify::Method;
use ihd_plot::{Pen, PlotCurve, span};

use super::curves::KNOWN;

/// Share of the values at either end that may lie outside the frame: the initial transient of a filter and the estimates at zero
/// crossings must not flatten everything else.
const OUTLIER_SHARE: f64 = 0.02;

/// Range in which a reconstructed waveform is shown beyond the measured one, in spans of it.
const MARGIN_SPANS: f64 = 1.0;

/// Range of the values without the outermost.
pub fn frame(curves: &[PlotCurve]) -> Option<Range<f64>> {
    // The paper's literal preset diverges; arrows at the frame's edge show that.
    let literal = |c: &&PlotCurve| c.name == Method::EkfPaper.name();
    let alone = curves.iter().all(|c| literal(&c));
    let lines = curves.iter().filter(|c| c.pen != Pen::Area);
    let framed = lines.filter(|c| alone || !literal(c));
    let mut y: Vec<f64> = framed
        .flat_map(PlotCurve::points)
        .map(|p| p.1)
        .filter(|y| y.is_finite())
        .collect();
    y.sort_unstable_by(f64::total_cmp);
    let cut = (OUTLIER_SHARE * y.len() as f64) as usize;
    let (mut low, mut high) = (*y.get(cut)?, *y.get(y.len() - 1 - cut)?);
    // Known curves are shown completely.
    if let Some(known) = known(curves) {
        (low, high) = (low.min(known.0), high.max(known.1));
    }
    Some(with_air(low, high))
}

/// Range of the values without the outermost, and zero.
pub fn with_zero(curves: &[PlotCurve]) -> Option<Range<f64>> {
    let Range { start, end } = frame(curves)?;
    Some(start.min(0.0)..end.max(0.0))
}

/// Range of all values; a diverging one is limited to the neighbourhood of the measurement.
pub fn whole(curves: &[PlotCurve]) -> Option<Range<f64>> {
    let (low, high) = known(curves)?;
    let reach = MARGIN_SPANS * (high - low);
    let all = span(curves.iter().flat_map(PlotCurve::points).map(|p| p.1))?;
    Some(with_air(all.0.max(low - reach), all.1.min(high + reach)))
}

/// Range of known and measured values.
fn known(curves: &[PlotCurve]) -> Option<(f64, f64)> {
    let known = curves.iter().filter(|c| c.pen == KNOWN);
    span(known.flat_map(PlotCurve::points).map(|p| p.1))
}

fn with_air(low: f64, high: f64) -> Range<f64> {
    let air = 0.08 * (high - low).max(1e-9 * high.abs().max(1e-9));
    low - air..high + air
}
