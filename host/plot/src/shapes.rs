//! Shapes that all figures are made of: areas, axes, pens, curves, colours.

use plotters::coord::Shift;
use plotters::prelude::*;

use crate::Scale;

/// Rectangle of a figure.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Result of drawing, or the backend's error.
pub type DrawResult<T = ()> = Result<T, Box<dyn std::error::Error>>;

/// Voltage, or the first curve.
pub const BLUE: RGBColor = RGBColor(31, 119, 180);
/// Current, or the second curve.
pub const RED: RGBColor = RGBColor(214, 39, 40);
/// Reference curve.
pub const GREY: RGBColor = RGBColor(130, 130, 130);

/// Lines of the grid at the numbers.
pub(crate) const GRID: RGBColor = RGBColor(215, 215, 215);
/// Lines of the grid between them, on an axis of decades.
pub(crate) const FINE_GRID: RGBColor = RGBColor(238, 238, 238);

/// Size of the numbers at the axes, in pixels.
pub(crate) const LABEL_PX: u32 = 14;

/// Axis: label and range.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Quantity and unit.
    pub label: String,
    /// Range and kind of division.
    pub scale: Scale,
}

impl Axis {
    /// Creates an axis of equal steps.
    pub fn linear(label: &str, range: std::ops::Range<f64>) -> Self {
        Self {
            label: label.into(),
            scale: Scale::linear(range),
        }
    }

    /// Creates an axis of decades.
    pub fn decades(label: &str, range: std::ops::Range<f64>) -> Self {
        Self {
            label: label.into(),
            scale: Scale::decades(range),
        }
    }
}

/// Style of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pen {
    /// A line of a width in pixels.
    Line(u32),
    /// A broken line of a width in pixels.
    Broken(u32),
    /// A dot at each point.
    Dots,
    /// A translucent area; each run is its closed outline, cut off at the frame.
    Area,
}

/// Curve in the units of its axes.
#[derive(Clone, Debug)]
pub struct PlotCurve {
    /// Name in the legend.
    pub name: String,
    /// Colour.
    pub colour: RGBColor,
    /// Style.
    pub pen: Pen,
    /// Runs of points; the line breaks between them.
    pub runs: Vec<Vec<(f64, f64)>>,
}

impl PlotCurve {
    /// Creates a curve of one run.
    pub fn new(name: &str, colour: RGBColor, pen: Pen, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.into(),
            colour,
            pen,
            runs: vec![points],
        }
    }

    /// All points.
    pub fn points(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.runs.iter().flatten().copied()
    }
}

/// Minimum and maximum of the finite values; `None` if there are none.
pub fn span(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values
        .filter(|x| x.is_finite())
        .map(|x| (x, x))
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}
