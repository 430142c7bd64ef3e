//! Contents of a drawn figure, for tests: lines, polygons, texts.

/// SVG as written by plotters: one element per line, except for texts.
pub struct Picture {
    text: String,
}

impl Picture {
    /// A drawn figure from its text.
    pub fn new(text: &str) -> Self {
        Self { text: text.into() }
    }

    /// A drawn figure from its file.
    ///
    /// # Panics
    /// Panics if the file cannot be read.
    pub fn read(path: &std::path::Path) -> Self {
        Self::new(&std::fs::read_to_string(path).unwrap())
    }

    /// Points of all polylines drawn in a colour (`#1F77B4`).
    pub fn polylines(&self, colour: &str) -> Vec<Vec<(i32, i32)>> {
        let paint = format!("stroke=\"{colour}\"");
        self.of_kind("<polyline ", &paint)
    }

    /// Points of all polygons filled with a colour.
    pub fn polygons(&self, colour: &str) -> Vec<Vec<(i32, i32)>> {
        self.of_kind("<polygon ", &format!("fill=\"{colour}\""))
    }

    /// All texts.
    pub fn texts(&self) -> Vec<String> {
        let parts = self.text.split("<text ").skip(1);
        let words = parts.filter_map(|part| {
            let (_, rest) = part.split_once('>')?;
            Some(rest.split_once("</text>")?.0.trim().to_owned())
        });
        words.collect()
    }

    fn of_kind(&self, element: &str, paint: &str) -> Vec<Vec<(i32, i32)>> {
        let parts = self.text.split(element).skip(1);
        let parts = parts.filter_map(|part| part.split_once('>').map(|(head, _)| head));
        let points = parts.filter(|head| head.contains(paint)).map(|head| {
            let (_, rest) = head.split_once("points=\"").unwrap();
            let (points, _) = rest.split_once('"').unwrap();
            let pair = |pair: &str| {
                let (x, y) = pair.split_once(',').unwrap();
                (x.parse().unwrap(), y.parse().unwrap())
            };
            points.split_whitespace().map(pair).collect()
        });
        points.collect()
    }
}
