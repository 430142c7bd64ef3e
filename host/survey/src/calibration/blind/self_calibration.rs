//! Result of a self-calibration, and the correction that follows from it.

use serde::Serialize;

use super::correction::Correction;
use super::fit::FittedValue;

/// Response of the sensors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum SensorResponse {
    /// Both channels are equal.
    Right,
    /// The current is sampled later; or both channels have different delays for any reason.
    Skew {
        /// Skew in seconds; negative if the current is earlier.
        skew_s: f64,
    },
    /// The current goes through a first-order low-pass.
    SlowCurrent {
        /// Time constant in seconds.
        tau_s: f64,
    },
    /// The voltage goes through a first-order low-pass.
    SlowVoltage {
        /// Time constant in seconds.
        tau_s: f64,
    },
    /// The current goes through a first-order high-pass.
    Droop {
        /// Corner in hertz.
        corner_hz: f64,
        /// Skew in seconds; positive if the current is sampled later.
        skew_s: f64,
        /// Time constant of a first-order low-pass of the current in seconds.
        tau_s: f64,
    },
}

/// Tests of the underlying model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ModelTests {
    /// Root mean square of the residual with the same shape in every plateau, as a share of the capacitor's voltage.
    pub misfit: f64,
    /// `true` if the misfit is within noise or below its limit.
    pub flat: bool,
    /// Relative change of the current sensor's gain at the largest current; positive for a saturating sensor.
    pub bend: FittedValue,
    /// `true` if both sides of the bridge agree; else the one at ground was used.
    pub sides_agree: bool,
}

/// Result of a self-calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SelfCalibration {
    /// Series capacitance in farad, times gain of the current over gain of the voltage.
    pub capacitance_f: FittedValue,
    /// Lag of the current behind the voltage in seconds, to first order at the switching frequency: the time constant of a slow
    /// current, a negative skew, and the bridge's resistance times C.
    pub lag_s: FittedValue,
    /// Lag as a pure skew in seconds, positive if the current is later; its deviation contains no choice of model.
    pub as_skew_s: FittedValue,
    /// Sensor response that explains it.
    pub response: SensorResponse,
    /// `true` if the capture distinguishes that response from a mere skew of the same lag.
    pub told_apart: bool,
    /// Tests of the model.
    pub tests: ModelTests,
    /// Capacitance that the user gave, in farad; `None` if unknown.
    pub known_capacitance_f: Option<f64>,
    /// Errors of R and of L in percent by an uncorrected lag; `None` without a load.
    pub cost_pct: Option<(f64, f64)>,
    /// Number of plateaus that were used.
    pub plateaus: usize,
    /// Mean number of samples per plateau.
    pub samples: f64,
    /// Largest amplitude of the current in ampere.
    pub i_a: f64,
}

/// Largest plausible resistance of a bridge in ohm: IGBTs drop 1.5 V at 40 A.
pub const BRIDGE_R_MAX_OHM: f64 = 0.05;

/// Largest resistance in ohm outside the voltage's probe that is not unusual: bridge, a shunt as current sensor, cables.
const LOOP_R_MAX_OHM: f64 = 0.2;

/// Standard deviation of a bridge's resistance in ohm: switches of hobs have 10 to 20 mohm.
const BRIDGE_R_SIGMA_OHM: f64 = 0.01;

/// Lag in seconds below which no correction is made.
const MIN_LAG_S: f64 = 0.5e-9;

/// Error of R in percent below which a lag is left: plateaus are trusted no further.
const MIN_COST_PCT: f64 = 0.25;

/// Lag beside droop, in seconds, below which it may be a bridge's resistance.
const MIN_BESIDE_DROOP_S: f64 = 3e-9;

/// Standard deviations from which a lag is significant.
pub(super) const MIN_LAG_SIGMAS: f64 = 3.0;

/// Relative standard deviation of a capacitance that is known to a percent.
const CAPACITANCE_SHARE: f64 = 5e-3;

/// Largest relative difference of C from the one given, beside its standard deviations.
const GAIN: f64 = 0.01;

/// Largest error of the gains that is corrected: beyond, a probe's factor is wrong, or the capacitance.
pub const MAX_GAIN_OFF: f64 = 0.2;

/// Relative change of the current's gain above which the sensor is not linear.
const MAX_GAIN_CHANGE: f64 = 4e-3;
const BENT_SIGMAS: f64 = 5.0;

/// The same for plateaus of fewer samples than [`FINE_SAMPLES`]: sound sensors at 61 samples in three periods show up to 0.6 %.
const BENT_IF_COARSE: f64 = 1e-2;
const FINE_SAMPLES: f64 = 30.0;

impl SelfCalibration {
    /// Returns `true` if the plateaus follow the model, so that its numbers are meaningful.
    pub fn is_sound(&self) -> bool {
        self.tests.flat && !self.is_bent()
    }

    /// Returns `true` if the current's sensor is not linear.
    pub fn is_bent(&self) -> bool {
        let bend = self.tests.bend;
        bend.value.abs() > self.max_gain_change() && bend.value.abs() > BENT_SIGMAS * bend.sigma
    }

    /// Relative change of the current's gain above which the sensor is not linear, for the samples of these plateaus.
    pub(super) fn max_gain_change(&self) -> f64 {
        if self.samples < FINE_SAMPLES {
            BENT_IF_COARSE
        } else {
            MAX_GAIN_CHANGE
        }
    }

    /// Returns `true` if the channels differ by more than noise.
    pub fn is_significant(&self) -> bool {
        let lag = self.lag_s;
        self.response != SensorResponse::Right && lag.value.abs() > self.least_lag_s()
    }

    /// Lag in seconds above which the channels differ by more than noise.
    pub(super) fn least_lag_s(&self) -> f64 {
        (MIN_LAG_SIGMAS * self.lag_s.sigma).max(MIN_LAG_S)
    }

    /// Returns `true` if the lag matters to R.
    pub fn is_costly(&self) -> bool {
        self.cost_pct.is_none_or(|(r, _)| r > MIN_COST_PCT)
    }

    /// Returns `true` if a resistance of the bridge could explain the whole lag, droop aside: the current seems late by no more
    /// than a bridge's resistance causes, and no sensor fault is distinguished.
    pub fn may_be_the_bridge(&self) -> bool {
        let least_s = match self.response {
            SensorResponse::Skew { .. } => 0.0,
            // Less precise, because it is estimated together with the corner.
            SensorResponse::Droop { .. } => MIN_BESIDE_DROOP_S,
            _ => return false,
        };
        (least_s..BRIDGE_R_MAX_OHM * self.capacitance_f.value).contains(&self.beside_droop_s())
    }

    /// Returns `true` if a resistance outside the voltage's probe could explain the whole lag, droop aside: a slow current has exactly its
    /// plateaus, and a late one nearly.
    pub fn may_be_the_loop(&self) -> bool {
        let beside_s = self.beside_droop_s();
        let is_late = match self.response {
            SensorResponse::Droop { .. } => beside_s > MIN_BESIDE_DROOP_S,
            _ => beside_s > 0.0,
        };
        is_late && beside_s < LOOP_R_MAX_OHM * self.capacitance_f.value
    }

    /// Standard deviation of the sensors' lag by the resistance outside the voltage's probe, in seconds. Where that could be all of the lag, any
    /// share of it is as likely as another.
    pub fn loop_sigma_s(&self) -> f64 {
        let bridge_s = BRIDGE_R_SIGMA_OHM * self.capacitance_f.value;
        match self.may_be_the_loop() {
            true => bridge_s.max(self.beside_droop_s() / 3f64.sqrt()),
            false => bridge_s,
        }
    }

    /// Standard deviation in seconds of a lag that is not corrected: the lag itself, droop and the rest apart, as either may be no fault of the
    /// sensors.
    pub fn uncorrected_sigma_s(&self) -> f64 {
        let beside_s = self.beside_droop_s();
        let of_rest = match self.may_be_the_bridge() {
            true => beside_s / 3f64.sqrt(),
            false => beside_s,
        };
        let of_droop = self.lag_s.value - beside_s;
        self.lag_s.sigma.hypot(of_droop).hypot(of_rest)
    }

    /// Share of R and L that a fault may cost which no correction explains: bent sensors, plateaus that are not flat.
    pub fn unexplained_share(&self) -> f64 {
        let of = |fails: bool, share: f64| if fails { share } else { 0.0 };
        of(!self.tests.flat, self.tests.misfit).hypot(of(self.is_bent(), self.tests.bend.value))
    }

    /// Resistance in ohm outside the voltage's probe that would cause this lag, droop aside.
    pub fn bridge_r_ohm(&self) -> f64 {
        self.beside_droop_s() / self.capacitance_f.value
    }

    /// Lag of the current without droop's share, in seconds.
    fn beside_droop_s(&self) -> f64 {
        match self.response {
            SensorResponse::Droop { skew_s, tau_s, .. } => tau_s - skew_s,
            _ => self.lag_s.value,
        }
    }

    /// Gain of the voltage over that of the current less 1, and the least that is significant; `None` without a known capacitance.
    pub fn gain_off(&self) -> Option<(f64, f64)> {
        let c = self.capacitance_f;
        let limit = GAIN.max(MIN_LAG_SIGMAS * c.sigma / c.value);
        self.known_capacitance_f
            .map(|known_f| (known_f / c.value - 1.0, limit))
    }

    /// Relative standard deviation of the ratio of the gains that a capacitance given by the user shows: by the samples, and by that
    /// capacitance.
    pub fn gain_share(&self) -> f64 {
        let c = self.capacitance_f;
        CAPACITANCE_SHARE.hypot(c.sigma / c.value)
    }

    /// Correction of the channels; `None` if the lag is not significant, not sound, or could be the bridge's resistance.
    pub fn correction(&self) -> Option<Correction> {
        (self.is_significant() && self.is_costly() && self.is_sound() && !self.may_be_the_bridge())
            .then(|| self.full_correction())
    }

    /// Correction of the channels on the assumption that the whole lag comes from the sensors.
    pub fn full_correction(&self) -> Correction {
        let none = Correction::default();
        match self.response {
            SensorResponse::Right => none,
            SensorResponse::Skew { skew_s } => Correction { skew_s, ..none },
            SensorResponse::SlowCurrent { tau_s } => Correction {
                i_tau_s: tau_s,
                ..none
            },
            SensorResponse::SlowVoltage { tau_s } => Correction {
                v_tau_s: tau_s,
                ..none
            },
            SensorResponse::Droop {
                corner_hz,
                skew_s,
                tau_s,
            } => Correction {
                skew_s,
                i_tau_s: tau_s,
                i_droop_hz: corner_hz,
                ..none
            },
        }
    }
}
