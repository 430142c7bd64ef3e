//! Search for the strongest line in the spectrum of a complex signal.

use std::f64::consts::LN_2;

use ihd_signal::fourier;
use ihd_signal::noise::median;
use nalgebra::Complex;

/// Least power of a line over the mean of its neighbours. White noise exceeds it once in 1e13 lines.
const LINE: f64 = 30.0;

/// Least power of a line over that at the mirrored offset: changes of the load have both sidebands, a tone has one.
const ONE_SIDED: f64 = 4.0;

/// Lines on either side that make up the floor.
const NEIGHBOURS: usize = 32;

/// Lines that the window's main lobe covers on either side.
const LOBE_LINES: usize = 4;

/// Largest offset that is searched, as a share of the signal's rate: a boxcar's first zero lies just beyond it.
const MAX_OFFSET: f64 = 0.25;

/// Steps of the search for a line's frequency.
const SEARCH_STEPS: usize = 24;

/// Power by line, those of negative frequency in the upper half.
pub struct Lines(Vec<f64>);

impl Lines {
    /// Computes the spectrum of a signal under a window's weights; `None` if the signal is empty.
    pub fn compute(x: &[Complex<f64>], weight: &[f64]) -> Option<Self> {
        let n = x.len();
        if n == 0 {
            return None;
        }
        let fft = fourier::forward(n);
        let transformed = |part: fn(&Complex<f64>) -> f64| {
            let mut input: Vec<f64> = x.iter().zip(weight).map(|(x, w)| part(x) * w).collect();
            let mut output = fft.make_output_vec();
            fft.process(&mut input, &mut output).ok()?;
            Some(output)
        };
        let (re, im) = (transformed(|x| x.re)?, transformed(|x| x.im)?);
        let mut power = vec![0.0; n];
        for (k, (re, im)) in re.iter().zip(&im).enumerate() {
            // X = Re + j·Im; the mirrored line takes the conjugates of both.
            power[k] = (re.re - im.im).powi(2) + (re.im + im.re).powi(2);
            if k > 0 {
                power[n - k] = (re.re + im.im).powi(2) + (re.im - im.re).powi(2);
            }
        }
        Some(Self(power))
    }

    fn power(&self, line: i64) -> f64 {
        self.0[line.rem_euclid(self.0.len() as i64) as usize]
    }

    /// Finds the strongest line that exceeds its neighbours, and returns its signed number. Only a line for which `expected`
    /// returns `true` may have a mirror image.
    pub fn strongest(&self, expected: impl Fn(i64) -> bool) -> Option<i64> {
        let of = |k: i64| self.power(k);
        let most = (MAX_OFFSET * self.0.len() as f64) as i64;
        let stands_out = |k: &i64| {
            let around = (LOBE_LINES..LOBE_LINES + NEIGHBOURS)
                .flat_map(|d| [of(k - d as i64), of(k + d as i64)]);
            let floor = median(&mut around.collect::<Vec<_>>()).unwrap_or(f64::INFINITY) / LN_2;
            let mirror = (-k - 1..=-k + 1).map(of).fold(0.0, f64::max);
            of(*k) > LINE * floor && (of(*k) > ONE_SIDED * mirror || expected(*k))
        };
        let is_peak = |k: &i64| of(*k) >= of(k - 1) && of(*k) >= of(k + 1);
        (-most..=most)
            .filter(|k| k.unsigned_abs() as usize > LOBE_LINES)
            .filter(is_peak)
            .filter(stands_out)
            .max_by(|a, b| of(*a).total_cmp(&of(*b)))
    }
}

/// Finds the maximum of `power` within `reach` of a place, by ternary search.
pub fn peak(place: f64, reach: f64, power: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (place - reach, place + reach);
    for _ in 0..SEARCH_STEPS {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if power(a) < power(b) {
            low = a;
        } else {
            high = b;
        }
    }
    0.5 * (low + high)
}
