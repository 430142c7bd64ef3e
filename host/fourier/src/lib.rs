//! Fourier transforms of real samples for all crates. The library is generic, so that each crate that plans a transform itself
//! would compile all kernels again, and once more with its unit tests (18 s of processor time, and 2 MB in the program).

use std::cell::RefCell;
use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::sync::Arc;

use realfft::RealFftPlanner;
pub use realfft::{ComplexToReal, RealToComplex};

/// Plans that a thread keeps, and their longest length: windows of a device repeat few lengths, captures may have any.
const MAX_PLANS: usize = 4;
const MAX_KEPT_POINTS: usize = 1 << 14;

thread_local! {
    /// Latest plans, the newest first.
    static LATEST: RefCell<VecDeque<Arc<dyn RealToComplex<f64>>>> = const { RefCell::new(VecDeque::new()) };
}

/// Plans the transform of this many samples to their spectrum.
#[inline(never)]
pub fn forward(points: usize) -> Arc<dyn RealToComplex<f64>> {
    let planned = || RealFftPlanner::new().plan_fft_forward(points);
    if points > MAX_KEPT_POINTS {
        return planned();
    }
    LATEST.with_borrow_mut(|latest| {
        let known = latest.iter().position(|plan| plan.len() == points);
        let plan = known.and_then(|k| latest.remove(k));
        let plan = plan.unwrap_or_else(planned);
        latest.truncate(MAX_PLANS - 1);
        latest.push_front(Arc::clone(&plan));
        plan
    })
}

/// Plans the transform of a spectrum back to this many samples, which come out `points` times as large.
#[inline(never)]
pub fn inverse(points: usize) -> Arc<dyn ComplexToReal<f64>> {
    RealFftPlanner::new().plan_fft_inverse(points)
}

/// Midpoint Hann window: `n` weights whose sum is n/2.
pub fn hann(n: usize) -> Vec<f64> {
    (0..n)
        .map(|k| 0.5 - 0.5 * libm::cos(TAU * (k as f64 + 0.5) / n as f64))
        .collect()
}

/// Periodic Hann window, which begins with zero: `n` weights whose sum is n/2.
pub fn periodic_hann(n: usize) -> Vec<f64> {
    (0..n)
        .map(|k| 0.5 - 0.5 * libm::cos(TAU * k as f64 / n as f64))
        .collect()
}

/// Returns sin(πx)/(πx), the spectrum of a rectangle of width 1.
pub fn sinc(x: f64) -> f64 {
    let angle = std::f64::consts::PI * x;
    if angle == 0.0 {
        1.0
    } else {
        libm::sin(angle) / angle
    }
}
