//! Shapes and texts of a figure as plotters writes it: what PDF and PNG are made of.

use roxmltree::{Document, Node};

/// Height of an x in sizes of the text.
const EX: f32 = 0.52;

/// Distance of a Bézier curve's control points that make a quarter of a circle, in radii.
const QUARTER: f32 = 0.552_285;

/// Error of a drawing that is none of plotters'.
#[derive(Debug, thiserror::Error)]
pub enum DrawingError {
    /// Text that is no SVG.
    #[error("the drawing is no SVG: {0}")]
    Svg(#[from] roxmltree::Error),
    /// Element or attribute that plotters does not write.
    #[error("the drawing has {0}, which only SVG can show")]
    Unknown(String),
    /// Pixels that cannot be written.
    #[error("the pixels cannot be written: {0}")]
    Pixels(#[from] png::EncodingError),
}

/// Place in pixels, x to the right and y downwards.
pub(crate) type Pixels = (f32, f32);

/// Red, green and blue from 0 to 1.
pub(crate) type Colour = [f32; 3];

/// Figure: size in pixels, and its marks from the lowest to the highest.
pub(crate) struct Drawing {
    pub(crate) size: Pixels,
    pub(crate) marks: Vec<Mark>,
}

/// Outline or text.
pub(crate) enum Mark {
    Outline(Outline),
    Words(Words),
}

/// Path with its paint.
pub(crate) struct Outline {
    pub(crate) steps: Vec<PathStep>,
    /// Colour and width in pixels.
    pub(crate) stroke: Option<(Colour, f32)>,
    pub(crate) fill: Option<Colour>,
    /// From 0 to 1.
    pub(crate) opacity: f32,
}

/// Part of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum PathStep {
    Move(Pixels),
    Line(Pixels),
    /// Two control points and the end of a Bézier curve.
    Curve(Pixels, Pixels, Pixels),
    Close,
}

/// Text with its place.
pub(crate) struct Words {
    pub(crate) text: String,
    /// Size in pixels.
    pub(crate) size: f32,
    pub(crate) colour: Colour,
    /// From 0 to 1.
    pub(crate) opacity: f32,
    pub(crate) is_bold: bool,
    /// Sine and cosine of the rotation, clockwise.
    pub(crate) turn: (f32, f32),
    at: Pixels,
    /// Share of the width that lies before the place.
    before: f32,
    /// Distance of the baseline below the place.
    below: f32,
}

impl Drawing {
    /// Parses a figure.
    pub(crate) fn parse(svg: &str) -> Result<Self, DrawingError> {
        let document = Document::parse(svg)?;
        let root = document.root_element();
        let elements = root.children().filter(Node::is_element);
        Ok(Self {
            size: (number(&root, "width")?, number(&root, "height")?),
            marks: elements
                .map(|shape| Mark::from_node(&shape))
                .collect::<Result<_, _>>()?,
        })
    }
}

impl Mark {
    fn from_node(shape: &Node<'_, '_>) -> Result<Self, DrawingError> {
        let of = |name| number(shape, name);
        let steps = match shape.tag_name().name() {
            "rect" => {
                let (x, y) = (of("x")?, of("y")?);
                let (right, bottom) = (x + of("width")?, y + of("height")?);
                let corners = [(x, y), (right, y), (right, bottom), (x, bottom)];
                connected(corners).chain([PathStep::Close]).collect()
            }
            "line" => connected([(of("x1")?, of("y1")?), (of("x2")?, of("y2")?)]).collect(),
            "polyline" => connected(points(shape)?).collect(),
            "polygon" => connected(points(shape)?).chain([PathStep::Close]).collect(),
            "circle" => circle((of("cx")?, of("cy")?), of("r")?),
            "text" => return Words::from_node(shape).map(Self::Words),
            other => return Err(DrawingError::Unknown(format!("an element <{other}>"))),
        };
        let width = match shape.attribute("stroke-width") {
            None => 1.0,
            Some(_) => of("stroke-width")?,
        };
        Ok(Self::Outline(Outline {
            steps,
            stroke: colour(shape, "stroke")?.map(|colour| (colour, width)),
            fill: colour(shape, "fill")?,
            opacity: opacity(shape),
        }))
    }

    /// Opacity from 0 to 1.
    pub(crate) fn opacity(&self) -> f32 {
        match self {
            Self::Outline(outline) => outline.opacity,
            Self::Words(words) => words.opacity,
        }
    }
}

impl Words {
    fn from_node(shape: &Node<'_, '_>) -> Result<Self, DrawingError> {
        let size = number(shape, "font-size")?;
        let before = match shape.attribute("text-anchor") {
            None | Some("start") => 0.0,
            Some("middle") => 0.5,
            Some("end") => 1.0,
            Some(_) => return Err(unreadable(shape, "text-anchor")),
        };
        Ok(Self {
            text: shape.text().unwrap_or_default().trim().to_owned(),
            size,
            colour: colour(shape, "fill")?.unwrap_or_default(),
            opacity: opacity(shape),
            is_bold: shape.attribute("font-weight") == Some("bold"),
            turn: turn(shape)?,
            at: (number(shape, "x")?, number(shape, "y")?),
            before,
            below: below(shape, size)?,
        })
    }

    /// Returns the left end of the baseline of a text of this width in pixels.
    pub(crate) fn start(&self, width: f32) -> Pixels {
        let ((sin, cos), (x, y)) = (self.turn, self.at);
        let back = self.before * width;
        (
            x - back * cos - self.below * sin,
            y - back * sin + self.below * cos,
        )
    }
}

fn connected(points: impl IntoIterator<Item = Pixels>) -> impl Iterator<Item = PathStep> {
    let mut points = points.into_iter();
    let first = points.next().map(PathStep::Move);
    first.into_iter().chain(points.map(PathStep::Line))
}

fn circle((x, y): Pixels, r: f32) -> Vec<PathStep> {
    let q = QUARTER * r;
    let quarter = |a, b, end| PathStep::Curve(a, b, end);
    vec![
        PathStep::Move((x + r, y)),
        quarter((x + r, y + q), (x + q, y + r), (x, y + r)),
        quarter((x - q, y + r), (x - r, y + q), (x - r, y)),
        quarter((x - r, y - q), (x - q, y - r), (x, y - r)),
        quarter((x + q, y - r), (x + r, y - q), (x + r, y)),
    ]
}

fn unreadable(shape: &Node<'_, '_>, attribute: &str) -> DrawingError {
    let value = shape.attribute(attribute).unwrap_or("none");
    DrawingError::Unknown(format!("{attribute}=\"{value}\""))
}

fn number(shape: &Node<'_, '_>, attribute: &str) -> Result<f32, DrawingError> {
    let value = shape
        .attribute(attribute)
        .and_then(|text| text.parse().ok());
    value.ok_or_else(|| unreadable(shape, attribute))
}

fn points(shape: &Node<'_, '_>) -> Result<Vec<Pixels>, DrawingError> {
    let pair = |pair: &str| {
        let (x, y) = pair.split_once(',')?;
        Some((x.parse().ok()?, y.parse().ok()?))
    };
    let all = shape.attribute("points").unwrap_or_default();
    let points: Option<Vec<_>> = all.split_whitespace().map(pair).collect();
    points.ok_or_else(|| unreadable(shape, "points"))
}

/// Colour of `#1F77B4`; `None` for no paint.
fn colour(shape: &Node<'_, '_>, attribute: &str) -> Result<Option<Colour>, DrawingError> {
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

fn opacity(shape: &Node<'_, '_>) -> f32 {
    let share = shape
        .attribute("opacity")
        .and_then(|text| text.parse().ok());
    share.unwrap_or(1.0_f32).clamp(0.0, 1.0)
}

/// Distance of the baseline below the text's place, in pixels.
fn below(shape: &Node<'_, '_>, size: f32) -> Result<f32, DrawingError> {
    let Some(dy) = shape.attribute("dy") else {
        return Ok(0.0);
    };
    let of = |unit, factor: f32| {
        let number: f32 = dy.strip_suffix(unit)?.parse().ok()?;
        Some(number * factor * size)
    };
    let distance = of("em", 1.0)
        .or_else(|| of("ex", EX))
        .or_else(|| dy.parse().ok());
    distance.ok_or_else(|| unreadable(shape, "dy"))
}

/// Sine and cosine of the rotation, clockwise: plotters writes `rotate(270, x, y)` about the text's place.
fn turn(shape: &Node<'_, '_>) -> Result<(f32, f32), DrawingError> {
    let Some(text) = shape.attribute("transform") else {
        return Ok((0.0, 1.0));
    };
    let degrees = text
        .strip_prefix("rotate(")
        .and_then(|rest| rest.split_once(','));
    match degrees.map(|(degrees, _)| degrees) {
        Some("90") => Ok((1.0, 0.0)),
        Some("180") => Ok((0.0, -1.0)),
        Some("270") => Ok((-1.0, 0.0)),
        _ => Err(unreadable(shape, "transform")),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) const DRAWING: &str = r##"<svg width="200" height="100" viewBox="0 0 200 100" xmlns="http://www.w3.org/2000/svg">
<rect x="0" y="0" width="200" height="100" opacity="1" fill="#FFFFFF" stroke="none"/>
<polyline fill="none" opacity="0.25" stroke="#1F77B4" stroke-width="2" points="1,2 3,4 5,7 "/>
<circle cx="50" cy="60" r="4" opacity="1" fill="#000000" stroke="none" stroke-width="1"/>
<text x="10" y="20" dy="0.76em" text-anchor="middle" font-family="sans-serif" font-size="10" opacity="1" fill="#000000">
R / Ω (a)
</text>
</svg>"##;

    #[test]
    fn an_element_that_plotters_does_not_write_is_an_error() {
        let error = |svg: &str| Drawing::parse(svg).err().map(|why| why.to_string());
        assert_eq!(
            error(&DRAWING.replace("<circle", "<image")).as_deref(),
            Some("the drawing has an element <image>, which only SVG can show")
        );
        let red = error(&DRAWING.replace("#1F77B4", "red")).unwrap();
        assert!(red.contains("stroke=\"red\""), "{red}");
        assert!(matches!(
            Drawing::parse("no svg"),
            Err(DrawingError::Svg(_))
        ));
    }
}
