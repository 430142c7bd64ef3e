//! What a correction of the sensors leaves open: a delay that is off by δ turns the impedance by ωδ.

use std::f64::consts::TAU;

use ihd_identify::Estimate;
use ihd_signal::{Capture, Load, Remark, Segment, Severity};
use ihd_survey::calibration::blind::{self, Ask, Looked, Mode, SelfCalibration};
use ihd_survey::{Hints, SurveyError};

/// Share of a lag that its correction may be off by, whatever the samples say: how well first order describes a probe.
const MODEL: f64 = 0.02;

/// Standard deviation of the bridge's resistance in ohm: switches of hobs have 10 to 20 mohm, which nobody tells.
const BRIDGE_R_OHM: f64 = 0.01;

/// Sampling rate in hertz from which the plateaus between edges have enough samples of their own.
const LEAST_RATE_HZ: f64 = 6e6;

/// Share of the time between two samples that a lag may be off by below that rate: clean captures of 61 samples in three
/// periods show 10 to 29 ns of theirs, 1 to 3 %.
const COARSE_SHARE: f64 = 0.04;

/// Share of R in percent that a correction's own deviation may be worth without a word.
const DOUBTFUL_PCT: f64 = 0.35;

/// Surveys a capture and looks at its sensors; a lag that coarse samples show by themselves is none.
///
/// # Errors
/// [`SurveyError`] where there is nothing to work on.
pub fn look<'a>(capture: &'a Capture, hints: &Hints, ask: Ask) -> Result<Looked<'a>, SurveyError> {
    let looked = blind::look(capture, hints, ask)?;
    let Some(Ok(found)) = &looked.sensors else {
        return Ok(looked);
    };
    let rate_hz = looked.survey.rate_hz;
    let coarse = rate_hz < LEAST_RATE_HZ;
    // What no delay explains is said at any rate.
    if coarse && found.is_sound() && found.lag_s.value.abs() * rate_hz < COARSE_SHARE {
        let mode = Mode::Off;
        return blind::look(capture, hints, Ask { mode, ..ask });
    }
    Ok(looked)
}

/// A correction that was applied, as far as it is uncertain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Applied {
    /// Standard deviation of the delay in seconds.
    lag_sigma_s: f64,
    /// What the bridge's resistance, which looks like a lag, may have added to it, in seconds.
    bridge_s: f64,
    /// Lag squared in square seconds where a skew and a slow channel look the same: they differ in gain by half of
    /// (ω·lag)².
    untold_s2: f64,
}

impl Applied {
    /// Of what was found and taken out.
    pub fn of(found: &SelfCalibration) -> Self {
        let lag_s = found.lag_s.value;
        Self {
            lag_sigma_s: found.lag_s.sigma.hypot(MODEL * lag_s),
            bridge_s: BRIDGE_R_OHM * found.capacitance_f.value,
            untold_s2: if found.told_apart { 0.0 } else { lag_s * lag_s },
        }
    }

    /// Standard deviations of R in ohm and L in henry that a lag of `sigma_s` seconds adds at a load and a frequency.
    fn sigmas(&self, sigma_s: f64, load: Load, f_sw_hz: f64) -> (f64, f64) {
        let omega = TAU * f_sw_hz;
        let gain = 0.5 * omega * omega * self.untold_s2;
        let r = (omega * omega * load.l_h * sigma_s).hypot(gain * load.r_ohm);
        let l = (load.r_ohm * sigma_s).hypot(gain * load.l_h);
        (r, l)
    }

    /// Adds it to an estimate's deviations, where it states any; the bridge's resistance included.
    pub fn widen(&self, estimate: &mut Estimate) {
        let f_sw_hz = estimate.f_sw_hz;
        let sigma_s = self.lag_sigma_s.hypot(self.bridge_s);
        let loads = estimate.r_ohm.iter().zip(&estimate.l_h);
        let added: Vec<_> = loads
            .map(|(&r_ohm, &l_h)| self.sigmas(sigma_s, Load { r_ohm, l_h }, f_sw_hz))
            .collect();
        for (sigma, (r, _)) in estimate.r_sigma_ohm.iter_mut().zip(&added) {
            *sigma = sigma.hypot(*r);
        }
        for (sigma, (_, l)) in estimate.l_sigma_h.iter_mut().zip(&added) {
            *sigma = sigma.hypot(*l);
        }
    }

    /// A warning where the correction rests on little.
    pub fn remark(&self, segment: &Segment, load: Option<Load>) -> Option<Remark> {
        let rate_hz = 1.0 / segment.dt_s;
        if rate_hz < LEAST_RATE_HZ {
            let text = format!(
                "the sensors were corrected from samples at {:.2} MS/s only, of which few lie between the edges: sample faster, \
                 or compare with --self-calibrate off",
                rate_hz * 1e-6
            );
            let remark = Remark::new("correction_doubtful", Severity::Warning, text);
            return Some(remark.with(rate_hz, Some(LEAST_RATE_HZ)));
        }
        let load = load?;
        let (r, _) = self.sigmas(self.lag_sigma_s, load, segment.f_sw_hz);
        let pct = 100.0 * (r / load.r_ohm).abs();
        (pct > DOUBTFUL_PCT).then(|| {
            let text = format!(
                "the correction of the sensors leaves R uncertain by {pct:.1} %: compare with --self-calibrate off, or calibrate \
                 against a reference"
            );
            Remark::new("correction_doubtful", Severity::Warning, text).with(pct, Some(DOUBTFUL_PCT))
        })
    }
}

#[cfg(test)]
mod tests {
    use ihd_identify::Method;

    use super::*;

    #[test]
    fn a_delay_that_is_off_turns_the_impedance() {
        let applied = Applied {
            lag_sigma_s: 3e-9,
            bridge_s: 4e-9,
            untold_s2: 0.0,
        };
        let mut estimate = Estimate::new(Method::LeastSquares, 45e3);
        estimate.t_s = vec![0.0];
        estimate.r_ohm = vec![3.0];
        estimate.l_h = vec![18e-6];
        estimate.r_sigma_ohm = vec![0.0];
        estimate.l_sigma_h = vec![1e-9];
        applied.widen(&mut estimate);
        let omega = TAU * 45e3;
        // Z·e^(jωδ): R falls by X·sin ωδ, X rises by R·sin ωδ.
        let turned = (omega * 5e-9).sin();
        assert!((estimate.r_sigma_ohm[0] / (omega * 18e-6 * turned) - 1.0).abs() < 1e-6);
        let l = (3.0 * turned / omega).hypot(1e-9);
        assert!((estimate.l_sigma_h[0] / l - 1.0).abs() < 1e-6);
    }
}
