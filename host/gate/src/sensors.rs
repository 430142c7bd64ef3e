//! Error that a correction of the sensors leaves: a delay that is wrong by δ turns the impedance by ωδ.

use std::borrow::Cow;
use std::f64::consts::TAU;

use ihd_identify::pooled::SharedSigma;
use ihd_signal::{Capture, Load, Remark, Segment, Severity};
use ihd_survey::calibration::blind::{
    self, BlindOptions, CalibratedCapture, MAX_GAIN_OFF, SelfCalibration,
};
use ihd_survey::{Hints, Survey, SurveyError};

use crate::limits::{MAX_SIGMA_PCT, TOLERABLE_PCT, TOLERABLE_SIGMAS};

/// Least relative error of a corrected lag, whatever the samples say: a probe is only roughly of first order.
const MODEL: f64 = 0.02;

/// Sampling rate in hertz from which the plateaus between edges have enough samples.
pub const MIN_RATE_HZ: f64 = 6e6;

/// Share of the sampling interval by which a lag may be wrong below that rate: clean captures of 61 samples in three periods
/// show lags of 10 to 29 ns, 1 to 3 % of it.
const COARSE_SHARE: f64 = 0.04;

/// Share of R in percent above which a correction's own deviation is reported.
const DOUBTFUL_PCT: f64 = 0.35;

/// Returns `true` if a lag is an artefact of sampling too coarse for plateaus, at a rate in hertz. Distortions that no delay explains
/// are none at any rate.
pub fn is_of_sampling(sensors: &SelfCalibration, rate_hz: f64) -> bool {
    rate_hz < MIN_RATE_HZ
        && sensors.is_sound()
        && sensors.lag_s.value.abs() * rate_hz < COARSE_SHARE
}

/// Calibrates the sensors of a surveyed capture. A lag that is an artefact of coarse sampling is not corrected.
///
/// # Errors
/// [`SurveyError`] if the capture holds nothing that can be identified.
pub fn calibrate<'a>(
    capture: &'a Capture,
    survey: Survey,
    hints: &Hints,
    options: BlindOptions,
) -> Result<CalibratedCapture<'a>, SurveyError> {
    let calibrated = blind::calibrate_surveyed(capture, survey, hints, options)?;
    let Some(Ok(sensors)) = &calibrated.sensors else {
        return Ok(calibrated);
    };
    if calibrated.saturation.is_none() && is_of_sampling(sensors, calibrated.survey.rate_hz) {
        let survey = match calibrated.correction {
            Some(_) => Survey::from_capture(capture, hints)?,
            None => calibrated.survey,
        };
        return Ok(CalibratedCapture {
            capture: Cow::Borrowed(capture),
            survey,
            sensors: None,
            correction: None,
            saturation: None,
        });
    }
    Ok(calibrated)
}

/// Corrects the ratio of the gains by the capacitance that the user gave; R and L depend on the ratio alone. Returns a warning,
/// which replaces that of the self-calibration, or `None` if there is nothing to correct.
pub fn correct_gain(calibrated: &mut CalibratedCapture<'_>) -> Option<Remark> {
    let Some(Ok(sensors)) = &calibrated.sensors else {
        return None;
    };
    let (off, limit) = sensors.gain_off()?;
    if off.abs() <= limit || off.abs() > MAX_GAIN_OFF || !sensors.is_sound() {
        return None;
    }
    let factor = (1.0 / (1.0 + off)) as f32;
    let capture = calibrated.capture.to_mut();
    capture.v_v.iter_mut().for_each(|v| *v *= factor);
    let full_scale = capture.v_full_scale_v.as_mut();
    full_scale.into_iter().for_each(|v| *v *= f64::from(factor));
    let text = format!(
        "the gain of the voltage over that of the current is off by {:+.2} %, as the capacitance given shows: the voltage is \
         corrected, and R and L are as right as that capacitance",
        100.0 * off
    );
    let remark = Remark::new("gain", Severity::Warning, text);
    Some(remark.with(100.0 * off, Some(100.0 * limit)))
}

/// Uncertainty by the sensors: of an applied correction, and by what is not corrected.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CorrectionUncertainty {
    /// Standard deviation of an applied delay in seconds.
    lag_sigma_s: f64,
    /// Standard deviation in seconds by a delay that was measured and not corrected.
    uncorrected_s: f64,
    /// Standard deviation in seconds of what a resistance outside the voltage's probe added to the delay.
    loop_s: f64,
    /// Delay in seconds that such a resistance alone could explain; 0 if it cannot.
    other_cause_s: f64,
    /// Square of the lag in s² if skew and low bandwidth cannot be told apart, else 0: their gains differ by half of
    /// (ω·lag)².
    ambiguous_lag_s2: f64,
    /// Relative standard deviation of the ratio of the gains.
    gain_share: f64,
}

impl CorrectionUncertainty {
    /// Derives the uncertainty from a self-calibration, with the gains corrected or not; `None` without one.
    pub fn from_self_calibration(
        calibrated: &CalibratedCapture<'_>,
        gain_corrected: bool,
    ) -> Option<Self> {
        let Some(Ok(sensors)) = &calibrated.sensors else {
            return None;
        };
        let of_gain = match gain_corrected {
            true => sensors.gain_share(),
            false => 0.0,
        };
        let of_bend = calibrated.saturation.map_or(0.0, |s| s.left);
        let gain_share = of_gain.hypot(of_bend).hypot(sensors.unexplained_share());
        let of_lag = match calibrated.correction {
            Some(_) => Self::of_lag(sensors),
            None => Self {
                uncorrected_s: sensors.uncorrected_sigma_s(),
                ..Self::default()
            },
        };
        Some(Self {
            gain_share,
            ..of_lag
        })
    }

    fn of_lag(sensors: &SelfCalibration) -> Self {
        let lag_s = sensors.lag_s.value;
        Self {
            lag_sigma_s: sensors.lag_s.sigma.hypot(MODEL * lag_s),
            loop_s: sensors.loop_sigma_s(),
            other_cause_s: match sensors.may_be_the_loop() {
                true => sensors.bridge_r_ohm() * sensors.capacitance_f.value,
                false => 0.0,
            },
            ambiguous_lag_s2: if sensors.told_apart {
                0.0
            } else {
                lag_s * lag_s
            },
            ..Self::default()
        }
    }

    /// Deviations of R and L by a lag that is wrong by `delay_s` seconds, at a frequency in hertz.
    fn by_lag(&self, delay_s: f64, f_sw_hz: f64) -> SharedSigma {
        let omega = TAU * f_sw_hz;
        let gain = self
            .gain_share
            .hypot(0.5 * omega * omega * self.ambiguous_lag_s2);
        SharedSigma {
            shares: [gain; 2],
            delay_s,
        }
    }

    /// Deviations of R and L, those by the bridge's resistance among them.
    pub fn shared_sigma(&self, f_sw_hz: f64) -> SharedSigma {
        let delay_s = self.lag_sigma_s.hypot(self.loop_s);
        self.by_lag(delay_s.hypot(self.uncorrected_s), f_sw_hz)
    }

    /// Deviation of R in percent by a lag that is wrong by `delay_s` seconds.
    fn r_pct(&self, delay_s: f64, load: Load, f_sw_hz: f64) -> f64 {
        let [r, _] = (self.by_lag(delay_s, f_sw_hz)).of([load.r_ohm, load.l_h], TAU * f_sw_hz);
        100.0 * (r / load.r_ohm).abs()
    }

    /// Warning on a correction that is uncertain, else `None`.
    pub fn remark(&self, segment: &Segment, load: Option<Load>) -> Option<Remark> {
        let doubt = load.and_then(|load| self.doubt(segment, load));
        let coarse = self.coarse(1.0 / segment.dt_s);
        // The rate explains a doubt, but no refusal is a warning for it.
        match (doubt, coarse) {
            (Some(doubt), _) if doubt.severity == Severity::Error => Some(doubt),
            (doubt, coarse) => coarse.or(doubt),
        }
    }

    /// Warning on a correction from few samples between the edges, `None` at a rate that is fast enough.
    fn coarse(&self, rate_hz: f64) -> Option<Remark> {
        let is_coarse = rate_hz < MIN_RATE_HZ && self.lag_sigma_s > 0.0;
        is_coarse.then(|| {
            let text = format!(
                "the sensors were corrected from samples at {:.2} MS/s only, of which few lie between the edges: sample faster, \
                 or compare with --self-calibrate off",
                rate_hz * 1e-6
            );
            let remark = Remark::new("correction_doubtful", Severity::Warning, text);
            remark.with(rate_hz, Some(MIN_RATE_HZ))
        })
    }

    /// Doubt by the size of the deviations on this load.
    fn doubt(&self, segment: &Segment, load: Load) -> Option<Remark> {
        if let Some(doubt) = self.two_causes(load, segment.f_sw_hz) {
            return Some(doubt);
        }
        let pct = self.r_pct(self.lag_sigma_s, load, segment.f_sw_hz);
        if pct > DOUBTFUL_PCT {
            let text = format!(
                "the correction of the sensors leaves R uncertain by {pct:.1} %: compare with --self-calibrate off, or calibrate \
                 against a reference"
            );
            let (severity, limit) = severity_of(pct, DOUBTFUL_PCT);
            let remark = Remark::new("correction_doubtful", severity, text);
            return Some(remark.with(pct, Some(limit)));
        }
        let pct = self.r_pct(self.lag_sigma_s.hypot(self.loop_s), load, segment.f_sw_hz);
        (TOLERABLE_SIGMAS * pct > TOLERABLE_PCT[0]).then(|| {
            let text = format!(
                "the sensors were corrected for a delay, of which the bridge's resistance may be a part: R is uncertain by \
                 {pct:.1} %; calibrate against a reference"
            );
            let remark = Remark::new("correction_doubtful", Severity::Warning, text);
            remark.with(pct, Some(TOLERABLE_PCT[0] / TOLERABLE_SIGMAS))
        })
    }

    /// Doubt of a correction whose whole delay a resistance could explain; an error where that is too much for a result.
    fn two_causes(&self, load: Load, f_sw_hz: f64) -> Option<Remark> {
        let pct = self.r_pct(self.lag_sigma_s.hypot(self.loop_s), load, f_sw_hz);
        if self.other_cause_s == 0.0 || TOLERABLE_SIGMAS * pct <= TOLERABLE_PCT[0] {
            return None;
        }
        let (severity, limit) = severity_of(pct, TOLERABLE_PCT[0] / TOLERABLE_SIGMAS);
        let without = load.r_ohm - (TAU * f_sw_hz).powi(2) * load.l_h * self.other_cause_s;
        let text = format!(
            "the current was corrected for being late by {:.0} ns, which a resistance outside the voltage's probe (bridge, shunt, \
             cables) would explain as well: then R is {without:.3} ohm, not {:.3}; it is uncertain by {pct:.1} %: use --self-calibrate off \
             if there is such a resistance, or calibrate against a reference",
            self.other_cause_s * 1e9,
            load.r_ohm
        );
        Some(Remark::new("correction_doubtful", severity, text).with(pct, Some(limit)))
    }
}

/// Severity of a deviation of R in percent that is beyond `warning_pct`, with the limit that it exceeds.
fn severity_of(pct: f64, warning_pct: f64) -> (Severity, f64) {
    match pct > MAX_SIGMA_PCT {
        true => (Severity::Error, MAX_SIGMA_PCT),
        false => (Severity::Warning, warning_pct),
    }
}

#[cfg(test)]
mod tests {
    use ihd_identify::{Estimate, Method};
    use ihd_signal::Samples;

    use super::*;

    /// ωL/R = 25: an error of δ turns R by 25·ωδ, 11 % for 15 ns.
    #[test]
    fn a_low_rate_makes_no_warning_of_an_error() {
        let remark = |rate_hz: f64, lag_sigma_s: f64| {
            let uncertainty = CorrectionUncertainty {
                lag_sigma_s,
                ..CorrectionUncertainty::default()
            };
            let samples = || Samples::singles(vec![1.0; 8]);
            let segment = Segment {
                f_sw_hz: 45e3,
                mains_hz: 50.0,
                zero_crossing_s: 0.0,
                t0_s: 0.0,
                dt_s: 1.0 / rate_hz,
                v_v: samples(),
                i_a: samples(),
            };
            let load = Load {
                r_ohm: 1.0,
                l_h: 25.0 / (TAU * 45e3),
            };
            let remark = uncertainty.remark(&segment, Some(load)).expect("a doubt");
            (remark.severity, remark.value)
        };
        for rate_hz in [2.5e6, 50e6] {
            let (severity, pct) = remark(rate_hz, 15e-9);
            assert_eq!(severity, Severity::Error, "{rate_hz}");
            assert!(
                pct.is_some_and(|pct| (pct / 10.6 - 1.0).abs() < 0.01),
                "{pct:?}"
            );
        }
        assert_eq!(remark(2.5e6, 1e-9), (Severity::Warning, Some(2.5e6)));
    }

    #[test]
    fn a_delay_that_is_off_turns_the_impedance() {
        let uncertainty = CorrectionUncertainty {
            lag_sigma_s: 3e-9,
            loop_s: 4e-9,
            ..CorrectionUncertainty::default()
        };
        let mut estimate = Estimate::new(Method::LeastSquares, 45e3);
        estimate.t_s = vec![0.0];
        estimate.r_ohm = vec![3.0];
        estimate.l_h = vec![18e-6];
        estimate.r_sigma_ohm = vec![0.0];
        estimate.l_sigma_h = vec![1e-9];
        uncertainty.shared_sigma(45e3).widen(&mut estimate);
        let omega = TAU * 45e3;
        // Z·e^(jωδ): R falls by X·sin ωδ, X rises by R·sin ωδ.
        let turned = (omega * 5e-9).sin();
        assert!((estimate.r_sigma_ohm[0] / (omega * 18e-6 * turned) - 1.0).abs() < 1e-6);
        let l = (3.0 * turned / omega).hypot(1e-9);
        assert!((estimate.l_sigma_h[0] / l - 1.0).abs() < 1e-6);
    }
}
