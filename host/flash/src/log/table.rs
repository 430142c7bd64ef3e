//! Texts of an image's log messages: they stay in its file, and a board sends their numbers and values.

use std::path::Path;

use defmt_decoder::{Encoding, Locations};
use object::{Object, ObjectSection, ObjectSymbol};
use serde::{Deserialize, Serialize};

use super::message::{LogLevel, LogMessage, SourceLocation};
use super::rzcobs;
use super::walk::{self, Format, Formats};
use ihd_signal::printable;

/// Error of reading a file's messages.
#[derive(Debug, thiserror::Error)]
pub enum LogTableError {
    /// The file has no log messages.
    #[error(
        "{image} has no log messages (defmt): is it the file that `cargo xtask firmware` writes, not stripped?"
    )]
    None {
        /// The file.
        image: String,
    },
    /// The messages are damaged.
    #[error("the log messages of {image} cannot be read: {why}")]
    Damaged {
        /// The file.
        image: String,
        /// Reason.
        why: String,
    },
    /// The messages use an unsupported feature.
    #[error("{image} logs with {what}, which `ihd log` does not decode")]
    Unsupported {
        /// The file.
        image: String,
        /// Feature.
        what: &'static str,
    },
}

/// Messages of one image.
pub struct LogTable {
    defmt: defmt_decoder::Table,
    locations: Locations,
    formats: Formats,
    timestamp: Option<String>,
    image: String,
}

impl LogTable {
    /// Reads the messages of an ELF file; `image` is its name in texts.
    ///
    /// # Errors
    /// [`LogTableError`].
    pub fn parse(elf: &[u8], image: &str) -> Result<Self, LogTableError> {
        let image = printable(image).to_string();
        let damaged = |why: &dyn std::fmt::Display| LogTableError::Damaged {
            image: image.clone(),
            why: printable(&why.to_string()).to_string(),
        };
        let table = defmt_decoder::Table::parse(elf).map_err(|why| damaged(&why))?;
        let defmt = table.ok_or_else(|| LogTableError::None {
            image: image.clone(),
        })?;
        let unsupported = |what| LogTableError::Unsupported {
            image: image.clone(),
            what,
        };
        if defmt.encoding() != Encoding::Rzcobs {
            return Err(unsupported("an encoding that is not rzcobs"));
        }
        let (formats, timestamp) = formats(elf).map_err(|why| damaged(&why))?;
        let texts = formats.values().map(|format| &format.text);
        // The decoder panics on an invalid date.
        if texts
            .chain(&timestamp)
            .any(|text| text.contains(":iso8601"))
        {
            return Err(unsupported("dates ({:iso8601…})"));
        }
        // Without debug information the places are missing, the messages are the same.
        let locations = defmt.get_locations(elf).unwrap_or_default();
        Ok(Self {
            defmt,
            locations,
            formats,
            timestamp,
            image,
        })
    }

    /// Name of the image.
    pub fn image(&self) -> &str {
        &self.image
    }

    /// Number of messages.
    pub fn len(&self) -> usize {
        let formats = self.formats.values();
        formats.filter(|format| format.is_message).count()
    }

    /// Returns `true` if there are no messages.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Decodes an encoded frame; `None` if it is no message of this image.
    pub fn decode(&self, frame: &[u8]) -> Option<LogMessage> {
        let bytes = rzcobs::decode(frame).ok()?;
        if !walk::fits(&self.formats, self.timestamp.as_deref(), &bytes) {
            return None;
        }
        let (frame, _) = self.defmt.decode(&bytes).ok()?;
        let place = self.locations.get(&frame.index());
        Some(LogMessage {
            level: frame.level().map(LogLevel::from),
            text: printable(&frame.display_message().to_string()).to_string(),
            uptime: frame
                .display_timestamp()
                .map(|time| printable(&time.to_string()).to_string()),
            place: place.map(|location| SourceLocation {
                module: printable(&location.module).to_string(),
                file: shortened(&location.file),
                line: location.line,
            }),
        })
    }
}

/// Shortens a path: a registry's crate to its name, a file of the checkout to its path from the root.
fn shortened(path: &Path) -> String {
    let path = path.to_string_lossy().replace('\\', "/");
    let of_registry = path.split_once("/registry/src/").map(|(_, rest)| rest);
    let behind_index = of_registry.and_then(|rest| rest.split_once('/'));
    let of_checkout = || path.find("/firmware/src/").map(|at| &path[at + 1..]);
    let short = behind_index.map(|(_, file)| file).or_else(of_checkout);
    printable(short.unwrap_or(&path)).to_string()
}

/// Name of a symbol in the section `.defmt`, as JSON; the symbol's address is the number of the message.
#[derive(Deserialize, Serialize)]
struct Symbol {
    tag: String,
    data: String,
}

/// Format strings by number, and that of the time stamp.
fn formats(elf: &[u8]) -> Result<(Formats, Option<String>), object::Error> {
    let file = object::File::parse(elf)?;
    let section = file
        .section_by_name(".defmt")
        .map(|section| section.index());
    let (mut formats, mut timestamp) = (Formats::new(), None);
    for symbol in file.symbols() {
        if section.is_none() || symbol.section_index() != section {
            continue;
        }
        let Ok(Symbol { tag, data }) = serde_json::from_str(symbol.name().unwrap_or_default())
        else {
            continue;
        };
        let is_message = match tag.as_str() {
            "defmt_timestamp" => {
                timestamp = Some(data);
                continue;
            }
            "defmt_trace" | "defmt_debug" | "defmt_info" | "defmt_warn" | "defmt_error" => true,
            "defmt_println" => true,
            "defmt_prim" | "defmt_derived" | "defmt_bitflags" | "defmt_write" | "defmt_str" => {
                false
            }
            _ => continue,
        };
        let text = data;
        formats.insert(symbol.address(), Format { text, is_message });
    }
    Ok((formats, timestamp))
}
