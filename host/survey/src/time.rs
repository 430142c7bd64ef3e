//! Runs: parts of a capture with finite, evenly spaced samples and without gaps.

use std::ops::Range;

use ihd_signal::vectorised::vectorised;
use ihd_signal::{Capture, TimeBase};

use super::finding::Finding;

/// Evenly sampled part of a capture without a gap.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// Indices of the samples in the capture.
    pub samples: Range<usize>,
    /// Time of the first sample in seconds.
    pub t0_s: f64,
    /// Time from one sample to the next in seconds.
    pub dt_s: f64,
}

impl Run {
    /// Time of sample `k` of the capture in seconds, for `k` within the run.
    pub fn t_s(&self, k: usize) -> f64 {
        self.t0_s + (k as f64 - self.samples.start as f64) * self.dt_s
    }

    /// Length in seconds.
    pub fn duration_s(&self) -> f64 {
        self.samples.len() as f64 * self.dt_s
    }

    /// Returns a part of the run; indices beyond it are cut off.
    pub fn part(&self, samples: Range<usize>) -> Self {
        let end = samples.end.min(self.samples.end);
        let start = samples.start.max(self.samples.start).min(end);
        Self {
            samples: start..end,
            t0_s: self.t_s(start),
            dt_s: self.dt_s,
        }
    }
}

/// Steps between stamps that are averaged before comparison: enough to average over stamps with few digits, and short
/// against the time between changes of frequency.
const BLOCK: usize = 64;

/// Cuts a capture into runs and adds findings on the cuts.
///
/// The channels and stamps must be of one length.
pub fn runs(capture: &Capture, findings: &mut Vec<Finding>) -> Vec<Run> {
    let pieces = finite(capture, findings);
    match &capture.time {
        TimeBase::Even { t0_s, dt_s } => {
            let whole = Run {
                samples: 0..capture.len(),
                t0_s: *t0_s,
                dt_s: *dt_s,
            };
            pieces.into_iter().map(|p| whole.part(p)).collect()
        }
        TimeBase::Stamps(t_s) => stamped(t_s, pieces, findings),
    }
}

/// Ranges of samples with finite voltage and current.
fn finite(capture: &Capture, findings: &mut Vec<Finding>) -> Vec<Range<usize>> {
    let mut pieces = Vec::new();
    let mut start = 0;
    let (mut bad, mut first) = (0, 0);
    let blocks = capture.v_v.chunks(FINITE_BLOCK);
    for (block, (v, i)) in blocks.zip(capture.i_a.chunks(FINITE_BLOCK)).enumerate() {
        if all_finite(v) && all_finite(i) {
            continue;
        }
        for (k, (v, i)) in (block * FINITE_BLOCK..).zip(v.iter().zip(i)) {
            if v.is_finite() && i.is_finite() {
                continue;
            }
            if bad == 0 {
                first = k;
            }
            bad += 1;
            if k > start {
                pieces.push(start..k);
            }
            start = k + 1;
        }
    }
    if capture.len() > start {
        pieces.push(start..capture.len());
    }
    if bad > 0 {
        findings.push(Finding::NotFinite {
            samples: bad,
            first,
        });
    }
    pieces
}

/// Samples that are checked together.
const FINITE_BLOCK: usize = 4096;

/// Returns `true` if all samples are finite; without a branch, for SIMD.
fn all_finite(x: &[f32]) -> bool {
    vectorised(
        #[inline(always)]
        || x.iter().fold(true, |all, x| all & x.is_finite()),
    )
}

/// Runs of stamped samples: cut where time does not ascend, where samples are missing, and where the rate changes.
fn stamped(t_s: &[f64], pieces: Vec<Range<usize>>, findings: &mut Vec<Finding>) -> Vec<Run> {
    let mut ascending = Ascending::default();
    let mut gaps = Gaps::default();
    let mut out = Vec::new();
    for piece in pieces {
        let mut start = piece.start;
        for k in piece.start + 1..piece.end {
            // NaN does not ascend either.
            let backwards = !(t_s[k] > t_s[k - 1] && t_s[k].is_finite());
            if backwards {
                ascending.note(k, t_s[k]);
            } else if !gaps.note(t_s, k, &piece) {
                continue;
            }
            rate_runs(t_s, start..k, &mut out);
            start = if t_s[k].is_finite() { k } else { k + 1 };
        }
        rate_runs(t_s, start..piece.end, &mut out);
    }
    findings.extend(ascending.0);
    findings.extend(gaps.0);
    out
}

/// Collected finding on time that does not ascend.
#[derive(Default)]
struct Ascending(Option<Finding>);

impl Ascending {
    fn note(&mut self, k: usize, at_s: f64) {
        if let Some(Finding::TimeNotAscending { times, .. }) = &mut self.0 {
            *times += 1;
        } else {
            self.0 = Some(Finding::TimeNotAscending {
                times: 1,
                sample: k,
                t_s: at_s,
            });
        }
    }
}

/// Collected finding on gaps.
#[derive(Default)]
struct Gaps(Option<Finding>);

impl Gaps {
    /// Returns `true` if there is a gap before sample `k`: a step half again as long as the median of the three steps before and
    /// of the three after. After a fall of the sampling rate the following steps are as long.
    fn note(&mut self, t_s: &[f64], k: usize, piece: &Range<usize>) -> bool {
        // The difference of two finite stamps may be infinite.
        let step = |n: usize| (t_s[n] - t_s[n - 1]).min(f64::MAX);
        let near = |n: usize| n > piece.start && n < piece.end;
        // Two samples alone have no other step to compare with.
        let neighbour = [k + 1, k - 1].into_iter().find(|&n| near(n));
        let Some(neighbour) = neighbour.map(step) else {
            return false;
        };
        let here = step(k);
        if here < 1.4 * neighbour {
            return false;
        }
        let median = |steps: Range<usize>| {
            let mut x: Vec<f64> = steps.filter(|&n| near(n)).map(step).collect();
            x.sort_by(f64::total_cmp);
            x.get(x.len() / 2).copied().unwrap_or(0.0)
        };
        let usual = median(k.saturating_sub(3).max(1)..k).max(median(k + 1..k + 4));
        if usual <= 0.0 || here < 1.5 * usual {
            return false;
        }
        let lost = (here / usual).round() as u64 - 1;
        if let Some(Finding::Gap {
            gaps,
            longest_s,
            missing,
            ..
        }) = &mut self.0
        {
            *gaps += 1;
            *longest_s = longest_s.max(here);
            *missing = missing.saturating_add(lost);
        } else {
            self.0 = Some(Finding::Gap {
                gaps: 1,
                t_s: t_s[k - 1],
                longest_s: here,
                missing: lost,
            });
        }
        true
    }
}

/// Cuts where the mean step between stamps changes permanently: a board's rate follows its switching frequency.
fn rate_runs(t_s: &[f64], range: Range<usize>, out: &mut Vec<Run>) {
    let mean = |from: usize, to: usize| (t_s[to] - t_s[from]) / (to - from) as f64;
    let mut push = |from: usize, to: usize| {
        if to > from + 1 {
            out.push(Run {
                samples: from..to,
                t0_s: t_s[from],
                dt_s: mean(from, to - 1),
            });
        }
    };
    let blocks = range.len().saturating_sub(1) / BLOCK;
    if blocks < 3 {
        push(range.start, range.end);
        return;
    }
    let slope: Vec<f64> = (0..blocks)
        .map(|b| mean(range.start + b * BLOCK, range.start + (b + 1) * BLOCK))
        .collect();
    let mut change: Vec<f64> = slope.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let jumps = change.clone();
    let middle = change.len() / 2;
    let (_, usual, _) = change.select_nth_unstable_by(middle, f64::total_cmp);
    // Six deviations of the stamps' rounding, and at least 1e-5 of the step.
    let tolerance = (9.0 * *usual).max(1e-5 * slope[0]);
    let mut start = range.start;
    let mut b = 0;
    while b < jumps.len() {
        if jumps[b] <= tolerance {
            b += 1;
            continue;
        }
        // Slope `before` holds to the end of block b, `after` from the start of block e.
        let first = b;
        while b < jumps.len() && jumps[b] > tolerance {
            b += 1;
        }
        let (k_before, k_after) = (range.start + first * BLOCK, range.start + b * BLOCK);
        let (before, after) = (slope[first], slope[b]);
        // Intersection of the two lines of stamps.
        let run = (k_after - k_before) as f64;
        let meet = (t_s[k_after] - t_s[k_before] - after * run) / (before - after);
        let cut = k_before + (meet.round().clamp(0.0, run) as usize);
        push(start, cut + 1);
        start = cut + 1;
    }
    push(start, range.end);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn capture(time: TimeBase, n: usize) -> Capture {
        Capture {
            name: "test".to_owned(),
            time,
            v_v: vec![1.0; n],
            i_a: vec![1.0; n],
            ..Capture::default()
        }
    }

    fn find_runs(t_s: Vec<f64>) -> (Vec<Run>, Vec<Finding>) {
        let mut findings = Vec::new();
        let n = t_s.len();
        let runs = runs(&capture(TimeBase::Stamps(t_s), n), &mut findings);
        (runs, findings)
    }

    #[test]
    fn samples_that_are_no_numbers_cut_the_capture() {
        let even = TimeBase::Even {
            t0_s: 1.0,
            dt_s: 1e-6,
        };
        let mut c = capture(even, 100);
        c.v_v[10] = f32::NAN;
        c.i_a[50] = f32::INFINITY;
        let mut findings = Vec::new();
        let ranges: Vec<_> = runs(&c, &mut findings)
            .into_iter()
            .map(|r| (r.samples.clone(), r.t0_s))
            .collect();
        assert_eq!(
            ranges,
            [(0..10, 1.0), (11..50, 1.0 + 11e-6), (51..100, 1.0 + 51e-6)]
        );
        let expected = Finding::NotFinite {
            samples: 2,
            first: 10,
        };
        assert_eq!(findings, [expected]);
    }

    #[test]
    fn a_gap_and_time_going_back_cut_the_capture() {
        let mut t: Vec<f64> = (0..1000).map(|k| f64::from(k) * 1e-6).collect();
        t[300..].iter_mut().for_each(|t| *t += 10e-6);
        t[700..].iter_mut().for_each(|t| *t -= 100e-6);
        let (runs, findings) = find_runs(t);
        let ranges: Vec<_> = runs.iter().map(|r| r.samples.clone()).collect();
        assert_eq!(ranges, [0..300, 300..700, 700..1000]);
        assert!(
            matches!(
                findings[0],
                Finding::TimeNotAscending {
                    times: 1,
                    sample: 700,
                    ..
                }
            ),
            "{findings:?}"
        );
        assert!(
            matches!(
                findings[1],
                Finding::Gap {
                    gaps: 1,
                    missing: 10,
                    ..
                }
            ),
            "{findings:?}"
        );
        assert!(runs.iter().all(|r| (r.dt_s / 1e-6 - 1.0).abs() < 1e-9));
    }

    #[test]
    fn a_rate_that_follows_the_frequency_cuts_at_the_sample() {
        // 45 kHz, then 45.1 kHz, then 60 kHz, each sampled at 61/3 of it.
        let mut t = vec![0.0];
        for (f, n) in [(45e3, 5000), (45.1e3, 3333), (60e3, 4000)] {
            for _ in 0..n {
                t.push(t[t.len() - 1] + 3.0 / (61.0 * f));
            }
        }
        let (runs, findings) = find_runs(t);
        assert!(findings.is_empty(), "{findings:?}");
        assert_eq!(runs.len(), 3, "{runs:?}");
        for (run, (f, end)) in runs
            .iter()
            .zip([(45e3, 5001usize), (45.1e3, 8334), (60e3, 12334)])
        {
            assert!((run.dt_s * 61.0 * f / 3.0 - 1.0).abs() < 1e-6, "{run:?}");
            assert!(run.samples.end.abs_diff(end) <= 1, "{run:?}");
        }
    }

    #[test]
    fn stamps_of_few_digits_are_even() {
        // Steps of 1 µs rounded to 0.3 µs: 0.9, 0.9, 1.2 µs.
        let t: Vec<f64> = (0..20_000)
            .map(|k| (f64::from(k) / 0.3).round() * 0.3e-6)
            .collect();
        let (runs, findings) = find_runs(t);
        assert_eq!(runs.len(), 1, "{}", runs.len());
        assert!(findings.is_empty(), "{findings:?}");
        assert!((runs[0].dt_s / 1e-6 - 1.0).abs() < 1e-4);
    }
}
