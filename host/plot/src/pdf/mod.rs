//! Figures as PDF for print: the shapes that plotters draws, as vectors, and their texts as text.
//!
//! Texts are in Helvetica, Symbol and ZapfDingbats, which every viewer has, so no font is embedded.

mod text;

use std::collections::BTreeSet;

use pdf_writer::writers::ExtGraphicsState;
use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref};
use roxmltree::{Document, Node};

use self::text::Words;

/// Points per pixel: a pixel is 1/96 inch, a point 1/72.
const POINTS_PER_PIXEL: f32 = 0.75;

/// Distance of a Bézier curve's control points that make a quarter of a circle, in radii.
const QUARTER: f32 = 0.552_285;

/// Error of a drawing that is none of plotters'.
#[derive(Debug, thiserror::Error)]
pub enum PdfError {
    /// Text that is no SVG.
    #[error("the drawing is no SVG: {0}")]
    Svg(#[from] roxmltree::Error),
    /// Element or attribute that plotters does not write.
    #[error("the drawing has {0}, which the PDF cannot show")]
    Unknown(String),
}

/// Converts a figure.
///
/// # Errors
/// [`PdfError`] if the text is not a drawing of plotters.
pub fn of_svg(svg: &str) -> Result<Vec<u8>, PdfError> {
    let document = Document::parse(svg)?;
    let root = document.root_element();
    let (width, height) = (number(&root, "width")?, number(&root, "height")?);
    let shapes: Vec<Node<'_, '_>> = root.children().filter(Node::is_element).collect();
    let opacities: BTreeSet<u16> = shapes.iter().map(permille).collect();

    let mut content = Content::new();
    // Pixels from the top, as in SVG.
    content.transform([
        POINTS_PER_PIXEL,
        0.0,
        0.0,
        -POINTS_PER_PIXEL,
        0.0,
        height * POINTS_PER_PIXEL,
    ]);
    content.set_line_join(pdf_writer::types::LineJoinStyle::RoundJoin);
    for shape in &shapes {
        content.set_parameters(Name(opacity_name(permille(shape)).as_bytes()));
        draw(&mut content, shape)?;
    }

    let [catalog, pages, page, stream] = [1, 2, 3, 4].map(Ref::new);
    let mut pdf = Pdf::new();
    pdf.catalog(catalog).pages(pages);
    pdf.pages(pages).kids([page]).count(1);
    let mut sheet = pdf.page(page);
    let size = Rect::new(
        0.0,
        0.0,
        width * POINTS_PER_PIXEL,
        height * POINTS_PER_PIXEL,
    );
    sheet.media_box(size).parent(pages).contents(stream);
    let mut resources = sheet.resources();
    text::fonts(&mut resources);
    let mut states = resources.ext_g_states();
    for permille in opacities {
        let share = f32::from(permille) * 1e-3;
        let mut state = states
            .insert(Name(opacity_name(permille).as_bytes()))
            .start::<ExtGraphicsState<'_>>();
        state.stroking_alpha(share).non_stroking_alpha(share);
    }
    states.finish();
    resources.finish();
    sheet.finish();
    pdf.stream(stream, &content.finish());
    Ok(pdf.finish())
}

fn draw(content: &mut Content, shape: &Node<'_, '_>) -> Result<(), PdfError> {
    let of = |name| number(shape, name);
    match shape.tag_name().name() {
        "rect" => {
            content.rect(of("x")?, of("y")?, of("width")?, of("height")?);
        }
        "line" => {
            content.move_to(of("x1")?, of("y1")?);
            content.line_to(of("x2")?, of("y2")?);
        }
        "polyline" | "polygon" => {
            for (k, (x, y)) in points(shape)?.into_iter().enumerate() {
                match k {
                    0 => content.move_to(x, y),
                    _ => content.line_to(x, y),
                };
            }
        }
        "circle" => circle(content, (of("cx")?, of("cy")?), of("r")?),
        "text" => {
            Words::of(shape)?.write(content);
            return Ok(());
        }
        other => return Err(PdfError::Unknown(format!("an element <{other}>"))),
    }
    let (stroke, fill) = (colour(shape, "stroke")?, colour(shape, "fill")?);
    if let Some([r, g, b]) = stroke {
        let width = shape
            .attribute("stroke-width")
            .map_or(Ok(1.0), |_| of("stroke-width"))?;
        content.set_stroke_rgb(r, g, b).set_line_width(width);
    }
    if let Some([r, g, b]) = fill {
        content.set_fill_rgb(r, g, b);
    }
    match (stroke.is_some(), fill.is_some()) {
        (true, true) => content.fill_nonzero_and_stroke(),
        (true, false) => content.stroke(),
        (false, true) => content.fill_nonzero(),
        (false, false) => content.end_path(),
    };
    Ok(())
}

fn circle(content: &mut Content, (x, y): (f32, f32), r: f32) {
    let q = QUARTER * r;
    content.move_to(x + r, y);
    content.cubic_to(x + r, y + q, x + q, y + r, x, y + r);
    content.cubic_to(x - q, y + r, x - r, y + q, x - r, y);
    content.cubic_to(x - r, y - q, x - q, y - r, x, y - r);
    content.cubic_to(x + q, y - r, x + r, y - q, x + r, y);
}

fn unreadable(shape: &Node<'_, '_>, attribute: &str) -> PdfError {
    let value = shape.attribute(attribute).unwrap_or("none");
    PdfError::Unknown(format!("{attribute}=\"{value}\""))
}

fn number(shape: &Node<'_, '_>, attribute: &str) -> Result<f32, PdfError> {
    let value = shape
        .attribute(attribute)
        .and_then(|text| text.parse().ok());
    value.ok_or_else(|| unreadable(shape, attribute))
}

fn points(shape: &Node<'_, '_>) -> Result<Vec<(f32, f32)>, PdfError> {
    let pair = |pair: &str| {
        let (x, y) = pair.split_once(',')?;
        Some((x.parse().ok()?, y.parse().ok()?))
    };
    let all = shape.attribute("points").unwrap_or_default();
    let points: Option<Vec<_>> = all.split_whitespace().map(pair).collect();
    points.ok_or_else(|| unreadable(shape, "points"))
}

/// Red, green and blue from 0 to 1 of `#1F77B4`; `None` for no paint.
fn colour(shape: &Node<'_, '_>, attribute: &str) -> Result<Option<[f32; 3]>, PdfError> {
    let text = match shape.attribute(attribute) {
        None | Some("none") => return Ok(None),
        Some(text) => text,
    };
    let code = text.strip_prefix('#').filter(|code| code.len() == 6);
    let code = code.and_then(|code| u32::from_str_radix(code, 16).ok());
    let code = code.ok_or_else(|| unreadable(shape, attribute))?;
    let [_, r, g, b] = code.to_be_bytes();
    Ok(Some([r, g, b].map(|x| f32::from(x) / 255.0)))
}

/// Opacity in thousandths.
fn permille(shape: &Node<'_, '_>) -> u16 {
    let share: Option<f32> = shape
        .attribute("opacity")
        .and_then(|text| text.parse().ok());
    (share.unwrap_or(1.0).clamp(0.0, 1.0) * 1e3).round() as u16
}

fn opacity_name(permille: u16) -> String {
    format!("O{permille}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const DRAWING: &str = r##"<svg width="200" height="100" viewBox="0 0 200 100" xmlns="http://www.w3.org/2000/svg">
<rect x="0" y="0" width="200" height="100" opacity="1" fill="#FFFFFF" stroke="none"/>
<polyline fill="none" opacity="0.25" stroke="#1F77B4" stroke-width="2" points="1,2 3,4 5,7 "/>
<circle cx="50" cy="60" r="4" opacity="1" fill="#000000" stroke="none" stroke-width="1"/>
<text x="10" y="20" dy="0.76em" text-anchor="middle" font-family="sans-serif" font-size="10" opacity="1" fill="#000000">
R / Ω (a)
</text>
</svg>"##;

    fn page(svg: &str) -> String {
        String::from_utf8_lossy(&of_svg(svg).unwrap()).into_owned()
    }

    #[test]
    fn shapes_keep_their_places_colours_and_opacities() {
        let page = page(DRAWING);
        assert!(page.starts_with("%PDF-1.") && page.trim_end().ends_with("%%EOF"));
        // 200 by 100 pixels are 150 by 75 points.
        assert!(page.contains("[0 0 150 75]"), "{page}");
        assert!(page.contains("0.75 0 0 -0.75 0 75 cm"));
        assert!(
            page.contains("1 2 m\n3 4 l\n5 7 l\n0.12156863 0.46666667 0.7058824 RG\n2 w\nS"),
            "{page}"
        );
        assert!(page.contains("/O250 gs") && page.contains("/CA 0.25"));
        assert_eq!(page.matches(" c\n").count(), 4, "a circle of four curves");
    }

    #[test]
    fn what_the_pdf_cannot_show_is_an_error() {
        let with = |element: &str| DRAWING.replace("<circle", element);
        let image = of_svg(&with("<image")).unwrap_err().to_string();
        assert_eq!(
            image,
            "the drawing has an element <image>, which the PDF cannot show"
        );
        let red = of_svg(&DRAWING.replace("#1F77B4", "red")).unwrap_err();
        assert!(red.to_string().contains("stroke=\"red\""), "{red}");
        assert!(matches!(of_svg("no svg"), Err(PdfError::Svg(_))));
    }
}
