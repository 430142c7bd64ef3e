//! Excess of a model's residual over white noise in a whole estimate: the increase of σ by it, and the remark.

use ihd_signal::{Remark, Severity};

use super::Estimate;

/// Relative standard deviations of R and L by the residual above which it is a warning: half of the errors that must be
/// reported.
const LIMITS: [f64; 2] = [5e-3, 3.5e-3];

/// Least χ² of a residual that is mentioned; a smaller one is chance and rounding.
const MIN_CHI2: f64 = 4.0;

/// Means over an estimate, weighted with the squared current.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ModelResidual {
    weight: f64,
    chi2: f64,
    r: f64,
    l: f64,
}

impl ModelResidual {
    /// Adds one time: squared amplitude of its current, χ² of its residual against noise, relative σ of R and L.
    pub fn add(&mut self, weight: f64, chi2: f64, [r, l]: [f64; 2]) {
        if (weight * (chi2 + r + l)).is_finite() {
            self.weight += weight;
            self.chi2 += weight * chi2;
            self.r += weight * r.abs();
            self.l += weight * l.abs();
        }
    }

    /// Adds the remark to an estimate, in place of one on a smaller residual.
    pub fn note_in(&self, estimate: &mut Estimate) {
        let Some(remark) = self.remark() else {
            return;
        };
        let same = |r: &&mut Remark| r.code == remark.code;
        match estimate.remarks.iter_mut().find(same) {
            Some(before) if before.value >= remark.value => {}
            Some(before) => *before = remark,
            None => estimate.remarks.push(remark),
        }
    }

    /// Remark on the residual; `None` if it is within noise.
    fn remark(&self) -> Option<Remark> {
        let [chi2, r, l] = [self.chi2, self.r, self.l].map(|sum| sum / self.weight);
        if self.weight <= 0.0 || chi2 <= MIN_CHI2 {
            return None;
        }
        let (severity, advice) = if r > LIMITS[0] || l > LIMITS[1] {
            let advice = "look for a moving frequency, a step of the load, a neighbouring coil or aliased edges";
            (Severity::Warning, advice)
        } else {
            (Severity::Info, "the standard deviations contain it")
        };
        let text = format!(
            "the fit leaves {:.1} times the noise; R may be off by {:.2} %, L by {:.2} %: {advice}",
            chi2.sqrt(),
            100.0 * r,
            100.0 * l,
        );
        Some(Remark::new("model_residual", severity, text).with(chi2, Some(MIN_CHI2)))
    }
}
