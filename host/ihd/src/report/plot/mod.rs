//! What all figures share: axes, curves that end where the frame does, envelopes, legends beside the curves.

pub mod clip;
pub mod envelope;
pub mod legend;
pub mod panel;
pub mod scale;
#[cfg(test)]
pub(crate) mod svg;
pub mod two_axes;

use plotters::coord::Shift;
use plotters::prelude::*;

pub use legend::Entry;
pub use panel::{Panel, draw};
pub use scale::Scale;

/// A rectangle of a figure.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// What drawing gives, or the backend's complaint.
pub type Drawn<T = ()> = Result<T, Box<dyn std::error::Error>>;

/// Voltage, and whatever else comes first.
pub const BLUE: RGBColor = RGBColor(31, 119, 180);
/// Current, and whatever else comes second.
pub const RED: RGBColor = RGBColor(214, 39, 40);
/// What the others are held against.
pub const GREY: RGBColor = RGBColor(130, 130, 130);

/// Lines of the grid where a number stands.
const GRID: RGBColor = RGBColor(215, 215, 215);
/// Lines of the grid between them, on an axis of decades.
const FINE_GRID: RGBColor = RGBColor(238, 238, 238);

/// Size of the numbers at the axes, in pixels.
const LABEL_PX: u32 = 14;

/// An axis: what stands beside it, and its range.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Quantity and unit.
    pub label: String,
    /// From where to where, and how.
    pub scale: Scale,
}

impl Axis {
    /// An axis of equal steps.
    pub fn linear(label: &str, range: std::ops::Range<f64>) -> Self {
        Self {
            label: label.into(),
            scale: Scale::linear(range),
        }
    }

    /// An axis of decades.
    pub fn decades(label: &str, range: std::ops::Range<f64>) -> Self {
        Self {
            label: label.into(),
            scale: Scale::decades(range),
        }
    }
}

/// How a curve is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pen {
    /// A line of a width in pixels.
    Line(u32),
    /// A broken line of a width in pixels.
    Broken(u32),
    /// A dot at each point.
    Dots,
}

/// A curve in the units of its axes.
#[derive(Clone, Debug)]
pub struct Curve {
    /// Its name in the legend.
    pub name: String,
    /// Its colour.
    pub colour: RGBColor,
    /// How it is drawn.
    pub pen: Pen,
    /// Runs of points; the line breaks between them.
    pub runs: Vec<Vec<(f64, f64)>>,
}

impl Curve {
    /// A curve of one run.
    pub fn new(name: &str, colour: RGBColor, pen: Pen, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.into(),
            colour,
            pen,
            runs: vec![points],
        }
    }

    /// All its points.
    pub fn points(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.runs.iter().flatten().copied()
    }

    /// Its line in the legend.
    pub fn entry(&self) -> Entry {
        Entry::of(self)
    }
}

/// The least and the largest of the finite values; none where there is none.
pub fn span(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values
        .filter(|x| x.is_finite())
        .map(|x| (x, x))
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}
