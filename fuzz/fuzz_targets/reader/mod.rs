//! Numbers out of a fuzzer's bytes, and frames for the wire. Whoever reads on beyond the last byte reads zeros.

// Each target uses some of it.
#![allow(dead_code)]

use ihd_shared::wire::frame::{MAX_ENCODED, MAX_PAYLOAD, encode_numbered, encode_raw};
use ihd_shared::wire::messages::Message;
use ihd_shared::wire::number::Number;

/// The bytes that are left.
pub struct Reader<'a>(pub &'a [u8]);

impl<'a> Reader<'a> {
    /// Returns `true` if all bytes are used up.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The next `n` bytes, fewer at the end.
    pub fn bytes(&mut self, n: usize) -> &'a [u8] {
        let (taken, rest) = self.0.split_at(n.min(self.0.len()));
        self.0 = rest;
        taken
    }

    /// The next `N` bytes.
    pub fn array<const N: usize>(&mut self) -> [u8; N] {
        let mut out = [0; N];
        let taken = self.bytes(N);
        out[..taken.len()].copy_from_slice(taken);
        out
    }

    /// One byte.
    pub fn u8(&mut self) -> u8 {
        self.array::<1>()[0]
    }

    /// Two bytes.
    pub fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.array())
    }

    /// Four bytes.
    pub fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.array())
    }

    /// Any number of f64, whatever it is.
    pub fn any_f64(&mut self) -> f64 {
        f64::from_le_bytes(self.array())
    }

    /// Two bytes spread evenly from `low` to `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * f64::from(self.u16()) / f64::from(u16::MAX)
    }
}

/// The frame of a message; a request's number is that of its frame.
pub fn framed<M: Message>(message: &M, seq: u16) -> Vec<u8> {
    let mut out = [0; MAX_ENCODED];
    let number = Number::from_le_bytes(seq.to_le_bytes());
    let length = encode_numbered(message, number, seq, &mut out).expect("the message fits a frame");
    out[..length].to_vec()
}

/// The frame of any payload, cut to the longest.
pub fn framed_raw(id: u8, seq: u16, payload: &[u8]) -> Vec<u8> {
    let mut out = [0; MAX_ENCODED];
    let payload = &payload[..payload.len().min(MAX_PAYLOAD)];
    let length = encode_raw(id, seq, payload, &mut out).expect("the payload fits a frame");
    out[..length].to_vec()
}
