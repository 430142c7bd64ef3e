//! Load and envelope as they are at an ADC sample: a law's own values, or the field model's over the last switching period.

use crate::inverter::harmonic_analyser::HarmonicAnalyser;
use crate::inverter::{Inverter, STEPS_PER_PERIOD};

/// Load and envelope at one ADC sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoadPoint {
    /// Time of the sample since the simulation's start, in seconds.
    pub t_s: f64,
    /// Resistance in ohm.
    pub r_ohm: f64,
    /// Inductance in henry.
    pub l_h: f64,
    /// Amplitude of the current's fundamental in ampere.
    pub i_a: f64,
}

/// Observer of the present load; the field model's R and L come from the harmonics of each switching period.
#[derive(Clone, Debug)]
pub struct LoadObserver {
    analyser: HarmonicAnalyser,
    measured: LoadPoint,
}

impl Default for LoadObserver {
    fn default() -> Self {
        Self {
            analyser: HarmonicAnalyser::new(STEPS_PER_PERIOD),
            measured: LoadPoint::default(),
        }
    }
}

impl LoadObserver {
    /// Returns the present load.
    pub fn point(&self, inverter: &Inverter) -> LoadPoint {
        let t_s = inverter.now_s();
        match inverter.load.law_point() {
            Some((r_ohm, l_h, i_a)) => LoadPoint {
                t_s,
                r_ohm,
                l_h,
                i_a,
            },
            None => LoadPoint {
                t_s,
                ..self.measured
            },
        }
    }

    /// Begins the truth of a switching period of the field model, at its first boundary.
    pub fn start(&mut self, inverter: &Inverter) {
        if inverter.step_in_period() == 0 {
            self.analyser.start(inverter.circuit.i_a);
        }
    }

    /// Adds the quantities after an integration step to the truth of the field model's period.
    pub fn push(&mut self, inverter: &Inverter) {
        let now = inverter.instant();
        let n = match inverter.step_in_period() {
            0 => STEPS_PER_PERIOD,
            n => n,
        };
        self.analyser.push_mean(n, now.coil_mean_v, now.i_a);
        if n == STEPS_PER_PERIOD {
            let truth = self.analyser.truth(now.t_s, inverter.f_sw_hz(), now.i_a);
            self.measured = LoadPoint {
                t_s: now.t_s,
                r_ohm: truth.r_ohm[0],
                l_h: truth.l_h[0],
                i_a: truth.i_a,
            };
        }
    }
}
