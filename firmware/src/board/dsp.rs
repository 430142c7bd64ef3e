//! Instructions of the Cortex-M4 for two 16-bit halves at once: SMLAD multiplies two pairs and adds both products; SADD16 and UQSUB16 see
//! if a half is out of bounds.

use core::arch::asm;

use ihd_firmware::sense::product_sums::{Bounds, PairArithmetic, ProductSums};

/// Nine instructions for two sample pairs, five of them SMLAD. firmware/on-target compares it with its twin in plain Rust.
pub struct DspArithmetic;

impl PairArithmetic for DspArithmetic {
    #[inline(always)]
    fn product_sums(pairs: &[[u32; 12]], factors: &[[u32; 12]]) -> ProductSums {
        let mut sums = ProductSums::default();
        let pairs = &pairs[..pairs.len().min(factors.len())];
        let range = pairs.as_ptr_range();
        if range.is_empty() {
            return sums;
        }
        // SAFETY: reads the words from the first of `pairs` to before `range.end`, at least twelve and a multiple of that, and as
        // many of `factors`, which has them; writes registers alone. Of the flags SMLAD sets Q, which nothing reads (Armv7-M with
        // the DSP extension, A7.7).
        unsafe {
            asm!(
                "2:",
                ".rept 6",
                "ldrd {a}, {b}, [{pair}], #8",
                "pkhbt {v}, {a}, {b}, lsl #16",
                "pkhtb {b}, {b}, {a}, asr #16",
                "ldrd {a}, {s}, [{factor}], #8",
                "smlad {v_c}, {v}, {a}, {v_c}",
                "smlad {i_c}, {b}, {a}, {i_c}",
                "smlad {v_s}, {v}, {s}, {v_s}",
                "smlad {i_s}, {b}, {s}, {i_s}",
                "smlad {v_i}, {v}, {b}, {v_i}",
                ".endr",
                "cmp {pair}, {end}",
                "bne 2b",
                pair = inout(reg) range.start => _,
                factor = inout(reg) factors.as_ptr() => _,
                end = in(reg) range.end,
                a = out(reg) _,
                b = out(reg) _,
                s = out(reg) _,
                v = out(reg) _,
                v_c = inout(reg) sums.v_c,
                i_c = inout(reg) sums.i_c,
                v_s = inout(reg) sums.v_s,
                i_s = inout(reg) sums.i_s,
                v_i = inout(reg) sums.v_i,
                options(pure, readonly, nostack),
            );
        }
        sums
    }

    #[inline(always)]
    fn is_any_beyond(words: &[[u32; 12]], bounds: Bounds) -> bool {
        let range = words.as_ptr_range();
        if range.is_empty() {
            return false;
        }
        let (reach, span) = bounds.words();
        let mut beyond = 0_u32;
        // SAFETY: reads the words from the first to before `range.end`, at least twelve and a multiple of that; writes registers
        // alone. UQSUB16 leaves of a half what is above `span`. Of the flags SADD16 sets GE, which nothing reads (Armv7-M with the
        // DSP extension, A7.7).
        unsafe {
            asm!(
                "2:",
                ".rept 2",
                "ldmia {word}!, {{r0, r1, r2, r3, r4, r5}}",
                ".irp half, r0, r1, r2, r3, r4, r5",
                "sadd16 \\half, \\half, {reach}",
                "uqsub16 \\half, \\half, {span}",
                "orr {beyond}, {beyond}, \\half",
                ".endr",
                ".endr",
                "cmp {word}, {end}",
                "bne 2b",
                word = inout(reg) range.start => _,
                end = in(reg) range.end,
                reach = in(reg) reach,
                span = in(reg) span,
                beyond = inout(reg) beyond,
                out("r0") _,
                out("r1") _,
                out("r2") _,
                out("r3") _,
                out("r4") _,
                out("r5") _,
                options(pure, readonly, nostack),
            );
        }
        beyond != 0
    }
}
