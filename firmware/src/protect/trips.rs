//! Trips: checks that open both switches within a block, whatever link or lookup say.
//!
//! The comparator on the current and the HRTIM fault input act first, in hardware; these are the
//! checks a block later. Their levels are in [`crate::limits`].

use ihd_shared::fault::Fault;
use ihd_shared::units::PicoHenry;

use crate::estimate::ekf::Ekf;
use crate::estimate::tank::resonant_inductance;
use crate::fixed::Complex;
use crate::limits::{
    BUS_SURGE_NS, BUS_TRIP_DV, ESTIMATE_BLOCKS, FROZEN_BLOCKS, LOST_BLOCKS, MAINS_LOST_NS,
    SATURATED_PAIRS, TRIP_PAIRS,
};
use crate::sense::correlation::BlockSums;

/// Checks that need memory.
#[derive(Clone, Debug, Default)]
pub struct TripChecks {
    lost_blocks: u32,
    since_zero_crossing_ns: u32,
    /// Time that the bus has been too high while the bridge does not switch.
    surge_ns: u32,
    below_resonance: u8,
    at_bound: u8,
    /// The last block's sums, and blocks in a row that were alike.
    last: (Complex, Complex),
    alike: u8,
    /// Below this inductance the inverter runs below resonance.
    l_min: PicoHenry,
}

impl TripChecks {
    /// All bits zero, as the default.
    pub(crate) const fn blank() -> Self {
        Self {
            lost_blocks: 0,
            since_zero_crossing_ns: 0,
            surge_ns: 0,
            below_resonance: 0,
            at_bound: 0,
            last: (Complex { re: 0, im: 0 }, Complex { re: 0, im: 0 }),
            alike: 0,
            l_min: PicoHenry(0),
        }
    }

    /// Counts blocks that are missing before the next one.
    pub fn lose_blocks(&mut self, lost: u32) {
        self.lost_blocks = self.lost_blocks.saturating_add(lost);
    }

    /// Checks raw samples and timing of one block. While the bridge is `switching`, no two blocks are alike: the mains moves on.
    pub fn check_block(
        &mut self,
        sums: &BlockSums,
        bus_dv: u16,
        block_ns: u32,
        zero_crossing: bool,
        switching: bool,
    ) -> Option<Fault> {
        let late = self.lost_blocks > LOST_BLOCKS;
        let now = (sums.v, sums.i);
        let alike = switching && now == core::mem::replace(&mut self.last, now);
        self.alike = if alike {
            self.alike.saturating_add(1)
        } else {
            0
        };
        if zero_crossing {
            self.since_zero_crossing_ns = 0;
            self.lost_blocks = 0;
        } else {
            self.since_zero_crossing_ns = self.since_zero_crossing_ns.saturating_add(block_ns);
        }
        self.surge_ns = if bus_dv >= BUS_TRIP_DV && !switching {
            self.surge_ns.saturating_add(block_ns)
        } else {
            0
        };
        let over_voltage = bus_dv >= BUS_TRIP_DV && (switching || self.surge_ns > BUS_SURGE_NS);
        if sums.saturated >= SATURATED_PAIRS {
            Some(Fault::SENSOR_SATURATED)
        } else if sums.i_beyond >= TRIP_PAIRS {
            Some(Fault::OVER_CURRENT)
        } else if over_voltage {
            Some(Fault::BUS_OVER_VOLTAGE)
        } else if late {
            Some(Fault::SAMPLES_LOST)
        } else if self.alike >= FROZEN_BLOCKS {
            Some(Fault::SAMPLES_FROZEN)
        } else if !self.has_mains() {
            Some(Fault::MAINS_LOST)
        } else {
            None
        }
    }

    /// Returns `true` while zero crossings of the mains come.
    pub fn has_mains(&self) -> bool {
        self.since_zero_crossing_ns <= MAINS_LOST_NS
    }

    /// Sets the switching frequency: computes the resonant inductance, and restarts both counts.
    pub fn set_frequency(&mut self, f_sw_hz: u32) {
        self.l_min = resonant_inductance(f_sw_hz);
        self.below_resonance = 0;
        self.at_bound = 0;
    }

    /// The inductance that resonates at the frequency in force.
    pub fn l_min(&self) -> PicoHenry {
        self.l_min
    }

    /// Checks the estimate after a block that was not held.
    pub fn check_estimate(&mut self, ekf: &Ekf) -> Option<Fault> {
        let count = |counter: &mut u8, bad: bool| {
            *counter = if bad { counter.saturating_add(1) } else { 0 };
            *counter >= ESTIMATE_BLOCKS
        };
        // An empty coil's R is next to nothing, and its L far from any harm: no pot, but no fault.
        let harmless = ekf.l().0 >= 2 * self.l_min.0;
        if count(&mut self.at_bound, ekf.is_at_bound() && !harmless) {
            Some(Fault::ESTIMATOR_DIVERGED)
        } else if count(&mut self.below_resonance, ekf.l() < self.l_min) {
            Some(Fault::BELOW_RESONANCE)
        } else {
            None
        }
    }

    /// Forgets what led to a trip.
    pub fn reset(&mut self) {
        *self = Self {
            l_min: self.l_min,
            ..Self::default()
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::ekf::Noise;
    use ihd_shared::units::MicroOhm;

    fn quiet() -> BlockSums {
        BlockSums::default()
    }

    #[test]
    fn each_limit_trips_with_its_number() {
        let check = |sums: BlockSums, bus, lost| {
            let mut p = TripChecks::default();
            p.lose_blocks(lost);
            p.check_block(&sums, bus, 60_000, false, true)
        };
        let current = BlockSums {
            i_beyond: TRIP_PAIRS,
            ..quiet()
        };
        let spikes = BlockSums {
            i_beyond: TRIP_PAIRS - 1,
            ..quiet()
        };
        let saturated = BlockSums {
            saturated: SATURATED_PAIRS,
            ..current
        };
        assert_eq!(check(quiet(), 3_300, 0), None);
        assert_eq!(check(spikes, 0, 0), None);
        assert_eq!(check(current, 0, 0), Some(Fault::OVER_CURRENT));
        assert_eq!(check(saturated, 0, 0), Some(Fault::SENSOR_SATURATED));
        assert_eq!(
            check(quiet(), BUS_TRIP_DV, 0),
            Some(Fault::BUS_OVER_VOLTAGE)
        );
        assert_eq!(check(quiet(), 0, 2), None);
        assert_eq!(check(quiet(), 0, 3), Some(Fault::SAMPLES_LOST));
    }

    /// A bridge that opened at the crest: the line's inductance charges the link, which the bleeder takes a tenth of a second to
    /// bring down. A bus that stays up is another mains.
    #[test]
    fn a_surge_after_off_is_no_fault_and_a_bus_that_stays_up_is() {
        let mut p = TripChecks::default();
        let mut check = |bus| p.check_block(&quiet(), bus, 1_000_000, true, false);
        for _ in 0..BUS_SURGE_NS / 1_000_000 {
            assert_eq!(check(5_000), None);
        }
        assert_eq!(check(BUS_TRIP_DV - 1), None);
        let tripped = (0..).find(|_| check(BUS_TRIP_DV).is_some());
        assert_eq!(tripped, Some(BUS_SURGE_NS / 1_000_000));
    }

    #[test]
    fn mains_must_cross_zero_within_thirty_milliseconds() {
        let mut p = TripChecks::default();
        let mut blocks = 0;
        while p.check_block(&quiet(), 0, 60_000, false, false).is_none() {
            blocks += 1;
            assert!(blocks < 1_000);
        }
        assert_eq!(blocks, 500);
        assert_eq!(p.check_block(&quiet(), 0, 60_000, true, true), None);
    }

    #[test]
    fn below_resonance_trips_after_a_few_blocks_in_a_row() {
        // 20 µH resonates at 35.40 kHz.
        let ekf = Ekf::new(
            37_000,
            MicroOhm(3_000_000),
            PicoHenry(20_000_000),
            Noise::TUNED,
        );
        let mut p = TripChecks::default();
        p.set_frequency(37_000);
        for _ in 0..100 {
            assert_eq!(p.check_estimate(&ekf), None);
        }
        p.set_frequency(33_000);
        for _ in 0..ESTIMATE_BLOCKS - 1 {
            assert_eq!(p.check_estimate(&ekf), None);
        }
        let tripped = p.check_estimate(&ekf);
        assert_eq!(tripped, Some(Fault::BELOW_RESONANCE));
    }

    /// A reset forgets what was counted, not the frequency in force.
    #[test]
    fn a_reset_begins_the_count_anew_at_the_same_frequency() {
        let ekf = Ekf::new(
            33_000,
            MicroOhm(3_000_000),
            PicoHenry(20_000_000),
            Noise::TUNED,
        );
        let mut p = TripChecks::default();
        p.set_frequency(33_000);
        // L = 1/((2π·33 kHz)²·C): between 20 and 24 µH.
        assert!(
            (20_000_000..24_000_000).contains(&p.l_min().0),
            "{:?}",
            p.l_min()
        );
        let to_trip = |p: &mut TripChecks| (1..).find(|_| p.check_estimate(&ekf).is_some());
        assert_eq!(to_trip(&mut p), Some(u32::from(ESTIMATE_BLOCKS)));
        p.reset();
        assert_eq!(to_trip(&mut p), Some(u32::from(ESTIMATE_BLOCKS)));
    }

    /// An estimate at its bound is harmless from twice the resonant inductance on, as an empty coil's is.
    #[test]
    fn at_its_bound_an_estimate_is_harmless_from_twice_the_resonant_inductance() {
        let l_min_ph = {
            let mut p = TripChecks::default();
            p.set_frequency(60_000);
            p.l_min().0
        };
        let diverged = Some(Fault::ESTIMATOR_DIVERGED);
        for (l_ph, fault) in [
            (l_min_ph - l_min_ph / 10, diverged),
            (2 * l_min_ph - l_min_ph / 20, diverged),
            (2 * l_min_ph + l_min_ph / 20, None),
        ] {
            let mut ekf = Ekf::new(60_000, MicroOhm(0), PicoHenry(l_ph), Noise::TUNED);
            // -0.5 ohm: impedances count in units of 2 ohm.
            let one = f64::from(1 << 24);
            let x_units = std::f64::consts::TAU * 60e3 * f64::from(l_ph) * 1e-12 / 2.0;
            let complex = |re: f64, im: f64| Complex {
                re: (re * one) as i32,
                im: (im * one) as i32,
            };
            let z = crate::sense::demodulator::Phasors {
                v: complex(-0.25, x_units),
                i: complex(1.0, 0.0),
            };
            (0..50).for_each(|_| ekf.step(&z));
            assert!(ekf.is_at_bound());
            let mut p = TripChecks::default();
            p.set_frequency(60_000);
            let tripped = (0..20).find_map(|_| p.check_estimate(&ekf));
            assert_eq!(tripped, fault, "{l_ph} pH");
        }
    }
}
