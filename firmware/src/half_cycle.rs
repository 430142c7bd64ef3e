//! One mains half-cycle in numbers, gathered block by block.

use ihd_shared::sampling::{ADC_LOCK_P, CODE_BITS, I_FULL_SCALE_MA, V_FULL_SCALE_MV};
use ihd_shared::units::{MicroOhm, PicoHenry};

use crate::demod::{BlockSums, Phasors, amplitude_ma};
use crate::ekf::Ekf;

/// Milliwatt of one code squared, times the codes' range squared.
const MILLIWATT: u64 = V_FULL_SCALE_MV as u64 * I_FULL_SCALE_MA as u64 / 1_000;

/// A mean of products is at most the range squared.
const _: () = assert!(MILLIWATT < 1 << (64 - 2 * (CODE_BITS - 1) as u32));

/// What the sampling path hands to power control and telemetry after each half-cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Summary {
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
}

/// Gathers a [`Summary`].
#[derive(Clone, Debug, Default)]
pub struct Accumulator {
    crest_norm: u64,
    crest: Summary,
    vi: i64,
    blocks: u32,
}

impl Accumulator {
    /// As the default.
    pub(crate) const fn blank() -> Self {
        Self {
            crest_norm: 0,
            crest: Summary {
                half_cycle: 0,
                f_sw_hz: 0,
                duration_ns: 0,
                r: MicroOhm(0),
                l: PicoHenry(0),
                i_crest_ma: 0,
                power_mw: 0,
                bus_peak_dv: 0,
            },
            vi: 0,
            blocks: 0,
        }
    }

    /// Adds one block, whether the inverter runs or not.
    pub fn add_block(&mut self, sums: &BlockSums, bus_dv: u16) {
        self.vi = self.vi.saturating_add(sums.vi);
        self.blocks += 1;
        self.crest.bus_peak_dv = self.crest.bus_peak_dv.max(bus_dv);
    }

    /// Adds one estimate.
    pub fn add_estimate(&mut self, z: &Phasors, ekf: &Ekf) {
        let norm = z.i.norm_squared();
        if norm > self.crest_norm && !ekf.is_held() {
            self.crest_norm = norm;
            self.crest.r = ekf.r();
            self.crest.l = ekf.l();
        }
    }

    /// The summary of what was added, and a fresh start.
    pub fn finish(&mut self, half_cycle: u32, f_sw_hz: u32, duration_ns: u32) -> Summary {
        let pairs = i64::from(self.blocks.max(1)) * ADC_LOCK_P as i64;
        let power_mw = ((self.vi / pairs).max(0) as u64 * MILLIWATT) >> (2 * (CODE_BITS - 1));
        let summary = Summary {
            half_cycle,
            f_sw_hz,
            duration_ns,
            power_mw: u32::try_from(power_mw).unwrap_or(u32::MAX),
            // Here and not at every block of a rising current: a square root takes its time.
            i_crest_ma: amplitude_ma(self.crest_norm),
            ..self.crest
        };
        *self = Self::default();
        summary
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ihd_shared::sampling::{AMPERE_PER_CODE, VOLT_PER_CODE};

    #[test]
    fn power_is_the_mean_product() {
        let mut a = Accumulator::default();
        let sums = BlockSums {
            vi: 61 * 200_000,
            ..BlockSums::default()
        };
        for _ in 0..150 {
            a.add_block(&sums, 3_000);
        }
        let s = a.finish(7, 45_000, 10_000_000);
        let expected = 200_000.0 * VOLT_PER_CODE * AMPERE_PER_CODE * 1e3;
        assert!((f64::from(s.power_mw) / expected - 1.0).abs() < 1e-5);
        assert_eq!((s.half_cycle, s.bus_peak_dv), (7, 3_000));
        assert_eq!(a.finish(8, 0, 0).power_mw, 0, "it must start afresh");
    }

    #[test]
    fn power_flowing_back_reads_as_none() {
        let mut a = Accumulator::default();
        a.add_block(
            &BlockSums {
                vi: -5_000_000,
                ..BlockSums::default()
            },
            0,
        );
        assert_eq!(a.finish(0, 45_000, 0).power_mw, 0);
    }
}
