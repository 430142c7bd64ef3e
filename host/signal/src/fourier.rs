//! Fourier transforms of real samples for all crates. The library is generic, so that each crate that plans a transform itself
//! would compile all kernels again (4 to 8 s of processor time, and 2 MB in the program).

use std::sync::Arc;

use realfft::RealFftPlanner;
pub use realfft::{ComplexToReal, RealToComplex};

/// Plans the transform of this many samples to their spectrum.
#[inline(never)]
pub fn forward(points: usize) -> Arc<dyn RealToComplex<f64>> {
    RealFftPlanner::new().plan_fft_forward(points)
}

/// Plans the transform of a spectrum back to this many samples, which come out `points` times as large.
#[inline(never)]
pub fn inverse(points: usize) -> Arc<dyn ComplexToReal<f64>> {
    RealFftPlanner::new().plan_fft_inverse(points)
}
