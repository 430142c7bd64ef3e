//! The rectified mains behind the half-bridge's bus.

use ihd_shared::board;

/// Mains whose voltage and frequency may change at any instant with a continuous phase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedMains {
    /// Mains frequency in hertz, 50 or 60.
    pub frequency_hz: f64,
    /// Peak of the bus voltage in volt; 0 without mains.
    pub peak_v: f64,
    /// `true` while the line is open, as with the plug pulled: no current, and no voltage but what C1 keeps. A voltage of 0 is a
    /// short circuit behind the line instead.
    pub is_open: bool,
    /// Distortion: third, fifth and seventh harmonic as a share of the fundamental, in phase at
    /// the zero crossing. A positive third or a negative fifth flattens the top.
    pub harmonics: [f64; 3],
    /// Time of the last change of frequency, in seconds, and the mains cycles until then.
    changed: (f64, f64),
}

impl SimulatedMains {
    /// Creates a mains of the board's nominal voltage.
    pub fn new(frequency_hz: f64) -> Self {
        Self {
            frequency_hz,
            peak_v: ihd_shared::hob::BUS_PEAK_V,
            is_open: false,
            harmonics: [0.0; 3],
            changed: (0.0, 0.0),
        }
    }

    /// Creates the board's mains.
    pub fn of_board() -> Self {
        Self::new(f64::from(board::MAINS_FREQUENCY_HZ))
    }

    /// Sets third, fifth and seventh harmonic as shares of the fundamental.
    pub fn with_harmonics(self, harmonics: [f64; 3]) -> Self {
        Self { harmonics, ..self }
    }

    /// Returns the mains with another voltage and frequency from `t_s` on, with a continuous phase.
    pub fn changed(self, t_s: f64, v_rms_v: f64, frequency_hz: f64) -> Self {
        Self {
            frequency_hz,
            peak_v: v_rms_v * std::f64::consts::SQRT_2,
            changed: (t_s, self.cycles(t_s)),
            ..self
        }
    }

    /// Rms of the fundamental, in volt.
    pub fn v_rms_v(&self) -> f64 {
        self.peak_v * std::f64::consts::FRAC_1_SQRT_2
    }

    /// Mains cycles since the start.
    pub fn cycles(&self, t_s: f64) -> f64 {
        let (changed_s, before) = self.changed;
        before + self.frequency_hz * (t_s - changed_s)
    }

    /// Number of completed half-cycles at a time; without mains they continue at the last frequency.
    pub fn half_cycle(&self, t_s: f64) -> u32 {
        (2.0 * self.cycles(t_s)) as u32
    }

    /// Time since the last zero crossing, in seconds.
    pub fn since_crossing_s(&self, t_s: f64) -> f64 {
        (2.0 * self.cycles(t_s)).fract() * self.half_cycle_s()
    }

    /// Duration of a half-cycle in seconds.
    pub fn half_cycle_s(&self) -> f64 {
        0.5 / self.frequency_hz
    }

    /// Mains voltage at a time after a rising zero crossing, in volt.
    pub fn mains_v(&self, t_s: f64) -> f64 {
        let (changed_s, before) = self.changed;
        let angle = std::f64::consts::TAU * self.frequency_hz * (t_s - changed_s)
            + std::f64::consts::TAU * before.fract();
        let mut v = libm::sin(angle);
        if self.harmonics != [0.0; 3] {
            for (share, order) in self.harmonics.into_iter().zip([3.0, 5.0, 7.0]) {
                v += share * libm::sin(order * angle);
            }
        }
        self.peak_v * v
    }

    /// Rectified mains at a time after a zero crossing, in volt.
    pub fn bus_v(&self, t_s: f64) -> f64 {
        libm::fabs(self.mains_v(t_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_of_frequency_keeps_the_phase_and_one_of_voltage_scales_at_once() {
        let mains = SimulatedMains::new(50.0);
        let at_s = 13.3e-3;
        let faster = mains.changed(at_s, 230.0, 60.0);
        assert!((faster.mains_v(at_s) - mains.mains_v(at_s)).abs() < 1e-9);
        // 0.335 of a cycle is left at 13.3 ms: 5.583 ms at 60 Hz.
        let crossing_s = at_s + 0.335 / 60.0;
        assert!(faster.mains_v(crossing_s).abs() < 1e-9);
        assert_eq!(faster.half_cycle(crossing_s - 1e-6), 1);
        assert_eq!(faster.half_cycle(crossing_s + 1e-6), 2);
        let since_s = faster.since_crossing_s(crossing_s + 1e-3);
        assert!((since_s - 1e-3).abs() < 1e-12, "{since_s}");
        let sag = mains.changed(at_s, 138.0, 50.0);
        assert!((sag.bus_v(at_s) / mains.bus_v(at_s) - 0.6).abs() < 1e-12);
        assert_eq!(mains.changed(at_s, 0.0, 50.0).bus_v(14e-3), 0.0);
        assert!(
            (sag.changed(15e-3, 230.0, 50.0).mains_v(0.025) - mains.mains_v(0.025)).abs() < 1e-9
        );
    }
}
