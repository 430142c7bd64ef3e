//! Blocks of a window, packed: codes have 12 bits, so four pairs take three words in place of four.
//!
//! Each pair is a word with v in the lower half and i in the upper one. In the first three words of four the upper four bits
//! of each half repeat the sign: the fourth word's halves lie there, four bits in each.

use ihd_shared::sampling::{ADC_LOCK_P, CODE_BITS, CODE_MAX, CODE_MIN, Pair};
use ihd_shared::window::{MAX_PAIRS, PAIR_BYTES};

/// Bits of a pair's word that hold its codes.
const CODES: u32 = 0x0FFF_0FFF;

const _: () = assert!(CODE_BITS == 12);

/// Words of a packed block: fifteen times three, and the last pair.
const BLOCK_WORDS: usize = ADC_LOCK_P / 4 * 3 + ADC_LOCK_P % 4;

type Block = [u32; BLOCK_WORDS];

/// Blocks of a window of so many pairs, which begins anywhere within the first one.
const BLOCKS: usize = (MAX_PAIRS + ADC_LOCK_P - 1).div_ceil(ADC_LOCK_P);

/// Place for the blocks of a window.
pub struct PackedBlocks([Block; BLOCKS]);

impl PackedBlocks {
    /// All bits zero.
    pub const fn blank() -> Self {
        Self([[0; BLOCK_WORDS]; BLOCKS])
    }

    /// Puts a block at place `at`; returns `false` where there is none. `ordinary` if no code is beyond 12 bits; another one
    /// ends at their bounds.
    #[inline(always)]
    pub fn put(&mut self, at: usize, pairs: &[Pair; ADC_LOCK_P], ordinary: bool) -> bool {
        let Some(place) = self.0.get_mut(at) else {
            return false;
        };
        if ordinary {
            pack(Pair::words(pairs), place);
        } else {
            pack_bounded(pairs, place);
        }
        true
    }

    /// Writes the pairs from place `at` of the first block on in the wire's layout, as many as `out` has room for.
    pub fn read(&self, at: usize, out: &mut [u8]) {
        let mut slots = out.as_chunks_mut().0;
        let mut from = at % ADC_LOCK_P;
        for block in self.0.iter().skip(at / ADC_LOCK_P) {
            let n = slots.len().min(ADC_LOCK_P - from);
            let (here, behind) = slots.split_at_mut(n);
            unpack(block, from, here);
            if behind.is_empty() {
                return;
            }
            (slots, from) = (behind, 0);
        }
        slots.fill([0; PAIR_BYTES]);
    }
}

#[inline(never)]
fn pack(words: &[u32; ADC_LOCK_P], place: &mut Block) {
    let (fours, last) = words.as_chunks();
    let (threes, last_place) = place.as_chunks_mut();
    for (&[a, b, c, d], three) in fours.iter().zip(threes) {
        *three = [
            a & CODES | d << 12 & !CODES,
            b & CODES | d << 8 & !CODES,
            c & CODES | d << 4 & !CODES,
        ];
    }
    last_place.copy_from_slice(last);
}

#[cold]
#[inline(never)]
fn pack_bounded(pairs: &[Pair; ADC_LOCK_P], place: &mut Block) {
    let bounded = pairs.map(|pair| Pair {
        v: pair.v.clamp(CODE_MIN, CODE_MAX),
        i: pair.i.clamp(CODE_MIN, CODE_MAX),
    });
    pack(Pair::words(&bounded), place);
}

/// Writes the pairs of a block from `from` on, four at a time where it can: the sampling path waits meanwhile.
fn unpack(block: &Block, from: usize, slots: &mut [[u8; PAIR_BYTES]]) {
    let before_four = from.next_multiple_of(4) - from;
    let (first, slots) = slots.split_at_mut(before_four.min(slots.len()));
    unpack_few(block, from, first);
    let (fours, last) = slots.as_chunks_mut();
    let next = from + before_four;
    let threes = block.as_chunks().0.iter().skip(next / 4);
    unpack_few(block, next + 4 * fours.len(), last);
    for (three, four) in threes.zip(fours) {
        *four = unpack_four(three);
    }
}

/// Writes pairs of one four, from `from` on.
#[inline(always)]
fn unpack_few(block: &Block, from: usize, slots: &mut [[u8; PAIR_BYTES]]) {
    if slots.is_empty() {
        return;
    }
    let (threes, last) = block.as_chunks();
    let last = last.first().copied().unwrap_or(0);
    let four = threes.get(from / 4).map_or([signed(last); 4], unpack_four);
    for (slot, pair) in slots.iter_mut().zip(four.iter().skip(from % 4)) {
        *slot = *pair;
    }
}

#[inline(always)]
fn unpack_four(&[a, b, c]: &[u32; 3]) -> [[u8; PAIR_BYTES]; 4] {
    let d = a >> 12 & 0x000F_000F | b >> 8 & 0x00F0_00F0 | c >> 4 & 0x0F00_0F00;
    [a, b, c, d].map(signed)
}

/// A pair on the wire from its word: the sign is the twelfth bit of each half.
#[inline(always)]
fn signed(word: u32) -> [u8; PAIR_BYTES] {
    let v = (word as i32) << 20 >> 20;
    let i = (word as i32) << 4 >> 20;
    (v as u32 & 0xFFFF | (i as u32) << 16).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::boxed::Box;
    use std::vec;
    use std::vec::Vec;

    fn read(packed: &PackedBlocks, at: usize, n: usize) -> Vec<Pair> {
        let mut bytes = vec![0; 4 * n];
        packed.read(at, &mut bytes);
        let (pairs, _) = bytes.as_chunks();
        pairs
            .iter()
            .map(|&pair| Pair::from_le_bytes(pair))
            .collect()
    }

    /// Each code beside the bounds and signs of the other, in each place of four.
    #[test]
    fn every_code_comes_back_from_wherever_it_is_read() {
        let others = [CODE_MIN, -1, 0, CODE_MAX];
        let codes = (CODE_MIN..=CODE_MAX).flat_map(|v| others.map(|i| (v, i)));
        let pairs: Vec<_> = codes
            .flat_map(|(v, i)| [Pair { v, i }, Pair { v: i, i: v }])
            .collect();
        let mut packed = Box::new(PackedBlocks::blank());
        for shift in [0, 1] {
            for ordinary in [true, false] {
                let all = pairs.iter().skip(shift).chain(&pairs).copied();
                let blocks: Vec<Pair> = all.take(BLOCKS * ADC_LOCK_P).collect();
                let (blocks, _) = blocks.as_chunks();
                for (at, block) in blocks.iter().enumerate() {
                    assert!(packed.put(at, block, ordinary));
                }
                for at in 0..70 {
                    let expected = &blocks.as_flattened()[at..][..MAX_PAIRS];
                    assert!(read(&packed, at, MAX_PAIRS) == expected, "from {at}");
                }
            }
        }
    }

    /// A host may replay codes that no converter gives.
    #[test]
    fn codes_of_more_bits_end_at_the_bounds() {
        let mut packed = Box::new(PackedBlocks::blank());
        let of = |v, i| Pair { v, i };
        let mut wild = [of(i16::MAX, -3_000); ADC_LOCK_P];
        wild[1] = of(2_048, i16::MIN);
        wild[2] = of(-1, 2_048);
        assert!(packed.put(0, &wild, false));
        let bounded = [of(2_047, -2_048), of(2_047, -2_048), of(-1, 2_047)];
        assert_eq!(read(&packed, 0, 3), bounded);
    }

    #[test]
    fn behind_the_last_block_is_no_place() {
        let mut packed = Box::new(PackedBlocks::blank());
        let block = [Pair { v: 1, i: -1 }; ADC_LOCK_P];
        assert!(packed.put(BLOCKS - 1, &block, true));
        assert!(!packed.put(BLOCKS, &block, true) && !packed.put(usize::MAX, &block, false));
        let end = BLOCKS * ADC_LOCK_P;
        assert_eq!(read(&packed, end - 1, 2), [block[0], Pair::default()]);
    }
}
