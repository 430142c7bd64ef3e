//! The DC bus between rectifier and half-bridge.

use super::InverterError;
use crate::mains::Mains;

/// Resistance of line, fuse and rectifier, in ohm; only matters with a bus capacitor.
const SOURCE_R_OHM: f64 = 0.2;

/// Period in seconds at which the mains is computed, linear in between: the error is (ω dt)²/8 = 5e-8 of the peak.
const MAINS_STEP_S: f64 = 2e-6;

/// Bus voltage over time. A bench supply determines it alone. Without capacitance it is the rectified mains; with it, the rectifier
/// charges the capacitor through the source resistance and the inverter discharges it.
#[derive(Clone, Debug, PartialEq)]
pub struct Bus {
    mains: Mains,
    capacitance_f: f64,
    /// DC voltage of a bench supply in place of the rectifier, in volt.
    supply_v: Option<f64>,
    v: f64,
    /// Number of the present piece of the mains, and the voltage at its ends.
    piece: (f64, f64, f64),
}

impl Bus {
    /// Bus capacitance in farad, 0 or 0.1 µF to 1 mF; starts at the mains voltage of time `t_s`.
    pub fn new(mains: Mains, capacitance_f: f64, t_s: f64) -> Result<Self, InverterError> {
        if capacitance_f != 0.0 {
            super::in_range(
                "bus_capacitance_f",
                capacitance_f,
                1e-7,
                1e-3,
                "0, or 0.1 µF to 1 mF",
            )?;
        }
        Ok(Self {
            mains,
            capacitance_f,
            supply_v: None,
            v: mains.bus_v(t_s),
            piece: (-1.0, 0.0, 0.0),
        })
    }

    /// Feeds the bus from a bench supply of this voltage from now on, instead of the rectifier.
    pub fn set_supply(&mut self, supply_v: f64) {
        self.supply_v = Some(supply_v);
        self.v = supply_v;
    }

    /// The mains.
    pub fn mains(&self) -> Mains {
        self.mains
    }

    /// Replaces the mains.
    pub fn set_mains(&mut self, mains: Mains) {
        self.mains = mains;
        self.piece.0 = -1.0;
    }

    /// Bus voltage now, in volt.
    pub fn v(&self) -> f64 {
        self.v
    }

    /// Advances by `dt_s` to time `t_s`, while the bridge draws `i_a`; returns the new voltage. The old voltage decides whether the
    /// diode conducts, the rest is implicit: stable for any step.
    pub fn advance(&mut self, t_s: f64, dt_s: f64, i_a: f64) -> f64 {
        let rectified = match self.supply_v {
            Some(supply_v) => supply_v,
            None => self.rectified_v(t_s),
        };
        self.v = if self.capacitance_f == 0.0 {
            rectified
        } else {
            let rate = dt_s / self.capacitance_f;
            let g = if rectified > self.v {
                rate / SOURCE_R_OHM
            } else {
                0.0
            };
            // The lower diodes keep the bus from going negative.
            ((self.v + g * rectified - rate * i_a) / (1.0 + g)).max(0.0)
        };
        self.v
    }

    fn rectified_v(&mut self, t_s: f64) -> f64 {
        let at = t_s / MAINS_STEP_S;
        let (number, ..) = self.piece;
        // Faster than computing the floor at every step.
        if !(number..number + 1.0).contains(&at) {
            let number = at.floor();
            let v = |n: f64| self.mains.mains_v(n * MAINS_STEP_S);
            self.piece = (number, v(number), v(number + 1.0));
        }
        let (number, from, to) = self.piece;
        (from + (at - number) * (to - from)).abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_capacitance_it_is_the_rectified_mains() {
        let mains = Mains::new(50.0);
        let mut bus = Bus::new(mains, 0.0, 0.0).unwrap();
        for t_s in [3e-3, 3.0001e-3, 9.9999e-3, 10.0001e-3] {
            let v = bus.advance(t_s, 20e-9, 40.0);
            assert!((v - mains.bus_v(t_s)).abs() < 1e-6 * mains.peak_v, "{t_s}");
        }
    }

    #[test]
    fn a_bench_supply_is_the_bus_whatever_the_mains() {
        let mut bus = Bus::new(Mains::new(50.0), 0.0, 0.0).unwrap();
        bus.set_supply(40.0);
        assert_eq!(bus.v(), 40.0);
        for t_s in [0.0, 3e-3, 10e-3] {
            assert_eq!(bus.advance(t_s, 20e-9, 30.0), 40.0);
        }
    }

    #[test]
    fn a_capacitor_holds_the_bus_up_at_the_zero_crossing() {
        // 0.1 A from 10 µF: 10 V a millisecond. It leaves the sine where ω V̂ |cos ωt| is that,
        // and falls in a straight line until the zero crossing.
        let mut bus = Bus::new(Mains::new(50.0), 10e-6, 5e-3).unwrap();
        for n in 1..=5000 {
            bus.advance(5e-3 + f64::from(n) * 1e-6, 1e-6, 0.1);
        }
        let (peak_v, omega) = (Mains::new(50.0).peak_v, std::f64::consts::TAU * 50.0);
        let angle = std::f64::consts::PI - (10e3 / (peak_v * omega)).acos();
        let expected_v = peak_v * angle.sin() - 10e3 * (10e-3 - angle / omega);
        assert!(
            (bus.v() - expected_v).abs() < 1.0,
            "{} {expected_v}",
            bus.v()
        );
    }

    #[test]
    fn refuses_an_impossible_capacitor() {
        let e = Bus::new(Mains::new(50.0), -1.0, 0.0).unwrap_err();
        assert!(e.to_string().contains("bus_capacitance_f"));
    }
}
