//! Panel: axes, and curves that end at the frame.

use plotters::prelude::*;

use crate::clip::{ClippedCurve, FrameEdge, OutsidePart, clip};
use crate::scale::{plain, power_of_ten};
use crate::shapes::{FINE_GRID, GRID, LABEL_PX};
use crate::{Area, Axis, DrawResult, Pen, PlotCurve, Scale};

/// Smallest distance between two arrows on the frame, in pixels.
const ARROWS_PX: f64 = 90.0;

/// Largest gap between two parts outside that share an arrow, in pixels.
const SAME_PX: f64 = 14.0;

/// Opacity of an area.
const AREA_OPACITY: f64 = 0.25;

/// Half width and height of an arrow, in pixels.
const ARROW_PX: (i32, i32) = (6, 10);

/// Axes of a panel.
#[derive(Clone, Debug)]
pub struct PlotPanel {
    /// Axis below.
    pub x: Axis,
    /// Axis at the left.
    pub y: Axis,
}

/// Coordinates of a panel.
pub(crate) type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Scale, Scale>>;

/// Draws axes and curves. A line beyond the frame ends there, and an arrow of its colour at the edge shows its direction. Returns
/// the parts outside of each line.
///
/// # Errors
/// Any error of the backend.
pub fn draw(
    area: &Area<'_>,
    panel: &PlotPanel,
    curves: &[PlotCurve],
) -> DrawResult<Vec<Vec<OutsidePart>>> {
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .margin_right(16)
        .x_label_area_size(if panel.x.label.is_empty() { 24 } else { 40 })
        .y_label_area_size(62)
        .build_cartesian_2d(panel.x.scale.clone(), panel.y.scale.clone())?;
    mesh(&mut chart, &panel.x.label, &panel.y.label)?;
    let mut outside = Vec::new();
    for (k, curve) in curves.iter().enumerate() {
        if curve.pen == Pen::Area {
            areas(&mut chart, curve)?;
            outside.push(Vec::new());
            continue;
        }
        let mut stretches = Vec::new();
        for run in &curve.runs {
            let cut = clip(run, &panel.x.scale, &panel.y.scale);
            line(&mut chart, curve, &cut)?;
            stretches.extend(cut.outside);
        }
        arrows(&chart, panel, curve, k, &stretches)?;
        outside.push(stretches);
    }
    Ok(outside)
}

/// Text on a curve's course beyond the frame: `▲ to 7.3·10⁵`; empty if it stays within.
pub fn beyond(outside: &[OutsidePart]) -> String {
    let extremes = |edge| {
        let of = move |o: &&OutsidePart| o.edge == edge;
        outside.iter().filter(of).map(|o| o.extreme)
    };
    let number = |x: f64| match x.abs() {
        a if (1e-3..1e4).contains(&a) => plain((x * 100.0).round() / 100.0),
        _ => power_of_ten(x),
    };
    let up = extremes(FrameEdge::Top).reduce(f64::max);
    let down = extremes(FrameEdge::Bottom).reduce(f64::min);
    let words = [("▲ to ", up), ("▼ to ", down)];
    let words = words
        .into_iter()
        .filter_map(|(word, x)| Some(word.to_owned() + &number(x?)));
    words.collect::<Vec<_>>().join(", ")
}

pub(crate) fn mesh(chart: &mut Chart<'_, '_>, x: &str, y: &str) -> DrawResult {
    chart
        .configure_mesh()
        .x_desc(x)
        .y_desc(y)
        .label_style(("sans-serif", LABEL_PX))
        .axis_desc_style(("sans-serif", LABEL_PX + 1))
        .x_labels(9)
        .y_labels(8)
        .bold_line_style(GRID)
        .light_line_style(FINE_GRID)
        .max_light_lines(9)
        .draw()?;
    Ok(())
}

/// Draws a curve's filled areas; the scale ends them at the frame.
fn areas(chart: &mut Chart<'_, '_>, curve: &PlotCurve) -> DrawResult {
    for outline in &curve.runs {
        let finite = |p: &&(f64, f64)| p.0.is_finite() && p.1.is_finite();
        let outline: Vec<_> = outline.iter().filter(finite).copied().collect();
        chart.draw_series([Polygon::new(
            outline,
            curve.colour.mix(AREA_OPACITY).filled(),
        )])?;
    }
    Ok(())
}

fn line(chart: &mut Chart<'_, '_>, curve: &PlotCurve, cut: &ClippedCurve) -> DrawResult {
    let colour = curve.colour;
    for run in &cut.inside {
        let points = run.iter().copied();
        match curve.pen {
            Pen::Line(width) => {
                chart.draw_series(LineSeries::new(points, colour.stroke_width(width)))?;
            }
            Pen::Broken(width) => {
                let style = colour.stroke_width(width);
                chart.draw_series(DashedLineSeries::new(points, 6, 4, style))?;
            }
            Pen::Dots => {
                chart.draw_series(points.map(|p| Circle::new(p, 2, colour.filled())))?;
            }
            // Drawn by `areas`.
            Pen::Area => {}
        }
    }
    Ok(())
}

/// Places of arrows for parts outside, in the units of the x axis; `phase` from 0 to 1 separates those of two curves.
fn arrow_units(stretches: &[(f64, f64)], width_px: f64, phase: f64) -> Vec<f64> {
    let mut merged: Vec<(f64, f64)> = Vec::new();
    for &(from, to) in stretches {
        match merged.last_mut() {
            Some(last) if (from - last.1) * width_px <= SAME_PX => last.1 = last.1.max(to),
            _ => merged.push((from, to)),
        }
    }
    let places = merged.into_iter().flat_map(|(from, to)| {
        let long_px = (to - from) * width_px;
        let count = (long_px / ARROWS_PX).floor().max(1.0) as usize;
        let shift = if count > 1 { phase - 0.5 } else { 0.0 };
        let step = (to - from) / count as f64;
        (0..count).map(move |k| from + (k as f64 + 0.5 + 0.8 * shift) * step)
    });
    places.collect()
}

fn arrows(
    chart: &Chart<'_, '_>,
    panel: &PlotPanel,
    curve: &PlotCurve,
    number: usize,
    outside: &[OutsidePart],
) -> DrawResult {
    let plotting = chart.plotting_area();
    let width_px = f64::from(plotting.dim_in_pixel().0);
    let (half, height) = ARROW_PX;
    let phase = (number as f64 * 0.37).fract();
    for edge in [FrameEdge::Top, FrameEdge::Bottom] {
        let of_edge = outside.iter().filter(|o| o.edge == edge);
        let unit = |x: f64| panel.x.scale.unit(x);
        let stretches: Vec<_> = of_edge.map(|o| (unit(o.from), unit(o.to))).collect();
        // The tip is at the edge, and the whole arrow inside, at the panel's corners too.
        let margin = f64::from(half) / width_px;
        for place in arrow_units(&stretches, width_px, phase) {
            let x = panel.x.scale.value(place.clamp(margin, 1.0 - margin));
            let ends = panel.y.scale.ends();
            let (y, down) = match edge {
                FrameEdge::Top => (ends.end, 1),
                FrameEdge::Bottom => (ends.start, -1),
            };
            let corners = vec![(0, down), (half, height * down), (-half, height * down)];
            let arrow = EmptyElement::at((x, y)) + Polygon::new(corners, curve.colour.filled());
            plotting.draw(&arrow)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::svg::Picture;
    use crate::{BLUE, RED};

    const SIZE: (u32, u32) = (600, 400);

    fn picture(panel: &PlotPanel, curves: &[PlotCurve]) -> (Picture, Vec<Vec<OutsidePart>>) {
        let mut text = String::new();
        let root = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        let outside = draw(&root, panel, curves).unwrap();
        root.present().unwrap();
        drop(root);
        (Picture::new(&text), outside)
    }

    fn panel() -> PlotPanel {
        PlotPanel {
            x: Axis::linear("t / ms", 0.0..10.0),
            y: Axis::linear("R / Ω", 1.0..4.0),
        }
    }

    /// The frame of [`SIZE`] with the margins of [`draw`]: left, top, right, bottom.
    const FRAME: (i32, i32, i32, i32) = (70, 8, 583, 351);

    #[test]
    fn no_line_runs_along_the_frame_or_beyond_it() {
        let runaway = (0..=100).map(|k| {
            let t = 0.1 * f64::from(k);
            (t, if (30..60).contains(&k) { 1e6 } else { 2.0 })
        });
        let never = vec![(0.0, -5.0), (10.0, -7.0)];
        let curves = [
            PlotCurve::new("a", BLUE, Pen::Line(2), runaway.collect()),
            PlotCurve::new("b", RED, Pen::Line(2), never),
        ];
        let (picture, outside) = picture(&panel(), &curves);
        let (left, top, right, bottom) = FRAME;
        let blue = picture.polylines("#1F77B4");
        assert_eq!(blue.len(), 2, "cut in two");
        for (x, y) in blue.iter().flatten() {
            assert!((left..=right).contains(x) && (top..=bottom).contains(y));
        }
        // The curve meets the edge where it leaves and where it comes back, and never goes along it.
        let at_top = blue.iter().flatten().filter(|p| p.1 == top).count();
        assert_eq!(at_top, 2);
        assert!(picture.polylines("#D62728").is_empty());
        // Both are marked, each in its colour, inside the frame, with the tip at its edge.
        for (colour, edge) in [("#1F77B4", top + 1), ("#D62728", bottom - 1)] {
            let arrows = picture.polygons(colour);
            assert!(!arrows.is_empty(), "{colour}");
            for corner in arrows.iter().flatten() {
                assert!((left..=right).contains(&corner.0) && (top..=bottom).contains(&corner.1));
            }
            assert!(arrows.iter().all(|a| a.iter().any(|c| c.1 == edge)));
        }
        assert_eq!(beyond(&outside[0]), "▲ to 10⁶");
        assert_eq!(beyond(&outside[1]), "▼ to -7");
    }

    #[test]
    fn both_axes_of_decades_have_powers_of_ten_and_fine_lines() {
        let panel = PlotPanel {
            x: Axis::decades("step", 1.0..5e3),
            y: Axis::decades("loss", 1e-9..1.0),
        };
        let points = vec![(1.0, 1.0), (10.0, 1e-3), (5e3, 1e-9)];
        let curve = PlotCurve::new("L_f", BLUE, Pen::Line(2), points);
        let (picture, outside) = picture(&panel, &[curve]);
        assert!(outside[0].is_empty());
        for label in ["10⁰", "10¹", "10²", "10³", "10⁻⁸", "10⁻²"] {
            assert!(picture.texts().contains(&label.to_owned()), "{label}");
        }
        // A third of nine decades down, where three decades of loss are.
        let line = &picture.polylines("#1F77B4")[0];
        let third = f64::from(FRAME.1) + f64::from(FRAME.3 - FRAME.1) / 3.0;
        assert!((f64::from(line[1].1) - third).abs() <= 1.0, "{line:?}");
    }

    #[test]
    fn short_stretches_share_an_arrow_and_a_long_one_has_some() {
        // Ten spikes within 100 pixels of 1000, each 10 from the next.
        let spikes: Vec<_> = (0..10)
            .map(|k| 0.3 + 0.01 * f64::from(k))
            .map(|x| (x, x + 0.001))
            .collect();
        assert_eq!(arrow_units(&spikes, 1000.0, 0.2).len(), 1);
        let long = arrow_units(&[(0.0, 1.0)], 1000.0, 0.2);
        assert_eq!(long.len(), 11);
        assert!(long.iter().all(|x| (0.0..=1.0).contains(x)));
        let other = arrow_units(&[(0.0, 1.0)], 1000.0, 0.7);
        let apart = long.iter().zip(&other).map(|(a, b)| (a - b).abs());
        assert!(apart.fold(f64::INFINITY, f64::min) * 1000.0 > 12.0);
    }
}
