//! Self-calibration of a device's sensors from its windows. One window of 61 samples in three periods gives the skew to some nanoseconds, a
//! hundred windows to a tenth of that (docs/accuracy.md).

use std::f64::consts::TAU;

use ihd_shared::hob::RESONANCE_CAPACITANCE_NF;
use ihd_shared::sampling::ANTI_ALIAS_HZ;
use ihd_signal::noise::{WhiteNoise, rms};
use ihd_signal::{Remark, Segment, Severity};
use ihd_survey::calibration::blind::{
    BRIDGE_R_MAX_OHM, BlindError, Correction, FittedValue, estimate_segment,
};
use serde::{Deserialize, Serialize};

/// Code of the remark that is made once when a correction begins.
pub const SELF_CALIBRATED: &str = "self_calibrated";

/// Share of the past that counts at the next window that is checked: 200 of them.
const FORGETTING: f64 = 0.995;

/// Windows after a boot that are all checked. Afterwards one of [`ONE_CHECKED_OF`] is: the check costs as much as the fit, and a mean over
/// 200 windows needs no more.
const ALL_CHECKED: u32 = 32;
const ONE_CHECKED_OF: u32 = 16;

/// Fewest windows that a correction rests on.
const MIN_WINDOWS: u32 = 8;

/// Standard deviations from which a lag is corrected, and its least size in seconds: the uncertainty that the settling filter and ten
/// samples a plateau add.
const MIN_LAG_SIGMAS: f64 = 4.0;
const MIN_S: f64 = 3e-9;

/// Noise of a channel over its rms up to which a window counts. The lag from plateaus has an error that grows with the noise squared: 27 ns
/// at 72 kHz and 30 dB, 10 ns at 35 dB, which a bridge's resistance would explain and is not corrected.
const MAX_NOISE: f64 = 0.02;

/// Tolerance of the resonance capacitor, as a share.
const CAPACITANCE: f64 = 0.05;

/// Weighted mean with exponential forgetting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Mean {
    weighted: f64,
    weight: f64,
    /// Sum of the weights with the forgetting factor squared, for the variance.
    weight_squared: f64,
}

impl Mean {
    fn add(&mut self, found: FittedValue) {
        let weight = found.sigma.powi(-2);
        if !(weight.is_finite() && found.value.is_finite()) {
            return;
        }
        *self = Self {
            weighted: FORGETTING * self.weighted + weight * found.value,
            weight: FORGETTING * self.weight + weight,
            weight_squared: FORGETTING * FORGETTING * self.weight_squared + weight,
        };
    }

    fn mean(&self) -> Option<FittedValue> {
        (self.weight > 0.0).then(|| FittedValue {
            value: self.weighted / self.weight,
            sigma: self.weight_squared.sqrt() / self.weight,
        })
    }

    fn is_sound(&self) -> bool {
        let all = [self.weighted, self.weight, self.weight_squared];
        all.iter().all(|x| x.is_finite()) && self.weight >= 0.0 && self.weight_squared >= 0.0
    }
}

/// Estimates of one device's sensor errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensors {
    /// Lag of the current in nanoseconds.
    lag_ns: Mean,
    /// Series capacitance in nanofarad.
    capacitance_nf: Mean,
    /// Windows that counted.
    windows: u32,
    /// Set if the remark on the correction was made.
    told: bool,
}

/// Evidence of one window on its device's sensors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SensorEvidence {
    /// Set if the window is too noisy for an estimate.
    pub noisy: bool,
    /// Lag of the current in nanoseconds and series capacitance in nanofarad; `None` if the window does not show them.
    pub found: Option<[FittedValue; 2]>,
    /// Faults of this window; not serialised.
    #[serde(skip)]
    pub remarks: Vec<Remark>,
}

impl SensorEvidence {
    /// Estimates the sensor errors from the window with this number since a boot, as it was sampled; no evidence where it is not checked.
    pub fn of_window(seq: u32, segment: &Segment) -> Self {
        if seq < ALL_CHECKED || seq.is_multiple_of(ONE_CHECKED_OF) {
            Self::estimate(segment)
        } else {
            Self::default()
        }
    }

    /// Estimates the sensor errors from a window as it was sampled.
    pub fn estimate(segment: &Segment) -> Self {
        let mut evidence = Self::default();
        if noisiest(segment) > MAX_NOISE {
            evidence.noisy = true;
            return evidence;
        }
        let scaled = |f: FittedValue, by: f64| FittedValue {
            value: by * f.value,
            sigma: by.abs() * f.sigma,
        };
        match estimate_segment(segment, None, None, Some(settling_s())) {
            // One window does not determine the kind of sensor.
            Ok(found) if found.is_sound() => {
                let lag_ns = scaled(found.as_skew_s, -1e9);
                evidence.found = Some([lag_ns, scaled(found.capacitance_f, 1e9)]);
            }
            Ok(found) => {
                let faults = found.remarks(false).into_iter();
                let nonlinear = faults.filter(|r| r.code == "sensor_nonlinear");
                evidence.remarks.extend(nonlinear);
            }
            Err(why @ BlindError::BridgeVoltage) => evidence.remarks.push(why.remark()),
            Err(_) => {}
        }
        evidence
    }
}

/// Returns a window with the sensor correction applied, in volt and ampere before the anti-alias filters.
pub(super) fn corrected(segment: &Segment, correction: Option<&Correction>) -> Segment {
    unfiltered(applied(segment, correction))
}

fn applied(segment: &Segment, correction: Option<&Correction>) -> Segment {
    correction.map_or_else(|| segment.clone(), |c| c.applied(segment))
}

/// Returns the fundamental's amplitude before the anti-alias filters over the one after them: 1.01 at 70 kHz.
pub fn anti_alias_loss(f_sw_hz: f64) -> f64 {
    f64::hypot(1.0, f_sw_hz / f64::from(ANTI_ALIAS_HZ))
}

/// Returns a window with both channels scaled to before the anti-alias filters. R and L do not change; the current to which they
/// belong does.
pub fn unfiltered(segment: Segment) -> Segment {
    let loss = anti_alias_loss(segment.f_sw_hz);
    let scaled = |x: &[f64]| x.iter().map(|x| x * loss).collect();
    Segment {
        v_v: scaled(&segment.v_v),
        i_a: scaled(&segment.i_a),
        ..segment
    }
}

impl Sensors {
    /// Adds a window; returns it corrected, with the remarks.
    #[cfg(test)]
    fn correct_window(&mut self, segment: &Segment) -> (Segment, Vec<Remark>) {
        let evidence = SensorEvidence::estimate(segment);
        let mut said = evidence.remarks.clone();
        said.extend(self.add(&evidence));
        (applied(segment, self.correction().as_ref()), said)
    }

    /// Adds the evidence of a window. Returns the remarks on all windows so far; that on a correction comes once, when it begins.
    pub fn add(&mut self, evidence: &SensorEvidence) -> Vec<Remark> {
        let mut remarks = Vec::new();
        if evidence.noisy {
            return remarks;
        }
        if let Some([lag_ns, capacitance_nf]) = evidence.found {
            self.lag_ns.add(lag_ns);
            self.capacitance_nf.add(capacitance_nf);
            self.windows = self.windows.saturating_add(1);
        }
        remarks.extend(self.gain_remark());
        if self.correction().is_some() && !self.told {
            self.told = true;
            remarks.push(self.correction_remark());
        }
        remarks
    }

    /// Returns the current's lag behind the voltage in seconds, with its deviation; `None` before the first window.
    pub fn lag_s(&self) -> Option<FittedValue> {
        self.lag_ns.mean().map(|f| FittedValue {
            value: 1e-9 * f.value,
            sigma: 1e-9 * f.sigma,
        })
    }

    /// Returns the number of windows that counted.
    pub fn windows(&self) -> u32 {
        self.windows
    }

    /// Returns the correction of the windows; `None` if the lag is not significant or the bridge's resistance could explain it.
    pub fn correction(&self) -> Option<Correction> {
        let lag = self.lag_s()?;
        let c_f = f64::from(RESONANCE_CAPACITANCE_NF) * 1e-9;
        // The bridge's resistance has the same effect as a current that lags.
        let bridge = (0.0..BRIDGE_R_MAX_OHM * c_f).contains(&lag.value);
        let significant = lag.value.abs() > (MIN_LAG_SIGMAS * lag.sigma).max(MIN_S);
        (self.windows >= MIN_WINDOWS && significant && !bridge).then(|| Correction {
            skew_s: -lag.value,
            ..Correction::default()
        })
    }

    fn correction_remark(&self) -> Remark {
        let lag = self.lag_ns.mean().unwrap_or_default();
        let text = format!(
            "self-calibrated: this device's current is behind by {:.1} ± {:.1} ns, found in {} windows; from now on that is \
             taken out",
            lag.value, lag.sigma, self.windows
        );
        Remark::new(SELF_CALIBRATED, Severity::Info, text).with(lag.value, None)
    }

    /// Returns a warning if the capacitance is out of the capacitor's tolerance, which points to a wrong gain.
    fn gain_remark(&self) -> Option<Remark> {
        let capacitance_nf = self.capacitance_nf.mean()?;
        let off = f64::from(RESONANCE_CAPACITANCE_NF) / capacitance_nf.value - 1.0;
        let limit = CAPACITANCE + MIN_LAG_SIGMAS * capacitance_nf.sigma / capacitance_nf.value;
        (self.windows >= MIN_WINDOWS && off.abs() > limit).then(|| {
            let text = format!(
                "the gain of the voltage over that of the current is off by {:+.1} %, or the resonance capacitor is {:.0} nF",
                100.0 * off,
                capacitance_nf.value
            );
            Remark::new("gain", Severity::Warning, text).with(100.0 * off, Some(100.0 * limit))
        })
    }

    /// Returns `true` if all sums are finite and no weight is negative.
    pub fn is_sound(&self) -> bool {
        self.lag_ns.is_sound() && self.capacitance_nf.is_sound()
    }
}

/// Returns white noise over rms of the noisier channel.
fn noisiest(segment: &Segment) -> f64 {
    let noise = WhiteNoise::measure(segment);
    f64::max(noise.v_v / rms(&segment.v_v), noise.i_a / rms(&segment.i_a))
}

/// Returns the time constant in seconds of the anti-alias filter that both channels share.
fn settling_s() -> f64 {
    1.0 / (TAU * f64::from(ANTI_ALIAS_HZ))
}

#[cfg(test)]
mod tests {
    use ihd_sim::pot::{PotBase, SimulatedPot};
    use ihd_sim::recording::run::record;
    use ihd_sim::recording::sensing::{Rate, Sensing};
    use ihd_sim::recording::settings::{CaptureSpec, LoadKind};

    use super::*;

    /// Windows of a board whose current is sampled late, at 40 dB.
    fn window(skew_s: f64, seed: u64) -> Segment {
        window_at(CaptureSpec::default().f_sw_hz, 40.0, skew_s, seed)
    }

    fn window_at(f_sw_hz: f64, snr_db: f64, skew_s: f64, seed: u64) -> Segment {
        let settings = CaptureSpec {
            f_sw_hz,
            load: LoadKind::Behavioural,
            pot: SimulatedPot::new(PotBase::Ferritic, 0.21),
            duration_s: 10e-3,
            seed,
            sensing: Sensing {
                rate: Rate::Locked,
                pole_hz: f64::from(ANTI_ALIAS_HZ),
                bits: 12,
                skew_s,
                snr_db: Some(snr_db),
                ..Sensing::default()
            },
            ..CaptureSpec::default()
        };
        let recording = record(&settings, |_| ()).unwrap();
        let capture = recording.capture("window");
        let wide = |x: &[f32]| x.iter().map(|x| f64::from(*x)).collect();
        Segment {
            f_sw_hz: settings.f_sw_hz,
            mains_hz: 50.0,
            zero_crossing_s: 0.0,
            t0_s: 0.0,
            dt_s: 3.0 / (61.0 * settings.f_sw_hz),
            v_v: wide(&capture.v_v),
            i_a: wide(&capture.i_a),
        }
    }

    #[test]
    fn a_skew_is_found_in_windows_told_once_and_kept_over_a_restart() {
        let mut sensors = Sensors::default();
        let mut told = 0;
        let mut last = None;
        for seed in 0..24 {
            let window = window(60e-9, seed);
            let (corrected, said) = sensors.correct_window(&window);
            told += said.iter().filter(|r| r.code == "self_calibrated").count();
            assert_eq!(corrected != window, sensors.correction().is_some());
            last = Some(corrected);
        }
        let lag = sensors.lag_s().unwrap();
        println!("{:?} of {} windows", lag, sensors.windows());
        assert!(
            (lag.value + 60e-9).abs() < 4.0 * lag.sigma + 2e-9,
            "{lag:?}"
        );
        assert!(told == 1 && sensors.correction().is_some(), "{sensors:?}");
        // What was taken out is not found again.
        let mut after = Sensors::default();
        after.correct_window(&last.unwrap());
        let left = after.lag_s().unwrap();
        assert!(left.value.abs() < 4.0 * left.sigma + 2e-9, "{left:?}");
        let text = serde_json::to_string(&sensors).unwrap();
        assert_eq!(serde_json::from_str::<Sensors>(&text).unwrap(), sensors);
    }

    /// Found in the closed loop at 25 dB: after eight windows 66 ns were taken out that were not there, 6 % of R.
    #[test]
    fn windows_that_are_mostly_noise_do_not_count() {
        let mut sensors = Sensors::default();
        for seed in 0..12 {
            sensors.correct_window(&window_at(79.9e3, 25.0, 0.0, seed));
        }
        assert_eq!((sensors.windows(), sensors.correction()), (0, None));
    }

    #[test]
    fn of_right_sensors_nothing_is_said() {
        let mut sensors = Sensors::default();
        for seed in 0..12 {
            let window = window(0.0, 100 + seed);
            let (same, said) = sensors.correct_window(&window);
            assert_eq!((same, said), (window, Vec::new()), "{sensors:?}");
        }
        assert!(sensors.windows() >= MIN_WINDOWS, "{sensors:?}");
    }
}
