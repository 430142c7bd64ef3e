//! Measurements over a mains half-cycle, from sums that grow block by block.

use ihd_shared::sampling::{
    ADC_LOCK_P, ANTI_ALIAS_HZ, CODE_BITS, I_FULL_SCALE_MA, Pair, V_FULL_SCALE_MV,
};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::messages::Limit;

use crate::estimate::ekf::Ekf;
use crate::fixed::Complex;
use crate::limits::{COMPARED_FROM_DV, HALF_CYCLE_MAX_NS, HALF_CYCLE_MIN_NS, POT_CURRENT_MIN_MA};
use crate::protect::soft_limit::SoftLimitCheck;
use crate::sense::correlation::BlockSums;
use crate::sense::demodulator::{Phasors, amplitude_ma};

/// Milliwatt of one code squared, times the codes' range squared.
const MILLIWATT: u64 = V_FULL_SCALE_MV as u64 * I_FULL_SCALE_MA as u64 / 1_000;

/// A mean of products is at most the range squared.
const _: () = assert!(MILLIWATT < 1 << (64 - 2 * (CODE_BITS - 1) as u32));

/// One block in so many counts for the offset: the mean over three whole periods.
const OFFSET_EVERY: u32 = 16;

/// One block in so many is looked at for codes beside zero, the first of them soon after the zero crossing, when the current is
/// small.
const NEAR_ZERO_EVERY: u32 = 16;
const NEAR_ZERO_FIRST: u32 = 8;

/// Codes beside zero: fewer than a converter lacks there of which bit 7 or a higher one sticks, 128 at the least, with the
/// correction for the supply (`sense::supply`) of 2.4 %. Of 61 samples a turn, a sine of up to 45 A has one on each side.
const NEAR_ZERO_CODES: u32 = 120;

/// Measurements over one mains half-cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HalfCycle {
    /// Half-cycles since boot.
    pub half_cycle: u32,
    /// Switching frequency in hertz; 0 with the inverter off.
    pub f_sw_hz: u32,
    /// Duration, in nanoseconds.
    pub duration_ns: u32,
    /// Estimated R at the crest of the current.
    pub r: MicroOhm,
    /// Estimated L at the crest of the current.
    pub l: PicoHenry,
    /// Largest amplitude of the current's fundamental, in milliampere; 0 when none was seen.
    pub i_crest_ma: u32,
    /// Mean power, in milliwatt, all harmonics included.
    pub power_mw: u32,
    /// Highest bus voltage, in decivolt.
    pub bus_peak_dv: u16,
    /// Bus voltage at the zero crossing that ended it, in decivolt.
    pub bus_at_crossing_dv: u16,
    /// Bus voltage where the current's amplitude was largest, in decivolt.
    pub bus_at_crest_dv: u16,
    /// Coil voltage and current where the current's amplitude was largest.
    pub crest: Phasors,
    /// Largest sample of the coil voltage where it reached its soft limit, in decivolt; else 0.
    pub v_peak_dv: u32,
    /// Smallest current at a turn-off, in milliampere; `i32::MAX` where none was seen.
    pub i_turn_off_min_ma: i32,
    /// The soft limit that acted last.
    pub limit: Limit,
    /// The drive changed within it: R, L and power are of no one frequency.
    pub disturbed: bool,
    /// It is a pot probe, from the zero crossing to before the crest.
    pub is_pot_probe: bool,
    /// Mean of the coil voltage, in decivolt.
    pub v_offset_dv: i32,
    /// Mean of the coil current, in milliampere.
    pub i_offset_ma: i32,
    /// The current has no code just below zero, or none just above: a bit of the converter sticks.
    pub i_gap: bool,
    /// Mean power out of the DC link, in milliwatt, where a sensor is fitted.
    pub dc_link_mw: Option<u32>,
}

impl HalfCycle {
    /// All bits zero, as the default.
    const BLANK: Self = Self {
        half_cycle: 0,
        f_sw_hz: 0,
        duration_ns: 0,
        r: MicroOhm(0),
        l: PicoHenry(0),
        i_crest_ma: 0,
        power_mw: 0,
        bus_peak_dv: 0,
        bus_at_crossing_dv: 0,
        bus_at_crest_dv: 0,
        crest: Phasors {
            v: Complex { re: 0, im: 0 },
            i: Complex { re: 0, im: 0 },
        },
        v_peak_dv: 0,
        i_turn_off_min_ma: 0,
        limit: Limit::None,
        disturbed: false,
        is_pot_probe: false,
        v_offset_dv: 0,
        i_offset_ma: 0,
        i_gap: false,
        dc_link_mw: None,
    };

    /// Returns `true` if it lasted as long as a mains' half-cycle does.
    pub fn is_in_time(&self) -> bool {
        (HALF_CYCLE_MIN_NS..=HALF_CYCLE_MAX_NS).contains(&self.duration_ns)
    }

    /// Returns `true` if the bus was high enough to compare readings with each other.
    pub fn is_comparable(&self) -> bool {
        self.bus_peak_dv >= COMPARED_FROM_DV
    }

    /// Returns `true` if the coil carried enough current to judge a load by.
    pub fn has_coil_current(&self) -> bool {
        self.i_crest_ma >= POT_CURRENT_MIN_MA
    }

    /// Amplitude of the coil voltage's fundamental at the crest, in decivolt.
    pub fn v_crest_dv(&self) -> u32 {
        crate::sense::demodulator::amplitude_dv(self.crest.v.norm_squared())
    }
}

/// Sums of the half-cycle under way.
#[derive(Clone, Debug, Default)]
pub struct HalfCycleAccumulator {
    crest_norm: u64,
    crest: HalfCycle,
    vi: i64,
    blocks: u32,
    turn_off_ma: Option<i32>,
    /// Sums of codes of the blocks that count for the offset, and their number.
    offsets: (i32, i32),
    offset_blocks: i32,
    /// The current had a code just below zero, and one from zero on.
    near_zero: (bool, bool),
    /// Σ of bus voltage times DC-link current, in decivolt milliampere, and the number of blocks with one.
    dc_link: u64,
    dc_link_blocks: u32,
}

impl HalfCycleAccumulator {
    /// All bits zero, as the default.
    pub(crate) const fn blank() -> Self {
        Self {
            crest_norm: 0,
            crest: HalfCycle::BLANK,
            vi: 0,
            blocks: 0,
            turn_off_ma: None,
            offsets: (0, 0),
            offset_blocks: 0,
            near_zero: (false, false),
            dc_link: 0,
            dc_link_blocks: 0,
        }
    }

    /// Adds one block, whether the inverter runs or not.
    pub fn add_block(&mut self, sums: &BlockSums, bus_dv: u16, dc_link_ma: Option<u32>) {
        // 28 bits a block of an ADC's codes: two weeks without a zero crossing.
        self.vi = self.vi.wrapping_add(sums.vi);
        self.blocks += 1;
        self.crest.bus_peak_dv = self.crest.bus_peak_dv.max(bus_dv);
        if sums.v_peak > 0 {
            let peak_dv = (u32::from(sums.v_peak) * (V_FULL_SCALE_MV / 100)) >> (CODE_BITS - 1);
            self.crest.v_peak_dv = self.crest.v_peak_dv.max(peak_dv);
        }
        if let Some(ma) = dc_link_ma {
            self.dc_link += u64::from(bus_dv) * u64::from(ma);
            self.dc_link_blocks += 1;
        }
    }

    /// Adds the codes of both channels for their offsets, in one block of sixteen.
    pub fn add_offsets(&mut self, pairs: &[Pair; ADC_LOCK_P]) {
        // 16 blocks of 61 codes of 12 bit a half-cycle, or some hundred without crossings: far from
        // 31 bit, and bounded all the same.
        if !self.blocks.is_multiple_of(OFFSET_EVERY) || self.offset_blocks > 1_000 {
            return;
        }
        // A load brings both channels.
        let (v, i) = Pair::words(pairs).iter().fold((0, 0), |(v, i), &word| {
            (v + i32::from(word as u16 as i16), i + (word as i32 >> 16))
        });
        self.offsets.0 += v;
        self.offsets.1 += i;
        self.offset_blocks += 1;
    }

    /// Looks for codes of the current on both sides of zero, in one block of sixteen, until both were seen.
    ///
    /// A bit that sticks at one leaves no codes from 0 to its weight, one that sticks at zero none as far below: of offset
    /// binary codes as of these, that differ in the sign's bit.
    pub fn look_near_zero(&mut self, pairs: &[Pair; ADC_LOCK_P]) {
        if self.near_zero == (true, true) || self.blocks % NEAR_ZERO_EVERY != NEAR_ZERO_FIRST {
            return;
        }
        let look = |(below, above), &word: &u32| {
            let code = word as i32 >> 16;
            (
                below | ((!code as u32) < NEAR_ZERO_CODES),
                above | ((code as u32) < NEAR_ZERO_CODES),
            )
        };
        self.near_zero = Pair::words(pairs).iter().fold(self.near_zero, look);
    }

    /// Adds the result of the soft limits.
    pub fn add_check(&mut self, checked: &SoftLimitCheck) {
        if let Some(ma) = checked.turn_off_ma {
            self.turn_off_ma = Some(self.turn_off_ma.map_or(ma, |least| least.min(ma)));
        }
        if checked.limit != Limit::None {
            self.crest.limit = checked.limit;
        }
    }

    /// The drive changes before the half-cycle is over.
    pub fn disturb(&mut self) {
        self.crest.disturbed = true;
    }

    /// Adds one estimate.
    pub fn add_estimate(&mut self, z: &Phasors, ekf: &Ekf, bus_dv: u16) {
        let norm = z.i.norm_squared();
        if norm > self.crest_norm && !ekf.is_held() {
            self.crest_norm = norm;
            self.crest.crest = *z;
            self.crest.bus_at_crest_dv = bus_dv;
            self.crest.r = ekf.r();
            self.crest.l = ekf.l();
        }
    }
}

/// Sums of a half-cycle that is over, for the thread to evaluate.
#[derive(Clone, Debug)]
pub struct HalfCycleSums(HalfCycleAccumulator);

impl HalfCycleSums {
    /// Evaluates the sums.
    pub fn evaluate(&self) -> HalfCycle {
        let sums = &self.0;
        let pairs = i64::from(sums.blocks.max(1)) * ADC_LOCK_P as i64;
        let power_mw = ((sums.vi / pairs).max(0) as u64 * MILLIWATT) >> (2 * (CODE_BITS - 1));
        // To a code: 0.3 V and 40 mA, of limits of 20 V and 3 A.
        let mean = |sum: i32, full_scale: u32| {
            let code = sum / (sums.offset_blocks.max(1) * ADC_LOCK_P as i32);
            // In 64 bits: a host may replay codes that no ADC has.
            ((i64::from(code) * i64::from(full_scale)) >> (CODE_BITS - 1)) as i32
        };
        let power_mw = unfiltered(power_mw, sums.crest.f_sw_hz);
        HalfCycle {
            power_mw: u32::try_from(power_mw).unwrap_or(u32::MAX),
            i_turn_off_min_ma: sums.turn_off_ma.unwrap_or(i32::MAX),
            v_offset_dv: mean(sums.offsets.0, V_FULL_SCALE_MV / 100),
            i_offset_ma: mean(sums.offsets.1, I_FULL_SCALE_MA),
            // A half-cycle in which nothing was looked at has no offset either.
            i_gap: sums.offset_blocks > 0 && sums.near_zero != (true, true),
            // Decivolt times milliampere are a tenth of a milliwatt.
            dc_link_mw: (sums.dc_link_blocks > 0)
                .then(|| (sums.dc_link / u64::from(sums.dc_link_blocks) / 10) as u32),
            i_crest_ma: amplitude_ma(sums.crest_norm),
            ..sums.crest
        }
    }
}

/// The half-cycle under way, and the last one until control takes it: two places that change their parts, so that a zero
/// crossing, the sampling path's longest block, copies nothing.
#[derive(Clone, Debug)]
pub struct HalfCycles {
    places: [HalfCycleAccumulator; 2],
    /// The second place has the half-cycle under way.
    in_second: bool,
    has_finished: bool,
}

impl HalfCycles {
    /// All bits zero: no block yet.
    pub(crate) const fn blank() -> Self {
        Self {
            places: [const { HalfCycleAccumulator::blank() }; 2],
            in_second: false,
            has_finished: false,
        }
    }

    /// Sums of the half-cycle under way.
    #[inline(always)]
    pub fn running(&mut self) -> &mut HalfCycleAccumulator {
        let [first, second] = &mut self.places;
        if self.in_second { second } else { first }
    }

    /// Begins anew; the last half-cycle stays.
    pub fn restart(&mut self) {
        *self.running() = HalfCycleAccumulator::blank();
    }

    /// Ends the half-cycle, keeps it in place of the last one and begins the next. No arithmetic here.
    #[inline]
    pub fn finish(
        &mut self,
        half_cycle: u32,
        f_sw_hz: u32,
        duration_ns: u32,
        bus_at_crossing_dv: u16,
        is_pot_probe: bool,
    ) {
        let over = &mut self.running().crest;
        over.half_cycle = half_cycle;
        over.f_sw_hz = f_sw_hz;
        over.duration_ns = duration_ns;
        over.bus_at_crossing_dv = bus_at_crossing_dv;
        over.is_pot_probe = is_pot_probe;
        self.in_second = !self.in_second;
        self.has_finished = true;
        self.restart();
    }

    /// The last half-cycle, once.
    pub fn take(&mut self) -> Option<HalfCycleSums> {
        let [first, second] = &self.places;
        let finished = if self.in_second { first } else { second };
        core::mem::take(&mut self.has_finished).then(|| HalfCycleSums(finished.clone()))
    }
}

/// The power before the anti-alias filters. The harmonics' power is a hundredth of it.
fn unfiltered(power_mw: u64, f_sw_hz: u32) -> u64 {
    power_mw + ((power_mw * u64::from(filter_loss_q16(f_sw_hz))) >> 16)
}

/// (f/f_c)² of the anti-alias filters, in 2⁻¹⁶: they leave 1/(1 + (f/f_c)²) of a product of two filtered quantities, the root of it
/// of one. 0.5 % at 34 kHz, 2.5 % at 80 kHz.
pub fn filter_loss_q16(f_sw_hz: u32) -> u32 {
    let share_q16 = (u64::from(f_sw_hz) << 16) / u64::from(ANTI_ALIAS_HZ);
    ((share_q16 * share_q16) >> 16) as u32
}

#[cfg(test)]
mod tests {
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
        // The filter lets 1/(1 + 0.09²) of it through.
        let expected = 200_000.0 * VOLT_PER_CODE * AMPERE_PER_CODE * 1e3 * (1.0 + 0.09f64.powi(2));
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
        let (v_dv, i_ma) = (32_767 * 6_400 / 2_048, -32_768_i64 * 80_000 / 2_048);
        assert_eq!((s.v_offset_dv, i64::from(s.i_offset_ma)), (v_dv, i_ma));
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
                (-1.0..=0.0).contains(&(f64::from(s.v_offset_dv) - v_dv)),
                "{v}: {} {v_dv}",
                s.v_offset_dv
            );
            assert!(
                (-1.0..=0.0).contains(&(f64::from(s.i_offset_ma) - i_ma)),
                "{i}: {} {i_ma}",
                s.i_offset_ma
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
        ended(&mut a, 0, 34_000, 10_000_000).i_gap
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
}
