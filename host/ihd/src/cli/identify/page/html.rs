//! Elements of a page. Text is escaped here, once.

use std::fmt::Write;

use ihd_plot::zoom;

use super::super::super::output::escaped;

/// Text of a file or a device for an element: marks of HTML and characters that are not shown are escaped.
pub fn text(text: &str) -> String {
    zoom::escape(&escaped(text))
}

/// Row of a table.
pub struct TableRow {
    /// Class by which the style chooses a colour.
    pub class: &'static str,
    /// Cells.
    pub cells: Vec<String>,
}

/// Column of a table.
#[derive(Clone, Copy)]
pub enum TableColumn {
    /// Text, left.
    Text(&'static str),
    /// Text of any length, broken where it must be.
    Long(&'static str),
    /// Number, right.
    Number(&'static str),
}

impl TableColumn {
    fn cell(self, kind: &str, value: &str) -> String {
        let class = match self {
            Self::Text(_) => "",
            Self::Long(_) => " class=\"long\"",
            Self::Number(_) => " class=\"number\"",
        };
        format!("<{kind}{class}>{}</{kind}>", text(value))
    }
}

/// Table under a heading.
pub fn table(columns: &[TableColumn], rows: &[TableRow]) -> String {
    let mut out = String::from("<div class=\"scroll\"><table>\n<thead><tr>");
    for column in columns {
        let (TableColumn::Text(name) | TableColumn::Long(name) | TableColumn::Number(name)) =
            column;
        out += &column.cell("th", name);
    }
    out += "</tr></thead>\n<tbody>\n";
    for row in rows {
        let _ = write!(out, "<tr class=\"{}\">", row.class);
        for (column, value) in columns.iter().zip(&row.cells) {
            out += &column.cell("td", value);
        }
        out += "</tr>\n";
    }
    out + "</tbody></table></div>\n"
}

/// Whole page. Its policy forbids the browser to load anything.
pub fn page(title: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; \
         script-src 'unsafe-inline'\">\n\
         <meta name=\"viewport\" content=\"width=device-width\">\n<title>{title}</title>\n\
         <style>\n{}{}</style>\n</head>\n<body>\n<h1>{title}</h1>\n{body}<script>\n{}</script>\n</body>\n</html>\n",
        include_str!("page.css"),
        zoom::STYLE,
        zoom::SCRIPT,
        title = text(title),
    )
}
