//! Numbers and findings of one channel.

use ihd_signal::Capture;
use ihd_signal::vectorised::{dot, extremes, sum, vectorised};
use serde::Serialize;

use super::carrier::CarrierPiece;
use super::clipping::{self, ClippedSamples};
use super::finding::{Channel, Finding};
use super::track::Track;

/// Offset in percent of the rms value above which it is reported.
const OFFSET_PCT: f64 = 1.0;

/// Largest voltage of a hob's coil; a larger one means a wrong probe factor. A half-bridge on 230 V gives 330 V, a
/// quasi-resonant hob up to 1.2 kV, which its switch would not survive by much.
const MAX_V: f64 = 2e3;

/// Largest current of a hob's coil; a larger one means a wrong probe factor. 3.7 kW at 230 V take 80 A at the crest.
const MAX_A: f64 = 300.0;

/// SNR in decibel below which it is reported: the paper's noisiest case is 30.
const NOISY_DB: f64 = 25.0;

/// Share of a channel's power in its fundamental below which the channel is dead.
const MIN_FUNDAMENTAL_SHARE: f64 = 1e-2;

/// Numbers of one channel, in its unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ChannelSurvey {
    /// Smallest sample.
    pub min: f64,
    /// Largest sample.
    pub max: f64,
    /// Mean over the pieces with switching.
    pub mean: f64,
    /// Rms value over the pieces with switching, without the mean.
    pub rms: f64,
    /// Standard deviation of white noise; `None` if the capture is too short to measure it.
    pub noise: Option<f64>,
    /// Signal-to-noise ratio in decibel (paper, section V); `None` if there is no noise value or no signal.
    pub snr_db: Option<f64>,
    /// Number of samples at an end of the range.
    pub clipped: usize,
}

/// Computes one channel's numbers and adds its findings.
pub(super) fn survey(
    which: Channel,
    capture: &Capture,
    pieces: &[CarrierPiece],
    tracks: &[Track],
    findings: &mut Vec<Finding>,
) -> ChannelSurvey {
    let (x, full_scale) = match which {
        Channel::Voltage => (&capture.v_v, capture.v_full_scale_v),
        Channel::Current => (&capture.i_a, capture.i_full_scale_a),
    };
    let mut out = ChannelSurvey {
        min: f64::INFINITY,
        max: f64::NEG_INFINITY,
        ..ChannelSurvey::default()
    };
    let (mut n, mut sum, mut square) = (0.0, 0.0, 0.0);
    for piece in pieces {
        for x in x[piece.run.samples.clone()].chunks(BLOCK_SAMPLES) {
            let part = vectorised(
                #[inline(always)]
                || Sums::accumulate(x),
            );
            (out.min, out.max) = (out.min.min(part.min), out.max.max(part.max));
            sum += part.sum;
            square += part.square;
        }
        n += piece.run.samples.len() as f64;
    }
    out.mean = sum / n;
    let variance = (square / n - out.mean * out.mean).max(0.0);
    out.rms = variance.sqrt();
    let clipped = clipping::count_clipped(x, full_scale);
    out.clipped = clipped.samples;
    let per_period = |p: &CarrierPiece| 1.0 / (p.f_hz * p.run.dt_s);
    let longest = pieces.iter().max_by_key(|p| p.run.samples.len());
    out.noise = longest
        .and_then(|p| ihd_signal::noise::deviation(&x[p.run.samples.clone()], per_period(p)));
    let signal =
        |sigma: f64| 10.0 * ((variance - sigma * sigma).max(0.0) / (sigma * sigma)).log10();
    let measured = out.noise.filter(|s| *s > 0.0).map(signal);
    out.snr_db = measured.filter(|db| db.is_finite());
    let are_tails = longest
        .zip(out.snr_db)
        .is_some_and(|(piece, snr_db)| clipped.are_tails_of_noise(x, snr_db, per_period(piece)));
    if is_dead(which, tracks, variance) {
        findings.push(Finding::Dead { channel: which });
    } else {
        let clipped = Some(clipped).filter(|c| c.samples > 0 && !are_tails);
        report(which, &out, clipped, findings);
    }
    out
}

/// Samples that are summed together.
const BLOCK_SAMPLES: usize = 1 << 14;

/// Samples that are converted together.
const PART_SAMPLES: usize = 256;

/// Sums from which a channel's numbers are computed.
struct Sums {
    min: f64,
    max: f64,
    sum: f64,
    square: f64,
}

impl Sums {
    /// Sums samples in lanes, which the compiler can vectorise.
    #[inline(always)]
    fn accumulate(x: &[f32]) -> Self {
        let (min, max) = extremes(x);
        let (mut wide, mut square) = ([0.0; PART_SAMPLES], 0.0);
        for x in x.chunks(PART_SAMPLES) {
            let wide = &mut wide[..x.len()];
            wide.iter_mut().zip(x).for_each(|(y, x)| *y = f64::from(*x));
            square += dot(wide, wide);
        }
        Self {
            min: f64::from(min),
            max: f64::from(max),
            sum: sum(x),
            square,
        }
    }
}

/// Returns `true` if the fundamental has next to nothing of the channel's variance.
fn is_dead(which: Channel, tracks: &[Track], variance: f64) -> bool {
    let fundamental: f64 = tracks
        .iter()
        .filter_map(|t| match which {
            Channel::Voltage => t.v_v.first(),
            Channel::Current => t.i_a.first(),
        })
        .map(|x| 0.5 * x.iter().map(|x| x.norm_sqr()).sum::<f64>())
        .sum();
    let frames: usize = tracks.iter().map(|t| t.t_s.len()).sum();
    !(fundamental / frames.max(1) as f64 > MIN_FUNDAMENTAL_SHARE * variance && variance > 0.0)
}

/// Clipping, offset and noise of a channel that is alive.
fn report(
    which: Channel,
    c: &ChannelSurvey,
    clipped: Option<ClippedSamples>,
    findings: &mut Vec<Finding>,
) {
    if let Some(clipped) = clipped {
        findings.push(Finding::Clipping {
            channel: which,
            samples: clipped.samples,
            level: clipped.rails.level(),
            rails: clipped.rails,
        });
    }
    let most = match which {
        Channel::Voltage => MAX_V,
        Channel::Current => MAX_A,
    };
    let peak = c.max.abs().max(c.min.abs());
    if peak > most {
        findings.push(Finding::Implausible {
            channel: which,
            peak,
            most,
        });
    }
    let of_rms_pct = 100.0 * c.mean.abs() / c.rms;
    if of_rms_pct > OFFSET_PCT {
        findings.push(Finding::Offset {
            channel: which,
            mean: c.mean,
            of_rms_pct,
        });
    }
    if let Some(snr_db) = c.snr_db.filter(|db| *db < NOISY_DB) {
        findings.push(Finding::Noisy {
            channel: which,
            snr_db,
        });
    }
}
