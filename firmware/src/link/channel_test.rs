//! Offset and noise of the measuring channels with the bridge open: means and deviations of their codes.
//!
//! The pairs come through the window recorder's slot, which is free then: the sampling path does what it does for a
//! window, and nothing more.

use ihd_shared::sampling::Pair;
use ihd_shared::window::{CHUNK_BYTES, MAX_PAIRS, PAIR_BYTES};
use ihd_shared::wire::messages::Channels;

use crate::link::window_sender::READ_BYTES;
use crate::sampling::path::SamplingLock;
use crate::sense::supply::Reference;

/// Duration of the measurement, in milliseconds: five periods of 50 Hz, six of 60 Hz.
const MEASURED_MS: u32 = 100;

/// Longest wait for the recorder's slot, in milliseconds; a window that was sent is kept for 200.
const SLOT_WITHIN_MS: u32 = 500;

/// Codes of the converter of bus and mains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlowCodes {
    /// Bus voltage, from 0 on.
    pub bus: u16,
    /// Mains voltage, from mid-scale on.
    pub mains: i16,
}

/// Sums of codes and of their squares.
#[derive(Clone, Copy, Debug, Default)]
struct Moments {
    n: u32,
    sum: i64,
    squares: u64,
}

impl Moments {
    /// So many codes of 12 bits keep every product below within 64 bits.
    const MAX_CODES: u32 = 1 << 19;

    fn add(&mut self, code: i32) {
        if self.n < Self::MAX_CODES {
            self.n += 1;
            self.sum += i64::from(code);
            self.squares += u64::from(code.unsigned_abs().pow(2));
        }
    }

    /// Mean in 1/256 code.
    fn mean(&self) -> i32 {
        match self.n {
            0 => 0,
            n => (self.sum * 256 / i64::from(n)) as i32,
        }
    }

    /// Root mean square about the mean in 1/256 code: √(n Σx² − (Σx)²) / n.
    fn rms(&self) -> u32 {
        let n = u64::from(self.n);
        let spread = (n * self.squares).saturating_sub(self.sum.unsigned_abs().pow(2));
        match n {
            0 => 0,
            n => (spread.isqrt() * 256 / n) as u32,
        }
    }
}

/// A measurement under way.
#[derive(Clone, Copy, Debug)]
pub struct ChannelTest {
    since_ms: u32,
    /// Pairs that were taken out of the recorder's slot; `None` while it is not ours.
    taken: Option<u16>,
    v: Moments,
    i: Moments,
    bus: Moments,
    mains: Moments,
}

impl ChannelTest {
    /// Begins with nothing measured.
    pub fn begin(now_ms: u32) -> Self {
        let none = Moments::default();
        Self {
            since_ms: now_ms,
            taken: None,
            v: none,
            i: none,
            bus: none,
            mains: none,
        }
    }

    /// Takes the samples since the last step; returns `true` if the measurement is over.
    #[inline(never)]
    pub fn step(
        &mut self,
        now_ms: u32,
        lock: &mut impl SamplingLock,
        slow: Option<SlowCodes>,
    ) -> bool {
        if let Some(slow) = slow {
            self.bus.add(slow.bus.into());
            self.mains.add(slow.mains.into());
        }
        self.take_pairs(lock);
        let elapsed_ms = now_ms.wrapping_sub(self.since_ms);
        let over = match self.v.n {
            0 => elapsed_ms >= SLOT_WITHIN_MS,
            _ => elapsed_ms >= MEASURED_MS,
        };
        if over {
            lock.with(|path| path.recorder().end_raw());
        }
        over
    }

    fn take_pairs(&mut self, lock: &mut impl SamplingLock) {
        let Some(taken) = self.taken else {
            if lock.with(|path| path.recorder().begin_raw()) {
                self.taken = Some(0);
            }
            return;
        };
        // More than a block brings, in parts under the lock by itself each.
        let mut taken = taken;
        for _ in 0..CHUNK_BYTES / READ_BYTES {
            let mut raw = [0; READ_BYTES];
            let n = lock.with(|path| match path.recorder().is_raw() {
                true => Some(path.recorder().read_pairs(taken, &mut raw)),
                false => None,
            });
            let Some(n) = n else {
                // The slot was freed meanwhile.
                self.taken = None;
                return;
            };
            let (pairs, _) = raw[..usize::from(n) * PAIR_BYTES].as_chunks();
            for pair in pairs {
                let pair = Pair::from_le_bytes(*pair);
                self.v.add(pair.v.into());
                self.i.add(pair.i.into());
            }
            taken += n;
            if n == 0 {
                break;
            }
        }
        self.taken = Some(taken);
        if usize::from(taken) >= MAX_PAIRS {
            lock.with(|path| path.recorder().end_raw());
            self.taken = None;
        }
    }

    /// Means and deviations; `None` if no pair was seen.
    pub fn result(&self, reference: Option<Reference>) -> Option<Channels> {
        (self.v.n > 0).then(|| Channels {
            samples: self.v.n,
            v_mean: self.v.mean(),
            v_rms: self.v.rms(),
            i_mean: self.i.mean(),
            i_rms: self.i.rms(),
            slow_samples: self.bus.n,
            bus_mean: self.bus.mean(),
            bus_rms: self.bus.rms(),
            mains_mean: self.mains.mean(),
            mains_rms: self.mains.rms(),
            reference: reference.map_or(0, |r| r.code),
            vdda_mv: reference.map_or(0, |r| r.vdda_mv()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_and_deviations_are_those_of_the_codes() {
        // Mean −6; squares about it 16, 4, 16, 36.
        let mut moments = Moments::default();
        for _ in 0..10_000 {
            for code in [-10, -4, -10, 0] {
                moments.add(code);
            }
        }
        assert_eq!(moments.mean(), -6 * 256);
        // Their mean is 18.
        assert_eq!(moments.rms(), (18f64.sqrt() * 256.0) as u32);
        assert_eq!(Moments::default().rms(), 0);
    }

    #[test]
    fn the_ends_of_the_range_for_ever_overflow_nothing() {
        let mut moments = Moments::default();
        for k in 0..Moments::MAX_CODES + 10 {
            moments.add(if k % 2 == 0 { -2_048 } else { 4_095 });
        }
        assert_eq!(moments.n, Moments::MAX_CODES);
        assert_eq!(moments.mean(), 2_047 * 256 / 2);
        // Half of the distance between the two.
        assert_eq!(moments.rms(), 6_143 * 256 / 2);
    }

    #[test]
    fn the_supply_follows_from_the_reference() {
        // 1.212 V at 3.0 V is code 1 654; at 3.3 V it is 1 504.
        let at = |code, calibrated| Reference { code, calibrated }.vdda_mv();
        assert_eq!(at(1_654, 1_654), 3_000);
        assert!((3_298..=3_300).contains(&at(1_504, 1_654)));
        assert_eq!(at(0, 1_654), 0);
        assert_eq!(at(1, u16::MAX), 0);
    }
}
