//! A link that flips bits, and loses, repeats and reorders frames, in both directions.

use std::collections::VecDeque;
use std::time::Duration;

use ihd_link::{LinkError, Transport};

/// Rates of faults: shares of the bits, or of the frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct Faults {
    /// Bits that change.
    pub flips: f64,
    /// Frames that are lost.
    pub lost: f64,
    /// Frames that come twice.
    pub repeated: f64,
    /// Frames that come behind the one that follows.
    pub swapped: f64,
}

/// A transport over another one.
pub struct FaultyLink<T> {
    inner: T,
    to_device: Direction,
    to_host: Direction,
    arrived: VecDeque<u8>,
}

impl<T: Transport> FaultyLink<T> {
    /// The same faults in both directions; `seed` decides which.
    pub fn new(inner: T, faults: Faults, seed: u64) -> Self {
        Self {
            inner,
            to_device: Direction::new(faults, 2 * seed + 1),
            to_host: Direction::new(faults, 2 * seed + 2),
            arrived: VecDeque::new(),
        }
    }
}

impl<T: Transport> Transport for FaultyLink<T> {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let mut out = Vec::new();
        self.to_device.take(bytes, &mut out);
        // Nothing follows that a frame could wait for.
        self.to_device.let_go(&mut out);
        self.inner.send(&out)
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        let deadline = self.inner.clock() + timeout;
        while self.arrived.is_empty() {
            let left = deadline.saturating_sub(self.inner.clock());
            let n = self.inner.receive(buf, left)?;
            let mut out = Vec::new();
            self.to_host.take(&buf[..n], &mut out);
            if n == 0 {
                self.to_host.let_go(&mut out);
            }
            self.arrived.extend(out);
            if n == 0 {
                break;
            }
        }
        let n = buf.len().min(self.arrived.len());
        for (slot, byte) in buf.iter_mut().zip(self.arrived.drain(..n)) {
            *slot = byte;
        }
        Ok(n)
    }

    fn describe(&self) -> String {
        self.inner.describe()
    }

    fn clock(&self) -> Duration {
        self.inner.clock()
    }
}

struct Direction {
    faults: Faults,
    random: u64,
    /// Bits until the next that is flipped.
    intact_bits: f64,
    frame: Vec<u8>,
    held: Option<Vec<u8>>,
}

impl Direction {
    fn new(faults: Faults, seed: u64) -> Self {
        let mut direction = Self {
            faults,
            random: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1,
            intact_bits: 0.0,
            frame: Vec::new(),
            held: None,
        };
        direction.draw_intact_bits();
        direction
    }

    /// Between 0 and 1, both excluded.
    fn draw(&mut self) -> f64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        ((self.random >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    fn draw_intact_bits(&mut self) {
        self.intact_bits = -self.draw().ln() / self.faults.flips;
    }

    fn take(&mut self, bytes: &[u8], out: &mut Vec<u8>) {
        for &byte in bytes {
            let ends = byte == 0 && self.frame.iter().any(|&b| b != 0);
            self.frame.push(byte);
            if ends {
                let frame = std::mem::take(&mut self.frame);
                self.pass(frame, out);
            }
        }
    }

    fn pass(&mut self, mut frame: Vec<u8>, out: &mut Vec<u8>) {
        let faults = self.faults;
        let [lost, repeated, swapped] =
            [faults.lost, faults.repeated, faults.swapped].map(|share| self.draw() < share);
        self.flip(&mut frame);
        if lost {
            return;
        }
        if repeated {
            frame = frame.repeat(2);
        }
        if swapped && self.held.is_none() {
            self.held = Some(frame);
            return;
        }
        out.extend(frame);
        self.let_go(out);
    }

    fn let_go(&mut self, out: &mut Vec<u8>) {
        out.extend(self.held.take().unwrap_or_default());
    }

    fn flip(&mut self, frame: &mut [u8]) {
        let bits = 8.0 * frame.len() as f64;
        let mut at = 0.0;
        while self.intact_bits < bits - at {
            at += self.intact_bits;
            let bit = at as usize;
            frame[bit / 8] ^= 1 << (bit % 8);
            self.draw_intact_bits();
            self.intact_bits += 1.0;
        }
        self.intact_bits -= bits - at;
    }
}
