//! Slow ADC: bus and mains voltage, as read by the board's third converter.

use ihd_firmware::sense::bus::BUS_MEAN;
use ihd_firmware::sense::mains::MAINS_FULL_SCALE_V;
use ihd_shared::sampling::{CODE_HALF_RANGE, CODE_MAX, CODE_MIN};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::dividers::DividedVoltages;
use super::front_end::BUS_FULL_SCALE_V;

/// White noise after the dividers' filters, standard deviation in codes.
const NOISE_CODES: f64 = 1.0;

/// Codes of the bus: 12 bit without a sign.
const BUS_CODES: f64 = 4_096.0;

/// Codes of one block.
#[derive(Clone, Copy, Debug)]
pub struct SlowBlock {
    /// Bus over the block's last switching period, from 0 on.
    pub bus: [u16; BUS_MEAN],
    /// Newest of the mains, with a sign.
    pub mains: i32,
}

/// Converter; deterministic for a seed.
#[derive(Clone, Debug)]
pub struct SlowAdc {
    rng: ChaCha8Rng,
}

impl SlowAdc {
    /// Creates one with a seed. Its noise differs from that of [`crate::adc::SimulatedAdc`] of the same seed.
    pub fn new(seed: u64) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(!seed),
        }
    }

    /// Codes of a block, as far as the firmware uses them.
    pub fn block(&mut self, divided: &DividedVoltages) -> SlowBlock {
        SlowBlock {
            bus: divided.bus_v.map(|bus_v| self.bus(bus_v)),
            mains: self.mains(divided.mains_v),
        }
    }

    /// Code of the bus voltage.
    pub fn bus(&mut self, bus_v: f64) -> u16 {
        let code = bus_v / BUS_FULL_SCALE_V * BUS_CODES + self.noise();
        code.round().clamp(0.0, BUS_CODES - 1.0) as u16
    }

    /// Code of the mains voltage.
    pub fn mains(&mut self, mains_v: f64) -> i32 {
        let code =
            (mains_v / MAINS_FULL_SCALE_V * f64::from(CODE_HALF_RANGE) + self.noise()).round();
        code.clamp(f64::from(CODE_MIN), f64::from(CODE_MAX)) as i32
    }

    fn noise(&mut self) -> f64 {
        let normal: f64 = StandardNormal.sample(&mut self.rng);
        NOISE_CODES * normal
    }
}

#[cfg(test)]
mod tests {
    use ihd_firmware::sense::bus::bus_dv;
    use ihd_firmware::sense::mains::ZeroCrossingDetector;
    use ihd_shared::sampling::{ADC_LOCK_P, block_ns};

    use super::*;
    use crate::mains::SimulatedMains;

    /// Each half-cycle has one crossing at any noise, within the noise over the slope of its time.
    #[test]
    fn the_detector_finds_each_crossing_once_and_in_its_place() {
        for (mains_hz, f_sw_hz) in [(50.0, 34_038), (60.0, 79_911), (50.0, 79_911)] {
            let (mains, mut adc) = (SimulatedMains::new(mains_hz), SlowAdc::new(7));
            let mut detector = ZeroCrossingDetector::default();
            let block_s = f64::from(block_ns(f_sw_hz)) * 1e-9;
            let mut found = 0;
            for block in 0..(1.0 / block_s) as u32 {
                let end_s = f64::from(block + 1) * block_s;
                let Some(at) = detector.on_block(adc.mains(mains.mains_v(end_s))) else {
                    continue;
                };
                found += 1;
                let at_s = (f64::from(block) + f64::from(at) / ADC_LOCK_P as f64) * block_s;
                let truth_s = f64::from(found) * mains.half_cycle_s();
                // 102 V/ms at 50 Hz are 0.52 codes/µs: four sigma of the noise are 8 µs.
                let error_s = (at_s - truth_s).abs();
                assert!(error_s < 10e-6, "{mains_hz} {found}: {error_s}");
            }
            assert!((f64::from(found) - 2.0 * mains_hz).abs() <= 1.0, "{found}");
        }
    }

    #[test]
    fn the_firmware_reads_the_bus_by_the_schematics_parts() {
        let mut adc = SlowAdc::new(1);
        for bus_v in [0.0, 100.0, 325.3, 418.4] {
            let sum: f64 = (0..1_000).map(|_| f64::from(bus_dv(adc.bus(bus_v)))).sum();
            // The firmware cuts a decivolt off; noise that is cut at 0 V has a mean of 0.05 V.
            let expected_v = bus_v - 0.05;
            let read_v = sum * 1e-4;
            assert!((read_v - expected_v).abs() < 0.12, "{bus_v}: {read_v}");
        }
        assert_eq!(adc.bus(600.0), 4_095);
    }
}
