//! Panels of a page, to be zoomed: inline SVG with the curves' points to a hundredth of a pixel, and the script that moves them.

use std::fmt::Write;

use plotters::coord::ranged1d::{BoldPoints, Ranged, ValueFormatter};
use plotters::prelude::RGBColor;

use crate::envelope::of_points;
use crate::{Axis, Pen, PlotCurve, PlotPanel};

/// Script of a page that has panels.
pub const SCRIPT: &str = include_str!("zoom.js");

/// Style of the panels.
pub const STYLE: &str = include_str!("zoom.css");

/// Size of a panel in pixels.
const SIZE_PX: (f64, f64) = (540.0, 320.0);

/// Corner and size of its frame in pixels.
const FRAME_PX: (f64, f64, f64, f64) = (66.0, 26.0, 464.0, 248.0);

/// Points of a curve beyond which columns of minimum and maximum are drawn.
const MAX_POINTS: usize = 8000;

/// Columns of such a curve.
const COLUMNS: usize = 4000;

/// Bound of coordinates in sizes of the frame: a diverging curve stays a number that browsers draw.
const MAX_FRAME_SIZES: f64 = 1e3;

/// Most numbers at an axis.
const NUMBERS: usize = 6;

/// Draws a panel of axes with equal steps as an SVG element for a page that has [`SCRIPT`] and [`STYLE`].
pub fn panel(title: &str, panel: &PlotPanel, curves: &[PlotCurve]) -> String {
    let ((width, height), (left, top, w, h)) = (SIZE_PX, FRAME_PX);
    let (x, y) = (panel.x.scale.ends(), panel.y.scale.ends());
    let ends = [x.start, x.end, y.start, y.end].map(|end| end.to_string());
    let mut out = format!(
        "<svg class=\"panel\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{title}\" data-ends=\"{ends}\">\n",
        title = escape(title),
        ends = ends.join(" ")
    );
    let (middle, below) = (left + w / 2.0, top + h + 38.0);
    let (title, x_label) = (escape(title), escape(&panel.x.label));
    let _ = writeln!(
        out,
        "<text class=\"middle\" x=\"{middle}\" y=\"16\">{title}</text>\n\
         <text class=\"middle\" x=\"{middle}\" y=\"{below}\">{x_label}</text>"
    );
    let (at, y_label) = (top + h / 2.0, escape(&panel.y.label));
    let _ = writeln!(
        out,
        "<text class=\"middle\" transform=\"translate(14 {at}) rotate(-90)\">{y_label}</text>"
    );
    let _ = writeln!(out, "<g class=\"ticks\">{}</g>", ticks(panel));
    let _ = writeln!(
        out,
        "<svg x=\"{left}\" y=\"{top}\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" preserveAspectRatio=\"none\">"
    );
    for curve in curves {
        curve_to(&mut out, panel, curve);
    }
    let _ = writeln!(
        out,
        "</svg>\n<rect class=\"frame\" x=\"{left}\" y=\"{top}\" width=\"{w}\" height=\"{h}\"/>\n</svg>"
    );
    out
}

/// Escapes text for an element or a quoted attribute.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}

/// Colour as in `#1f77b4`.
pub fn hex(RGBColor(r, g, b): RGBColor) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Lines of the grid and their numbers.
fn ticks(panel: &PlotPanel) -> String {
    let (left, top, w, h) = FRAME_PX;
    let numbers = |axis: &Axis| -> Vec<(f64, String)> {
        let values = axis.scale.key_points(BoldPoints(NUMBERS));
        let text = |value: f64| (axis.scale.unit(value), axis.scale.format_ext(&value));
        values.into_iter().map(text).collect()
    };
    let mut out = String::new();
    for (unit, text) in numbers(&panel.x) {
        let (at, bottom) = (left + unit * w, top + h);
        let _ = write!(
            out,
            "<line x1=\"{at:.2}\" x2=\"{at:.2}\" y1=\"{top}\" y2=\"{bottom}\"/>\
             <text class=\"x\" x=\"{at:.2}\" y=\"{}\">{text}</text>",
            bottom + 17.0
        );
    }
    for (unit, text) in numbers(&panel.y) {
        let (at, right) = (top + (1.0 - unit) * h, left + w);
        let _ = write!(
            out,
            "<line x1=\"{left}\" x2=\"{right}\" y1=\"{at:.2}\" y2=\"{at:.2}\"/>\
             <text class=\"y\" x=\"{}\" y=\"{:.2}\">{text}</text>",
            left - 6.0,
            at + 4.0
        );
    }
    out
}

/// Adds a path for each run; it breaks at values that are not finite.
fn curve_to(out: &mut String, panel: &PlotPanel, curve: &PlotCurve) {
    let colour = hex(curve.colour);
    let style = match curve.pen {
        Pen::Line(width) => format!("stroke=\"{colour}\" stroke-width=\"{width}\""),
        Pen::Broken(width) => {
            format!("stroke=\"{colour}\" stroke-width=\"{width}\" stroke-dasharray=\"6 4\"")
        }
        // A line of no length with round ends.
        Pen::Dots => format!("stroke=\"{colour}\" stroke-width=\"3\" stroke-linecap=\"round\""),
        Pen::Area => format!("class=\"area\" fill=\"{colour}\""),
    };
    for run in &curve.runs {
        let points = match curve.pen {
            Pen::Area => {
                let (above, below) = run.split_at(run.len() / 2);
                [
                    thinned(panel, above, |_, max| vec![max]),
                    thinned(panel, below, |min, _| vec![min]),
                ]
                .concat()
            }
            _ => thinned(panel, run, |min, max| vec![min, max]),
        };
        let d = path(panel, curve.pen, &points);
        if !d.is_empty() {
            let _ = writeln!(out, "<path {style} d=\"{d}\"/>");
        }
    }
}

/// Points of a run; of a long one those that `of` chooses from minimum and maximum of each column.
fn thinned(
    panel: &PlotPanel,
    run: &[(f64, f64)],
    of: impl Fn(f64, f64) -> Vec<f64>,
) -> Vec<(f64, f64)> {
    if run.len() <= MAX_POINTS {
        return run.to_vec();
    }
    let scale = &panel.x.scale;
    let columns = of_points(run, COLUMNS, |x| scale.unit(x), |unit| scale.value(unit));
    let points = columns
        .iter()
        .flat_map(|c| of(c.min, c.max).into_iter().map(|y| (c.at, y)));
    points.collect()
}

fn path(panel: &PlotPanel, pen: Pen, points: &[(f64, f64)]) -> String {
    let (_, _, w, h) = FRAME_PX;
    let (mut d, mut is_down) = (String::new(), false);
    for (x, y) in points {
        if !(x.is_finite() && y.is_finite()) {
            is_down = false;
            continue;
        }
        let unit = |axis: &Axis, value| {
            axis.scale
                .unit(value)
                .clamp(-MAX_FRAME_SIZES, MAX_FRAME_SIZES)
        };
        let (px, py) = (unit(&panel.x, *x) * w, (1.0 - unit(&panel.y, *y)) * h);
        let command = if is_down { "L" } else { "M" };
        let _ = write!(d, "{command}{px:.2} {py:.2}");
        match pen {
            Pen::Dots => d.push_str("h0"),
            _ => is_down = true,
        }
    }
    d
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BLUE;

    fn drawn(pen: Pen, points: Vec<(f64, f64)>) -> String {
        let axes = PlotPanel {
            x: Axis::linear("t / ms", 0.0..10.0),
            y: Axis::linear("R / Ω", 0.0..4.0),
        };
        panel("<b>&", &axes, &[PlotCurve::new("a", BLUE, pen, points)])
    }

    #[test]
    fn points_are_where_the_axes_say() {
        let svg = drawn(
            Pen::Line(1),
            vec![(0.0, 0.0), (5.0, 4.0), (6.0, f64::NAN), (10.0, 1.0)],
        );
        // The frame is 464 by 248 pixels, y downwards.
        assert!(
            svg.contains("d=\"M0.00 248.00L232.00 0.00M464.00 186.00\""),
            "{svg}"
        );
        assert!(svg.contains("data-ends=\"0 10 0 4\""));
        assert!(svg.contains("&lt;b&gt;&amp;") && !svg.contains("<b>"));
    }

    #[test]
    fn a_long_curve_keeps_its_extremes_and_loses_points() {
        let mut points: Vec<_> = (0..100_000).map(|k| (f64::from(k) * 1e-4, 2.0)).collect();
        points[31_234].1 = 3.0;
        points[71_234].1 = 1.0;
        let svg = drawn(Pen::Line(1), points);
        assert!(svg.contains(" 62.00L") && svg.contains(" 186.00L"));
        assert!(svg.len() < 200_000, "{}", svg.len());
    }

    #[test]
    fn a_runaway_stays_a_number() {
        let svg = drawn(Pen::Line(1), vec![(0.0, 1e300), (1.0, -1e300)]);
        assert!(svg.contains("M0.00 -247752.00"), "{svg}");
    }
}
