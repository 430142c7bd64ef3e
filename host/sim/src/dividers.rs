//! Dividers of bus and mains in front of the slow converter: their poles (docs/board.md).

use ihd_firmware::sense::bus::BUS_MEAN;
use ihd_shared::board::{BUS_POLE_HZ, MAINS_POLE_HZ, SLOW_PIN_POLE_HZ};

use super::low_pass::LowPass;

/// Voltages that the slow converter takes in one block and the firmware uses, as volt at the dividers' inputs.
#[derive(Clone, Copy, Debug, Default)]
pub struct DividedVoltages {
    /// Bus voltage over the block's last switching period.
    pub bus_v: [f64; BUS_MEAN],
    /// Half of the codes' ring that the block fills: 0 or 1.
    pub half: usize,
    /// Newest mains voltage.
    pub mains_v: f64,
}

/// Voltages behind the dividers' poles, as volt at their inputs.
#[derive(Clone, Debug)]
pub struct Dividers {
    bus: [LowPass; 2],
    mains: [LowPass; 2],
}

impl Default for Dividers {
    fn default() -> Self {
        let pole = |corner_hz: u32| LowPass::settled(f64::from(corner_hz), 0.0);
        let pin = pole(SLOW_PIN_POLE_HZ);
        Self {
            bus: [pole(BUS_POLE_HZ), pin],
            mains: [pole(MAINS_POLE_HZ), pin],
        }
    }
}

impl Dividers {
    /// Advances by `dt_s` to these voltages at the inputs, in volt.
    pub fn advance(&mut self, bus_v: f64, mains_v: f64, dt_s: f64) {
        for (poles, v) in [(&mut self.bus, bus_v), (&mut self.mains, mains_v)] {
            let [divider, pin] = poles;
            pin.advance(divider.advance(v, dt_s), dt_s);
            divider.end_decay();
            pin.end_decay();
        }
    }

    /// Bus voltage, in volt.
    pub fn bus_v(&self) -> f64 {
        self.bus[1].output()
    }

    /// Mains voltage, in volt.
    pub fn mains_v(&self) -> f64 {
        self.mains[1].output()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At 45 kHz the bus's poles let 1/√(1 + (45/11.8)²)/√(1 + (45/50.4)²) through: 0.254 · 0.746.
    #[test]
    fn the_ripple_of_the_switching_frequency_is_damped_and_the_mains_is_not() {
        let (mut dividers, dt_s) = (Dividers::default(), 0.5e-6);
        let mut crest_v = 0.0f64;
        for n in 0..4_000 {
            let angle = std::f64::consts::TAU * 45e3 * f64::from(n) * dt_s;
            dividers.advance(300.0 + 15.0 * angle.sin(), -200.0, dt_s);
            if n > 3_000 {
                crest_v = crest_v.max(dividers.bus_v() - 300.0);
            }
        }
        let expected_v = 15.0 * 0.254 * 0.746;
        assert!(
            (crest_v / expected_v - 1.0).abs() < 0.03,
            "{crest_v} {expected_v}"
        );
        assert!((dividers.mains_v() + 200.0).abs() < 0.01);
    }
}
