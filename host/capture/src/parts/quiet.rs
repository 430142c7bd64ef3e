//! Place of a cut: where the voltage, whose amplitude follows the mains, is smallest.

use std::ops::Range;

use ihd_signal::Capture;

/// Half-cycle of the slowest mains, 45 Hz, and some, in seconds: the last cut of a part lies within it.
const HALF_CYCLE_S: f64 = 12.5e-3;

/// Length of a sum of squares in seconds: some switching periods.
const BLOCK_S: f64 = 0.1e-3;

/// Sums on either side of the smallest one through which a parabola gives its vertex: 1 ms, where v² of the mains is one.
const PARABOLA_SUMS: usize = 10;

/// Furthest vertex from the smallest sum, in blocks.
const MAX_VERTEX_BLOCKS: f64 = 3.0;

/// Index at which a capture is cut, in the last half-cycle of `range`, never at its beginning.
pub fn place(capture: &Capture, range: Range<usize>) -> usize {
    let (from, to) = (range.start, range.end);
    let at = |k: usize| capture.time.at(k).unwrap_or(f64::INFINITY);
    let dt_s = (at(to) - at(to - 1)).abs();
    // Stamps may ascend unevenly: the window is found by time, at most to the middle of the range.
    let middle = from + (to - from) / 2;
    let window = (middle..to).filter(|k| at(to) - at(*k) <= HALF_CYCLE_S);
    let Some(begin) = window.into_iter().next() else {
        return to;
    };
    let block = (BLOCK_S / dt_s).round();
    if !(block >= 1.0 && block < (to - begin) as f64) {
        return to;
    }
    let block = block as usize;
    let v = capture.v_v.get(begin..to).unwrap_or(&[]);
    let sums: Vec<f64> = v.chunks_exact(block).map(energy).collect();
    let Some(smallest) = smallest(&sums) else {
        return to;
    };
    let offset = (smallest as f64 + 0.5 + vertex(&sums, smallest)) * block as f64;
    (begin + offset.max(0.0) as usize).clamp(middle.max(from + 1), to)
}

fn energy(v: &[f32]) -> f64 {
    let finite = v.iter().map(|v| f64::from(*v)).filter(|v| v.is_finite());
    finite.map(|v| v * v).sum()
}

/// Middle of the five sums that are smallest together.
fn smallest(sums: &[f64]) -> Option<usize> {
    let five = sums.windows(5).map(|w| w.iter().sum::<f64>());
    let least = five.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
    least.map(|(k, _)| k + 2)
}

/// Vertex of the parabola through the sums around one, in blocks from it; zero without one.
fn vertex(sums: &[f64], middle: usize) -> f64 {
    let Some(around) = middle
        .checked_sub(PARABOLA_SUMS)
        .and_then(|from| sums.get(from..=middle + PARABOLA_SUMS))
    else {
        return 0.0;
    };
    let (mut y0, mut y1, mut y2, mut x2, mut x4) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (k, y) in around.iter().enumerate() {
        let x = k as f64 - PARABOLA_SUMS as f64;
        y0 += y;
        y1 += x * y;
        y2 += x * x * y;
        x2 += x * x;
        x4 += x * x * x * x;
    }
    let n = around.len() as f64;
    let (slope, bend) = (y1 / x2, (n * y2 - x2 * y0) / (n * x4 - x2 * x2));
    let vertex = -0.5 * slope / bend;
    if bend > 0.0 && vertex.abs() <= MAX_VERTEX_BLOCKS {
        vertex
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use ihd_signal::TimeBase;

    use super::*;

    /// A carrier of 45 kHz whose amplitude follows the mains, with a zero crossing at `crossing_s`.
    fn capture(crossing_s: f64, noise: f64) -> Capture {
        let dt_s = 1e-6;
        let mut seed = 1u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(seed) / f64::from(u32::MAX) - 0.5
        };
        let v = (0..100_000).map(|k| {
            let t_s = f64::from(k) * dt_s;
            let mains = (std::f64::consts::PI * (t_s - crossing_s) / 10e-3)
                .sin()
                .abs();
            let carrier = (std::f64::consts::TAU * 45e3 * t_s).sin();
            (300.0 * mains * carrier + noise * random()) as f32
        });
        let v_v: Vec<f32> = v.collect();
        Capture {
            time: TimeBase::Even { t0_s: 0.0, dt_s },
            i_a: v_v.clone(),
            v_v,
            ..Capture::default()
        }
    }

    #[test]
    fn a_cut_lies_within_fifty_microseconds_of_a_zero_crossing() {
        for crossing_s in [0.0, 1.3e-3, 4.99e-3, 9.7e-3] {
            for noise in [0.0, 60.0] {
                let at = place(&capture(crossing_s, noise), 3..90_000);
                let off = (at as f64 * 1e-6 - crossing_s + 5e-3).rem_euclid(10e-3) - 5e-3;
                assert!(off.abs() < 50e-6, "{crossing_s} {noise}: {at} {off}");
                assert!((77_500..=90_000).contains(&at));
            }
        }
    }

    #[test]
    fn there_is_a_cut_whatever_the_samples_are() {
        let mut capture = capture(0.0, 0.0);
        capture.v_v.fill(f32::NAN);
        let inside = |at: usize, range: Range<usize>| at > range.start && at <= range.end;
        for range in [0..1, 0..2, 5..60_000, 0..100_000] {
            assert!(
                inside(place(&capture, range.clone()), range.clone()),
                "{range:?}"
            );
        }
        for dt_s in [0.0, f64::NAN, 1.0, 1e-12] {
            capture.time = TimeBase::Even { t0_s: 0.0, dt_s };
            assert!(inside(place(&capture, 0..90_000), 0..90_000), "{dt_s}");
        }
        capture.time = TimeBase::Stamps(Vec::new());
        assert!(inside(place(&capture, 0..90_000), 0..90_000));
    }
}
