//! Steadiness of an operating point, from its half-cycles.

use std::time::Duration;

use ihd_firmware::drive::pwm;
use ihd_shared::wire::messages::{State, Telemetry};

/// Longest heating time for an operating point to settle.
pub const SETTLE_WITHIN: Duration = Duration::from_secs(6);

/// Half-cycles at one frequency after which a power as requested counts as settled.
const SETTLED_AFTER: u32 = 5;

/// Half-cycles at one frequency after which any power does: one that the load cannot take ends at the resonance margin.
const SETTLED_ANYWAY_AFTER: u32 = 10 * SETTLED_AFTER;

/// Largest deviation of the power from the requested one, as a share.
const MAX_DEVIATION: f64 = 0.05;

/// Number of half-cycles that an operating point has stood at one frequency.
#[derive(Clone, Copy, Debug, Default)]
pub struct Steadiness {
    f_sw_hz: u32,
    half_cycles: u32,
}

impl Steadiness {
    /// Begins anew: the hob waits for a pot, or pauses.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Adds a half-cycle; returns `true` if a requested power, in watt, has settled: it is reached, or a limit of the frequency, or the
    /// frequency has stood for long.
    pub fn add(&mut self, t: &Telemetry, asked_w: u16) -> bool {
        // Between two bursts of a low power.
        if t.state == State::Heating && t.f_sw_hz == 0 {
            return false;
        }
        let is_steady = t.state == State::Heating && t.f_sw_hz == self.f_sw_hz;
        *self = Self {
            f_sw_hz: t.f_sw_hz,
            half_cycles: if is_steady { self.half_cycles + 1 } else { 0 },
        };
        let power_w = f64::from(t.power_mw) * 1e-3;
        let is_reached = (power_w / f64::from(asked_w) - 1.0).abs() < MAX_DEVIATION;
        let is_at_limit = t.f_sw_hz <= pwm::MIN_HZ || t.f_sw_hz >= pwm::MAX_HZ;
        self.half_cycles >= SETTLED_AFTER
            && (is_reached || is_at_limit || self.half_cycles >= SETTLED_ANYWAY_AFTER)
    }
}

#[cfg(test)]
mod tests {
    use ihd_fakes::telemetry;

    use super::*;

    /// Half-cycles at a frequency and a power after which 1,000 W have settled.
    fn settled_after(f_sw_hz: u32, power_w: u32) -> Option<u32> {
        let mut steadiness = Steadiness::default();
        let mut t = telemetry(State::Heating);
        (t.f_sw_hz, t.power_mw) = (f_sw_hz, power_w * 1_000);
        (1..=100).find(|_| steadiness.add(&t, 1_000))
    }

    #[test]
    fn a_limit_of_the_frequency_settles_as_fast_as_the_power() {
        assert_eq!(settled_after(50_000, 960), Some(6));
        assert_eq!(settled_after(pwm::MIN_HZ, 600), Some(6));
        assert_eq!(settled_after(pwm::MAX_HZ, 1_400), Some(6));
        assert_eq!(settled_after(50_000, 600), Some(51));
    }
}
