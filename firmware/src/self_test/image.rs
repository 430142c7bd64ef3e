//! The program in flash and its copies in RAM, a slice at a time.

use core::ops::ControlFlow;

/// A unit that makes the CRC-32 of zlib and the wire (polynomial 0x04C1_1DB7 reflected), words little-endian.
pub trait Crc32 {
    /// Begins anew.
    fn restart(&mut self);
    /// Takes words.
    fn feed(&mut self, words: &[u32]);
    /// The CRC of all words since the beginning.
    fn value(&self) -> u32;
}

/// Memory that is checked again and again.
#[derive(Clone, Copy, Debug)]
struct Slices {
    at: usize,
}

impl Slices {
    /// Returns the next `words` of `length`, and `true` if they are the last.
    fn next(&mut self, words: usize, length: usize) -> (core::ops::Range<usize>, bool) {
        let begin = self.at.min(length);
        let end = (begin + words.max(1)).min(length);
        let last = end == length;
        self.at = if last { 0 } else { end };
        (begin..end, last)
    }
}

/// The check of the program in flash.
#[derive(Clone, Copy, Debug)]
pub struct ImageCheck {
    words: &'static [u32],
    expected: u32,
    slices: Slices,
}

impl ImageCheck {
    /// Begins with the image's words before its CRC, and the CRC.
    pub fn new(words: &'static [u32], expected: u32) -> Self {
        Self {
            words,
            expected,
            slices: Slices { at: 0 },
        }
    }

    /// Takes the next `words` words; at the end of the image returns `true` if it is whole, and begins anew.
    pub fn step(&mut self, unit: &mut impl Crc32, words: usize) -> Option<bool> {
        let (slice, last) = self.slices.next(words, self.words.len());
        if slice.start == 0 {
            unit.restart();
        }
        unit.feed(self.words.get(slice).unwrap_or(&[]));
        last.then(|| unit.value() == self.expected)
    }

    /// Takes all of it at once; returns `true` if it is whole.
    pub fn run(&mut self, unit: &mut impl Crc32) -> bool {
        self.slices.at = 0;
        self.step(unit, self.words.len()) == Some(true)
    }
}

/// A part of RAM that start-up copied from flash, and that must not change.
#[derive(Clone, Copy, Debug)]
pub struct CopyCheck {
    copy: &'static [u32],
    original: &'static [u32],
    slices: Slices,
}

impl CopyCheck {
    /// Begins with a copy and its original, equally long.
    pub fn new(copy: &'static [u32], original: &'static [u32]) -> Self {
        Self {
            copy,
            original,
            slices: Slices { at: 0 },
        }
    }

    /// Compares the next `words` words; breaks off where they differ.
    pub fn step(&mut self, words: usize) -> ControlFlow<()> {
        let (slice, _) = self.slices.next(words, self.original.len());
        let same = self.copy.get(slice.clone()) == self.original.get(slice);
        if same {
            ControlFlow::Continue(())
        } else {
            ControlFlow::Break(())
        }
    }
}

#[cfg(test)]
mod tests {
    use std::boxed::Box;
    use std::vec::Vec;

    use ihd_shared::wire::frame::{CRC32, Digest};

    use super::*;

    struct Software(Digest);

    impl Crc32 for Software {
        fn restart(&mut self) {
            self.0 = CRC32.digest();
        }
        fn feed(&mut self, words: &[u32]) {
            for word in words {
                self.0.update(&word.to_le_bytes());
            }
        }
        fn value(&self) -> u32 {
            self.0.clone().finalize()
        }
    }

    fn words() -> Vec<u32> {
        (0..1_000u32)
            .map(|k| k.wrapping_mul(2_654_435_761))
            .collect()
    }

    fn check(words: Vec<u32>, expected: u32) -> ImageCheck {
        ImageCheck::new(Box::leak(words.into_boxed_slice()), expected)
    }

    fn crc(words: &[u32]) -> u32 {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        CRC32.checksum(&bytes)
    }

    #[test]
    fn every_single_bit_is_found_in_slices_of_any_length() {
        let expected = crc(&words());
        for (slice, steps) in [(1, 1_000), (64, 16), (999, 2), (5_000, 1)] {
            let mut unit = Software(CRC32.digest());
            for bit in [None, Some(0), Some(31_999), Some(15_000)] {
                let mut words = words();
                if let Some(bit) = bit {
                    words[bit / 32] ^= 1 << (bit % 32);
                }
                let mut image = check(words, expected);
                // The second time through as well.
                for _ in 0..2 {
                    let verdicts: Vec<_> =
                        (0..steps).map(|_| image.step(&mut unit, slice)).collect();
                    assert!(verdicts[..steps - 1].iter().all(Option::is_none));
                    assert_eq!(verdicts[steps - 1], Some(bit.is_none()), "{bit:?}");
                }
                assert_eq!(image.run(&mut unit), bit.is_none());
            }
        }
    }

    #[test]
    fn a_copy_that_differs_is_found_within_one_time_through() {
        let original: &'static [u32] = Box::leak(words().into_boxed_slice());
        for wrong in [None, Some(0), Some(999), Some(500)] {
            let mut copy = words();
            if let Some(at) = wrong {
                copy[at] ^= 4;
            }
            let copy = Box::leak(copy.into_boxed_slice());
            let mut check = CopyCheck::new(copy, original);
            let found = (0..32).filter(|_| check.step(32).is_break()).count();
            assert_eq!(found, usize::from(wrong.is_some()), "{wrong:?}");
        }
        let mut shorter = CopyCheck::new(&original[1..], original);
        assert!((0..32).any(|_| shorter.step(32).is_break()));
    }
}
