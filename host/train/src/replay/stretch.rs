//! Blocks of a capture for a device: one stretch of pairs on the ADC's grid for every frequency.

use ihd_shared::hob::{BUS_PEAK_V, F_SW_MAX_HZ, F_SW_MIN_HZ};
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q, CODE_BITS, Pair, Scales};
use ihd_signal::resample::{AdcGrid, adc_pairs};
use ihd_signal::{Capture, Segment, TimeBase, current_transformer};

/// Relative difference of a capture's rate from the ADC's up to which it is not resampled: over a half-cycle it drifts by less than a
/// sample.
const MAX_RATE_DIFFERENCE: f64 = 1e-4;

/// Reason why a segment is not replayed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Omitted {
    /// Its frequency is outside the hob's ratings.
    Frequency,
    /// It is shorter than a block.
    Short,
}

/// Returns segments of a capture as this build's board samples them: the current behind its transformer, unless a board recorded it.
pub fn board_segments(capture: &Capture, segments: Vec<Segment>) -> Vec<Segment> {
    match current_transformer::tau_s(capture) {
        Some(_) => segments,
        None => segments.iter().map(current_transformer::sampled).collect(),
    }
}

/// Whole blocks of pairs at one switching frequency.
#[derive(Clone, Debug, PartialEq)]
pub struct Stretch {
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Time of the first pair in seconds, on the capture's clock.
    pub t0_s: f64,
    /// Time from one pair to the next in seconds.
    pub dt_s: f64,
    /// The pairs.
    pub pairs: Vec<Pair>,
    /// Indices of the first pair after each mains zero crossing.
    pub crossings: Vec<usize>,
}

impl Stretch {
    /// Resamples a segment to codes of the device's scales.
    ///
    /// # Errors
    /// The reason why it cannot be replayed.
    pub fn resample(segment: &Segment, scales: Scales) -> Result<Self, Omitted> {
        let f_sw_hz = segment.f_sw_hz.round() as u32;
        if !(F_SW_MIN_HZ..=F_SW_MAX_HZ).contains(&f_sw_hz) {
            return Err(Omitted::Frequency);
        }
        let own_hz = f64::from(ADC_LOCK_Q) / (ADC_LOCK_P as f64 * segment.dt_s);
        let on_grid = (own_hz / segment.f_sw_hz - 1.0).abs() < MAX_RATE_DIFFERENCE;
        let grid = AdcGrid {
            f_sw_hz: if on_grid { own_hz } else { segment.f_sw_hz },
            t0_s: segment.t0_s,
        };
        let time = TimeBase::Even {
            t0_s: segment.t0_s,
            dt_s: segment.dt_s,
        };
        let mut pairs = adc_pairs(&time, &segment.v_v, &segment.i_a, grid, scales);
        pairs.truncate(pairs.len() - pairs.len() % ADC_LOCK_P);
        let dt_s = grid.dt_s();
        let half_s = segment.half_cycle_s();
        // From the first crossing within the stretch on.
        let first = ((segment.t0_s - segment.zero_crossing_s) / half_s).ceil();
        let crossings = (0..)
            .map(|n| segment.zero_crossing_s + (first + f64::from(n)) * half_s - segment.t0_s)
            .map(|after_s| (after_s / dt_s).ceil() as usize)
            .take_while(|&at| at < pairs.len())
            .collect();
        if pairs.is_empty() {
            return Err(Omitted::Short);
        }
        Ok(Self {
            f_sw_hz,
            t0_s: segment.t0_s,
            dt_s,
            pairs,
            crossings,
        })
    }

    /// Returns the number of pairs at a limit of the converters' range.
    pub fn saturated(&self) -> usize {
        let limit = 1 << (CODE_BITS - 1);
        let is_limit = |code: i16| i32::from(code) == -limit || i32::from(code) == limit - 1;
        let pairs = self.pairs.iter();
        pairs.filter(|p| is_limit(p.v) || is_limit(p.i)).count()
    }

    /// Returns the number of blocks.
    pub fn blocks(&self) -> usize {
        self.pairs.len() / ADC_LOCK_P
    }

    /// Returns the time of a block's first pair in seconds, on the capture's clock.
    pub fn block_s(&self, block: usize) -> f64 {
        self.t0_s + (block * ADC_LOCK_P) as f64 * self.dt_s
    }

    /// Returns the crossing within pairs `from` to `to`, counted from `from`; `None` if there is none.
    pub fn crossing_in(&self, from: usize, to: usize) -> Option<usize> {
        let at = self.crossings.partition_point(|&at| at < from);
        let found = self.crossings.get(at).filter(|&&at| at < to);
        found.map(|at| at - from)
    }
}

/// Bus voltage that a replay states, in decivolt: no capture holds it, and the firmware only guards
/// against too much of it.
pub const BUS_DV: u16 = (BUS_PEAK_V * 10.0) as u16;

#[cfg(test)]
mod tests {
    use ihd_shared::sampling::f_adc_hz;

    use super::*;

    const SCALES: Scales = Scales {
        v_full_scale_mv: 400_000,
        i_full_scale_ma: 80_000,
    };

    fn segment(dt_s: f64, samples: usize) -> Segment {
        let code = |k: usize| f64::from((k % 100) as i16 - 50);
        Segment {
            f_sw_hz: 45_000.2,
            mains_hz: 50.0,
            zero_crossing_s: -3e-3,
            t0_s: 1e-3,
            dt_s,
            v_v: (0..samples)
                .map(|k| code(k) * SCALES.volt_per_code())
                .collect(),
            i_a: (0..samples)
                .map(|k| -code(k) * SCALES.ampere_per_code())
                .collect(),
        }
    }

    #[test]
    fn a_boards_own_samples_are_sent_as_they_are() {
        let stretch = Stretch::resample(&segment(1.0 / f_adc_hz(45_000), 20_000), SCALES).unwrap();
        assert_eq!(stretch.blocks(), 20_000 / 61);
        for (k, pair) in stretch.pairs.iter().enumerate() {
            let code = (k % 100) as i16 - 50;
            assert_eq!((pair.v, pair.i), (code, -code), "{k}");
        }
    }

    /// A recording of one front end for a device with another: within half a code of the same volts.
    #[test]
    fn another_scale_gives_the_same_volts_in_its_own_codes() {
        let own = segment(1.0 / f_adc_hz(45_000), 20_000);
        let wider = Scales {
            v_full_scale_mv: 640_000,
            i_full_scale_ma: 100_000,
        };
        let stretch = Stretch::resample(&own, wider).unwrap();
        let mut codes = 0;
        for (k, pair) in stretch.pairs.iter().enumerate() {
            let off_v = f64::from(pair.v) - own.v_v[k] / wider.volt_per_code();
            let off_a = f64::from(pair.i) - own.i_a[k] / wider.ampere_per_code();
            assert!(
                off_v.abs() <= 0.5 + 1e-9 && off_a.abs() <= 0.5 + 1e-9,
                "{k}"
            );
            codes = codes.max(pair.v);
        }
        // 49 codes of 400 V.
        assert_eq!(codes, 31);
    }

    #[test]
    fn crossings_lie_where_the_mains_puts_them() {
        let stretch = Stretch::resample(&segment(0.2e-6, 120_000), SCALES).unwrap();
        // Crossings at 7 and 17 ms; the stretch begins at 1 ms.
        let at_s = |k: usize| 1e-3 + k as f64 * stretch.dt_s;
        assert_eq!(stretch.crossings.len(), 2);
        for (&k, due_s) in stretch.crossings.iter().zip([7e-3, 17e-3]) {
            assert!(at_s(k) >= due_s - 1e-12 && at_s(k - 1) < due_s, "{k}");
        }
        let first = stretch.crossings[0];
        assert_eq!(stretch.crossing_in(first - 10, first + 1), Some(10));
        assert_eq!(stretch.crossing_in(first - 10, first), None);
    }

    #[test]
    fn what_a_hob_never_switches_at_is_left_out() {
        let slow = Segment {
            f_sw_hz: 20e3,
            ..segment(0.2e-6, 120_000)
        };
        assert_eq!(Stretch::resample(&slow, SCALES), Err(Omitted::Frequency));
        let short = segment(0.2e-6, 30);
        assert_eq!(Stretch::resample(&short, SCALES), Err(Omitted::Short));
    }

    /// 50 of 100 codes of 400 V and 80 A, for a front end of 300 V and one of 4 V.
    #[test]
    fn pairs_beyond_the_front_end_are_counted() {
        let own = segment(1.0 / f_adc_hz(45_000), 20_000);
        let of = |v_full_scale_mv| {
            let scales = Scales {
                v_full_scale_mv,
                ..SCALES
            };
            Stretch::resample(&own, scales).unwrap()
        };
        assert_eq!(of(300_000).saturated(), 0);
        let narrow = of(4_000);
        // Codes from 21 to 49 and from -50 to -21 are beyond.
        let share = narrow.saturated() as f64 / narrow.pairs.len() as f64;
        assert!((share - 0.59).abs() < 0.01, "{share}");
    }
}
