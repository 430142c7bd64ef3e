//! What a device's windows show of its sensors, little by little: a window of 61 samples in three periods knows a skew to
//! some nanoseconds, a hundred of them to a tenth of that (docs/accuracy.md).

use std::f64::consts::TAU;

use ihd_shared::hob::RESONANCE_CAPACITANCE_NF;
use ihd_shared::sampling::ANTI_ALIAS_HZ;
use ihd_signal::noise::WhiteNoise;
use ihd_signal::{Remark, Segment, Severity};
use ihd_survey::calibration::blind::{BlindError, Correction, Found, of_segment};
use serde::{Deserialize, Serialize};

/// What is said once when something begins to be taken out of the windows.
pub const SELF_CALIBRATED: &str = "self_calibrated";

/// Share of the past that counts at the next window: 200 windows, some 40 s.
const KEPT: f64 = 0.995;

/// Fewest windows that a correction rests on.
const FEWEST: u32 = 8;

/// Standard deviations from which a lag is corrected, and its least size in seconds: what the settling filter and ten
/// samples a plateau leave uncertain besides.
const SIGNIFICANT: f64 = 4.0;
const LEAST_S: f64 = 3e-9;

/// Noise of a channel over its rms up to which a window counts. What plateaus say is off by the noise squared: 27 ns at
/// 72 kHz and 30 dB, 10 ns at 35 dB, which a bridge's resistance would explain and nothing is taken out for.
const MOST_NOISE: f64 = 0.02;

/// Resistance of the bridge in ohm that is taken for possible: it looks like a current that is behind.
const BRIDGE_R_OHM: f64 = 0.05;

/// By how much the capacitor may differ from its value, as a share: its tolerance, 5 %, stays.
const CAPACITANCE: f64 = 0.05;

/// A mean of numbers by their weights, that forgets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Mean {
    weighted: f64,
    weight: f64,
    /// Sum of the weights with their forgetting squared: what the variance rests on.
    weight_squared: f64,
}

impl Mean {
    fn add(&mut self, found: Found) {
        let weight = found.sigma.powi(-2);
        if !(weight.is_finite() && found.value.is_finite()) {
            return;
        }
        *self = Self {
            weighted: KEPT * self.weighted + weight * found.value,
            weight: KEPT * self.weight + weight,
            weight_squared: KEPT * KEPT * self.weight_squared + weight,
        };
    }

    fn found(&self) -> Option<Found> {
        (self.weight > 0.0).then(|| Found {
            value: self.weighted / self.weight,
            sigma: self.weight_squared.sqrt() / self.weight,
        })
    }

    fn is_sound(&self) -> bool {
        let all = [self.weighted, self.weight, self.weight_squared];
        all.iter().all(|x| x.is_finite()) && self.weight >= 0.0 && self.weight_squared >= 0.0
    }
}

/// What is known of one device's sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensors {
    /// Lag of the current in nanoseconds.
    lag_ns: Mean,
    /// Series capacitance in nanofarad.
    capacitance_nf: Mean,
    /// Windows that counted.
    windows: u32,
    /// Whether the correction was told of.
    told: bool,
}

/// What one window says of its device's sensors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Whether the window is too noisy to say anything.
    pub noisy: bool,
    /// Lag of the current in nanoseconds and series capacitance in nanofarad; none where the window does not show them.
    pub found: Option<[Found; 2]>,
    /// What is wrong with this window; it does not travel.
    #[serde(skip)]
    pub remarks: Vec<Remark>,
}

impl Evidence {
    /// Of a window as it was sampled.
    pub fn of(segment: &Segment) -> Self {
        let mut evidence = Self::default();
        if noisiest(segment) > MOST_NOISE {
            evidence.noisy = true;
            return evidence;
        }
        let scaled = |f: Found, by: f64| Found {
            value: by * f.value,
            sigma: by.abs() * f.sigma,
        };
        match of_segment(segment, None, None, Some(settling_s())) {
            // Of a window the kind of sensor is not worth choosing.
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

/// A window with what is known of its sensors taken out.
pub(super) fn corrected(segment: &Segment, correction: Option<&Correction>) -> Segment {
    correction.map_or_else(|| segment.clone(), |c| c.applied(segment))
}

impl Sensors {
    /// Looks at a window; the same window with what is known by now taken out, and what is to be said of it.
    #[cfg(test)]
    fn look(&mut self, segment: &Segment) -> (Segment, Vec<Remark>) {
        let evidence = Evidence::of(segment);
        let mut said = evidence.remarks.clone();
        said.extend(self.count(&evidence));
        (corrected(segment, self.correction().as_ref()), said)
    }

    /// Takes in what a window says; what is to be said of all windows since: once when a correction begins.
    pub fn count(&mut self, evidence: &Evidence) -> Vec<Remark> {
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

    /// How far the current is behind in seconds, with its deviation; `None` before the first window.
    pub fn lag_s(&self) -> Option<Found> {
        self.lag_ns.found().map(|f| Found {
            value: 1e-9 * f.value,
            sigma: 1e-9 * f.sigma,
        })
    }

    /// Windows that counted.
    pub fn windows(&self) -> u32 {
        self.windows
    }

    /// What is taken out of the windows; `None` where there is too little, or the bridge's resistance could be it.
    pub fn correction(&self) -> Option<Correction> {
        let lag = self.lag_s()?;
        let c_f = f64::from(RESONANCE_CAPACITANCE_NF) * 1e-9;
        let bridge = (0.0..BRIDGE_R_OHM * c_f).contains(&lag.value);
        let significant = lag.value.abs() > (SIGNIFICANT * lag.sigma).max(LEAST_S);
        (self.windows >= FEWEST && significant && !bridge).then(|| Correction {
            skew_s: -lag.value,
            ..Correction::default()
        })
    }

    fn correction_remark(&self) -> Remark {
        let lag = self.lag_ns.found().unwrap_or_default();
        let text = format!(
            "self-calibrated: this device's current is behind by {:.1} ± {:.1} ns, found in {} windows; from now on that is \
             taken out",
            lag.value, lag.sigma, self.windows
        );
        Remark::new(SELF_CALIBRATED, Severity::Info, text).with(lag.value, None)
    }

    /// The hob's own capacitor is known to its tolerance.
    fn gain_remark(&self) -> Option<Remark> {
        let found = self.capacitance_nf.found()?;
        let off = f64::from(RESONANCE_CAPACITANCE_NF) / found.value - 1.0;
        let limit = CAPACITANCE + SIGNIFICANT * found.sigma / found.value;
        (self.windows >= FEWEST && off.abs() > limit).then(|| {
            let text = format!(
                "the gain of the voltage over that of the current is off by {:+.1} %, or the resonance capacitor is {:.0} nF",
                100.0 * off,
                found.value
            );
            Remark::new("gain", Severity::Warning, text).with(100.0 * off, Some(100.0 * limit))
        })
    }

    /// Whether its numbers can be what windows taught.
    pub fn is_sound(&self) -> bool {
        self.lag_ns.is_sound() && self.capacitance_nf.is_sound()
    }
}

/// White noise over the rms, of the noisier channel.
fn noisiest(segment: &Segment) -> f64 {
    let rms = |x: &[f64]| (x.iter().map(|x| x * x).sum::<f64>() / x.len().max(1) as f64).sqrt();
    let noise = WhiteNoise::measure(segment);
    f64::max(noise.v_v / rms(&segment.v_v), noise.i_a / rms(&segment.i_a))
}

/// Time constant of the filter that both channels of a board share, in seconds.
fn settling_s() -> f64 {
    1.0 / (TAU * f64::from(ANTI_ALIAS_HZ))
}

#[cfg(test)]
mod tests {
    use ihd_sim::pot::{Metal, Pot};
    use ihd_sim::recording::run::record;
    use ihd_sim::recording::sensing::{Rate, Sensing};
    use ihd_sim::recording::settings::{LoadKind, Settings};

    use super::*;

    /// Windows of a board whose current is sampled late, at 40 dB.
    fn window(skew_s: f64, seed: u64) -> Segment {
        window_at(Settings::default().f_sw_hz, 40.0, skew_s, seed)
    }

    fn window_at(f_sw_hz: f64, snr_db: f64, skew_s: f64, seed: u64) -> Segment {
        let settings = Settings {
            f_sw_hz,
            load: LoadKind::Behavioural,
            pot: Pot::new(Metal::Ferritic, 0.21),
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
            ..Settings::default()
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
            let (corrected, said) = sensors.look(&window);
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
        after.look(&last.unwrap());
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
            sensors.look(&window_at(79.9e3, 25.0, 0.0, seed));
        }
        assert_eq!((sensors.windows(), sensors.correction()), (0, None));
    }

    #[test]
    fn of_right_sensors_nothing_is_said() {
        let mut sensors = Sensors::default();
        for seed in 0..12 {
            let window = window(0.0, 100 + seed);
            let (same, said) = sensors.look(&window);
            assert_eq!((same, said), (window, Vec::new()), "{sensors:?}");
        }
        assert!(sensors.windows() >= FEWEST, "{sensors:?}");
    }
}
