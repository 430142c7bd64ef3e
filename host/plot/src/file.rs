//! Files of figures: SVG or PDF, by the ending of the name.

use std::path::Path;

use plotters::prelude::{IntoDrawingArea, SVGBackend, WHITE};

use crate::pdf;
use crate::{Area, DrawResult, FigureError};

/// Endings of the names of figures.
pub const ENDINGS: [&str; 2] = ["svg", "pdf"];

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

/// Draws a figure of this size in pixels on white to a file: PDF for `.pdf`, else SVG.
///
/// # Errors
/// [`FigureError`] with the file's name if it cannot be drawn or written.
pub fn write(
    path: &Path,
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> DrawResult,
) -> Result<(), FigureError> {
    let figure = bytes(path, size, draw)?;
    std::fs::write(path, figure).map_err(|why| FigureError::new(path, &why))
}

/// Draws a figure of this size in pixels on white, and returns the bytes of a file of this name: PDF for `.pdf`, else SVG.
///
/// # Errors
/// [`FigureError`] with the file's name if drawing fails.
pub fn bytes(
    path: &Path,
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> DrawResult,
) -> Result<Vec<u8>, FigureError> {
    let drawn = svg(size, draw).map_err(|why| FigureError::new(path, &why))?;
    if path.extension().is_some_and(|ending| ending == "pdf") {
        return pdf::of_svg(&drawn).map_err(|why| FigureError::new(path, &why));
    }
    Ok(drawn.into_bytes())
}
