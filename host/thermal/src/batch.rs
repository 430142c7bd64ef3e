//! Means of half-cycles at one operating point.

use ihd_shared::wire::messages::{State, Telemetry};

/// Measurements over one half-cycle, from telemetry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThermalHalfCycle {
    /// End of the half-cycle in seconds, from any origin.
    pub t_s: f64,
    /// Switching frequency in hertz.
    pub f_hz: f64,
    /// Amplitude of the current at its crest, in ampere.
    pub i_a: f64,
    /// R at the crest, in ohm.
    pub r_ohm: f64,
    /// L at the crest, in henry.
    pub l_h: f64,
    /// Mean power in watt.
    pub power_w: f64,
    /// Set if the hob heats: R and L are those of a pot in operation.
    pub heats: bool,
}

impl ThermalHalfCycle {
    /// Returns `true` if the hob heats and R and L are numbers.
    pub fn shows_load(&self) -> bool {
        let numbers = [self.f_hz, self.i_a, self.r_ohm, self.l_h];
        self.heats && numbers.iter().all(|x| x.is_finite() && *x > 0.0)
    }

    /// Converts telemetry, at a time in seconds from any origin.
    pub fn from_telemetry(t: &Telemetry, t_s: f64) -> Self {
        Self {
            t_s,
            f_hz: f64::from(t.f_sw_hz),
            i_a: f64::from(t.i_crest_ma) * 1e-3,
            r_ohm: t.r.ohm(),
            l_h: t.l.henry(),
            power_w: f64::from(t.power_mw) * 1e-3,
            heats: t.state == State::Heating,
        }
    }
}

/// Half-cycles of a full batch: half a second at 50 Hz, in which no base warms by more than 3 K.
const HALF_CYCLES: usize = 50;

/// Fewest half-cycles of a usable batch; a smaller one is dropped when the operating point changes.
const MIN_HALF_CYCLES: usize = 8;

/// Relative change of frequency or current that ends a batch.
const MAX_RELATIVE_CHANGE: f64 = 0.02;

/// Half-cycles that are left out after a change of operating point, while the device's filter settles.
const SETTLING_HALF_CYCLES: usize = 3;

/// Relative errors of R and of L beside white noise: aliasing that changes with the frequency within a batch.
const FLOOR: (f64, f64) = (3e-4, 1.5e-4);

/// Means over half-cycles at one operating point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfCycleBatch {
    /// Middle of the batch in seconds.
    pub t_s: f64,
    /// Mean switching frequency in hertz.
    pub f_hz: f64,
    /// Mean crest current in ampere.
    pub i_a: f64,
    /// Mean of ln R, R in ohm.
    pub ln_r: f64,
    /// Mean of ln L, L in henry.
    pub ln_l: f64,
    /// Standard deviation of `ln_r`.
    pub r_sigma: f64,
    /// Standard deviation of `ln_l`.
    pub l_sigma: f64,
}

/// Collects half-cycles into batches.
#[derive(Clone, Debug, Default)]
pub struct Batches {
    first: Option<ThermalHalfCycle>,
    skipped: usize,
    count: usize,
    sums: [f64; 7],
}

impl Batches {
    /// Adds a half-cycle that heats; returns a batch when one is full, or when the operating point changed.
    pub fn push(&mut self, h: &ThermalHalfCycle) -> Option<HalfCycleBatch> {
        if !h.shows_load() || !h.t_s.is_finite() {
            return self.end();
        }
        let moved = self.first.is_none_or(|first| {
            (h.f_hz / first.f_hz - 1.0).abs() > MAX_RELATIVE_CHANGE
                || (h.i_a / first.i_a - 1.0).abs() > MAX_RELATIVE_CHANGE
        });
        if moved {
            let batch = self.end();
            self.first = Some(*h);
            return batch;
        }
        if self.skipped < SETTLING_HALF_CYCLES {
            self.skipped += 1;
            return None;
        }
        self.count += 1;
        let (r, l) = (h.r_ohm.ln(), h.l_h.ln());
        let values = [h.f_hz, h.i_a, r, l, r * r, l * l, h.t_s];
        for (sum, x) in self.sums.iter_mut().zip(values) {
            *sum += x;
        }
        if self.count < HALF_CYCLES {
            return None;
        }
        let batch = self.mean();
        // The operating point is the same: nothing has to settle.
        (self.first, self.count, self.sums) = (Some(*h), 0, [0.0; 7]);
        batch
    }

    /// Returns the batch so far and begins the next.
    fn end(&mut self) -> Option<HalfCycleBatch> {
        let batch = self.mean();
        *self = Self::default();
        batch
    }

    fn mean(&self) -> Option<HalfCycleBatch> {
        if self.count < MIN_HALF_CYCLES {
            return None;
        }
        let n = self.count as f64;
        let [f_hz, i_a, ln_r, ln_l, rr, ll, t_s] = self.sums.map(|sum| sum / n);
        let sigma = |square: f64, mean: f64, floor: f64| {
            ((square - mean * mean).max(0.0) / n + floor * floor).sqrt()
        };
        Some(HalfCycleBatch {
            t_s,
            f_hz,
            i_a,
            ln_r,
            ln_l,
            r_sigma: sigma(rr, ln_r, FLOOR.0),
            l_sigma: sigma(ll, ln_l, FLOOR.1),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn half_cycle(k: usize, f_hz: f64) -> ThermalHalfCycle {
        ThermalHalfCycle {
            t_s: k as f64 * 0.01,
            f_hz,
            i_a: 40.0,
            r_ohm: 3.0 * (1.0 + 1e-3 * (k % 2) as f64),
            l_h: 20e-6,
            power_w: 1500.0,
            heats: true,
        }
    }

    #[test]
    fn a_batch_is_the_mean_with_its_deviation() {
        let mut batches = Batches::default();
        let found: Vec<HalfCycleBatch> = (0..200)
            .filter_map(|k| batches.push(&half_cycle(k, 45e3)))
            .collect();
        assert_eq!(found.len(), 3);
        let b = found[1];
        assert!((b.ln_r - (3.0f64.ln() + 5e-4)).abs() < 1e-6, "{b:?}");
        // Half a thousandth of scatter over √50, and the floor.
        assert!((b.r_sigma - (5e-9f64 + 9e-8).sqrt()).abs() < 1e-5, "{b:?}");
    }

    #[test]
    fn another_operating_point_and_what_is_no_number_end_a_batch() {
        let mut batches = Batches::default();
        for k in 0..20 {
            assert!(batches.push(&half_cycle(k, 45e3)).is_none());
        }
        let ended = batches.push(&half_cycle(20, 50e3)).unwrap();
        assert!((ended.f_hz - 45e3).abs() < 1e-6);
        for bad in [f64::NAN, 0.0, -1.0, f64::INFINITY] {
            let mut h = half_cycle(21, 50e3);
            h.r_ohm = bad;
            assert!(batches.push(&h).is_none());
        }
    }
}
