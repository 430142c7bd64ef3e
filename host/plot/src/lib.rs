//! Figures as SVG, PDF or PNG: axes, curves that end where the frame does, envelopes, legends beside the curves; panels of a page to zoom.
//!
//! ```text
//! shapes ◄─ clip, envelope, scale ◄─ legend, panel ◄─ two_axes
//! shapes ◄─ drawing ◄─ pdf, png ◄─ file
//! panel, envelope ◄─ zoom
//! ```

pub mod clip;
mod drawing;
pub mod envelope;
mod figure_error;
pub mod file;
pub mod legend;
pub mod panel;
mod pdf;
mod png;
pub mod scale;
mod shapes;
pub mod svg;
pub mod two_axes;
pub mod zoom;

pub use figure_error::FigureError;
pub use legend::LegendEntry;
pub use panel::{PlotPanel, draw};
pub use scale::Scale;
pub use shapes::{Area, Axis, BLUE, DrawResult, GREY, Pen, PlotCurve, RED, span};
