//! Standard output and standard error. A closed reader or a full disk is an error, not a panic, and text of a device or a file is
//! escaped.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};
use std::path::PathBuf;

use anyhow::Result;
use ihd_plot::file::{ENDING_NAMES, ENDINGS};
use ihd_signal::printable::is_shown;
use serde::Serialize;

/// Prints a line like `println!`, and returns the error.
#[macro_export]
macro_rules! say {
    ($($argument:tt)*) => {
        $crate::cli::output::line(format_args!($($argument)*))
    };
}

/// Writes a line to standard output, control characters escaped.
///
/// # Errors
/// If standard output cannot be written.
pub fn line(arguments: Arguments<'_>) -> Result<()> {
    text(&format!("{arguments}\n"))
}

/// Writes text to standard output, control characters but line ends and tabs escaped.
///
/// # Errors
/// If standard output cannot be written.
pub fn text(text: &str) -> Result<()> {
    raw(escaped(text).as_bytes())
}

/// Writes a value as JSON to standard output, on several lines.
///
/// # Errors
/// If it cannot be written.
pub fn json(value: &impl Serialize) -> Result<()> {
    raw(json_text(&serde_json::to_string_pretty(value)?).as_bytes())
}

/// JSON array on standard output, element by element, as [`json`] writes it at once.
#[derive(Debug, Default)]
pub struct JsonArray {
    begun: bool,
}

impl JsonArray {
    /// Writes an element.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn push(&mut self, value: &impl Serialize) -> Result<()> {
        let before = if self.begun { ",\n  " } else { "[\n  " };
        self.begun = true;
        let element = serde_json::to_string_pretty(value)?.replace('\n', "\n  ");
        raw(json_escaped(&format!("{before}{element}")).as_bytes())
    }

    /// Writes the end.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn end(&mut self) -> Result<()> {
        raw(if self.begun { b"\n]\n" } else { b"[]\n" })
    }
}

/// Writes a value as one line of JSON to standard output.
///
/// # Errors
/// If it cannot be written.
pub fn json_line(value: &impl Serialize) -> Result<()> {
    raw(json_text(&serde_json::to_string(value)?).as_bytes())
}

/// Parses the name of a figure's file.
pub fn figure_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension().and_then(|ending| ending.to_str()) {
        Some(ending) if ENDINGS.contains(&ending) => Ok(path),
        _ => Err(format!("the name of a figure ends with {ENDING_NAMES}")),
    }
}

/// Prints a line on standard error; errors are ignored.
pub fn complain(arguments: Arguments<'_>) {
    let text = escaped(&format!("{arguments}\n"));
    let _ = std::io::stderr().write_all(text.as_bytes());
}

/// Colour on a terminal.
#[cfg(feature = "log")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Colour {
    /// Default colour.
    Plain,
    /// For secondary information.
    Dim,
    /// For a good state.
    Green,
    /// For a warning.
    Yellow,
    /// For an alarm.
    Red,
}

/// Writes a line of parts to standard output, each in its colour where `coloured`; control characters escaped.
///
/// # Errors
/// If standard output cannot be written.
#[cfg(feature = "log")]
pub fn parts(coloured: bool, parts: &[(Colour, String)]) -> Result<()> {
    raw(parts_text(coloured, parts).as_bytes())
}

#[cfg(feature = "log")]
fn parts_text(coloured: bool, parts: &[(Colour, String)]) -> String {
    let mut out = String::new();
    for (colour, text) in parts {
        let code = match colour {
            Colour::Plain => "",
            Colour::Dim => "\x1b[2m",
            Colour::Green => "\x1b[32m",
            Colour::Yellow => "\x1b[33m",
            Colour::Red => "\x1b[31m",
        };
        let text = escaped(text).replace('\n', "\\u{a}");
        if coloured && !code.is_empty() {
            out += &format!("{code}{text}\x1b[0m");
        } else {
            out += &text;
        }
    }
    out + "\n"
}

/// Error of standard output whose reader is gone. A command that heats ends with the hob off, as after any error.
#[derive(Debug, thiserror::Error)]
#[error("nothing reads standard output any more")]
pub struct OutputClosed;

fn raw(bytes: &[u8]) -> Result<()> {
    let mut out = std::io::stdout().lock();
    let written = out.write_all(bytes).and_then(|()| out.flush());
    written.map_err(output_error)
}

/// Error of writing to standard output.
pub fn output_error(error: std::io::Error) -> anyhow::Error {
    match error.kind() {
        ErrorKind::BrokenPipe => OutputClosed.into(),
        _ => anyhow::Error::from(error).context("cannot write to standard output"),
    }
}

/// Escapes control characters other than line ends and tabs as `\u{1b}`.
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if is_shown(c) || matches!(c, '\n' | '\t') {
            out.push(c);
        } else {
            out.extend(c.escape_unicode());
        }
    }
    out
}

/// Returns JSON with a line end.
fn json_text(json: &str) -> String {
    json_escaped(json) + "\n"
}

/// Returns JSON without control characters: its own escapes leave DEL and U+0080 to U+009F as they are.
fn json_escaped(json: &str) -> String {
    let mut out = String::with_capacity(json.len() + 1);
    for c in json.chars() {
        if c.is_control() && c != '\n' {
            out.push_str(&format!("\\u{:04x}", u32::from(c)));
        } else {
            out.push(c);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_keeps_its_lines_and_loses_its_escapes() {
        let shown = escaped("a\tb\n\x1b]0;owned\x07c\u{9b}");
        assert_eq!(shown, "a\tb\n\\u{1b}]0;owned\\u{7}c\\u{9b}");
    }

    #[test]
    #[cfg(feature = "log")]
    fn colours_are_ours_alone() {
        let parts = [
            (Colour::Red, "error ".to_owned()),
            (Colour::Plain, "a\x1b[1m\nb".to_owned()),
        ];
        let plain = parts_text(false, &parts);
        assert_eq!(plain, "error a\\u{1b}[1m\\u{a}b\n");
        let coloured = parts_text(true, &parts);
        assert_eq!(coloured, "\x1b[31merror \x1b[0ma\\u{1b}[1m\\u{a}b\n");
    }

    #[test]
    fn json_stays_what_it_says() {
        let value = serde_json::json!({ "name": "\x1b]0;owned\x07\n\u{7f}\u{9b}" });
        let text = json_text(&serde_json::to_string_pretty(&value).unwrap());
        assert!(text.chars().all(|c| !c.is_control() || c == '\n'), "{text}");
        let back: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(back, value);
    }
}
