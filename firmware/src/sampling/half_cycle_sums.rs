//! Sums of the half-cycle under way, that grow block by block, and their evaluation.

use ihd_shared::sampling::{
    ADC_LOCK_P, ANTI_ALIAS_HZ, CODE_BITS, I_FULL_SCALE_MA, Pair, V_FULL_SCALE_MV,
};
use ihd_shared::window::TrajectoryEntry;
use ihd_shared::wire::messages::Limit;

use crate::protect::soft_limit::SoftLimitCheck;
use crate::sampling::half_cycle::{ChannelDefects, CurrentCrest, HalfCycle};
use crate::sense::bus::BusReading;
use crate::sense::correlation::BlockSums;
use crate::sense::current_transformer::true_power_mw;
use crate::sense::demodulator::{Phasors, amplitude_ma, norm_of_ma};

/// Half the input range of the coil voltage, in decivolt.
const V_FULL_SCALE_DV: u32 = (V_FULL_SCALE_MV + 50) / 100;

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

/// Sums of the half-cycle under way.
#[derive(Clone, Debug, Default)]
pub struct HalfCycleAccumulator {
    crest_norm: u64,
    /// Results that need no evaluation at the end.
    result: HalfCycle,
    vi: i64,
    blocks: u32,
    /// `i32::MAX` less the smallest current at a turn-off, in milliampere: 0 where none was seen, so that a blank one is cleared at once.
    below_max_ma: u32,
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
            result: HalfCycle::BLANK,
            vi: 0,
            blocks: 0,
            below_max_ma: 0,
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
        self.result.bus_peak_dv = self.result.bus_peak_dv.max(bus_dv);
        if sums.v_peak > 0 {
            let peak_dv = (u32::from(sums.v_peak) * V_FULL_SCALE_DV) >> (CODE_BITS - 1);
            self.result.v_peak_dv = self.result.v_peak_dv.max(peak_dv);
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

    /// Returns `true` once the amplitude of the coil current has been so large, in milliampere.
    pub fn has_reached(&self, i_ma: u32) -> bool {
        self.crest_norm >= norm_of_ma(i_ma)
    }

    /// Adds the result of the soft limits.
    pub fn add_check(&mut self, checked: &SoftLimitCheck) {
        if let Some(ma) = checked.turn_off_ma {
            self.below_max_ma = self.below_max_ma.max(i32::MAX.wrapping_sub(ma) as u32);
        }
        if checked.limit != Limit::None {
            self.result.limit = checked.limit;
        }
    }

    /// Marks the half-cycle as disturbed: the drive changes within it.
    pub fn disturb(&mut self) {
        self.result.disturbed = true;
    }

    /// Adds one estimate that was not held.
    pub fn add_estimate(&mut self, z: &Phasors, load: TrajectoryEntry, bus: &BusReading) {
        let norm = z.i.norm_squared();
        if norm > self.crest_norm {
            self.crest_norm = norm;
            self.result.crest.phasors = *z;
            self.result.crest.bus = *bus;
            self.result.crest.r = load.r;
            self.result.crest.l = load.l;
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
        let crest = &sums.result.crest;
        let power_mw = true_power_mw(unfiltered(power_mw, sums.result.f_sw_hz), crest.r, crest.l);
        HalfCycle {
            power_mw: u32::try_from(power_mw).unwrap_or(u32::MAX),
            i_turn_off_min_ma: i32::MAX.wrapping_sub(sums.below_max_ma as i32),
            channels: ChannelDefects {
                v_offset_dv: mean(sums.offsets.0, V_FULL_SCALE_DV),
                i_offset_ma: mean(sums.offsets.1, I_FULL_SCALE_MA),
                // A half-cycle in which nothing was looked at has no offset either.
                i_gap: sums.offset_blocks > 0 && sums.near_zero != (true, true),
            },
            // Decivolt times milliampere are a tenth of a milliwatt.
            dc_link_mw: (sums.dc_link_blocks > 0)
                .then(|| (sums.dc_link / u64::from(sums.dc_link_blocks) / 10) as u32),
            crest: CurrentCrest {
                i_ma: amplitude_ma(sums.crest_norm),
                ..sums.result.crest
            },
            ..sums.result
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

    /// Begins anew with samples of another source; a half-cycle that was not taken is dropped.
    pub fn restart(&mut self) {
        self.has_finished = false;
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
        let over = &mut self.running().result;
        over.half_cycle = half_cycle;
        over.f_sw_hz = f_sw_hz;
        over.duration_ns = duration_ns;
        over.bus_at_crossing_dv = bus_at_crossing_dv;
        over.is_pot_probe = is_pot_probe;
        self.in_second = !self.in_second;
        self.has_finished = true;
        *self.running() = HalfCycleAccumulator::blank();
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
mod tests;
