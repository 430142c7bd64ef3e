//! Samples at an end of a channel's range: the other channel and what is left of this one say what they were.

use std::borrow::Cow;

use ihd_signal::carrier::Carrier;
use ihd_signal::{Capture, Remark, Severity};
use ihd_survey::clipping::{MIN_PER_PERIOD, Rails};
use ihd_survey::{Channel, Finding, Span, Survey};

use super::censored::{Censored, Pair, is_inside};
use crate::limits::{TOLERABLE_PCT, TOLERABLE_SIGMAS};

/// Samples within this share of the range from an end count as clipped, because noise behind an amplifier that clips blurs the end.
/// A crest within it is fitted as well, at little cost.
const END_SHARE: f64 = 1.5 / 128.0;

/// Duration over which errors average, in seconds: R and L of the estimators have no more than one value in it.
const PART_S: f64 = 0.4e-3;

/// Fewest parts in which the fit is tried.
const MIN_PARTS: usize = 4;

/// Samples beyond a channel's range were restored.
#[derive(Clone, Debug)]
pub struct RestoredSamples {
    /// Warning.
    pub remark: Remark,
    /// Standard deviation of R and of L as shares, by which they were restored wrongly.
    pub shares: [f64; 2],
}

/// Restores the samples at the ends of one channel's range; `None` if none are there, or too little beside them.
pub(super) fn repair(capture: &mut Cow<'_, Capture>, survey: &Survey) -> Option<RestoredSamples> {
    let clipped = ClippedChannel::of_survey(survey)?;
    let (mut values, mut errors) = (Vec::new(), Vec::new());
    for span in &survey.spans {
        let pair = clipped.pair(capture, span)?;
        if pair.x.iter().all(|x| is_inside(*x, pair.rails)) {
            continue;
        }
        let carrier = || Carrier::from_segment(&survey.segment(capture, span));
        if pair.per_period < MIN_PER_PERIOD || carrier().is_some_and(|c| c.moves()) {
            return None;
        }
        let model = Censored::fit_span(pair)?;
        let parts = model.errors((PART_S * span.f_sw_hz) as usize);
        if parts.len() < MIN_PARTS {
            return None;
        }
        errors.extend(parts);
        let of_span = model.values().into_iter();
        values.extend(of_span.map(|(k, x)| (span.first + k, x)));
    }
    let rms =
        |k: usize| (errors.iter().map(|e| e[k] * e[k]).sum::<f64>() / errors.len() as f64).sqrt();
    let shares = [rms(0), rms(1)];
    let right = (0..2).all(|k| TOLERABLE_SIGMAS * 100.0 * shares[k] <= TOLERABLE_PCT[k]);
    if values.is_empty() || !right {
        return None;
    }
    let capture = capture.to_mut();
    let (x, full_scale) = match clipped.is_voltage {
        true => (&mut capture.v_v, &mut capture.v_full_scale_v),
        false => (&mut capture.i_a, &mut capture.i_full_scale_a),
    };
    for (k, value) in values {
        x[k] = value;
    }
    // Values beyond the range are no clipping any more.
    *full_scale = None;
    Some(RestoredSamples {
        remark: clipped.remark(shares),
        shares,
    })
}

/// The only channel that clips.
struct ClippedChannel {
    is_voltage: bool,
    /// Number of samples at the ends of its range.
    samples: usize,
    /// Levels at which they rest, in the channel's unit.
    levels: Rails,
    /// Values below and above which a sample is at an end.
    rails: [f64; 2],
    /// Noise of a sample of this channel and of the other.
    noise: [f64; 2],
}

impl ClippedChannel {
    /// Returns `None` if no channel clips, or both: then neither says what the other one was.
    fn of_survey(survey: &Survey) -> Option<Self> {
        let clipped = |f: &Finding| match f {
            Finding::Clipping {
                channel,
                samples,
                rails,
                ..
            } => Some((*channel, *samples, *rails)),
            _ => None,
        };
        let mut all = survey.findings.iter().filter_map(clipped);
        let ((channel, samples, levels), None) = (all.next()?, all.next()) else {
            return None;
        };
        let is_voltage = channel == Channel::Voltage;
        let numbers = match is_voltage {
            true => [&survey.voltage, &survey.current],
            false => [&survey.current, &survey.voltage],
        };
        let margin = END_SHARE * (numbers[0].max - numbers[0].min);
        Some(Self {
            is_voltage,
            samples,
            levels,
            rails: [numbers[0].min + margin, numbers[0].max - margin],
            noise: [numbers[0].noise?, numbers[1].noise?],
        })
    }

    /// Returns both channels' samples of a span.
    fn pair<'c>(&self, capture: &'c Capture, span: &Span) -> Option<Pair<'c>> {
        let range = span.first..span.first + span.samples;
        let (v, i) = (capture.v_v.get(range.clone())?, capture.i_a.get(range)?);
        let (x, y) = if self.is_voltage { (v, i) } else { (i, v) };
        Some(Pair {
            x,
            y,
            is_voltage: self.is_voltage,
            per_period: 1.0 / (span.f_sw_hz * span.dt_s),
            noise: self.noise,
            rails: self.rails,
        })
    }

    /// Warning with the standard deviations of R and of L as shares.
    fn remark(&self, shares: [f64; 2]) -> Remark {
        let (channel, other) = match self.is_voltage {
            true => (Channel::Voltage, Channel::Current),
            false => (Channel::Current, Channel::Voltage),
        };
        let (levels, samples) = (self.levels.in_words(channel.unit()), self.samples);
        let text = format!(
            "the {channel} was clipped at {levels}, {samples} samples: they were left out, and what they were follows from \
             the {other} and the samples beside them, R to {:.2} % and L to {:.2} %; better use a larger range",
            100.0 * shares[0],
            100.0 * shares[1]
        );
        Remark::new("clipping", Severity::Warning, text).with(samples as f64, None)
    }
}
