//! Legends beside the curves: in the line of the title, or in a column at the right.

use plotters::prelude::*;

use crate::{Area, DrawResult, Pen, PlotCurve};

/// Size of the title in pixels.
const TITLE_PX: i32 = 17;
/// Size of a name in pixels.
const NAME_PX: i32 = 14;
/// Size of a note below a name in pixels.
const NOTE_PX: i32 = 13;
/// Height of a line of the legend in pixels.
const LINE_PX: i32 = 22;
/// Width of a line's sign in pixels.
const SIGN_PX: i32 = 20;
/// Gap between two entries of a line, in pixels.
const GAP_PX: i32 = 16;
/// Indentation of a title, in pixels: about where the axis begins.
const INDENT_PX: i32 = 14;

/// Sign before a name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sign {
    /// A line of a curve.
    Curve(RGBColor, Pen),
    /// A shaded area.
    Shade(RGBColor),
    /// None.
    None,
}

/// Entry of a legend.
#[derive(Clone, Debug, PartialEq)]
pub struct LegendEntry {
    /// Sign.
    pub sign: Sign,
    /// Name.
    pub name: String,
    /// Note below the name in a column; may be empty.
    pub note: String,
}

impl LegendEntry {
    /// Entry of a curve.
    pub fn from_curve(curve: &PlotCurve) -> Self {
        Self::line(&curve.name, curve.colour, curve.pen)
    }

    /// Entry of a line.
    pub fn line(name: &str, colour: RGBColor, pen: Pen) -> Self {
        Self {
            sign: Sign::Curve(colour, pen),
            name: name.into(),
            note: String::new(),
        }
    }

    /// Entry of a shaded area.
    pub fn shade(name: &str, colour: RGBColor) -> Self {
        Self {
            sign: Sign::Shade(colour),
            name: name.into(),
            note: String::new(),
        }
    }

    /// Entry of text alone.
    pub fn text_only(text: &str) -> Self {
        Self {
            sign: Sign::None,
            name: text.into(),
            note: String::new(),
        }
    }

    fn width_px(&self) -> i32 {
        self.indent_px() + text_px(&self.name, NAME_PX) + GAP_PX
    }

    /// Distance from the sign's left edge to the name, in pixels.
    fn indent_px(&self) -> i32 {
        match self.sign {
            Sign::None => 0,
            Sign::Curve(..) | Sign::Shade(_) => SIGN_PX + 6,
        }
    }

    fn draw(&self, area: &Area<'_>, (x, y): (i32, i32)) -> DrawResult {
        match self.sign {
            Sign::Curve(colour, Pen::Line(width)) => {
                let ends = [(x, y), (x + SIGN_PX, y)];
                area.draw(&PathElement::new(ends, colour.stroke_width(width.max(2))))?;
            }
            Sign::Curve(colour, Pen::Broken(width)) => {
                for at in [x, x + 7, x + 14] {
                    let ends = [(at, y), (at + 4, y)];
                    area.draw(&PathElement::new(ends, colour.stroke_width(width.max(2))))?;
                }
            }
            Sign::Curve(colour, Pen::Dots) => {
                for at in [x + 4, x + 15] {
                    area.draw(&Circle::new((at, y), 3, colour.filled()))?;
                }
            }
            Sign::Curve(colour, Pen::Area) | Sign::Shade(colour) => {
                let corners = [(x, y - 6), (x + SIGN_PX, y + 6)];
                area.draw(&Rectangle::new(corners, colour.filled()))?;
            }
            Sign::None => {}
        }
        let style = ("sans-serif", NAME_PX).into_text_style(area);
        area.draw_text(&self.name, &style, (x + self.indent_px(), y - NAME_PX / 2))?;
        Ok(())
    }
}

/// Upper limit of a text's width in the fonts that browsers use for sans-serif, in pixels.
fn text_px(text: &str, size_px: i32) -> i32 {
    text.chars().count() as i32 * size_px * 3 / 5
}

/// Draws the title and the legend, beside it or in lines of its own; returns the area below.
///
/// # Errors
/// Any error of the backend.
pub fn header<'a>(area: &Area<'a>, title: &str, entries: &[LegendEntry]) -> DrawResult<Area<'a>> {
    let width = area.dim_in_pixel().0 as i32;
    let title_px = text_px(title, TITLE_PX);
    let names_px: i32 = entries.iter().map(LegendEntry::width_px).sum();
    let first = INDENT_PX + title_px + 2 * GAP_PX;
    let beside = title.is_empty() || first + names_px <= width;
    let mut places = Vec::new();
    // Beside the title it is at the right.
    let (mut x, mut line) = match (title.is_empty(), beside) {
        (true, _) => (INDENT_PX, 0),
        (false, true) => (width - names_px, 0),
        (false, false) => (INDENT_PX, 1),
    };
    for entry in entries {
        if x + entry.width_px() > width && x > INDENT_PX {
            (x, line) = (INDENT_PX, line + 1);
        }
        places.push((x, line));
        x += entry.width_px();
    }
    let height = 6 + LINE_PX * (line + 1);
    let (strip, rest) = area.split_vertically(height);
    let style = ("sans-serif", TITLE_PX).into_text_style(&strip);
    strip.draw_text(title, &style, (INDENT_PX, 6))?;
    for (entry, (x, line)) in entries.iter().zip(places) {
        entry.draw(&strip, (x, 6 + LINE_PX * line + LINE_PX / 2 - 2))?;
    }
    Ok(rest)
}

/// Draws the entries one below the other, each with its note.
///
/// # Errors
/// Any error of the backend.
pub fn column(area: &Area<'_>, entries: &[LegendEntry]) -> DrawResult {
    let mut y = LINE_PX;
    for entry in entries {
        entry.draw(area, (4, y))?;
        if !entry.note.is_empty() {
            y += NOTE_PX + 5;
            let style = ("sans-serif", NOTE_PX)
                .into_text_style(area)
                .color(&RGBColor(90, 90, 90));
            area.draw_text(&entry.note, &style, (4 + SIGN_PX + 6, y - NOTE_PX / 2))?;
        }
        y += LINE_PX;
    }
    Ok(())
}
