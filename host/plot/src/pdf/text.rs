//! Texts in fonts that every viewer of PDF has: Helvetica, Symbol for Greek letters and signs, ZapfDingbats for arrows.

use pdf_writer::types::TextRenderingMode;
use pdf_writer::writers::{Resources, Type1Font};
use pdf_writer::{Content, Finish, Name, Str};

use crate::drawing::Words;

/// Width in thousandths of the size of Helvetica's characters from the space to the tilde (Adobe's font metrics).
const HELVETICA: [u16; 95] = [
    278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556,
    556, 556, 556, 556, 556, 556, 556, 278, 278, 584, 584, 584, 556, 1015, 667, 667, 722, 722, 667,
    611, 778, 722, 278, 500, 667, 556, 833, 722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667,
    667, 611, 278, 278, 278, 469, 556, 333, 556, 556, 500, 556, 556, 278, 556, 556, 222, 222, 500,
    222, 833, 556, 556, 556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334, 260, 334, 584,
];

/// Characters of Helvetica beyond ASCII in figures, with code in WinAnsiEncoding and width.
const WESTERN: [(char, u8, u16); 14] = [
    ('\u{a0}', 0xa0, 278),
    ('°', 0xb0, 400),
    ('±', 0xb1, 584),
    ('²', 0xb2, 333),
    ('³', 0xb3, 333),
    ('µ', 0xb5, 556),
    ('·', 0xb7, 278),
    ('¼', 0xbc, 834),
    ('½', 0xbd, 834),
    ('¾', 0xbe, 834),
    ('×', 0xd7, 584),
    ('–', 0x96, 556),
    ('—', 0x97, 1000),
    ('…', 0x85, 1000),
];

/// Characters of Symbol in figures, with code and width.
const SYMBOLS: [(char, u8, u16); 24] = [
    ('Ω', 0x57, 768),
    ('Δ', 0x44, 612),
    ('Σ', 0x53, 592),
    ('Φ', 0x46, 763),
    ('α', 0x61, 631),
    ('β', 0x62, 549),
    ('δ', 0x64, 494),
    ('ε', 0x65, 439),
    ('θ', 0x71, 521),
    ('λ', 0x6c, 549),
    ('μ', 0x6d, 576),
    ('π', 0x70, 549),
    ('ρ', 0x72, 549),
    ('σ', 0x73, 603),
    ('τ', 0x74, 439),
    ('φ', 0x66, 521),
    ('χ', 0x63, 549),
    ('ψ', 0x79, 686),
    ('ω', 0x77, 686),
    ('−', 0x2d, 549),
    ('√', 0xd6, 549),
    ('≤', 0xa3, 549),
    ('≥', 0xb3, 549),
    ('→', 0xae, 987),
];

/// Arrows at a frame's edge in ZapfDingbats, with code and width.
const ARROWS: [(char, u8, u16); 2] = [('▲', 0x73, 892), ('▼', 0x74, 892)];

/// Digits above the line that Helvetica lacks, by their code.
const EXPONENTS: [(char, u8); 8] = [
    ('⁰', b'0'),
    ('⁴', b'4'),
    ('⁵', b'5'),
    ('⁶', b'6'),
    ('⁷', b'7'),
    ('⁸', b'8'),
    ('⁹', b'9'),
    ('⁻', b'-'),
];

/// Font of a character.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Font {
    Helvetica,
    Symbol,
    Dingbats,
    /// Small Helvetica above the line, for exponents.
    Raised,
}

impl Font {
    fn name(self) -> Name<'static> {
        match self {
            Self::Helvetica | Self::Raised => Name(b"H"),
            Self::Symbol => Name(b"S"),
            Self::Dingbats => Name(b"D"),
        }
    }

    /// Size and rise above the line, in sizes of the text.
    fn size_and_rise(self) -> (f32, f32) {
        match self {
            Self::Helvetica | Self::Symbol | Self::Dingbats => (1.0, 0.0),
            Self::Raised => (0.6, 0.4),
        }
    }
}

/// Lists the fonts among the resources of a page.
pub(super) fn fonts(resources: &mut Resources<'_>) {
    let mut fonts = resources.fonts();
    let helvetica = fonts.insert(Font::Helvetica.name());
    let mut helvetica = helvetica.start::<Type1Font<'_>>();
    helvetica.base_font(Name(b"Helvetica"));
    helvetica.encoding_predefined(Name(b"WinAnsiEncoding"));
    helvetica.finish();
    // These two have an encoding of their own.
    for (font, name) in [(Font::Symbol, "Symbol"), (Font::Dingbats, "ZapfDingbats")] {
        let font = fonts.insert(font.name());
        font.start::<Type1Font<'_>>()
            .base_font(Name(name.as_bytes()));
    }
}

/// Font, code and width of a character; a question mark for one that no font has.
fn glyph(c: char) -> (Font, u8, u16) {
    let ascii = |c: char| {
        let code = u8::try_from(c).ok()?;
        let width = *HELVETICA.get(usize::from(code.checked_sub(b' ')?))?;
        Some((Font::Helvetica, code, width))
    };
    let listed = |list: &[(char, u8, u16)], font| {
        let known = list.iter().find(|(known, ..)| *known == c);
        known.map(|(_, code, width)| (font, *code, *width))
    };
    let exponent = EXPONENTS.iter().find(|(known, _)| *known == c);
    let raised = exponent.and_then(|(_, code)| {
        let (_, code, width) = ascii(char::from(*code))?;
        Some((Font::Raised, code, width))
    });
    let found = ascii(c)
        .or(raised)
        .or_else(|| listed(&WESTERN, Font::Helvetica))
        .or_else(|| listed(&SYMBOLS, Font::Symbol))
        .or_else(|| listed(&ARROWS, Font::Dingbats));
    found.unwrap_or((Font::Helvetica, b'?', 556))
}

/// Writes a text; later runs go on where the one before ended.
pub(super) fn write(content: &mut Content, words: &Words) {
    let size = words.size;
    let mut runs: Vec<(Font, Vec<u8>)> = Vec::new();
    let mut width = 0.0;
    for c in words.text.chars() {
        let (font, code, thousandths) = glyph(c);
        width += f32::from(thousandths) * 1e-3 * size * font.size_and_rise().0;
        match runs.last_mut() {
            Some((last, codes)) if *last == font => codes.push(code),
            _ => runs.push((font, vec![code])),
        }
    }
    let [r, g, b] = words.colour;
    let ((sin, cos), (x, y)) = (words.turn, words.start(width));
    content.begin_text().set_fill_rgb(r, g, b);
    if words.is_bold {
        content.set_stroke_rgb(r, g, b).set_line_width(0.03 * size);
        content.set_text_rendering_mode(TextRenderingMode::FillStroke);
    }
    // The page's y runs downwards, a text's upwards.
    content.set_text_matrix([cos, sin, sin, -cos, x, y]);
    for (font, codes) in &runs {
        let (share, rise) = font.size_and_rise();
        content.set_font(font.name(), share * size);
        content.set_rise(rise * size);
        content.show(Str(codes));
    }
    content.set_rise(0.0);
    if words.is_bold {
        content.set_text_rendering_mode(TextRenderingMode::Fill);
    }
    content.end_text();
}

#[cfg(test)]
mod tests {
    use super::super::encode;
    use crate::drawing::Drawing;

    fn page(text: &str, more: &str) -> String {
        let svg = format!(
            r##"<svg width="200" height="100"><text x="100" y="50" font-size="10" fill="#000000" {more}>{text}</text></svg>"##
        );
        String::from_utf8_lossy(&encode(&Drawing::parse(&svg).unwrap())).into_owned()
    }

    #[test]
    fn greek_letters_and_exponents_are_of_other_fonts_and_the_text_goes_on() {
        let page = page("R / Ω at 10⁴ Hz", "");
        let runs = [
            "/H 10 Tf\n0 Ts\n(R / ) Tj",
            "/S 10 Tf\n0 Ts\n(W) Tj",
            "/H 10 Tf\n0 Ts\n( at 10) Tj",
            "/H 6 Tf\n4 Ts\n(4) Tj",
            "/H 10 Tf\n0 Ts\n( Hz) Tj",
        ];
        assert!(page.contains(&runs.join("\n")), "{page}");
        assert!(page.contains("/BaseFont /Symbol") && page.contains("/WinAnsiEncoding"));
    }

    /// "HH" is 1.444 sizes wide by Adobe's metrics: centred it begins .722 sizes to the left, at its end 1.444.
    #[test]
    fn texts_are_anchored_by_their_width_along_their_own_direction() {
        assert!(page("HH", "text-anchor=\"middle\"").contains("1 0 0 -1 92.78 50 Tm"));
        assert!(page("HH", "text-anchor=\"end\"").contains("1 0 0 -1 85.56 50 Tm"));
        let upwards = page(
            "HH",
            "text-anchor=\"end\" transform=\"rotate(270, 100, 50)\"",
        );
        assert!(
            upwards.contains("0 -1 -1 0 100 64.44 Tm")
                || upwards.contains("0 -1 -1 -0 100 64.44 Tm"),
            "{upwards}"
        );
    }

    #[test]
    fn arrows_at_the_frame_are_of_a_third_font() {
        let page = page("▲▼ goes on", "");
        assert!(page.contains("/D 10 Tf"), "{page}");
        assert!(page.contains("(st) Tj"), "{page}");
    }

    #[test]
    fn a_character_that_no_font_has_is_a_question_mark() {
        assert!(page("漢", "").contains("(?) Tj"));
    }
}
