//! The paper's extended Kalman filter, eq. (15)-(19): literal, repaired, and smoothed.
//!
//! The repaired filter works in units of the capture's own rms current and voltage, so that a probe of another ratio changes only
//! the units of the result. It takes the measurement noise from the capture ([`WhiteNoise`]). The reasons for its tuning are in
//! docs/identification.md.

pub mod literal;
pub mod rts;
pub mod step;
pub(crate) mod waveforms;

use std::time::Instant;

use ihd_signal::correlation::mean_impedance;
use ihd_signal::noise::WhiteNoise;
use ihd_signal::{Samples, Segment};
use serde::{Deserialize, Serialize};

use self::step::{EnvelopeFilter, FilterState, Model};
use self::waveforms::{EkfWaveforms, PeriodMeans};
use super::{Estimate, IdentifyError, IdentifyOptions, Method};

/// Noise model of the repaired filter, in units of the capture's rms current and voltage.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EkfTuning {
    /// Standard deviation of the change of i beyond x2 in a sample of 20 ns: Euler's error, in I_rms.
    pub current: f64,
    /// Standard deviation of the change of x2 in a sample of 20 ns: an edge of the bridge, in I_rms.
    pub slope: f64,
    /// Standard deviation of the change of R and ωL in a sample of 20 ns, in V_rms/I_rms.
    pub impedance: f64,
    /// Standard deviation of R and ωL at the start, as a share of the mean impedance.
    pub start: f64,
    /// Least standard deviation of a measured current, in I_rms.
    pub current_floor: f64,
    /// Least standard deviation of a measured voltage, in V_rms.
    pub voltage_floor: f64,
}

impl Default for EkfTuning {
    fn default() -> Self {
        Self {
            current: 4e-4,
            slope: 1.3e-3,
            impedance: 3e-4,
            start: 0.25,
            current_floor: 4e-3,
            voltage_floor: 6e-3,
        }
    }
}

/// Sampling interval at which [`EkfTuning`] is stated, in seconds: the paper's 50 MS/s.
const REFERENCE_S: f64 = 20e-9;

/// A segment in units of its rms current and voltage, and the filter for it.
#[derive(Clone, Debug, PartialEq)]
pub struct PreparedSegment {
    /// Current, sample by sample, in I_rms.
    pub i: Vec<f64>,
    /// Voltage in the middle between each sample and the next, in V_rms.
    pub v: Vec<f64>,
    /// Ampere and volt of one unit.
    i_unit_a: f64,
    v_unit_v: f64,
    /// Noise and transition of the filter.
    pub model: Model,
    /// Initial state of the filter.
    pub start: EnvelopeFilter,
}

/// Calls `each` with all samples as doubles, in order.
fn for_each(x: &Samples, mut each: impl FnMut(f64)) {
    let mut buffer = Vec::new();
    for from in (0..x.len()).step_by(Samples::CHUNK) {
        let range = from..(from + Samples::CHUNK).min(x.len());
        x.block(range, &mut buffer).iter().for_each(|x| each(*x));
    }
}

fn rms(x: &Samples) -> f64 {
    let mut sum = 0.0;
    for_each(x, |x| sum += x * x);
    (sum / x.len().max(1) as f64).sqrt()
}

impl PreparedSegment {
    /// Measures units, noise and start of a segment that passes [`Segment::check`].
    pub fn new(segment: &Segment, settings: &IdentifyOptions) -> Self {
        let (i_unit_a, v_unit_v) = (rms(&segment.i_a), rms(&segment.v_v));
        // x2 is the change to the next sample, so that R·i + L·di/dt belongs to the middle between the two.
        let mut v = Vec::with_capacity(segment.len());
        let mut before = None;
        for_each(&segment.v_v, |next| {
            v.extend(before.map(|before| 0.5 * (before + next) / v_unit_v));
            before = Some(next);
        });
        v.extend(before.map(|last| 0.5 * (last + last) / v_unit_v));
        let mut i = Vec::with_capacity(segment.i_a.len());
        for_each(&segment.i_a, |x| i.push(x / i_unit_a));
        let noise = WhiteNoise::measure(segment);
        let tuning = &settings.ekf;
        let ratio = segment.dt_s / REFERENCE_S;
        let omega_dt = std::f64::consts::TAU * segment.f_sw_hz * segment.dt_s;
        // Random walks grow with √T_s; x2 = T_s·di/dt has one T_s more, x4 = L/T_s one less.
        let deviation = [
            tuning.current * ratio.sqrt(),
            tuning.slope * ratio.sqrt() * ratio,
            tuning.impedance * ratio.sqrt(),
            tuning.impedance * ratio.sqrt() / omega_dt,
        ];
        let square = |x: f64| x * x;
        let z = mean_impedance(segment) * (i_unit_a / v_unit_v);
        let (r, l) = match settings.start {
            Some((r, l)) => {
                let unit = v_unit_v / i_unit_a;
                (r / unit, l / segment.dt_s / unit)
            }
            None => (z.re, z.im / omega_dt),
        };
        let x4 = l + 0.5 * r;
        let z2 = z.norm_sqr();
        Self {
            i,
            v,
            i_unit_a,
            v_unit_v,
            model: Model {
                f12: 1.0,
                q: deviation.map(square),
                q34: 0.0,
                r: [
                    square(tuning.current_floor.max(noise.i_a / i_unit_a)),
                    square(tuning.voltage_floor.max(noise.v_v / v_unit_v)),
                ],
            },
            start: EnvelopeFilter {
                x: [0.0, 0.0, r, x4],
                p: [
                    1.0,
                    0.0,
                    0.0,
                    0.0,
                    square(omega_dt),
                    0.0,
                    0.0,
                    square(settings.ekf.start) * z2,
                    0.0,
                    square(settings.ekf.start) * z2 / square(omega_dt),
                ],
            },
        }
    }

    /// Factors from the filter's R and x4 to ohm and henry.
    fn units(&self, segment: &Segment) -> [f64; 2] {
        let ohm = self.v_unit_v / self.i_unit_a;
        [ohm, ohm * segment.dt_s]
    }
}

/// L/T_s of a state: the current in the middle between two samples is x1 + x2/2, so x4 is
/// L/T_s + R/2.
#[inline(always)]
fn inductance(x: &FilterState) -> f64 {
    x[3] - 0.5 * x[2]
}

/// Runs the repaired filter once over the segment.
///
/// # Errors
/// [`IdentifyError::Diverged`] if state or covariance become unsound.
pub fn identify(segment: &Segment, settings: &IdentifyOptions) -> Result<Estimate, IdentifyError> {
    let started = Instant::now();
    let prepared = PreparedSegment::new(segment, settings);
    let mut means = PeriodMeans::new(segment, prepared.units(segment));
    let mut waves = EkfWaveforms::new(segment.len(), prepared.i_unit_a, prepared.v_unit_v);
    let mut filter = prepared.start;
    for (i, v) in prepared.i.iter().zip(&prepared.v) {
        filter.step(&prepared.model, *i, *v);
        means.push(
            filter.x[2],
            inductance(&filter.x),
            [filter.p[7], filter.p[9]],
        );
        waves.push(filter.x[0], filter.v());
    }
    waveforms::sound(&filter, segment, Method::Ekf)?;
    let mut estimate = means.finish(Method::Ekf);
    waves.centre_voltage();
    waves.finish(&mut estimate);
    estimate.elapsed = started.elapsed();
    Ok(estimate)
}

/// Runs the repaired filter forward and the smoother backward.
///
/// # Errors
/// [`IdentifyError::Diverged`] if the estimates are not finite.
pub fn identify_smoothed(
    segment: &Segment,
    settings: &IdentifyOptions,
) -> Result<Estimate, IdentifyError> {
    let started = Instant::now();
    let prepared = PreparedSegment::new(segment, settings);
    let n = segment.len();
    // The smoother runs from the end: its means are those of the reversed segment.
    let mut means = PeriodMeans::backward(segment, prepared.units(segment));
    let mut waves = EkfWaveforms::new(n, prepared.i_unit_a, prepared.v_unit_v);
    rts::smooth(
        &prepared.model,
        prepared.start,
        &prepared.i,
        &prepared.v,
        |_, x, variance| {
            means.push(x[2], inductance(x), variance);
            waves.push(x[0], x[0] * x[2] + x[1] * x[3]);
        },
    );
    let mut estimate = means.finish(Method::Rts);
    waveforms::finite(&estimate, segment)?;
    waves.reverse();
    waves.centre_voltage();
    waves.finish(&mut estimate);
    estimate.elapsed = started.elapsed();
    Ok(estimate)
}
