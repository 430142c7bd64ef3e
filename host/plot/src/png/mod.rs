//! Figures as PNG for a screen: the shapes that plotters draws, two pixels for each of its own.

mod font;

use zeno::{Command, Join, Mask, Stroke, Style, Vector};

use crate::drawing::{Colour, Drawing, DrawingError, Mark, Outline, PathStep, Pixels, Words};

/// Pixels for one of the drawing's, which is 1/96 inch.
const SCALE: f32 = 2.0;

/// Pixels per metre: 192 to the inch.
const PER_METRE: u32 = 7559;

/// Encodes a figure as a PNG file.
///
/// # Errors
/// [`DrawingError::Pixels`] if the figure has no pixels or more than PNG can have.
pub(crate) fn encode(drawing: &Drawing) -> Result<Vec<u8>, DrawingError> {
    let mut raster = Raster::new(drawing.size);
    for mark in &drawing.marks {
        match mark {
            Mark::Outline(outline) => raster.draw(outline),
            Mark::Words(words) => raster.write(words),
        }
    }
    raster.encode()
}

/// Pixels of a figure on white.
struct Raster {
    width: u32,
    height: u32,
    /// Red, green, blue of each, row after row.
    pixels: Vec<[u8; 3]>,
}

impl Raster {
    fn new((width, height): Pixels) -> Self {
        let [width, height] = [width, height].map(|side| (side * SCALE).round() as u32);
        let count = width as usize * height as usize;
        Self {
            width,
            height,
            pixels: vec![[u8::MAX; 3]; count],
        }
    }

    fn draw(&mut self, outline: &Outline) {
        let path: Vec<Command> = outline.steps.iter().map(|step| command(*step)).collect();
        if let Some(colour) = outline.fill {
            self.paint(&path, zeno::Fill::NonZero, colour, outline.opacity);
        }
        if let Some((colour, width)) = outline.stroke {
            let mut stroke = Stroke::new(width * SCALE);
            stroke.join(Join::Round);
            self.paint(&path, stroke, colour, outline.opacity);
        }
    }

    fn write(&mut self, words: &Words) {
        let path = font::outline(words);
        self.paint(&path, zeno::Fill::NonZero, words.colour, words.opacity);
        if words.is_bold {
            let stroke = Stroke::new(font::BOLD * words.size * SCALE);
            self.paint(&path, stroke, words.colour, words.opacity);
        }
    }

    /// Mixes a colour into the pixels by the share of each that the path covers.
    fn paint<'a>(
        &mut self,
        path: &[Command],
        style: impl Into<Style<'a>>,
        colour: Colour,
        opacity: f32,
    ) {
        let (cover, place) = Mask::new(path).style(style).render();
        if place.width == 0 {
            return;
        }
        for (row, y) in cover.chunks_exact(place.width as usize).zip(place.top..) {
            let inked = row
                .iter()
                .zip(place.left..)
                .filter(|(cover, _)| **cover > 0);
            for (cover, x) in inked {
                let share = f32::from(*cover) / 255.0 * opacity;
                let Some(pixel) = self.pixel(x, y) else {
                    continue;
                };
                for (old, new) in pixel.iter_mut().zip(colour) {
                    *old = ((1.0 - share) * f32::from(*old) + share * 255.0 * new).round() as u8;
                }
            }
        }
    }

    /// Pixel at a place; `None` outside.
    fn pixel(&mut self, x: i32, y: i32) -> Option<&mut [u8; 3]> {
        let (x, y) = (u32::try_from(x).ok()?, u32::try_from(y).ok()?);
        let inside = x < self.width && y < self.height;
        let index = y as usize * self.width as usize + x as usize;
        self.pixels.get_mut(index).filter(|_| inside)
    }

    fn encode(&self) -> Result<Vec<u8>, DrawingError> {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.width, self.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_pixel_dims(Some(png::PixelDimensions {
            xppu: PER_METRE,
            yppu: PER_METRE,
            unit: png::Unit::Meter,
        }));
        let mut writer = encoder.write_header()?;
        writer.write_image_data(self.pixels.as_flattened())?;
        writer.finish()?;
        Ok(file)
    }
}

fn scaled((x, y): Pixels) -> Vector {
    Vector::new(x * SCALE, y * SCALE)
}

fn command(step: PathStep) -> Command {
    match step {
        PathStep::Move(to) => Command::MoveTo(scaled(to)),
        PathStep::Line(to) => Command::LineTo(scaled(to)),
        PathStep::Curve(a, b, to) => Command::CurveTo(scaled(a), scaled(b), scaled(to)),
        PathStep::Close => Command::Close,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::tests::DRAWING;

    /// Size and pixels of a file.
    fn decoded(file: &[u8]) -> (u32, u32, Vec<u8>) {
        let mut reader = png::Decoder::new(std::io::Cursor::new(file))
            .read_info()
            .unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        (info.width, info.height, pixels)
    }

    #[test]
    fn shapes_and_texts_are_where_the_drawing_has_them() {
        let (width, height, pixels) = decoded(&encode(&Drawing::parse(DRAWING).unwrap()).unwrap());
        assert_eq!((width, height), (400, 200));
        let at = |x: u32, y: u32| {
            let first = 3 * (y * width + x) as usize;
            <[u8; 3]>::try_from(&pixels[first..first + 3]).unwrap()
        };
        assert_eq!(at(399, 199), [255; 3], "the ground");
        assert_eq!(at(100, 120), [0; 3], "the circle's centre");
        // A quarter of #1F77B4 on white, in the middle of a line of two pixels' width.
        assert_eq!(at(4, 6), [199, 221, 236]);
        // The text's baseline is at 20 + 7.6, of capitals .729 high and brackets .13 deep, in sizes of 10.
        let dark = |x: u32, y: u32| at(x, y).iter().all(|part| *part < 64);
        let ink = (0..100).flat_map(|y| (0..width).map(move |x| (x, y)));
        let (columns, rows): (Vec<_>, Vec<_>) = ink.filter(|(x, y)| dark(*x, *y)).unzip();
        assert!(rows.iter().all(|y| (39..=58).contains(y)), "{rows:?}");
        assert!(columns.iter().max().is_some_and(|x| (50..70).contains(x)));
    }

    #[test]
    fn a_figure_without_pixels_is_an_error() {
        let empty = Drawing::parse(&DRAWING.replacen("200", "0", 1)).unwrap();
        assert!(matches!(encode(&empty), Err(DrawingError::Pixels(_))));
    }
}
