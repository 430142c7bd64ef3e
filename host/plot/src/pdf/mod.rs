//! Figures as PDF for print: the shapes that plotters draws, as vectors, and their texts as text.
//!
//! Texts are in Helvetica, Symbol and ZapfDingbats, which every viewer has, so no font is embedded.

mod text;

use std::collections::BTreeSet;

use pdf_writer::writers::ExtGraphicsState;
use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref};

use crate::drawing::{Drawing, Mark, Outline, PathStep};

/// Points per pixel: a pixel is 1/96 inch, a point 1/72.
const POINTS_PER_PIXEL: f32 = 0.75;

/// Encodes a figure as a PDF file.
pub(crate) fn encode(drawing: &Drawing) -> Vec<u8> {
    let (width, height) = drawing.size;
    let opacities: BTreeSet<u16> = drawing.marks.iter().map(permille).collect();

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
    for mark in &drawing.marks {
        content.set_parameters(Name(opacity_name(permille(mark)).as_bytes()));
        match mark {
            Mark::Outline(outline) => draw(&mut content, outline),
            Mark::Words(words) => text::write(&mut content, words),
        }
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
    pdf.finish()
}

fn draw(content: &mut Content, outline: &Outline) {
    for step in &outline.steps {
        match *step {
            PathStep::Move((x, y)) => content.move_to(x, y),
            PathStep::Line((x, y)) => content.line_to(x, y),
            PathStep::Curve((ax, ay), (bx, by), (x, y)) => content.cubic_to(ax, ay, bx, by, x, y),
            PathStep::Close => content.close_path(),
        };
    }
    if let Some(([r, g, b], width)) = outline.stroke {
        content.set_stroke_rgb(r, g, b).set_line_width(width);
    }
    if let Some([r, g, b]) = outline.fill {
        content.set_fill_rgb(r, g, b);
    }
    match (outline.stroke.is_some(), outline.fill.is_some()) {
        (true, true) => content.fill_nonzero_and_stroke(),
        (true, false) => content.stroke(),
        (false, true) => content.fill_nonzero(),
        (false, false) => content.end_path(),
    };
}

/// Opacity in thousandths.
fn permille(mark: &Mark) -> u16 {
    (mark.opacity() * 1e3).round() as u16
}

fn opacity_name(permille: u16) -> String {
    format!("O{permille}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::tests::DRAWING;

    #[test]
    fn shapes_keep_their_places_colours_and_opacities() {
        let page = encode(&Drawing::parse(DRAWING).unwrap());
        let page = String::from_utf8_lossy(&page);
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
}
