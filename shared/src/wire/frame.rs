//! Frames: `00 COBS(id u8 · seq u16 LE · payload · crc32 LE) 00`.
//!
//! The leading zero costs a byte and buys that a frame cut short cannot swallow the next one.
//! The CRC-32 (ISO-HDLC, as in zlib) covers id, sequence number and payload. The sequence number
//! counts the frames one end sends, per direction, so that the other sees what got lost. The payload of a request or an
//! answer begins with the request's [`Number`], two bytes.

use core::fmt;

use super::messages::{Message, is_numbered};
use super::number::Number;

/// Longest frame before stuffing: id, sequence number, payload and CRC.
pub const MAX_BODY: usize = 1024;

/// Bytes of id and sequence number.
pub const HEADER: usize = 3;

/// Bytes of the CRC.
pub const TRAILER: usize = 4;

/// Longest payload, the number of a request included.
pub const MAX_PAYLOAD: usize = MAX_BODY - HEADER - TRAILER;

/// Longest frame on the wire: stuffing adds a byte per 254, and the two zeros.
pub const MAX_ENCODED: usize = MAX_BODY + MAX_BODY.div_ceil(254) + 2;

/// The CRC-32 of frames, windows and lookups, with one table of 1 KiB.
pub static CRC32: crc::Crc<u32, Table> = crc::Crc::<u32, Table>::new(&crc::CRC_32_ISO_HDLC);

/// A CRC-32 under way.
pub type Digest = crc::Digest<'static, u32, Table>;

type Table = crc::Table<1>;

/// Reason that a message could not be framed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncodeError {
    /// The message is longer than [`MAX_PAYLOAD`].
    TooLong,
    /// The output buffer is shorter than the frame.
    NoRoom,
}

impl fmt::Display for EncodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong => write!(f, "message longer than {MAX_PAYLOAD} bytes"),
            Self::NoRoom => write!(f, "output buffer shorter than the frame"),
        }
    }
}

impl core::error::Error for EncodeError {}

/// Writes the frame of a message that is neither request nor answer into `out`; returns its length, at most
/// [`MAX_ENCODED`].
///
/// # Errors
/// [`EncodeError`] when the message or the frame does not fit; `out` is then undefined.
pub fn encode<M: Message>(message: &M, seq: u16, out: &mut [u8]) -> Result<usize, EncodeError> {
    const {
        assert!(
            !M::PART.is_numbered(),
            "a request and its answer have a number"
        )
    };
    encode_message(message, &[], seq, out)
}

/// Encodes any message as [`encode`] does: a request and the answer to it carry the number, and no other does.
///
/// # Errors
/// Same as [`encode`].
pub fn encode_numbered<M: Message>(
    message: &M,
    number: Number,
    seq: u16,
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let number = number.to_le_bytes();
    let number = if M::PART.is_numbered() {
        &number[..]
    } else {
        &[]
    };
    encode_message(message, number, seq, out)
}

fn encode_message<M: Message>(
    message: &M,
    number: &[u8],
    seq: u16,
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let mut body = [0u8; MAX_BODY];
    let (begin, payload_end) = (HEADER + number.len(), MAX_BODY - TRAILER);
    body[HEADER..begin].copy_from_slice(number);
    let used = postcard::to_slice(message, &mut body[begin..payload_end])
        .map_err(|_| EncodeError::TooLong)?
        .len();
    encode_body(M::ID, seq, number.len() + used, &mut body, out)
}

/// Encodes a payload that is already bytes. For tests and tools that send what no
/// message table would.
///
/// # Errors
/// Same as [`encode`].
pub fn encode_raw(id: u8, seq: u16, payload: &[u8], out: &mut [u8]) -> Result<usize, EncodeError> {
    let mut body = [0u8; MAX_BODY];
    body.get_mut(HEADER..HEADER + payload.len())
        .filter(|_| payload.len() <= MAX_PAYLOAD)
        .ok_or(EncodeError::TooLong)?
        .copy_from_slice(payload);
    encode_body(id, seq, payload.len(), &mut body, out)
}

fn encode_body(
    id: u8,
    seq: u16,
    payload_len: usize,
    body: &mut [u8; MAX_BODY],
    out: &mut [u8],
) -> Result<usize, EncodeError> {
    let end = HEADER + payload_len;
    body[0] = id;
    body[1..HEADER].copy_from_slice(&seq.to_le_bytes());
    let crc = CRC32.checksum(&body[..end]);
    body[end..end + TRAILER].copy_from_slice(&crc.to_le_bytes());
    let body = &body[..end + TRAILER];
    if out.len() < cobs::max_encoding_length(body.len()) + 2 {
        return Err(EncodeError::NoRoom);
    }
    out[0] = 0;
    let stuffed = cobs::encode(body, &mut out[1..]);
    out[stuffed + 1] = 0;
    Ok(stuffed + 2)
}

/// A frame whose CRC is right; the payload is not decoded yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Message id.
    pub id: u8,
    /// The sender's frame counter.
    pub seq: u16,
    /// Number of a request or an answer, then postcard bytes.
    pub payload: &'a [u8],
}

impl<'a> Frame<'a> {
    /// The number and the message's bytes; [`Number::NONE`] where the message has none.
    pub fn split(&self) -> (Number, &'a [u8]) {
        match self.payload {
            [low, high, message @ ..] if is_numbered(self.id) => {
                (Number::from_le_bytes([*low, *high]), message)
            }
            message => (Number::NONE, message),
        }
    }
}

/// Reason that bytes between two zeros are not a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// Longer than any frame.
    TooLong,
    /// Shorter than header and CRC.
    TooShort,
    /// Byte stuffing is broken.
    Stuffing,
    /// The CRC does not match.
    Crc,
}

impl fmt::Display for FrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::TooLong => "frame longer than any message",
            Self::TooShort => "frame shorter than header and CRC",
            Self::Stuffing => "byte stuffing broken",
            Self::Crc => "CRC-32 does not match",
        })
    }
}

impl core::error::Error for FrameError {}

/// Unstuffs one frame in place and checks its CRC. `stuffed` holds no zero.
///
/// # Errors
/// [`FrameError`] when the bytes are not a frame.
pub fn decode(stuffed: &mut [u8]) -> Result<Frame<'_>, FrameError> {
    let len = cobs::decode_in_place(stuffed).map_err(|_| FrameError::Stuffing)?;
    let body = &stuffed[..len];
    if len < HEADER + TRAILER {
        return Err(FrameError::TooShort);
    }
    let (covered, crc) = body.split_at(len - TRAILER);
    if CRC32.checksum(covered).to_le_bytes() != crc {
        return Err(FrameError::Crc);
    }
    Ok(Frame {
        id: covered[0],
        seq: u16::from_le_bytes([covered[1], covered[2]]),
        payload: &covered[HEADER..],
    })
}
