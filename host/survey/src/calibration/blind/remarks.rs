//! Remarks on a self-calibration.

use std::f64::consts::TAU;
use std::ops::RangeInclusive;

use ihd_signal::{Remark, Severity, WithSigma};

use super::error::BlindError;
use super::self_calibration::{MAX_GAIN_OFF, SelfCalibration, SensorResponse};
use super::straighten::Saturation;

/// Series capacitances of hobs in nF, a factor of two beyond those in use.
const HOBS_NF: RangeInclusive<f64> = 150.0..=5000.0;

/// Error of R in percent from which an uncorrected lag is a warning.
const COSTLY_PCT: f64 = 0.5;

impl BlindError {
    /// Converts to a remark: an error if the wrong voltage was measured, else an information.
    pub fn remark(&self) -> Remark {
        match self {
            Self::BridgeVoltage => Remark::new("bridge_voltage", Severity::Error, self.to_string()),
            _ => Remark::new(
                "self_calibration_impossible",
                Severity::Info,
                self.to_string(),
            ),
        }
    }
}

impl Saturation {
    /// Warning on a saturation that was corrected.
    pub fn remark(&self) -> Remark {
        let text = format!(
            "the current's sensor saturates (tanh, {:.0} A): its gain was off by {:.1} % at the largest current, which is corrected to \
             {:.2} %; better take a probe of more range",
            self.at_a,
            100.0 * self.bend,
            100.0 * self.left
        );
        let remark = Remark::new("sensor_nonlinear", Severity::Warning, text);
        remark.with(100.0 * self.bend, Some(100.0 * self.limit))
    }
}

impl SelfCalibration {
    /// Remarks on the sensors; `corrected` says that the correction was applied.
    pub fn remarks(&self, corrected: bool) -> Vec<Remark> {
        let mut out = Vec::new();
        out.extend(self.model_remarks());
        out.push(self.lag_remark(corrected));
        out.push(self.gain_remark());
        out
    }

    /// Remarks on failed tests of the model.
    fn model_remarks(&self) -> Vec<Remark> {
        let mut out = Vec::new();
        let bend = self.tests.bend;
        if self.is_bent() {
            out.push(
                Remark::new(
                    "sensor_nonlinear",
                    Severity::Warning,
                    format!(
                        "the current's sensor is not linear: at {:.0} A its gain is off by {} %, and so are R and L; \
                         take a probe of more range",
                        self.i_a,
                        WithSigma::new(100.0 * bend.value, 100.0 * bend.sigma)
                    ),
                )
                .with(100.0 * bend.value, Some(100.0 * self.max_gain_change())),
            );
        }
        if !self.tests.flat {
            out.push(
                Remark::new(
                    "plateaus_not_flat",
                    Severity::Warning,
                    format!(
                        "between edges, voltage and charge do not add up to a plateau: {:.2} % of the capacitor's voltage is left; \
                         no sensor that is known here explains it, R and L may be off by as much",
                        100.0 * self.tests.misfit
                    ),
                )
                .with(100.0 * self.tests.misfit, None),
            );
        }
        out
    }

    fn lag_remark(&self, corrected: bool) -> Remark {
        let (ns, sigma) = (self.lag_s.value * 1e9, self.lag_s.sigma * 1e9);
        let least = Some(self.least_lag_s() * 1e9);
        let cost = self.cost_pct.map_or(String::new(), |(r, l)| {
            format!(
                ", {} to R by {r:.2} %, to L by {l:.2} %",
                if corrected {
                    "which would matter"
                } else {
                    "which matters"
                }
            )
        });
        if !self.is_significant() {
            let lag = WithSigma::new(ns, sigma);
            let text = format!("the sensors agree: the current's lag is {lag} ns");
            return Remark::new("sensors_agree", Severity::Info, text).with(ns, least);
        }
        let (code, what) = self.in_words();
        if corrected {
            let or = match self.may_be_the_loop() {
                true => format!(
                    "A resistance of {:.0} mohm outside the voltage's probe (bridge, shunt, cables) looks the same, and R and L are then \
                     right without the correction",
                    self.bridge_r_ohm() * 1e3
                ),
                false => format!(
                    "A resistance of the bridge of 10 mohm would be {:.0} ns of it",
                    0.01 * self.capacitance_f.value * 1e9
                ),
            };
            let text = format!(
                "self-calibrated: {what}{cost}; {}. {or}",
                self.full_correction()
            );
            return Remark::new("self_calibrated", Severity::Info, text).with(ns, None);
        }
        let costly = self.cost_pct.is_none_or(|(r, _)| r > COSTLY_PCT);
        // A sensor that is not linear looks like one with droop or skew: the failed test is the warning.
        let severity = if costly && self.is_sound() {
            Severity::Warning
        } else {
            Severity::Info
        };
        let why = if !self.is_sound() {
            "; linear sensors do not explain the capture, so this may come from that fault, and is not corrected".to_owned()
        } else if self.may_be_the_bridge() {
            format!(
                "; a resistance of the bridge of {:.0} mohm looks the same, so it is not corrected: calibrate against a reference",
                self.bridge_r_ohm() * 1e3
            )
        } else if !self.is_costly() {
            "; that is too little to be corrected".to_owned()
        } else {
            "; it is not corrected: --self-calibrate auto does".to_owned()
        };
        Remark::new(code, severity, format!("{what}{cost}{why}")).with(ns, least)
    }

    /// Code of the response, and its description with numbers.
    fn in_words(&self) -> (&'static str, String) {
        let of_lag = |ns: f64| WithSigma::new(ns, self.lag_s.sigma * 1e9);
        let lag = of_lag(self.lag_s.value * 1e9);
        let band = |whose: &str, tau_s: f64| {
            let khz = 1e-3 / (TAU * tau_s);
            let tau = of_lag(tau_s * 1e9);
            format!("the {whose} has a bandwidth of {khz:.0} kHz only ({tau} ns)")
        };
        match self.response {
            SensorResponse::Right | SensorResponse::Skew { .. } => {
                ("skew", format!("the current's lag is {lag} ns"))
            }
            SensorResponse::SlowCurrent { tau_s } => ("bandwidth", band("current", tau_s)),
            SensorResponse::SlowVoltage { tau_s } => ("bandwidth", band("voltage", tau_s)),
            SensorResponse::Droop { corner_hz, .. } => (
                "droop",
                format!(
                    "the current droops with a corner of {corner_hz:.0} Hz: its lag is {lag} ns in all"
                ),
            ),
        }
    }

    fn gain_remark(&self) -> Remark {
        let nf = self.capacitance_f.value * 1e9;
        let shown = WithSigma::new(nf, self.capacitance_f.sigma * 1e9);
        let (Some(known_f), Some((off, limit))) = (self.known_capacitance_f, self.gain_off())
        else {
            if self.is_sound() && !HOBS_NF.contains(&nf) {
                let text = format!(
                    "the series capacitor would be {shown} nF, and a hob has {} to {}: a probe's factor (--input probe) or a unit \
                     (--input units) is wrong, and R and L with it, or give its value (--input resonance-capacitance)",
                    HOBS_NF.start(),
                    HOBS_NF.end()
                );
                return Remark::new("gain_unknown", Severity::Warning, text).with(nf, None);
            }
            let text = format!(
                "the series capacitor is {shown} nF if both gains are right; which of the three is off cannot be told: \
                 give its value (--input resonance-capacitance) to have the gains checked"
            );
            return Remark::new("gain_unknown", Severity::Info, text).with(nf, None);
        };
        if off.abs() <= limit {
            let text = format!("the gains are right to {:.2} %: {shown} nF", 100.0 * limit);
            return Remark::new("gain_right", Severity::Info, text)
                .with(100.0 * off, Some(100.0 * limit));
        }
        let text = format!(
            "the gain of the voltage over that of the current is off by {:+.2} %, and so are R and L: the series capacitor shows \
             as {shown} nF instead of {:.1} nF",
            100.0 * off,
            known_f * 1e9
        );
        if off.abs() > MAX_GAIN_OFF && self.is_sound() {
            let text = format!(
                "{text}; that is too much for a tolerance: a probe's factor (--input probe), a unit (--input units) or the \
                 capacitance given is wrong"
            );
            return Remark::new("gain", Severity::Error, text)
                .with(100.0 * off, Some(100.0 * MAX_GAIN_OFF));
        }
        Remark::new("gain", Severity::Warning, text).with(100.0 * off, Some(100.0 * limit))
    }
}
