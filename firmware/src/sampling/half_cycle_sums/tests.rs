use super::*;
use crate::sense::supply::SupplyScale;
use ihd_shared::sampling::{ADC_LOCK_Q, AMPERE_PER_CODE, CODE_HALF_RANGE, VOLT_PER_CODE};
use std::f64::consts::{PI, TAU};

/// Half-cycle that ends here, as the thread evaluates it.
fn ended(a: &mut HalfCycles, half_cycle: u32, f_sw_hz: u32, duration_ns: u32) -> HalfCycle {
    a.finish(half_cycle, f_sw_hz, duration_ns, 0, false);
    a.take().expect("one has ended").evaluate()
}

#[test]
fn power_is_the_mean_product() {
    let mut a = HalfCycles::blank();
    let sums = BlockSums {
        vi: 61 * 200_000,
        ..BlockSums::default()
    };
    for _ in 0..150 {
        a.running().add_block(&sums, 3_000, None);
    }
    let s = ended(&mut a, 7, 45_000, 10_000_000);
    // The filter lets 1/(1 + (f_sw/f_c)²) of it through.
    let unfiltered = 1.0 + (45e3 / f64::from(ANTI_ALIAS_HZ)).powi(2);
    let expected = 200_000.0 * VOLT_PER_CODE * AMPERE_PER_CODE * 1e3 * unfiltered;
    assert!((f64::from(s.power_mw) / expected - 1.0).abs() < 1e-4);
    assert_eq!((s.half_cycle, s.bus_peak_dv), (7, 3_000));
    let afresh = ended(&mut a, 8, 0, 0);
    assert_eq!(afresh.power_mw, 0, "it must start afresh");
    assert!(a.take().is_none(), "each is taken once");
}

/// A host replays what it likes.
#[test]
fn codes_that_no_adc_has_overflow_nothing() {
    let mut a = HalfCycles::blank();
    let (v, i) = (i16::MAX, i16::MIN);
    for _ in 0..20_000 {
        a.running().add_block(&BlockSums::default(), 0, None);
        a.running().add_offsets(&[Pair { v, i }; ADC_LOCK_P]);
    }
    let s = ended(&mut a, 0, 45_000, 10_000_000);
    let (v_dv, i_ma) = (
        32_767 * V_FULL_SCALE_DV as i32 / 2_048,
        -16 * i64::from(I_FULL_SCALE_MA),
    );
    assert_eq!(
        (s.channels.v_offset_dv, i64::from(s.channels.i_offset_ma)),
        (v_dv, i_ma)
    );
}

#[test]
fn offsets_are_the_means_of_both_channels() {
    for (v, i) in [
        (100, -50),
        (-3, 3),
        (-2_048, 2_047),
        (2_047, -2_048),
        (0, -1),
    ] {
        let mut a = HalfCycles::blank();
        for block in 0..3 * OFFSET_EVERY as i16 {
            a.running().add_block(&BlockSums::default(), 0, None);
            // Around the mean, and unlike from pair to pair, as far as the range allows.
            let swing = |mean: i16, k: usize| match mean.unsigned_abs() {
                2_000.. => mean,
                _ => mean + (k as i16 - 30) * (1 + block % 3),
            };
            let pairs = core::array::from_fn(|k| Pair {
                v: swing(v, k),
                i: swing(i, ADC_LOCK_P - 1 - k),
            });
            a.running().add_offsets(&pairs);
        }
        let s = ended(&mut a, 0, 45_000, 10_000_000);
        let (v_dv, i_ma) = (
            f64::from(v) * VOLT_PER_CODE * 10.0,
            f64::from(i) * AMPERE_PER_CODE * 1e3,
        );
        // Rounded down.
        assert!(
            (-1.0..=0.0).contains(&(f64::from(s.channels.v_offset_dv) - v_dv)),
            "{v}: {} {v_dv}",
            s.channels.v_offset_dv
        );
        assert!(
            (-1.0..=0.0).contains(&(f64::from(s.channels.i_offset_ma) - i_ma)),
            "{i}: {} {i_ma}",
            s.channels.i_offset_ma
        );
    }
}

/// A half-cycle of a coil current with this crest and mean, of a converter that does `fault` to its offset binary codes, at a
/// supply that is corrected.
fn has_gap(crest_a: f64, mean_a: f64, supply: f64, fault: impl Fn(u16) -> u16) -> bool {
    let scale = SupplyScale::from_bits((supply * 65_536.0) as u32);
    let blocks = 113;
    let mut a = HalfCycles::blank();
    for block in 0..blocks {
        let envelope_a = crest_a * (PI * f64::from(block) / f64::from(blocks)).sin();
        let pairs = core::array::from_fn(|n| {
            let turns = f64::from(ADC_LOCK_Q) * n as f64 / ADC_LOCK_P as f64;
            let i_a = mean_a + envelope_a * (TAU * turns + 0.7).sin();
            let code = (i_a / AMPERE_PER_CODE / supply).round() as i16;
            let i = fault((code + CODE_HALF_RANGE) as u16) as i16 - CODE_HALF_RANGE;
            let scaled = scale.pair((i as u16 as u32) << 16);
            Pair {
                v: 0,
                i: (scaled as i32 >> 16) as i16,
            }
        });
        a.running().add_block(&BlockSums::default(), 0, None);
        a.running().add_offsets(&pairs);
        a.running().look_near_zero(&pairs);
    }
    ended(&mut a, 0, 34_000, 10_000_000).channels.i_gap
}

#[test]
fn a_bit_that_sticks_leaves_a_gap_beside_zero() {
    for crest_a in [6.0, 22.0, 40.0, 70.0] {
        for supply in [0.976, 0.999, 1.0, 1.001, 1.024] {
            for mean_a in [-2.9, 0.0, 2.9] {
                let gap = has_gap(crest_a, mean_a, supply, |code| code);
                assert!(!gap, "{crest_a} {supply} {mean_a}");
            }
            for bit in 7..12 {
                assert!(
                    has_gap(crest_a, 0.0, supply, |code| code | 1 << bit),
                    "bit {bit} at one: {crest_a} {supply}"
                );
                assert!(
                    has_gap(crest_a, 0.0, supply, |code| code & !(1 << bit)),
                    "bit {bit} at zero: {crest_a} {supply}"
                );
            }
        }
    }
}

#[test]
fn power_flowing_back_reads_as_none() {
    let mut a = HalfCycles::blank();
    a.running().add_block(
        &BlockSums {
            vi: -5_000_000,
            ..BlockSums::default()
        },
        0,
        None,
    );
    assert_eq!(ended(&mut a, 0, 45_000, 0).power_mw, 0);
}
