//! Outlines of texts: DejaVu Sans, of which figures.ttf has the characters that figures have.

use std::sync::LazyLock;

use ttf_parser::{Face, OutlineBuilder};
use zeno::{Command, Vector};

use super::SCALE;
use crate::drawing::Words;

/// Font of the figures' texts (fonts-dejavu-core 2.37 of Debian, cut down by fontTools).
static FILE: &[u8] = include_bytes!("figures.ttf");

static FACE: LazyLock<Option<Face<'_>>> = LazyLock::new(|| Face::parse(FILE, 0).ok());

/// Width of the line that makes a text bold, in its sizes.
pub(super) const BOLD: f32 = 0.03;

/// Returns the outline of a text in pixels.
pub(super) fn outline(words: &Words) -> Vec<Command> {
    let Some(face) = LazyLock::force(&FACE) else {
        return Vec::new();
    };
    let unit = words.size / f32::from(face.units_per_em());
    let glyphs = words.text.chars().map(|c| {
        let glyph = face.glyph_index(c).or_else(|| face.glyph_index('?'));
        glyph.unwrap_or_default()
    });
    let glyphs: Vec<_> = glyphs.collect();
    let advance = |glyph| unit * f32::from(face.glyph_hor_advance(glyph).unwrap_or_default());
    let width: f32 = glyphs.iter().map(|glyph| advance(*glyph)).sum();
    let ((sin, cos), (x, y)) = (words.turn, words.start(width));
    let mut pen = Pen {
        unit: unit * SCALE,
        turn: (sin, cos),
        at: Vector::new(x * SCALE, y * SCALE),
        path: Vec::new(),
    };
    for glyph in glyphs {
        face.outline_glyph(glyph, &mut pen);
        let step = advance(glyph) * SCALE;
        pen.at = Vector::new(pen.at.x + step * cos, pen.at.y + step * sin);
    }
    pen.path
}

/// Path of the glyphs so far.
struct Pen {
    /// Pixels of one unit of the font.
    unit: f32,
    /// Sine and cosine of the rotation, clockwise.
    turn: (f32, f32),
    /// Left end of the glyph's baseline, in pixels.
    at: Vector,
    path: Vec<Command>,
}

impl Pen {
    /// Place of a point of the font, whose y runs upwards.
    fn place(&self, x: f32, y: f32) -> Vector {
        let ((sin, cos), (x, y)) = (self.turn, (x * self.unit, -y * self.unit));
        Vector::new(self.at.x + x * cos - y * sin, self.at.y + x * sin + y * cos)
    }
}

impl OutlineBuilder for Pen {
    fn move_to(&mut self, x: f32, y: f32) {
        self.path.push(Command::MoveTo(self.place(x, y)));
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.path.push(Command::LineTo(self.place(x, y)));
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let step = Command::QuadTo(self.place(x1, y1), self.place(x, y));
        self.path.push(step);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let control = (self.place(x1, y1), self.place(x2, y2));
        let step = Command::CurveTo(control.0, control.1, self.place(x, y));
        self.path.push(step);
    }

    fn close(&mut self) {
        self.path.push(Command::Close);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::{Drawing, Mark};

    /// Left, right, top and bottom of a text's outline in the drawing's pixels.
    fn extent(text: &str, more: &str) -> [f32; 4] {
        let svg = format!(
            r##"<svg width="200" height="100"><text x="100" y="50" font-size="10" fill="#000000" {more}>{text}</text></svg>"##
        );
        let drawing = Drawing::parse(&svg).unwrap();
        let [Mark::Words(words)] = &drawing.marks[..] else {
            panic!("one text");
        };
        let points = outline(words).into_iter().filter_map(|step| match step {
            Command::MoveTo(to) | Command::LineTo(to) => Some(to),
            _ => None,
        });
        let start = [f32::MAX, f32::MIN, f32::MAX, f32::MIN];
        points.fold(start, |[left, right, top, bottom], at| {
            let (x, y) = (at.x / SCALE, at.y / SCALE);
            [left.min(x), right.max(x), top.min(y), bottom.max(y)]
        })
    }

    /// DejaVu's H is .752 sizes wide with .098 of space on either side, and .729 high.
    #[test]
    fn texts_are_anchored_by_their_width_along_their_own_direction() {
        let near = |have: [f32; 4], want: [f32; 4]| {
            let close = have.iter().zip(want).all(|(a, b)| (a - b).abs() < 0.02);
            assert!(close, "{have:?} {want:?}");
        };
        near(extent("H", ""), [100.98, 106.54, 42.71, 50.0]);
        let middle = extent("H", "text-anchor=\"middle\"");
        near(middle, [97.22, 102.78, 42.71, 50.0]);
        let upwards = "text-anchor=\"middle\" transform=\"rotate(270, 100, 50)\"";
        near(extent("H", upwards), [92.71, 100.0, 47.22, 52.78]);
    }

    #[test]
    fn every_character_of_the_figures_has_a_shape_of_its_own() {
        let face = LazyLock::force(&FACE).as_ref().unwrap();
        for c in "RL0Ωµμσ±²³·×–−√≤≥→▲▼⁰⁴⁵⁶⁷⁸⁹⁻Δθφω°½".chars()
        {
            assert!(face.glyph_index(c).is_some(), "{c}");
        }
        assert!(face.glyph_index('漢').is_none(), "shown as a question mark");
    }
}
