//! Conversion of a filter's states at every sample to an estimate, by means over switching periods.

use ihd_signal::Segment;

use super::step::EnvelopeFilter;
use crate::{Estimate, IdentifyError, Method};

/// Means of R and x4 over each switching period; the ripple within a period is no estimate.
pub struct PeriodMeans {
    t0_s: f64,
    dt_s: f64,
    f_sw_hz: f64,
    per_period: f64,
    units: [f64; 2],
    samples: usize,
    backward: bool,
    taken: usize,
    periods: usize,
    count: usize,
    sums: [f64; 4],
    rows: Vec<[f64; 5]>,
}

impl PeriodMeans {
    /// Creates means for samples in ascending order; `units` are the factors to ohm and henry.
    pub fn new(segment: &Segment, units: [f64; 2]) -> Self {
        Self {
            t0_s: segment.t0_s,
            dt_s: segment.dt_s,
            f_sw_hz: segment.f_sw_hz,
            per_period: segment.samples_per_period(),
            units,
            samples: segment.len(),
            backward: false,
            taken: 0,
            periods: 0,
            count: 0,
            sums: [0.0; 4],
            rows: Vec::new(),
        }
    }

    /// Creates means for samples in descending order.
    pub fn backward(segment: &Segment, units: [f64; 2]) -> Self {
        Self {
            backward: true,
            ..Self::new(segment, units)
        }
    }

    /// Adds the next sample's R, x4 and their variances.
    #[inline(always)]
    pub fn push(&mut self, r: f64, x4: f64, variance: [f64; 2]) {
        self.sums[0] += r;
        self.sums[1] += x4;
        self.sums[2] += variance[0];
        self.sums[3] += variance[1];
        self.count += 1;
        self.taken += 1;
        if self.taken as f64 >= (self.periods + 1) as f64 * self.per_period {
            self.end_period();
        }
    }

    #[inline(never)]
    fn end_period(&mut self) {
        let n = self.count as f64;
        let middle = self.taken as f64 - 0.5 * (n + 1.0);
        let at = if self.backward {
            self.samples as f64 - 1.0 - middle
        } else {
            middle
        };
        let sigma = |k: usize| (self.sums[k] / n).max(0.0).sqrt() * self.units[k - 2];
        self.rows.push([
            self.t0_s + at * self.dt_s,
            self.sums[0] / n * self.units[0],
            self.sums[1] / n * self.units[1],
            sigma(2),
            sigma(3),
        ]);
        self.periods += 1;
        self.count = 0;
        self.sums = [0.0; 4];
    }

    /// Converts the means to an estimate, in order of time.
    pub fn finish(mut self, method: Method) -> Estimate {
        if self.backward {
            self.rows.reverse();
        }
        let mut estimate = Estimate::new(method, self.f_sw_hz);
        for [t, r, l, r_sigma, l_sigma] in self.rows {
            estimate.push(t, (r, l), (r_sigma, l_sigma));
        }
        estimate
    }
}

/// Reconstructed current and voltage, sample by sample.
pub struct EkfWaveforms {
    i_unit_a: f64,
    v_unit_v: f64,
    i_a: Vec<f32>,
    v_v: Vec<f32>,
}

impl EkfWaveforms {
    /// Reserves room for `samples` samples in units of so many ampere and volt.
    pub fn new(samples: usize, i_unit_a: f64, v_unit_v: f64) -> Self {
        Self {
            i_unit_a,
            v_unit_v,
            i_a: Vec::with_capacity(samples),
            v_v: Vec::with_capacity(samples),
        }
    }

    /// Adds the next sample.
    #[inline(always)]
    pub fn push(&mut self, i: f64, v: f64) {
        self.i_a.push((i * self.i_unit_a) as f32);
        self.v_v.push((v * self.v_unit_v) as f32);
    }

    /// Reverses the order of the samples.
    pub fn reverse(&mut self) {
        self.i_a.reverse();
        self.v_v.reverse();
    }

    /// Moves the voltages from the middles between samples to the samples.
    pub fn centre_voltage(&mut self) {
        for k in (1..self.v_v.len()).rev() {
            self.v_v[k] = 0.5 * (self.v_v[k] + self.v_v[k - 1]);
        }
    }

    /// Moves the waveforms to the estimate.
    pub fn finish(self, estimate: &mut Estimate) {
        estimate.i_hat_a = self.i_a;
        estimate.v_hat_v = self.v_v;
    }
}

/// Returns an error if the filter's last state is unsound; an earlier fault persists until then.
pub fn sound(
    filter: &EnvelopeFilter,
    segment: &Segment,
    method: Method,
) -> Result<(), IdentifyError> {
    if filter.is_sound() {
        return Ok(());
    }
    Err(diverged(method, segment.t_s(segment.len() - 1)))
}

/// Returns an error if the estimate has no points, or an R or L that is not finite.
pub fn finite(estimate: &Estimate, segment: &Segment) -> Result<(), IdentifyError> {
    let bad = estimate
        .points()
        .find(|(_, r, l)| !(r.is_finite() && l.is_finite()));
    match bad {
        Some((t_s, ..)) => Err(diverged(estimate.method, t_s)),
        None if estimate.t_s.is_empty() => Err(diverged(estimate.method, segment.t0_s)),
        None => Ok(()),
    }
}

fn diverged(method: Method, t_s: f64) -> IdentifyError {
    IdentifyError::Diverged {
        method,
        what: "state or covariance stopped being finite and positive".into(),
        t_s,
        advice: "the noise model does not fit this capture; try `least-squares` or `lockin`",
    }
}
