//! Sums of products of sample pairs, two pairs at once.
//!
//! The Cortex-M4 has an instruction for it, SMLAD, that stable Rust has no function for: a board brings it (`src/board/dsp.rs`) as
//! [`PairArithmetic`] of its sampling path. Everything else takes [`PlainArithmetic`], which gives the same bits.

/// Sums over sample pairs (v, i) with the factors c and s of each pair; they wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ProductSums {
    /// Σ v·c.
    pub v_c: i32,
    /// Σ v·s.
    pub v_s: i32,
    /// Σ i·c.
    pub i_c: i32,
    /// Σ i·s.
    pub i_s: i32,
    /// Σ v·i.
    pub v_i: i32,
}

/// Word of two halves.
pub const fn halves(low: i16, high: i16) -> u32 {
    low as u16 as u32 | (high as u16 as u32) << 16
}

/// Signed lower half of a word.
#[inline(always)]
pub fn low(word: u32) -> i32 {
    i32::from(word as u16 as i16)
}

/// Signed upper half of a word.
#[inline(always)]
pub fn high(word: u32) -> i32 {
    word as i32 >> 16
}

/// Arithmetic on words of two halves: [`ProductSums`], and codes beyond [`Bounds`].
pub trait PairArithmetic {
    /// Sums over pairs with v in the lower half of each word and i in the upper one. For two pairs `factors` has a word with c of
    /// the first in its lower half and c of the second in its upper one, and a word of the same with s. What one of the two has
    /// more than the other does not count.
    fn product_sums(pairs: &[[u32; 12]], factors: &[[u32; 12]]) -> ProductSums;

    /// Returns `true` if a half of any word is beyond its bounds.
    fn is_any_beyond(words: &[[u32; 12]], bounds: Bounds) -> bool;
}

/// Symmetric bounds of both halves of a word, packed like it: halves from −`reach` to `reach` are within.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    reach: u32,
    /// Twice `reach`: a half plus `reach`, without a sign, is at most that.
    span: u32,
}

impl Bounds {
    /// Bounds from −`low` to `low` of the lower half, and likewise of the upper one; below 2^14 each.
    pub const fn new(low: u16, high: u16) -> Self {
        assert!(low < 1 << 14 && high < 1 << 14);
        let reach = halves(low as i16, high as i16);
        Self {
            reach,
            span: reach << 1,
        }
    }

    /// Words with `reach` and `span`.
    pub fn words(self) -> (u32, u32) {
        (self.reach, self.span)
    }

    /// Returns `true` if a half of the word is beyond its bounds.
    #[inline(always)]
    pub fn is_beyond(self, word: u32) -> bool {
        let beyond = |shift: u32| {
            let half = |word: u32| (word >> shift) as u16;
            half(word).wrapping_add(half(self.reach)) > half(self.span)
        };
        beyond(0) | beyond(16)
    }
}

/// Arithmetic of any processor.
#[derive(Clone, Copy, Debug)]
pub struct PlainArithmetic;

impl PairArithmetic for PlainArithmetic {
    fn product_sums(pairs: &[[u32; 12]], factors: &[[u32; 12]]) -> ProductSums {
        let (pairs, _) = pairs.as_flattened().as_chunks();
        let (factors, _) = factors.as_flattened().as_chunks();
        let mut sums = ProductSums::default();
        for (&[first, second], &[c, s]) in pairs.iter().zip(factors) {
            let add = |sum: &mut i32, a: [i32; 2], b: [i32; 2]| {
                *sum = sum.wrapping_add(a[0] * b[0]).wrapping_add(a[1] * b[1]);
            };
            let (v, i) = ([low(first), low(second)], [high(first), high(second)]);
            let [c, s] = [c, s].map(|word| [low(word), high(word)]);
            add(&mut sums.v_c, v, c);
            add(&mut sums.v_s, v, s);
            add(&mut sums.i_c, i, c);
            add(&mut sums.i_s, i, s);
            add(&mut sums.v_i, v, i);
        }
        sums
    }

    fn is_any_beyond(words: &[[u32; 12]], bounds: Bounds) -> bool {
        let words = words.as_flattened().iter();
        words.fold(false, |any, &word| any | bounds.is_beyond(word))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ihd_shared::sampling::Pair;

    /// Each of the five sums is that of one factor's products, with the other codes and factors there.
    #[test]
    fn each_sum_is_that_of_its_products() {
        let code = |k: i32, of: i32| (of * (k * k + 7 * k - 300)) as i16;
        let pairs: [Pair; 24] = core::array::from_fn(|k| Pair {
            v: code(k as i32, 3),
            i: code(k as i32, -2),
        });
        let (c, s) = (|k| code(k, 11), |k| code(23 - k, 13));
        let of_two = |first: i16, second: i16| first as u16 as u32 | (second as u16 as u32) << 16;
        let words = pairs.map(|pair| of_two(pair.v, pair.i));
        let factors: [u32; 24] = core::array::from_fn(|n| {
            let k = (n as i32) & !1;
            let of = |f: &dyn Fn(i32) -> i16| of_two(f(k), f(k + 1));
            if n % 2 == 0 { of(&c) } else { of(&s) }
        });
        let sum = |product: &dyn Fn(i32, Pair) -> i32| {
            (0..).zip(pairs).map(|(k, pair)| product(k, pair)).sum()
        };
        let (v, i) = (
            |pair: Pair| i32::from(pair.v),
            |pair: Pair| i32::from(pair.i),
        );
        let expected = ProductSums {
            v_c: sum(&|k, pair| v(pair) * i32::from(c(k))),
            v_s: sum(&|k, pair| v(pair) * i32::from(s(k))),
            i_c: sum(&|k, pair| i(pair) * i32::from(c(k))),
            i_s: sum(&|k, pair| i(pair) * i32::from(s(k))),
            v_i: sum(&|_, pair| v(pair) * i(pair)),
        };
        let sums = |pairs: &[u32], factors: &[u32]| {
            PlainArithmetic::product_sums(pairs.as_chunks().0, factors.as_chunks().0)
        };
        assert_eq!(sums(&words, &factors), expected);
        assert_eq!(sums(&words, &factors[..12]), sums(&words[..12], &factors));
        assert_eq!(sums(&words, &[]), ProductSums::default());
    }
}
