//! Samples of one channel of a stretch: those of a capture, converted where they are needed, or others.

use std::ops::Range;

use ihd_signal::correlation::weighted_sums;
use ihd_signal::vectorised::{sum, vectorised};

/// Samples of one channel, without their mean.
#[derive(Clone, Debug)]
pub(super) enum StretchSamples<'a> {
    /// Samples of a capture, which stay as they are.
    Captured {
        /// Samples of the capture.
        x: &'a [f32],
        /// Factor of all of them, 1 or −1.
        sign: f64,
        /// Mean of the products.
        mean: f64,
    },
    /// Other samples.
    Doubles(Vec<f64>),
}

impl<'a> StretchSamples<'a> {
    /// Takes samples of a capture times a sign, less their mean.
    pub fn captured(x: &'a [f32], sign: f64) -> Self {
        let mean = sign * mean(x);
        Self::Captured { x, sign, mean }
    }

    /// Copies samples less their mean.
    pub fn copied(x: &[f64]) -> Self {
        let mean = mean(x);
        Self::Doubles(x.iter().map(|x| x - mean).collect())
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        match self {
            Self::Captured { x, .. } => x.len(),
            Self::Doubles(x) => x.len(),
        }
    }

    /// Sample `k`.
    pub fn at(&self, k: usize) -> f64 {
        match self {
            Self::Captured { x, sign, mean } => sign * f64::from(x[k]) - mean,
            Self::Doubles(x) => x[k],
        }
    }

    /// Samples of a range; `buffer` is used if they must be converted.
    pub fn block<'b>(&'b self, range: Range<usize>, buffer: &'b mut Vec<f64>) -> &'b [f64] {
        let (x, sign, mean) = match self {
            Self::Captured { x, sign, mean } => (&x[range], *sign, *mean),
            Self::Doubles(x) => return &x[range],
        };
        buffer.resize(x.len(), 0.0);
        vectorised(
            #[inline(always)]
            || {
                for (y, x) in buffer.iter_mut().zip(x) {
                    *y = sign * f64::from(*x) - mean;
                }
            },
        );
        buffer
    }

    /// Sums of a range's samples, each with two weights, whose own sums are given.
    pub fn weighted_sums(
        &self,
        range: Range<usize>,
        weights: [&[f64]; 2],
        of_weights: [f64; 2],
    ) -> [f64; 2] {
        match self {
            Self::Captured { x, sign, mean } => {
                let [a, b] = weighted_sums(&x[range], weights);
                [
                    sign * a - mean * of_weights[0],
                    sign * b - mean * of_weights[1],
                ]
            }
            Self::Doubles(x) => weighted_sums(&x[range], weights),
        }
    }

    /// Copies all samples.
    pub fn to_vec(&self) -> Vec<f64> {
        self.block(0..self.len(), &mut Vec::new()).to_vec()
    }
}

fn mean<T: Copy + Into<f64>>(x: &[T]) -> f64 {
    let sum = vectorised(
        #[inline(always)]
        || sum(x),
    );
    sum / x.len().max(1) as f64
}
