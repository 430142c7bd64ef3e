//! Phasors of harmonics over time, from Hann-windowed frames of a few switching periods.

use std::f64::consts::TAU;

use ihd_signal::fourier::periodic_hann;
use ihd_signal::vectorised::{dot, sum, vectorised};
use ihd_signal::{Capture, ORDERS};
use nalgebra::{Complex, Matrix4, Vector4};

use super::time::Run;

/// Least switching periods per frame, and the largest number of them.
const MIN_PERIODS: f64 = 3.0;
const MAX_PERIODS: f64 = 30.0;

/// Most that a load turns the phase over a piece, in radian: less than that from full to no saturation.
const MAX_TURN: f64 = 1.0;

/// Phasors at the middles of frames: x(t) = Σ Re(X_h e^{jhω(t − t0)}), amplitudes, with `t0` the time of the first sample.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Switching frequency in hertz.
    pub f_sw_hz: f64,
    /// Times of the frames' middles in seconds.
    pub t_s: Vec<f64>,
    /// Voltage in volt, one vector an order of [`ORDERS`] that the rate can show.
    pub v_v: Vec<Vec<Complex<f64>>>,
    /// Current in ampere, one vector an order of [`ORDERS`] that the rate can show.
    pub i_a: Vec<Vec<Complex<f64>>>,
    /// Samples per frame.
    pub frame: usize,
}

/// Phasors of the current's fundamental.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackedFundamental {
    /// Times in seconds.
    pub t_s: Vec<f64>,
    /// Phasors of the current, amplitudes in ampere.
    pub i_a: Vec<Complex<f64>>,
}

/// Real and imaginary part of `scale` times a window times e^{-jφ}, whose phase φ grows by `turn` radian a sample.
pub fn turned(window: &[f64], scale: f64, turn: f64) -> [Vec<f64>; 2] {
    // The phase of a sample is that of the first of so many, and one of a table.
    const TABLE: usize = 64;
    let phasor = |k: usize| {
        let (sin, cos) = libm::sincos(turn * k as f64);
        Complex::new(cos, -sin)
    };
    let table: Vec<Complex<f64>> = (0..TABLE).map(phasor).collect();
    let of_table = |(n, window): (usize, &[f64])| {
        let first = phasor(n * TABLE) * scale;
        let each = window.iter().zip(&table);
        each.map(|(w, turned)| first * turned * *w)
            .collect::<Vec<_>>()
    };
    let all = window.chunks(TABLE).enumerate().flat_map(of_table);
    let (re, im) = all.map(|z| (z.re, z.im)).unzip();
    [re, im]
}

/// Phasors of a run at `f_hz` in hertz, frames overlapping by half.
pub fn track(capture: &Capture, run: &Run, f_hz: f64) -> Track {
    let per_period = 1.0 / (f_hz * run.dt_s);
    let frame = samples_per_frame(per_period);
    let orders: Vec<u32> = ORDERS
        .into_iter()
        .filter(|&h| h == 1 || f64::from(h) * 2.2 < per_period)
        .collect();
    let (t_s, v_v) = channel(&capture.v_v, run, f_hz, frame, frame / 2, &orders);
    let (_, i_a) = channel(&capture.i_a, run, f_hz, frame, frame / 2, &orders);
    Track {
        f_sw_hz: f_hz,
        t_s,
        v_v,
        i_a,
        frame,
    }
}

/// Samples per frame: of five numbers of periods the one that is nearest to a whole number of samples, so that the window's nulls lie
/// on the other harmonics. The mirror image, at the sampling rate less the switching frequency, is beyond the window's main lobe,
/// two of its bins wide.
fn samples_per_frame(per_period: f64) -> usize {
    let least = if per_period > 2.0 {
        (2.0 / (per_period - 2.0))
            .ceil()
            .clamp(MIN_PERIODS, MAX_PERIODS)
    } else {
        MIN_PERIODS
    };
    let lengths = (0..5).map(|more| (least + f64::from(more)) * per_period);
    let mismatch = |n: &f64| (n - n.round()).abs() / n;
    let length = lengths.min_by(|a, b| mismatch(a).total_cmp(&mismatch(b)));
    length.unwrap_or(least * per_period).round() as usize
}

/// Phasors of the current's fundamental in the frames of [`track`].
pub fn of_current(capture: &Capture, run: &Run, f_hz: f64) -> TrackedFundamental {
    let frame = samples_per_frame(1.0 / (f_hz * run.dt_s));
    current(capture, run, f_hz, (frame, frame / 2))
}

/// Phasors of the current's fundamental, two periods per frame and a frame every half period.
pub fn fundamental(capture: &Capture, run: &Run, f_hz: f64) -> TrackedFundamental {
    let per_period = 1.0 / (f_hz * run.dt_s);
    let frame = (2.0 * per_period).round() as usize;
    let hop = (0.5 * per_period).round().max(1.0) as usize;
    current(capture, run, f_hz, (frame, hop))
}

/// Phasors of the current at a frequency, with so many samples a frame and from frame to frame.
fn current(
    capture: &Capture,
    run: &Run,
    f_hz: f64,
    (frame, hop): (usize, usize),
) -> TrackedFundamental {
    let (t_s, mut i_a) = channel(&capture.i_a, run, f_hz, frame, hop, &[1]);
    TrackedFundamental {
        t_s,
        i_a: i_a.pop().unwrap_or_default(),
    }
}

/// Rms values of the current's phasors at some frequencies in hertz, with so many samples a frame and from frame to frame.
pub fn rms_of_current<const MANY: usize>(
    capture: &Capture,
    run: &Run,
    f_hz: [f64; MANY],
    (frame, hop): (usize, usize),
) -> [f64; MANY] {
    let x = &capture.i_a[run.samples.clone()];
    let (mut squares, mut frames) = ([0.0; MANY], 0);
    let steps = f_hz.map(|f_hz| TAU * f_hz * run.dt_s);
    for_frames(x, frame.max(1), hop, &steps, |_, sums| {
        frames += 1;
        for (square, [re, im]) in squares.iter_mut().zip(sums) {
            *square += re * re + im * im;
        }
    });
    squares.map(|square| (square / f64::from(frames.max(1))).sqrt())
}

/// Times of the frames' middles, and their phasors, one vector per order.
fn channel(
    x: &[f32],
    run: &Run,
    f_hz: f64,
    frame: usize,
    hop: usize,
    orders: &[u32],
) -> (Vec<f64>, Vec<Vec<Complex<f64>>>) {
    let x = &x[run.samples.clone()];
    let frame = frame.max(1);
    let middle = 0.5 * frame as f64;
    let step = TAU * f_hz * run.dt_s;
    let steps: Vec<f64> = orders.iter().map(|&h| f64::from(h) * step).collect();
    let mut t_s = Vec::new();
    let mut out = vec![Vec::new(); orders.len()];
    for_frames(x, frame, hop, &steps, |start, sums| {
        t_s.push(run.t0_s + (start as f64 + middle) * run.dt_s);
        for ((order, [re, im]), out) in orders.iter().zip(sums).zip(&mut out) {
            let turned = f64::from(*order) * (step * start as f64 % TAU);
            out.push(Complex::new(*re, *im) * Complex::from_polar(1.0, -turned));
        }
    });
    (t_s, out)
}

/// Calls `each` with a frame's first sample and its phasors, counted from that sample, one for each of the frequencies: `steps` in
/// radian a sample.
fn for_frames(
    x: &[f32],
    frame: usize,
    hop: usize,
    steps: &[f64],
    mut each: impl FnMut(usize, &[[f64; 2]]),
) {
    let window = periodic_hann(frame);
    // Window times e^{-jωt} from the frame's first sample; the remaining factor is one rotation per frame.
    let tables: Vec<[Vec<f64>; 2]> = steps
        .iter()
        .map(|&step| turned(&window, 4.0 / frame as f64, step))
        .collect();
    let mut sums = vec![[0.0; 2]; BATCH_FRAMES * steps.len()];
    let (mut means, mut buffer) = ([0.0; BATCH_FRAMES], [0.0; STRETCH]);
    let frames = (x.len() + 1).saturating_sub(frame).div_ceil(hop.max(1));
    for first in (0..frames).step_by(BATCH_FRAMES) {
        let starts = (first..frames.min(first + BATCH_FRAMES)).map(|k| k * hop.max(1));
        sums.fill([0.0; 2]);
        vectorised(
            #[inline(always)]
            || {
                for (mean, start) in means.iter_mut().zip(starts.clone()) {
                    *mean = sum(&x[start..start + frame]) / frame as f64;
                }
                // A part of the tables stays in the cache for all these frames.
                let mut from = 0;
                while from < frame {
                    let to = frame.min(from + STRETCH);
                    let of_frames = sums.chunks_exact_mut(steps.len());
                    for ((start, mean), sums) in starts.clone().zip(&means).zip(of_frames) {
                        let buffer = &mut buffer[..to - from];
                        for (y, x) in buffer.iter_mut().zip(&x[start + from..start + to]) {
                            *y = f64::from(*x) - mean;
                        }
                        for ([re, im], sum) in tables.iter().zip(sums) {
                            sum[0] += dot(&re[from..to], buffer);
                            sum[1] += dot(&im[from..to], buffer);
                        }
                    }
                    from = to;
                }
            },
        );
        for (start, sums) in starts.zip(sums.chunks_exact(steps.len())) {
            each(start, sums);
        }
    }
}

/// Frames that are correlated together; then samples of the tables per pass.
const BATCH_FRAMES: usize = 8;
const STRETCH: usize = 256;

impl TrackedFundamental {
    /// Difference of the switching frequency from the track's, in hertz, by the slope of the current's phase.
    ///
    /// The load turns the phase as its R and L follow the current, by a law of the amplitude. The amplitude and its square are
    /// therefore fitted as well, which keeps the slope free of them in a capture that is no whole number of half-cycles. Where the
    /// fit asks for more than a load's turn, amplitude and time cannot be told apart, and the rotation alone counts.
    pub fn frequency_error_hz(&self) -> f64 {
        let i_a = &self.i_a;
        if i_a.len() < 2 {
            return 0.0;
        }
        let hop_s = self.t_s[1] - self.t_s[0];
        let coarse = pulse_pair_hz(i_a, hop_s);
        let t0_s = self.t_s[0];
        let level = i_a
            .iter()
            .map(|i| i.norm())
            .fold(0.0, f64::max)
            .max(f64::MIN_POSITIVE);
        let steady: Vec<Complex<f64>> = (i_a.iter().zip(&self.t_s))
            .map(|(i, t)| i * Complex::from_polar(1.0, -TAU * coarse * (t - t0_s)))
            .collect();
        let mean: Complex<f64> = steady.iter().sum();
        let span_s = self.t_s[self.t_s.len() - 1] - t0_s;
        let mut normal = Matrix4::zeros();
        let mut right = Vector4::zeros();
        for (i, t) in steady.iter().zip(&self.t_s) {
            let e = i.norm() / level;
            let row = Vector4::new(1.0, (t - t0_s) / span_s, e, e * e);
            let weight = e * e;
            normal += row * row.transpose() * weight;
            right += row * ((i * mean.conj()).arg() * weight);
        }
        // A steady amplitude does not determine its columns: a small weight keeps them at zero.
        let ridge = 1e-9 * normal[(0, 0)];
        normal[(2, 2)] += ridge;
        normal[(3, 3)] += ridge;
        let turn = normal.cholesky().map_or(0.0, |c| c.solve(&right)[1]);
        if turn.abs() > MAX_TURN {
            return coarse;
        }
        coarse + turn / (TAU * span_s)
    }
}

/// Frequency of a phasor track in hertz from the phase of its autocorrelation, at lags that double, so that none turns by more
/// than half a circle.
fn pulse_pair_hz(x: &[Complex<f64>], hop_s: f64) -> f64 {
    let mut f_hz = 0.0;
    let mut lag = 1;
    while lag < x.len() && lag <= x.len() / 2 + 1 {
        let sum: Complex<f64> = x.iter().zip(&x[lag..]).map(|(a, b)| b * a.conj()).sum();
        let lag_s = lag as f64 * hop_s;
        let expected = Complex::from_polar(1.0, -TAU * f_hz * lag_s);
        f_hz += (sum * expected).arg() / (TAU * lag_s);
        lag *= 2;
    }
    f_hz
}

#[cfg(test)]
mod tests {
    use ihd_signal::TimeBase;

    use super::*;
    use crate::{Hints, Survey};

    /// x(t) of the test: fundamental, third harmonic, offset.
    fn tone(rate_hz: f64, f_hz: f64) -> (Capture, Run) {
        let n = (2e-3 * rate_hz) as usize;
        let x = |k: usize, third: f64| {
            let a = TAU * f_hz * k as f64 / rate_hz;
            (0.3 + 2.0 * (a + 0.5).cos() + third * (3.0 * a - 1.0).cos()) as f32
        };
        let capture = Capture {
            name: "tone".to_owned(),
            time: TimeBase::Even {
                t0_s: 0.0,
                dt_s: 1.0 / rate_hz,
            },
            v_v: (0..n).map(|k| x(k, 1.0)).collect(),
            i_a: (0..n).map(|k| x(k, 0.1)).collect(),
            ..Capture::default()
        };
        let run = Run {
            samples: 0..n,
            t0_s: 0.0,
            dt_s: 1.0 / rate_hz,
        };
        (capture, run)
    }

    /// Half-cycle of 3 Ω and 22 µH at 45 kHz: exact v = Ri + L di/dt.
    #[test]
    fn little_more_than_two_samples_a_period_show_the_load() {
        for rate_hz in [95e3, 100e3, 103.7e3, 106e3, 112e3, 125e3] {
            let (mains, carrier) = (TAU * 50.0, TAU * 45e3);
            let sample = |k: usize| {
                let t = k as f64 / rate_hz;
                let (swell, turn) = (mains * t, carrier * t);
                let i = 40.0 * swell.sin() * turn.cos();
                let slope =
                    40.0 * (mains * swell.cos() * turn.cos() - carrier * swell.sin() * turn.sin());
                ((3.0 * i + 22e-6 * slope) as f32, i as f32)
            };
            let (v_v, i_a) = (0..(0.02 * rate_hz) as usize).map(sample).unzip();
            let capture = Capture {
                name: "slow".to_owned(),
                time: TimeBase::Even {
                    t0_s: 0.0,
                    dt_s: 1.0 / rate_hz,
                },
                v_v,
                i_a,
                ..Capture::default()
            };
            let survey = Survey::from_capture(&capture, &Hints::default()).unwrap();
            let load = survey.spans[0].load.unwrap();
            assert!((load.r_ohm / 3.0 - 1.0).abs() < 0.01, "{rate_hz} {load:?}");
            assert!((load.l_h / 22e-6 - 1.0).abs() < 0.01, "{rate_hz} {load:?}");
        }
    }

    #[test]
    fn phasors_are_amplitude_and_phase_of_each_harmonic() {
        for rate_hz in [45e3 * 61.0 / 3.0, 1e6, 12.5e6] {
            let (capture, run) = tone(rate_hz, 45e3);
            let track = track(&capture, &run, 45e3);
            for k in [0, track.t_s.len() / 2, track.t_s.len() - 1] {
                let first = Complex::from_polar(2.0, 0.5);
                let third = Complex::from_polar(1.0, -1.0);
                assert!((track.v_v[0][k] - first).norm() < 3e-3, "{rate_hz} {k}");
                assert!((track.v_v[1][k] - third).norm() < 3e-3, "{rate_hz} {k}");
                assert!((track.i_a[0][k] - first).norm() < 3e-3);
            }
        }
    }

    /// A piece of a rising flank whose frequency changes: over it the amplitude looks like time.
    #[test]
    fn a_sweep_on_a_flank_has_the_frequency_of_its_middle() {
        let (span_s, frames) = (1.2e-3, 40);
        for bend in [-2.0, 2.0] {
            let phasor = |k: usize| {
                let share = k as f64 / (frames - 1) as f64;
                let level = 40.0 * (TAU * 50.0 * span_s * (0.2 + share)).sin();
                let phase = TAU * 150.0 * span_s * share + bend * (share - 0.5).powi(2);
                Complex::from_polar(level, phase)
            };
            let track = TrackedFundamental {
                t_s: (0..frames)
                    .map(|k| span_s * k as f64 / (frames - 1) as f64)
                    .collect(),
                i_a: (0..frames).map(phasor).collect(),
            };
            let error = track.frequency_error_hz();
            // The ends are 2 · bend / (TAU · span) off.
            assert!((error - 150.0).abs() < 300.0, "{error}");
        }
    }

    #[test]
    fn the_frequency_comes_from_the_phase() {
        let (capture, run) = tone(1e6, 45_037.3);
        let error = of_current(&capture, &run, 45e3).frequency_error_hz();
        assert!((error - 37.3).abs() < 0.05, "{error}");
    }
}
