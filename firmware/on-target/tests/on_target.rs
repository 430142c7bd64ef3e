//! Tests on the controller itself, one after the other, each after a reset: `probe-rs run` runs them on a board, `cargo xtask
//! target-tests` does that where there is one, and in QEMU where there is none.
#![no_std]
#![no_main]

/// The file of the board's image.
#[cfg(test)]
#[path = "../../src/board/dsp.rs"]
mod dsp;

#[cfg(test)]
#[embedded_test::tests]
mod tests {
    use ihd_firmware::sampling::path::SamplingPath;
    use ihd_firmware::sense::product_sums::{Bounds, PairArithmetic, PlainArithmetic};
    use ihd_on_target::digits;
    use ihd_shared::units::{MicroOhm, PicoHenry};
    use static_cell::ConstStaticCell;

    use crate::dsp::DspArithmetic;

    /// 53 KiB: never on the stack.
    static PATH: ConstStaticCell<SamplingPath<DspArithmetic>> =
        ConstStaticCell::new(SamplingPath::blank());

    fn path() -> &'static mut SamplingPath<DspArithmetic> {
        let path = PATH.take();
        path.begin(MicroOhm(4_000_000), PicoHenry(25_000_000));
        path
    }

    /// Fixed point is fixed: the compiler for this core and its instructions give the digits of the host's build.
    #[test]
    #[timeout(20)]
    fn the_estimator_gives_the_digits_of_the_host() {
        assert_eq!(digits::run(path()).crc, digits::EXPECTED);
    }

    /// SMLAD gives the bits of plain Rust: for any words, where sums wrap, where one slice is shorter, from wherever it is read.
    #[test]
    fn smlad_gives_the_bits_of_its_twin() {
        const EXTREMES: [u32; 4] = [0x8000_8000, 0x7FFF_8000, 0x8000_7FFF, 0xFFFF_0001];
        let mut noise = 1_u32;
        for round in 0..200 {
            let mut words = || {
                core::array::from_fn::<u32, 72, _>(|_| {
                    noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    let extreme = EXTREMES[(noise >> 30) as usize];
                    if round < 100 { extreme } else { noise }
                })
            };
            let (pairs, factors) = (words(), words());
            let (n, m) = (round % 6, round / 6 % 6);
            let (pairs, _) = pairs[round % 12..][..12 * n].as_chunks();
            let (factors, _) = factors[..12 * m].as_chunks();
            let sums = DspArithmetic::product_sums(pairs, factors);
            let expected = PlainArithmetic::product_sums(pairs, factors);
            assert_eq!(sums, expected, "round {round}");
        }
    }

    /// Every code of either half is beyond its bounds where its magnitude is, wherever its word stands.
    #[test]
    #[timeout(60)]
    fn no_half_beyond_its_bounds_is_missed() {
        let reach = [1_899, 1_499];
        let bounds = Bounds::new(reach[0], reach[1]);
        for code in i16::MIN..=i16::MAX {
            for (shift, reach) in [0, 16].into_iter().zip(reach) {
                let mut words = [0x0001_FFFF; 24];
                let magnitude = code.unsigned_abs();
                let at = usize::from(magnitude) % words.len();
                words[at] &= !(0xFFFF << shift);
                words[at] |= u32::from(code as u16) << shift;
                let is_beyond = DspArithmetic::is_any_beyond(words.as_chunks().0, bounds);
                assert_eq!(is_beyond, magnitude > reach, "{code} << {shift}");
            }
        }
        assert!(!DspArithmetic::is_any_beyond(&[], bounds));
    }

    /// Index out of range is a panic here too, and a panic fails a test: else none above could.
    #[test]
    #[should_panic]
    fn a_panic_is_seen() {
        let pairs = digits::block(0, &mut 1);
        let at = core::hint::black_box(pairs.len());
        let _ = core::hint::black_box(pairs[at]);
    }

    /// DBGMCU_IDCODE (RM0440, 47.6.1): the tests run on the part that they are for.
    #[cfg(feature = "stm32g474")]
    #[test]
    fn the_chip_is_an_stm32g474() {
        // SAFETY: a register that only reads, at an address that the bus matrix always answers.
        let id = unsafe { core::ptr::read_volatile(0xE004_2000 as *const u32) };
        assert_eq!(id & 0xFFF, ihd_shared::image::DEVICE_ID);
    }

    /// A block at 80 kHz lasts 6 375 cycles of 170 MHz. Here the core runs from HSI16 without wait states, which the emulated
    /// chip counts with 3 090 cycles (docs/performance.md); half as much again is a defect of one of them.
    #[cfg(feature = "stm32g474")]
    #[test]
    #[timeout(20)]
    fn a_block_takes_the_cycles_that_the_emulated_chip_counts() {
        let mut core = cortex_m::Peripherals::take().unwrap();
        core.DCB.enable_trace();
        core.DWT.enable_cycle_counter();
        let path = path();
        digits::run(path);
        let pairs = digits::block(100, &mut 1);
        let before = cortex_m::peripheral::DWT::cycle_count();
        core::hint::black_box(path.replay_block(&ihd_firmware::sampling::path::AdcBlock {
            pairs: core::hint::black_box(&pairs),
            zero_crossing: None,
            bus: ihd_firmware::sense::bus::BusReading::steady(3_000),
            dc_link_ma: None,
            lost: 0,
        }));
        let cycles = cortex_m::peripheral::DWT::cycle_count().wrapping_sub(before);
        assert!((1_500..4_650).contains(&cycles), "{cycles} cycles");
    }
}
