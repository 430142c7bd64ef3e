//! The paper's filter exactly as eq. (15)-(19) and section V print it: raw units, x̂₀ = 0,
//! Σ_x,0 = 10³·I, Σ_v = 1 for either measurement.
//!
//! Three errors in print are kept: Σ_w is indefinite (its cross term 10⁻⁵ exceeds
//! √(10⁻⁷·10⁻⁶)), x̂₀ = 0 is a saddle, and (17) makes x2 a rate in A/s while (18) multiplies it by
//! L/T_s. The estimate notes which of these had an effect.

use std::time::Instant;

use ihd_signal::Segment;
use nalgebra::{Cholesky, Matrix4};

use super::step::{Covariance, EnvelopeFilter, Model};
use super::waveforms::{EkfWaveforms, PeriodMeans, finite};
use crate::{Estimate, IdentifyError, Method};

/// Eq. (19) at a sampling interval in seconds.
fn model(dt_s: f64) -> Model {
    Model {
        f12: dt_s,
        q: [1e-1, 1e-1 / dt_s, 1e-7, 1e-6],
        q34: 1e-5,
        r: [1.0, 1.0],
    }
}

const START: EnvelopeFilter = EnvelopeFilter {
    x: [0.0; 4],
    p: [1e3, 0.0, 0.0, 0.0, 1e3, 0.0, 0.0, 1e3, 0.0, 1e3],
};

/// Runs the paper's filter over the segment; L = x4·T_s, as the paper defines x4.
///
/// # Errors
/// [`IdentifyError::Diverged`] if an estimate is not finite.
pub fn identify(segment: &Segment) -> Result<Estimate, IdentifyError> {
    let started = Instant::now();
    let model = model(segment.dt_s);
    let mut means = PeriodMeans::new(segment, [1.0, segment.dt_s]);
    let mut waves = EkfWaveforms::new(segment.len(), 1.0, 1.0);
    let mut filter = START;
    let per_period = segment.samples_per_period().ceil() as usize;
    let (mut looks, mut indefinite) = (0u32, 0u32);
    for (n, (i, v)) in segment.i_a.iter().zip(&segment.v_v).enumerate() {
        filter.step(&model, *i, *v);
        means.push(filter.x[2], filter.x[3], [filter.p[7], filter.p[9]]);
        waves.push(filter.x[0], filter.v());
        if n % per_period == 0 {
            looks += 1;
            indefinite += u32::from(!is_positive(&filter.p));
        }
    }
    let mut estimate = means.finish(Method::EkfPaper);
    finite(&estimate, segment)?;
    waves.finish(&mut estimate);
    estimate.elapsed = started.elapsed();
    estimate.notes = vec![
        "Σ_w of eq. (19) is indefinite: its cross term 1e-5 exceeds √(1e-7·1e-6)".into(),
        "eq. (17) takes x2 in A/s, eq. (18) per sample: L = x4·T_s is only as good as that".into(),
    ];
    if indefinite > 0 {
        estimate.notes.push(format!(
            "the covariance was not positive definite in {indefinite} of {looks} looks, one a period"
        ));
    }
    Ok(estimate)
}

fn is_positive(p: &Covariance) -> bool {
    let [a, b, c, d, e, f, g, h, i, j] = *p;
    // Scaled to a unit diagonal: the states differ by ten orders of magnitude.
    let scale = [a, e, h, j].map(|x| 1.0 / x.sqrt());
    let dense = Matrix4::new(a, b, c, d, b, e, f, g, c, f, h, i, d, g, i, j);
    let scaled = Matrix4::from_fn(|r, c| dense[(r, c)] * scale[r] * scale[c]);
    scaled.iter().all(|x| x.is_finite()) && Cholesky::new(scaled).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_process_noise_is_indefinite_as_written() {
        let q = model(20e-9);
        assert!(q.q34 * q.q34 > q.q[2] * q.q[3]);
        assert!(!is_positive(&[
            q.q[0], 0.0, 0.0, 0.0, q.q[1], 0.0, 0.0, q.q[2], q.q34, q.q[3]
        ]));
        assert!(is_positive(&START.p));
    }
}
