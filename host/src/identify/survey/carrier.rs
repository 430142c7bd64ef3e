//! Where the hob switches, and at which frequency: a short-time spectrum of voltage and current.

use std::f64::consts::TAU;
use std::ops::Range;
use std::sync::Arc;

use nalgebra::Complex;
use realfft::{RealFftPlanner, RealToComplex};

use super::time::Run;
use super::track;
use crate::capture::Capture;

/// Smallest switching frequency that is looked for, in hertz.
pub const LEAST_HZ: f64 = 15e3;

/// Largest, in hertz.
pub const LARGEST_HZ: f64 = 150e3;

/// Relative width around a given frequency in which it is looked for.
const HINT_WIDTH: f64 = 0.1;

/// Rate to which samples are averaged for the search, in hertz: four times the largest frequency.
const SEARCH_RATE_HZ: f64 = 4.0 * LARGEST_HZ;

/// Length of a spectrum's frame in seconds: tells 1.25 kHz apart and follows the mains' envelope.
const FRAME_S: f64 = 0.8e-3;

/// Frames a frame's length: each begins an eighth later.
const HOPS: usize = 8;

/// A line must stand this much above the median of the spectrum, in power: noise of a thousand
/// bins reaches 10.
const LINE_OVER_MEDIAN: f64 = 30.0;

/// A line weaker than the strongest by this much in power tells nothing about the frequency: 1 % of
/// amplitude.
const WEAK: f64 = 1e-4;

/// A line where a person says it is may be weaker than the strongest by this much in power; a third
/// harmonic is weaker.
const BESIDE: f64 = 0.1;

/// Change of frequency that counts as a step, in hertz: an eighth of the spectrum's resolution.
const STEP_HZ: f64 = 150.0;

/// Frames without a line that count as switched off: 1 ms, longer than a zero crossing hides it.
const OFF_HOPS: usize = 10;

/// A stretch with one switching frequency.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    /// The run it is a part of, cut to it.
    pub run: Run,
    /// Switching frequency in hertz, to some 20 Hz.
    pub f_hz: f64,
}

/// What a search found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Stretches with a carrier, in order of time.
    pub pieces: Vec<Piece>,
    /// Times in seconds between which there is none.
    pub off_s: Vec<(f64, f64)>,
}

/// Range of frequencies to search, in hertz, around a frequency that was given.
pub fn band(hint_hz: Option<f64>) -> (f64, f64) {
    hint_hz.map_or((LEAST_HZ, LARGEST_HZ), |f| {
        (f * (1.0 - HINT_WIDTH), f * (1.0 + HINT_WIDTH))
    })
}

/// One frame's strongest line.
#[derive(Clone, Copy, Debug)]
struct Line {
    f_hz: f64,
    power: f64,
    /// Power over the median of the band.
    contrast: f64,
}

/// Finds the stretches of a run in which it switches at one frequency, within `band_hz`.
pub fn find(capture: &Capture, run: &Run, band_hz: (f64, f64)) -> Found {
    let lines = Lines::of(capture, run, band_hz);
    let strongest = lines.frames.iter().map(|l| l.power).fold(0.0, f64::max);
    let valid: Vec<bool> = lines
        .frames
        .iter()
        .map(|l| l.contrast > LINE_OVER_MEDIAN && l.power > WEAK * strongest)
        .collect();
    let mut found = Found::default();
    let mut end = run.samples.start;
    let ranges = on_ranges(&valid);
    for on in &ranges {
        let part = switching(capture, run, &lines, on);
        if on.off_before {
            found.off_s.push((run.t_s(end), part.t0_s));
        }
        end = part.samples.end;
        let within = lines.within(&part.samples, &on.frames);
        steps(capture, &part, &lines, &valid, within, &mut found.pieces);
    }
    if ranges.last().is_some_and(|on| on.off_after) {
        found.off_s.push((run.t_s(end), run.t_s(run.samples.end)));
    }
    found
}

/// A range of frames with a carrier.
struct On {
    frames: Range<usize>,
    off_before: bool,
    off_after: bool,
}

/// Frames that belong together: interruptions shorter than [`OFF_HOPS`] are zero crossings, at either
/// end of the run too.
fn on_ranges(valid: &[bool]) -> Vec<On> {
    let mut out: Vec<On> = Vec::new();
    for k in (0..valid.len()).filter(|&k| valid[k]) {
        if let Some(on) = out.last_mut().filter(|on| k - on.frames.end < OFF_HOPS) {
            on.frames.end = k + 1;
            continue;
        }
        if let Some(before) = out.last_mut() {
            before.off_after = true;
        }
        out.push(On {
            frames: k..k + 1,
            off_before: k >= OFF_HOPS,
            off_after: false,
        });
    }
    if let Some(first) = out.first_mut().filter(|on| !on.off_before) {
        first.frames.start = 0;
    }
    if let Some(last) = out.last_mut() {
        last.off_after = valid.len() - last.frames.end >= OFF_HOPS;
        if !last.off_after {
            last.frames.end = valid.len();
        }
    }
    out
}

/// The part of a run in which it switches: where it goes on or off, the frames' windows reach beyond
/// the edge, and the current's amplitude tells the place.
fn switching(capture: &Capture, run: &Run, lines: &Lines, on: &On) -> Run {
    let window = lines.length * lines.every;
    let edge = |frame: usize, rising: bool| {
        let middle = lines.middle(frame);
        let zone = run.part(middle.saturating_sub(window)..middle + window);
        let f_hz = lines.frames[frame].f_hz;
        let track = track::fundamental(capture, &zone, f_hz);
        let amplitude: Vec<f64> = track.i_a.iter().map(|i| i.norm()).collect();
        let half = 0.5 * amplitude.iter().copied().fold(0.0, f64::max);
        let strong = |a: &f64| *a >= half;
        let at = if rising {
            amplitude.iter().position(strong)
        } else {
            amplitude.iter().rposition(strong)
        };
        let at_s = at.map_or(run.t_s(middle), |k| track.t_s[k]);
        // The amplitude is that of two periods.
        let guard_s = if rising { 2.0 / f_hz } else { -2.0 / f_hz };
        run.samples.start + ((at_s + guard_s - run.t0_s) / run.dt_s).max(0.0) as usize
    };
    let (first, last) = (on.frames.start, on.frames.end - 1);
    let start = if on.off_before { edge(first, true) } else { lines.begin(first) };
    let end = if on.off_after { edge(last, false) } else { lines.end(last) };
    run.part(start..end)
}

/// Cuts a range of frames where the frequency steps.
fn steps(
    capture: &Capture,
    run: &Run,
    lines: &Lines,
    valid: &[bool],
    frames: Range<usize>,
    out: &mut Vec<Piece>,
) {
    // Weak frames carry the frequency of the last strong one.
    let Some(first) = frames.clone().find(|&k| valid[k]) else {
        return;
    };
    let mut f_hz = Vec::with_capacity(frames.len());
    let mut last = lines.frames[first].f_hz;
    for k in frames.clone() {
        if valid[k] {
            last = lines.frames[k].f_hz;
        }
        f_hz.push(last);
    }
    let half = HOPS / 2;
    // Frames a whole frame apart share no sample.
    let steps = |k: usize| {
        k >= half && k + half < f_hz.len() && (f_hz[k + half] - f_hz[k - half]).abs() > STEP_HZ
    };
    let median = |range: Range<usize>| {
        let mut x = f_hz[range].to_vec();
        x.sort_by(f64::total_cmp);
        x[x.len() / 2]
    };
    let mut start = 0;
    let mut cuts: Vec<(Range<usize>, f64)> = Vec::new();
    let mut k = 0;
    while k < f_hz.len() {
        if !steps(k) {
            k += 1;
            continue;
        }
        let from = k;
        while k < f_hz.len() && steps(k) {
            k += 1;
        }
        if from > start {
            cuts.push((start..from, median(start..from)));
        }
        start = k;
    }
    if start < f_hz.len() {
        cuts.push((start..f_hz.len(), median(start..f_hz.len())));
    }
    // What is shorter than a frame is a transition, and nothing of its own.
    if cuts.iter().any(|(range, _)| range.len() >= HOPS) {
        cuts.retain(|(range, _)| range.len() >= HOPS);
    }
    let end = run.samples.end;
    let mut from = run.samples.start;
    for (n, (range, f)) in cuts.iter().enumerate() {
        let (mut to, mut next) = (end, end);
        if let Some((after, f_after)) = cuts.get(n + 1) {
            let zone = lines.middle(frames.start + range.end - 1)
                ..lines.middle(frames.start + after.start) + 1;
            let boundary = boundary(capture, &run.part(zone), *f, *f_after);
            // What settles after the step, and the period that the step cuts, belong to neither.
            let guard = (2.0 / (f.min(*f_after) * run.dt_s)) as usize;
            (to, next) = (boundary.saturating_sub(guard), boundary + guard);
        }
        out.push(Piece {
            run: run.part(from..to),
            f_hz: *f,
        });
        from = next;
    }
}

/// Sample at which the frequency changes from `before` to `after`, in hertz: where the current's
/// phasor begins to turn at the other speed, least squares over its increments.
fn boundary(capture: &Capture, zone: &Run, before: f64, after: f64) -> usize {
    let track = track::fundamental(capture, zone, before);
    let n = track.i_a.len();
    if n < 3 {
        return zone.samples.start + zone.samples.len() / 2;
    }
    let hop_s = track.t_s[1] - track.t_s[0];
    let cost = |k: usize, f: f64| {
        let turn = track.i_a[k + 1] * track.i_a[k].conj();
        let expected = Complex::from_polar(1.0, TAU * (f - before) * hop_s);
        turn.norm() * (turn * expected.conj()).arg().powi(2)
    };
    let mut sum: f64 = (0..n - 1).map(|k| cost(k, after)).sum();
    let (mut best, mut least) = (0, sum);
    for k in 0..n - 1 {
        sum += cost(k, before) - cost(k, after);
        if sum < least {
            (best, least) = (k + 1, sum);
        }
    }
    let t_s = track.t_s[best];
    zone.samples.start + ((t_s - zone.t0_s) / zone.dt_s).round().max(0.0) as usize
}

/// The strongest line of every frame.
struct Lines {
    frames: Vec<Line>,
    /// Samples averaged into one.
    every: usize,
    /// Index of the run's first sample.
    first: usize,
    /// Index after its last.
    last: usize,
    /// Averaged samples from frame to frame.
    hop: usize,
    /// Averaged samples a frame.
    length: usize,
}

impl Lines {
    fn of(capture: &Capture, run: &Run, band_hz: (f64, f64)) -> Self {
        let every = ((1.0 / (run.dt_s * SEARCH_RATE_HZ)) as usize).max(1);
        let dt_s = run.dt_s * every as f64;
        let channels = [&capture.v_v, &capture.i_a].map(|x| {
            let x = averaged(&x[run.samples.clone()], every);
            let mean_square = x.iter().map(|x| x * x).sum::<f64>() / x.len().max(1) as f64;
            (x, mean_square)
        });
        let n = channels[0].0.len();
        let length = ((FRAME_S / dt_s) as usize).clamp(1, n.max(1));
        let hop = (length / HOPS).max(1);
        let mut spectrum = Spectrum::new(length, dt_s, band_hz);
        let mut frames = Vec::new();
        let mut start = 0;
        while start + length <= n {
            let line = spectrum.line(
                channels
                    .iter()
                    .map(|(x, p)| (&x[start..start + length], *p)),
            );
            frames.push(line);
            start += hop;
        }
        Self {
            frames,
            every,
            first: run.samples.start,
            last: run.samples.end,
            hop,
            length,
        }
    }

    /// First sample that frame `k` stands for: all of the run before the first frame's middle.
    fn begin(&self, k: usize) -> usize {
        if k == 0 { self.first } else { self.middle(k) }
    }

    /// Sample after the last that frame `k` stands for.
    fn end(&self, k: usize) -> usize {
        if k + 1 >= self.frames.len() {
            self.last
        } else {
            self.middle(k)
        }
    }

    /// Frames of a range whose windows lie within these samples; all of them when none does.
    fn within(&self, samples: &Range<usize>, frames: &Range<usize>) -> Range<usize> {
        let half = self.length / 2 * self.every;
        let inside = |k: &usize| {
            let middle = self.middle(*k);
            middle >= samples.start + half && middle + half <= samples.end
        };
        match (frames.clone().find(inside), frames.clone().rfind(inside)) {
            (Some(first), Some(last)) => first..last + 1,
            _ => frames.clone(),
        }
    }

    fn middle(&self, k: usize) -> usize {
        self.first + (k * self.hop + self.length / 2) * self.every
    }
}

fn averaged(x: &[f32], every: usize) -> Vec<f64> {
    let scale = 1.0 / every as f64;
    x.chunks_exact(every)
        .map(|c| scale * f64::from(c.iter().sum::<f32>()))
        .collect()
}

/// Spectrum of Hann-windowed frames, voltage and current together, each by its own power.
struct Spectrum {
    fft: Arc<dyn RealToComplex<f64>>,
    window: Vec<f64>,
    input: Vec<f64>,
    output: Vec<Complex<f64>>,
    power: Vec<f64>,
    bins: Range<usize>,
    /// Bins of every frequency that a hob may have.
    all: Range<usize>,
    hz_per_bin: f64,
}

impl Spectrum {
    fn new(length: usize, dt_s: f64, (from_hz, to_hz): (f64, f64)) -> Self {
        // Twice the length, so that a line's top lies within a third of a bin of a parabola.
        let n = (2 * length).next_power_of_two().max(8);
        let fft = RealFftPlanner::new().plan_fft_forward(n);
        let hz_per_bin = 1.0 / (dt_s * n as f64);
        let bin = |f: f64| ((f / hz_per_bin).max(1.0) as usize).min(n / 2 - 1);
        Self {
            window: track::hann(length),
            input: fft.make_input_vec(),
            output: fft.make_output_vec(),
            power: vec![0.0; n / 2 + 1],
            bins: bin(from_hz)..bin(to_hz) + 1,
            all: bin(LEAST_HZ)..bin(LARGEST_HZ) + 1,
            hz_per_bin,
            fft,
        }
    }

    fn line<'a>(&mut self, channels: impl Iterator<Item = (&'a [f64], f64)>) -> Line {
        self.power.fill(0.0);
        for (x, mean_square) in channels {
            if mean_square <= 0.0 {
                continue;
            }
            let mean = x.iter().sum::<f64>() / x.len() as f64;
            self.input.fill(0.0);
            for ((y, x), w) in self.input.iter_mut().zip(x).zip(&self.window) {
                *y = (x - mean) * w;
            }
            // Lengths are those of the plan.
            if self.fft.process(&mut self.input, &mut self.output).is_ok() {
                for (p, y) in self.power.iter_mut().zip(&self.output) {
                    *p += y.norm_sqr() / mean_square;
                }
            }
        }
        let (bins, power) = (self.bins.clone(), &self.power);
        let top = bins
            .clone()
            .max_by(|a, b| power[*a].total_cmp(&power[*b]))
            .unwrap_or(bins.start);
        let mut sorted = power[bins.clone()].to_vec();
        let middle = sorted.len() / 2;
        let (_, median, _) = sorted.select_nth_unstable_by(middle, f64::total_cmp);
        // A narrow band around a hint holds little but the line: its floor is the whole spectrum's.
        let mut all = power.clone();
        let middle = all.len() / 2;
        let (_, floor, _) = all.select_nth_unstable_by(middle, f64::total_cmp);
        let floor = median.min(*floor).max(f64::MIN_POSITIVE);
        let strongest = power[self.all.clone()].iter().copied().fold(0.0, f64::max);
        let is_line = power[top] > 0.0
            && power[top] >= power[top - 1].max(power[top + 1])
            && power[top] >= BESIDE * strongest;
        Line {
            f_hz: (top as f64 + self.summit(top)) * self.hz_per_bin,
            power: power[top],
            contrast: if is_line { power[top] / floor } else { 0.0 },
        }
    }

    /// Where between the bins the top lies: the parabola through three logarithms.
    fn summit(&self, top: usize) -> f64 {
        let log = |k: usize| self.power[k].max(f64::MIN_POSITIVE).ln();
        let (a, b, c) = (log(top - 1), log(top), log(top + 1));
        let curvature = a - 2.0 * b + c;
        if curvature < 0.0 {
            (0.5 * (a - c) / curvature).clamp(-0.5, 0.5)
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_interruptions_are_zero_crossings_and_long_ones_are_not() {
        let mut valid = vec![true; 100];
        valid[..3].fill(false);
        valid[40..45].fill(false);
        valid[60..80].fill(false);
        let on = on_ranges(&valid);
        let ranges: Vec<_> = on.iter().map(|on| on.frames.clone()).collect();
        assert_eq!(ranges, [0..60, 80..100]);
        let off: Vec<_> = on.iter().map(|on| (on.off_before, on.off_after)).collect();
        assert_eq!(off, [(false, true), (true, false)]);
        assert!(on_ranges(&[false; 50]).is_empty());
    }

    #[test]
    fn a_line_is_found_between_the_bins() {
        let (f, dt_s) = (45_123.0, 1.0 / SEARCH_RATE_HZ);
        let x: Vec<f64> = (0..480)
            .map(|k| (TAU * f * dt_s * f64::from(k)).cos())
            .collect();
        let mut spectrum = Spectrum::new(480, dt_s, band(None));
        let line = spectrum.line([(x.as_slice(), 0.5)].into_iter());
        assert!((line.f_hz - f).abs() < 10.0, "{}", line.f_hz);
        assert!(line.contrast > 1e6);
    }
}
