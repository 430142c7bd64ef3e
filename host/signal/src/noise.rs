//! White noise of both channels, measured between the harmonics.
//!
//! At 1.5 f_sw a half-bridge has nothing: what is found there is noise. Windows of sin⁶ over 16
//! periods keep the carrier's and the third harmonic's own modulation out (8 bins away their
//! sidelobes are below 1e-6), and the median over the windows ignores the zero crossings.

use std::f64::consts::{LN_2, PI};

use super::Segment;
use super::correlation::Correlator;

/// Where the noise is looked for, in multiples of f_sw.
const ORDER: f64 = 1.5;

/// Switching periods of one window.
const PERIODS: f64 = 16.0;

/// Most windows that are looked at: their median is within 20 %.
const MOST_WINDOWS: usize = 16;

/// Standard deviation of one sample's white noise; zero where it could not be measured.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct WhiteNoise {
    /// Of the voltage in volt.
    pub v_v: f64,
    /// Of the current in ampere.
    pub i_a: f64,
}

impl WhiteNoise {
    /// Of a segment; zero when it is shorter than one window of 16 switching periods.
    pub fn measure(segment: &Segment) -> Self {
        let length = (PERIODS * segment.samples_per_period()).round() as usize;
        let weight: Vec<f64> = (0..length)
            .map(|n| {
                let s = libm::sin(PI * (n as f64 + 0.5) / length as f64);
                let square = s * s;
                square * square * square
            })
            .collect();
        let power: f64 = weight.iter().map(|w| w * w).sum();
        let correlator = Correlator::new(segment, length, [ORDER]);
        let windows = segment.len() / length.max(1);
        let stride = windows.div_ceil(MOST_WINDOWS).max(1);
        let (mut v, mut i) = (Vec::new(), Vec::new());
        let weighted =
            |x: &[f64]| -> Vec<f64> { x.iter().zip(&weight).map(|(x, w)| x * w).collect() };
        for k in (0..windows).step_by(stride) {
            let range = k * length..(k + 1) * length;
            let sums = correlator.block(
                range.start,
                &weighted(&segment.v_v[range.clone()]),
                &weighted(&segment.i_a[range]),
            );
            v.push(sums.v[0].norm_sqr() / power);
            i.push(sums.i[0].norm_sqr() / power);
        }
        // |X|² of white noise is exponential with mean σ²·Σw²: its median is ln 2 of that.
        let sigma = |x: Vec<f64>| median(x).map_or(0.0, |m| (m / LN_2).sqrt());
        Self {
            v_v: sigma(v),
            i_a: sigma(i),
        }
    }

    /// Deviations in volt and ampere; `None` where the segment was too short to measure them.
    pub fn measured(self) -> Option<[f64; 2]> {
        (self != Self::default()).then_some([self.v_v, self.i_a])
    }
}

/// The middle value; `None` of nothing.
pub fn median(mut x: Vec<f64>) -> Option<f64> {
    let middle = x.len() / 2;
    (!x.is_empty()).then(|| *x.select_nth_unstable_by(middle, f64::total_cmp).1)
}
