//! Transforms of real samples, planned here for every crate: the library is generic, and each crate that plans one by
//! itself compiles all of its kernels again (4 to 8 s of processor time, and 2 MB in the program).

use std::sync::Arc;

use realfft::RealFftPlanner;
pub use realfft::{ComplexToReal, RealToComplex};

/// The transform of this many samples to their spectrum.
#[inline(never)]
pub fn forward(points: usize) -> Arc<dyn RealToComplex<f64>> {
    RealFftPlanner::new().plan_fft_forward(points)
}

/// The transform of a spectrum back to this many samples, each `points` times as large.
#[inline(never)]
pub fn inverse(points: usize) -> Arc<dyn ComplexToReal<f64>> {
    RealFftPlanner::new().plan_fft_inverse(points)
}
