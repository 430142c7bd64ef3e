//! Panel with an axis at each side: voltage and current, each in its own unit.

use plotters::prelude::*;

use crate::envelope::Column;
use crate::panel::{Chart, mesh};
use crate::shapes::LABEL_PX;
use crate::{Area, Axis, DrawResult, Scale};

/// Length of the left and the right axis over the largest value, so that the curves do not overlap.
const ROOM: (f64, f64) = (1.08, 1.35);

/// Curve of one of the axes.
#[derive(Clone, Debug)]
pub enum Trace {
    /// A line through points.
    Line(Vec<(f64, f64)>),
    /// The least and the largest of each column of pixels.
    Band(Vec<Column>),
}

impl Trace {
    /// Corners of its bounding box.
    fn corners(&self) -> Option<((f64, f64), (f64, f64))> {
        match self {
            Self::Line(points) => {
                let x = crate::span(points.iter().map(|p| p.0))?;
                Some((x, crate::span(points.iter().map(|p| p.1))?))
            }
            Self::Band(columns) => {
                let x = crate::span(columns.iter().map(|c| c.at))?;
                let y = columns.iter().flat_map(|c| [c.min, c.max]);
                Some((x, crate::span(y)?))
            }
        }
    }
}

/// One side: label and colour of its axis, and its curve.
#[derive(Clone, Debug)]
pub struct Side {
    /// Quantity and unit.
    pub label: String,
    /// Colour of line and band.
    pub colour: RGBColor,
    /// The curve.
    pub trace: Trace,
}

/// Elements drawn under the curves.
#[derive(Clone, Debug, Default)]
pub struct Underlay {
    /// Shaded parts of the x axis with their colours.
    pub shaded: Vec<(f64, f64, RGBColor)>,
    /// Broken lines from bottom to top.
    pub marks: Vec<f64>,
    /// Lines from bottom to top, for alarms.
    pub alarms: Vec<f64>,
}

/// Place of zero on the axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Zero {
    /// In the middle of both.
    Middle,
    /// At the bottom of both.
    Bottom,
}

/// Draws both sides over one x axis; nothing if the left one has no values.
///
/// # Errors
/// Any error of the backend.
pub fn draw(
    area: &Area<'_>,
    x_label: &str,
    zero: Zero,
    sides: &[Side; 2],
    under: &Underlay,
) -> DrawResult {
    let Some(((from, to), _)) = sides[0].trace.corners() else {
        return Ok(());
    };
    let x = Axis::linear(x_label, from..to);
    let range = |side: &Side, room: f64| {
        let (low, high) = side.trace.corners().map_or((0.0, 1.0), |c| c.1);
        let size = room * low.abs().max(high.abs()).max(1e-9);
        match zero {
            Zero::Middle => Scale::linear(-size..size),
            Zero::Bottom => Scale::linear(0.0..size),
        }
    };
    let (left, right) = (range(&sides[0], ROOM.0), range(&sides[1], ROOM.1));
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .x_label_area_size(if x_label.is_empty() { 24 } else { 40 })
        .y_label_area_size(62)
        .right_y_label_area_size(62)
        .build_cartesian_2d(x.scale.clone(), left.clone())?
        .set_secondary_coord(x.scale.clone(), right);
    mesh(&mut chart, x_label, &sides[0].label)?;
    chart
        .configure_secondary_axes()
        .y_desc(&sides[1].label)
        .label_style(("sans-serif", LABEL_PX))
        .axis_desc_style(("sans-serif", LABEL_PX + 1))
        .draw()?;
    underlay(&mut chart, under, (&x.scale, &left))?;
    for (side, second) in [(&sides[0], false), (&sides[1], true)] {
        for points in lines(&side.trace) {
            let line = LineSeries::new(points, side.colour.stroke_width(1));
            if second {
                chart.draw_secondary_series(line)?;
            } else {
                chart.draw_series(line)?;
            }
        }
        if let Some(outline) = outline(&side.trace) {
            // The curve behind must remain visible.
            let band = [Polygon::new(outline, side.colour.mix(0.45).filled())];
            if second {
                chart.draw_secondary_series(band)?;
            } else {
                chart.draw_series(band)?;
            }
        }
    }
    Ok(())
}

/// Draws what lies under the curves.
fn underlay(chart: &mut Chart<'_, '_>, under: &Underlay, (x, y): (&Scale, &Scale)) -> DrawResult {
    let (x, y) = (x.ends(), y.ends());
    let inside = |t: &f64| x.contains(t);
    for (a, b, colour) in &under.shaded {
        let (a, b) = (a.max(x.start), b.min(x.end));
        if a < b {
            let corners = [(a, y.start), (b, y.end)];
            chart.draw_series([Rectangle::new(corners, colour.filled())])?;
        }
    }
    for &t in under.marks.iter().filter(|t| inside(t)) {
        let line = [(t, y.start), (t, y.end)];
        let style = BLACK.mix(0.5).stroke_width(1);
        chart.draw_series(DashedLineSeries::new(line, 6, 6, style))?;
    }
    for &t in under.alarms.iter().filter(|t| inside(t)) {
        let line = [(t, y.start), (t, y.end)];
        chart.draw_series(LineSeries::new(line, crate::RED.mix(0.5)))?;
    }
    Ok(())
}

/// The curve, or both edges of its band.
fn lines(trace: &Trace) -> Vec<Vec<(f64, f64)>> {
    match trace {
        Trace::Line(points) => {
            let finite = |p: &&(f64, f64)| p.0.is_finite() && p.1.is_finite();
            vec![points.iter().filter(finite).copied().collect()]
        }
        Trace::Band(columns) => vec![
            columns.iter().map(|c| (c.at, c.max)).collect(),
            columns.iter().map(|c| (c.at, c.min)).collect(),
        ],
    }
}

fn outline(trace: &Trace) -> Option<Vec<(f64, f64)>> {
    let Trace::Band(columns) = trace else {
        return None;
    };
    let above = columns.iter().map(|c| (c.at, c.max));
    let below = columns.iter().rev().map(|c| (c.at, c.min));
    Some(above.chain(below).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::svg::Picture;
    use crate::{BLUE, RED};

    fn picture(sides: &[Side; 2]) -> Picture {
        let mut text = String::new();
        let root = SVGBackend::with_string(&mut text, (600, 300)).into_drawing_area();
        draw(&root, "t / ms", Zero::Middle, sides, &Underlay::default()).unwrap();
        root.present().unwrap();
        drop(root);
        Picture::new(&text)
    }

    #[test]
    fn each_side_has_its_own_unit_and_bands_show_least_and_largest() {
        let column = |k: i32| Column {
            at: f64::from(k),
            min: -325.0,
            max: 325.0,
        };
        let sides = [
            Side {
                label: "v / V".into(),
                colour: BLUE,
                trace: Trace::Band((0..=10).map(column).collect()),
            },
            Side {
                label: "i / A".into(),
                colour: RED,
                trace: Trace::Line(vec![(0.0, -40.0), (10.0, 40.0)]),
            },
        ];
        let picture = picture(&sides);
        for label in ["v / V", "i / A", "200", "-40"] {
            assert!(picture.texts().contains(&label.to_owned()), "{label}");
        }
        let band = &picture.polygons("#1F77B4")[0];
        let (top, bottom) = (
            band.iter().map(|p| p.1).min().unwrap(),
            band.iter().map(|p| p.1).max().unwrap(),
        );
        // The frame is from 8 to 252; the band takes 1/1.08 of it, in its middle.
        let half = 122.0 / ROOM.0;
        assert!((f64::from(top) - (130.0 - half)).abs() <= 2.0, "{top}");
        assert!(
            (f64::from(bottom) - (130.0 + half)).abs() <= 2.0,
            "{bottom}"
        );
        assert!(!picture.polylines("#D62728").is_empty());
    }

    #[test]
    fn nothing_to_show_is_no_panic() {
        let none = |colour| Side {
            label: "x".into(),
            colour,
            trace: Trace::Line(vec![]),
        };
        picture(&[none(BLUE), none(RED)]);
    }
}
