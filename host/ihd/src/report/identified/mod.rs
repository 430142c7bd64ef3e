//! Figure of `ihd identify`: R(t), L(t), their errors where the truth is known, and the waveforms, by every method.

mod curves;
mod frame;

use std::fmt::Write;
use std::ops::Range;
use std::path::Path;

use ihd_identify::accuracy::fundamental;
use ihd_identify::{Estimate, Method};
use ihd_plot::legend::{Sign, header};
use ihd_plot::{
    self as plot, Axis, DrawResult, GREY, LegendEntry, Pen, PlotCurve, PlotPanel, span,
};
use ihd_plot::{Area, FigureError, file, zoom};
use ihd_signal::Segment;
use ihd_signal::truth::PeriodTruth;
use plotters::prelude::RGBColor;

use curves::{CurveQuantity, KNOWN, close_up, colour, errors, over_time, waves};
use frame::{frame, whole, with_zero};

/// Width of the figure and height of a row of panels, in pixels.
const SIZE_PX: (u32, u32) = (1100, 385);

/// Height of title and legend, in pixels.
const HEADER_PX: u32 = 30;

/// Colour of the legend's sign for bands.
const BAND_SIGN: RGBColor = RGBColor(215, 215, 215);

/// Draws R and L over time with ± 2σ, the truth and the errors where there is one, and a close-up of the measured and
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
    if estimates.iter().all(|e| e.t_s.is_empty()) {
        return Err(FigureError::new(path, &"no method gave an estimate"));
    }
    let panels = panels(segments, estimates, truth);
    let rows = panels.len().div_ceil(2).max(1);
    let size = (SIZE_PX.0, HEADER_PX + SIZE_PX.1 * rows as u32);
    file::write(path, size, |root| {
        let entries = entries(estimates, !truth.is_empty(), &panels);
        let below = header(root, name, &entries)?;
        draw_all(&below, &panels, rows)
    })
}

/// Draws the panels of [`draw`] to be zoomed in a page ([`zoom`]), after a legend; empty if no method gave an estimate.
pub fn zoomable(segments: &[Segment], estimates: &[&Estimate], truth: &[PeriodTruth]) -> String {
    if estimates.iter().all(|e| e.t_s.is_empty()) {
        return String::new();
    }
    let panels = panels(segments, estimates, truth);
    let mut out = String::from("<p class=\"legend\">");
    for entry in entries(estimates, !truth.is_empty(), &panels) {
        let sign = match entry.sign {
            Sign::Curve(colour, _) | Sign::Shade(colour) => {
                format!("<b style=\"color:{}\">■</b> ", zoom::hex(colour))
            }
            // Nothing points outside of these frames: they are moved.
            Sign::None => continue,
        };
        let _ = write!(out, "<span>{sign}{}</span> ", zoom::escape(&entry.name));
    }
    out.push_str("</p>\n<div class=\"panels\">\n");
    for framed in &panels {
        out += &zoom::panel(framed.title, &framed.panel, &framed.curves);
    }
    out + "</div>\n"
}

fn draw_all(below: &Area<'_>, panels: &[FramedPanel], rows: usize) -> DrawResult {
    let places = below.split_evenly((rows, 2));
    for (area, framed) in places.iter().zip(panels) {
        let below = header(area, framed.title, &[])?;
        plot::draw(&below, &framed.panel, &framed.curves)?;
    }
    Ok(())
}

/// Panel with its axes.
struct FramedPanel {
    title: &'static str,
    panel: PlotPanel,
    curves: Vec<PlotCurve>,
}

impl FramedPanel {
    fn new(
        title: &'static str,
        label: &str,
        curves: Vec<PlotCurve>,
        y: impl Fn(&[PlotCurve]) -> Option<Range<f64>>,
    ) -> Option<Self> {
        let (from, to) = span(curves.iter().flat_map(PlotCurve::points).map(|p| p.0))?;
        let panel = PlotPanel {
            x: Axis::linear("t / ms", from..to),
            y: Axis::linear(label, y(&curves)?),
        };
        Some(Self {
            title,
            panel,
            curves,
        })
    }

    /// Returns `true` if a line extends beyond the frame.
    fn has_more(&self) -> bool {
        let frame = self.panel.y.scale.ends();
        let lines = self.curves.iter().filter(|c| c.pen != Pen::Area);
        let mut points = lines.flat_map(PlotCurve::points);
        points.any(|p| p.1 < frame.start || p.1 > frame.end)
    }

    fn has_band(&self) -> bool {
        self.curves.iter().any(|c| c.pen == Pen::Area)
    }
}

/// Panels of R and L, of their errors if the truth is known, and of the waveforms if there is a segment; two a row.
fn panels(
    segments: &[Segment],
    estimates: &[&Estimate],
    truth: &[PeriodTruth],
) -> Vec<FramedPanel> {
    use CurveQuantity::{Inductance, Resistance};
    let truth = fundamental(truth);
    let of = |quantity| over_time(quantity, estimates, &truth);
    let error = |quantity| errors(quantity, estimates, &truth);
    let mut all = vec![
        FramedPanel::new("Resistance", "R / Ω", of(Resistance), frame),
        FramedPanel::new("Inductance", "L / µH", of(Inductance), frame),
        FramedPanel::new("Error of R", "ΔR / %", error(Resistance), with_zero),
        FramedPanel::new("Error of L", "ΔL / %", error(Inductance), with_zero),
    ];
    if let Some((segment, range)) = close_up(segments) {
        let v = waves(segment, &range, estimates, &segment.v_v, |e| &e.v_hat_v);
        let i = waves(segment, &range, estimates, &segment.i_a, |e| &e.i_hat_a);
        all.extend([
            FramedPanel::new("Voltage, reconstructed", "v / V", v, whole),
            FramedPanel::new("Current, reconstructed", "i / A", i, whole),
        ]);
    }
    all.into_iter().flatten().collect()
}

/// Names and colours in one line above the panels.
fn entries(estimates: &[&Estimate], truth: bool, panels: &[FramedPanel]) -> Vec<LegendEntry> {
    let grey = if truth { "truth, measured" } else { "measured" };
    let mut entries = vec![LegendEntry::line(grey, GREY, KNOWN)];
    for method in Method::ALL {
        if estimates.iter().any(|e| e.method == method) {
            entries.push(LegendEntry::line(
                method.name(),
                colour(method),
                Pen::Line(2),
            ));
        }
    }
    if panels.iter().any(FramedPanel::has_band) {
        entries.push(LegendEntry::shade("± 2σ", BAND_SIGN));
    }
    if panels.iter().any(FramedPanel::has_more) {
        entries.push(LegendEntry::text_only("▲▼ goes on outside"));
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
