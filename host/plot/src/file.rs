//! Files of figures: SVG, PDF or PNG, by the ending of the name.

use std::path::Path;

use plotters::prelude::{IntoDrawingArea, SVGBackend, WHITE};

use crate::drawing::Drawing;
use crate::{Area, DrawResult, FigureError, pdf, png};

/// Endings of the names of figures.
pub const ENDINGS: [&str; 3] = ["svg", "pdf", "png"];

/// [`ENDINGS`] in a sentence.
pub const ENDING_NAMES: &str = ".svg, .pdf or .png";

/// Draws a figure on white, and returns it as SVG.
fn svg(
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> DrawResult,
) -> Result<String, Box<dyn std::error::Error>> {
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        root.fill(&WHITE)?;
        draw(&root)?;
        root.present()?;
    }
    Ok(text)
}

/// Draws a figure of this size in pixels on white to a file: PDF for `.pdf`, PNG of twice as many pixels for `.png`, else SVG.
///
/// # Errors
/// [`FigureError`] with the file's name if it cannot be drawn or written.
pub fn write(
    path: &Path,
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> DrawResult,
) -> Result<(), FigureError> {
    let figure = bytes(path, size, draw)?;
    ihd_signal::atomic::replace(path, &figure).map_err(|why| FigureError::new(path, &why))
}

/// Draws a figure of this size in pixels on white, and returns the bytes of [such a file](write()) of this name.
///
/// # Errors
/// [`FigureError`] with the file's name if drawing fails.
pub fn bytes(
    path: &Path,
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> DrawResult,
) -> Result<Vec<u8>, FigureError> {
    let failed = |why: &dyn std::fmt::Display| FigureError::new(path, why);
    let drawn = svg(size, draw).map_err(|why| failed(&why))?;
    let drawing = || Drawing::parse(&drawn);
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("pdf") => drawing().map(|drawing| pdf::encode(&drawing)),
        Some("png") => drawing().and_then(|drawing| png::encode(&drawing)),
        _ => return Ok(drawn.into_bytes()),
    }
    .map_err(|why| failed(&why))
}
