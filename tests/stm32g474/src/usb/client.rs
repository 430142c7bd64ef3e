//! Host without an operating system: it enumerates the board as Linux and Windows do, and provides the board's bulk endpoints
//! as the link's [`ihd_link::Transport`].

use std::sync::mpsc;
use std::time::Duration;

use super::cable::Cable;
use super::transfer::{Outcome, Request, Status};

mod link;
#[cfg(test)]
pub(super) mod tests;

pub use link::BulkLink;

/// Longest real time for a control transfer: emulation is slow.
const PATIENCE: Duration = Duration::from_secs(60);

/// Request code GET_DESCRIPTOR, and the types of descriptors.
const GET_DESCRIPTOR: u8 = 6;
const DEVICE: u8 = 1;
const CONFIGURATION: u8 = 2;
const STRING: u8 = 3;
const QUALIFIER: u8 = 6;
const BOS: u8 = 15;
/// wIndex of the request for Microsoft's descriptor set.
const MICROSOFT_SET: u16 = 7;
/// Language code of American English.
const LANGUAGE: u16 = 0x0409;
/// Microsoft's platform capability {D8DD60DF-4589-4CC7-9CD2-659D9E648A9F}, in the byte order of a BOS.
const MICROSOFT: [u8; 16] = [
    0xDF, 0x60, 0xDD, 0xD8, 0x89, 0x45, 0xC7, 0x4C, 0x9C, 0xD2, 0x65, 0x9D, 0x9E, 0x64, 0x8A, 0x9F,
];

/// Error in the enumeration of a board.
#[derive(Debug, thiserror::Error)]
pub enum EnumerationError {
    /// A transfer ended with another status than done.
    #[error("{what}: {status:?}")]
    Refused {
        /// Request of the host.
        what: String,
        /// Status at the end of the transfer.
        status: Status,
    },
    /// The machine ended, or is too slow.
    #[error("{what}: the machine is gone, or slower than {PATIENCE:?} for it")]
    NoAnswer {
        /// Request of the host.
        what: String,
    },
    /// The response is not a valid descriptor.
    #[error("{what} is malformed: {bytes:02x?}")]
    Malformed {
        /// Name of the descriptor.
        what: String,
        /// Bytes of the response.
        bytes: Vec<u8>,
    },
}

/// Descriptors of a board.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Description {
    /// Device descriptor.
    pub device: Vec<u8>,
    /// Configuration with its interfaces and endpoints.
    pub configuration: Vec<u8>,
    /// Binary object store (BOS) of USB 2.1; empty for older versions.
    pub bos: Vec<u8>,
    /// Microsoft's descriptor set (MS OS 2.0); empty if the BOS names none.
    pub microsoft: Vec<u8>,
    /// Manufacturer, product, serial number.
    pub strings: [String; 3],
    /// Set if the board has a device qualifier, which only a high-speed device may have.
    pub qualifier: bool,
}

/// Enumerated and configured board.
pub struct Board {
    cable: Cable,
    /// Descriptors of the board.
    pub description: Description,
}

impl Board {
    /// Plugs the board in and enumerates it as a new device.
    ///
    /// # Errors
    /// The board does not respond as USB 2.0, chapter 9, requires.
    pub fn enumerate(cable: &Cable, address: u8) -> Result<Self, EnumerationError> {
        cable.plug();
        let board = Self {
            cable: cable.clone(),
            description: Description::default(),
        };
        board.ask("reset", Request::Reset)?;
        // The first eight bytes contain the packet size of endpoint 0.
        board.descriptor(DEVICE, 0, 0, 8)?;
        board.ask("reset", Request::Reset)?;
        board.control("SET_ADDRESS", [0, 5, address, 0, 0, 0, 0, 0])?;
        let description = board.describe()?;
        board.control("SET_CONFIGURATION", [0, 9, 1, 0, 0, 0, 0, 0])?;
        Ok(Self {
            description,
            ..board
        })
    }

    /// Link over the board's bulk endpoints, number 1 in both directions.
    pub fn link(&self) -> BulkLink {
        BulkLink::new(self.cable.clone(), &self.description.strings[2])
    }

    fn describe(&self) -> Result<Description, EnumerationError> {
        let device = self.descriptor(DEVICE, 0, 0, 18)?;
        let is_short = || EnumerationError::Malformed {
            what: "device".into(),
            bytes: device.clone(),
        };
        let &[manufacturer, product, serial, _configurations] = device
            .get(14..18)
            .and_then(|tail| <&[u8; 4]>::try_from(tail).ok())
            .ok_or_else(is_short)?;
        let strings = [manufacturer, product, serial].map(|index| self.string(index));
        let [manufacturer, product, serial] = strings;
        let version = u16::from_le_bytes([device[2], device[3]]);
        let bos = if version > 0x0200 {
            self.whole(BOS)?
        } else {
            Vec::new()
        };
        let qualifier = self.descriptor(QUALIFIER, 0, 0, 10);
        Ok(Description {
            configuration: self.whole(CONFIGURATION)?,
            microsoft: self.microsoft(&bos)?,
            strings: [manufacturer?, product?, serial?],
            qualifier: qualifier.is_ok(),
            device,
            bos,
        })
    }

    /// Reads a descriptor with all that follows it; its bytes 2 and 3 contain the total length.
    fn whole(&self, kind: u8) -> Result<Vec<u8>, EnumerationError> {
        let head = self.descriptor(kind, 0, 0, 9)?;
        match head[..] {
            [_, _, low, high, ..] => self.descriptor(kind, 0, 0, u16::from_le_bytes([low, high])),
            _ => Err(EnumerationError::Malformed {
                what: format!("descriptor {kind}"),
                bytes: head,
            }),
        }
    }

    fn string(&self, index: u8) -> Result<String, EnumerationError> {
        let bytes = self.descriptor(STRING, index, LANGUAGE, 255)?;
        let units = bytes.get(2..).unwrap_or_default().chunks_exact(2);
        let units: Vec<u16> = units
            .map(|unit| u16::from_le_bytes([unit[0], unit[1]]))
            .collect();
        String::from_utf16(&units).map_err(|_| EnumerationError::Malformed {
            what: format!("string {index}"),
            bytes,
        })
    }

    /// Reads Microsoft's descriptor set, with the request and the length that the BOS contains.
    fn microsoft(&self, bos: &[u8]) -> Result<Vec<u8>, EnumerationError> {
        let Some(place) = bos
            .windows(MICROSOFT.len())
            .position(|bytes| bytes == MICROSOFT)
        else {
            return Ok(Vec::new());
        };
        let Some(&[_, _, _, _, low, high, request, _]) = bos.get(place + 16..place + 24) else {
            return Err(EnumerationError::Malformed {
                what: "BOS".into(),
                bytes: bos.to_vec(),
            });
        };
        let [index, index_high] = MICROSOFT_SET.to_le_bytes();
        let setup = [0xC0, request, 0, 0, index, index_high, low, high];
        Ok(self.control("MS OS 2.0 descriptor set", setup)?.data)
    }

    fn descriptor(
        &self,
        kind: u8,
        index: u8,
        language: u16,
        length: u16,
    ) -> Result<Vec<u8>, EnumerationError> {
        let ([language, language_high], [length, length_high]) =
            (language.to_le_bytes(), length.to_le_bytes());
        let setup = [
            0x80,
            GET_DESCRIPTOR,
            index,
            kind,
            language,
            language_high,
            length,
            length_high,
        ];
        let what = format!("descriptor {kind}.{index}");
        Ok(self.control(&what, setup)?.data)
    }

    /// Runs a control transfer without data, or with data from the board.
    ///
    /// # Errors
    /// The transfer ends with another status than done.
    pub fn control(&self, what: &str, setup: [u8; 8]) -> Result<Outcome, EnumerationError> {
        self.ask(
            what,
            Request::Control {
                setup,
                data: Vec::new(),
            },
        )
    }

    fn ask(&self, what: &str, request: Request) -> Result<Outcome, EnumerationError> {
        let (sender, receiver) = mpsc::channel();
        self.cable
            .submit(request, move |outcome| drop(sender.send(outcome)));
        let what = what.to_owned();
        match receiver.recv_timeout(PATIENCE) {
            Ok(outcome) if outcome.status == Status::Done => Ok(outcome),
            Ok(Outcome { status, .. }) => Err(EnumerationError::Refused { what, status }),
            Err(_) => Err(EnumerationError::NoAnswer { what }),
        }
    }
}
