//! Power, R and L of a device over the last minutes, a mean a second.

use std::collections::VecDeque;

use ihd_model::{History, Live};

/// Length of the trend in seconds.
pub(super) const SPAN_S: i64 = 300;

/// Quantity of a trend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quantity {
    /// Mean power in watt.
    Power,
    /// R at the crest in ohm, while it heats.
    R,
    /// L at the crest in microhenry, while it heats.
    L,
}

impl Quantity {
    /// All, in the order in which they are drawn.
    pub(super) const ALL: [Self; 3] = [Self::Power, Self::R, Self::L];

    /// Letter of the quantity.
    pub(super) fn letter(self) -> &'static str {
        match self {
            Self::Power => "P",
            Self::R => "R",
            Self::L => "L",
        }
    }

    /// A value with its unit.
    pub(super) fn text(self, value: f64) -> String {
        match self {
            Self::Power => format!("{value:.0} W"),
            Self::R => format!("{value:.3} Ω"),
            Self::L => format!("{value:.2} µH"),
        }
    }
}

/// Sum and number of values.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    sum: f64,
    count: u32,
}

impl Mean {
    fn add(&mut self, value: f64) {
        if value.is_finite() {
            self.sum += value;
            self.count += 1;
        }
    }

    fn get(self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / f64::from(self.count))
    }
}

/// Means of one second.
#[derive(Clone, Copy, Debug)]
struct Bucket {
    at_s: i64,
    means: [Mean; 3],
}

impl Bucket {
    fn new(at_s: i64) -> Self {
        Self {
            at_s,
            means: [Mean::default(); 3],
        }
    }
}

/// Last minutes of a device.
#[derive(Clone, Debug, Default)]
pub(super) struct Trend {
    buckets: VecDeque<Bucket>,
}

impl Trend {
    /// Adds a half-cycle received at `at_ms`.
    pub(super) fn add(&mut self, live: &Live, at_ms: i64) {
        let at_s = at_ms.div_euclid(1000);
        // A clock that was set back starts the trend again.
        if self.buckets.back().is_some_and(|b| b.at_s > at_s + 1) {
            self.buckets.clear();
        }
        if self.buckets.back().is_none_or(|b| b.at_s < at_s) {
            self.buckets.push_back(Bucket::new(at_s));
        }
        if let Some(bucket) = self.buckets.back_mut() {
            bucket.means[0].add(live.power_w);
            if live.f_sw_hz > 0 {
                bucket.means[1].add(live.r_ohm);
                bucket.means[2].add(live.l_h * 1e6);
            }
        }
        while self.buckets.front().is_some_and(|b| b.at_s < at_s - SPAN_S) {
            self.buckets.pop_front();
        }
    }

    /// Adds the time before the first half-cycle received here.
    pub(super) fn fill(&mut self, history: &History) {
        let first_s = self.buckets.front().map_or(i64::MAX, |b| b.at_s);
        let value = |list: &[Option<f64>], k: usize| list.get(k).copied().flatten();
        for (k, at_ms) in history.at_ms.iter().enumerate().rev() {
            let at_s = at_ms.div_euclid(1000);
            let newest = self.buckets.front().map_or(first_s, |b| b.at_s);
            if at_s >= newest {
                continue;
            }
            let mut bucket = Bucket::new(at_s);
            let means = [&history.power_w, &history.r_ohm, &history.l_h];
            for (number, (mean, envelope)) in bucket.means.iter_mut().zip(means).enumerate() {
                let unit = if number == 2 { 1e6 } else { 1.0 };
                if let Some(x) = value(&envelope.mean, k) {
                    mean.add(x * unit);
                }
            }
            self.buckets.push_front(bucket);
        }
    }

    /// Means of `columns` equal parts of the last [`SPAN_S`], oldest first; `None` without data.
    pub(super) fn columns(
        &self,
        quantity: Quantity,
        columns: usize,
        now_ms: i64,
    ) -> Vec<Option<f64>> {
        let mut means = vec![Mean::default(); columns];
        let from_s = now_ms.div_euclid(1000) - SPAN_S;
        for bucket in &self.buckets {
            let share = (bucket.at_s - from_s) as f64 / (SPAN_S + 1) as f64;
            if !(0.0..1.0).contains(&share) {
                continue;
            }
            if let (Some(mean), Some(value)) = (
                means.get_mut((share * columns as f64) as usize),
                bucket.means[quantity as usize].get(),
            ) {
                mean.add(value);
            }
        }
        means.into_iter().map(Mean::get).collect()
    }

    /// Runs of consecutive seconds, as (seconds before now, value): a line breaks at missing data.
    pub(super) fn runs(&self, quantity: Quantity, now_ms: i64) -> Vec<Vec<(f64, f64)>> {
        let now_s = now_ms.div_euclid(1000);
        let mut runs: Vec<Vec<(f64, f64)>> = Vec::new();
        let mut last_s = i64::MIN;
        for bucket in &self.buckets {
            let Some(value) = bucket.means[quantity as usize].get() else {
                continue;
            };
            let point = ((bucket.at_s - now_s) as f64, value);
            match runs.last_mut() {
                Some(run) if bucket.at_s - last_s <= 2 => run.push(point),
                _ => runs.push(vec![point]),
            }
            last_s = bucket.at_s;
        }
        runs
    }

    /// Smallest and largest second of the last [`SPAN_S`].
    pub(super) fn range(&self, quantity: Quantity, now_ms: i64) -> Option<(f64, f64)> {
        let from_s = now_ms.div_euclid(1000) - SPAN_S;
        let recent = self.buckets.iter().filter(|b| b.at_s >= from_s);
        let values = recent.filter_map(|b| b.means[quantity as usize].get());
        values
            .map(|x| (x, x))
            .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }
}

#[cfg(test)]
mod tests {
    use ihd_model::Envelope;

    use super::*;

    fn live(power_w: f64, r_ohm: f64, f_sw_hz: u32) -> Live {
        Live {
            half_cycle: 0,
            state: "Heating".into(),
            pot: "Ferromagnetic".into(),
            fault: 0,
            fault_text: String::new(),
            limit: "None".into(),
            asked_w: 1000,
            power_w,
            f_sw_hz,
            i_crest_a: 40.0,
            r_ohm,
            l_h: 19e-6,
            glass_hot: false,
        }
    }

    #[test]
    fn a_second_is_its_mean_and_r_is_not_known_while_it_does_not_heat() {
        let mut trend = Trend::default();
        trend.add(&live(900.0, 3.0, 50_000), 10_100);
        trend.add(&live(1100.0, 3.2, 50_000), 10_900);
        trend.add(&live(0.0, f64::NAN, 0), 11_500);
        let runs = trend.runs(Quantity::Power, 12_000);
        assert_eq!(runs, [vec![(-2.0, 1000.0), (-1.0, 0.0)]]);
        let r = trend.runs(Quantity::R, 12_000);
        assert_eq!(r.len(), 1);
        assert!((r[0][0].1 - 3.1).abs() < 1e-12);
        assert_eq!(trend.range(Quantity::Power, 12_000), Some((0.0, 1000.0)));
    }

    #[test]
    fn what_is_older_than_the_span_is_dropped_and_a_gap_breaks_the_line() {
        let mut trend = Trend::default();
        for at_s in [0, 1, 2, 10, 11, SPAN_S + 5] {
            trend.add(&live(1.0, 1.0, 1), at_s * 1000);
        }
        let runs = trend.runs(Quantity::Power, (SPAN_S + 5) * 1000);
        let lengths: Vec<usize> = runs.iter().map(Vec::len).collect();
        assert_eq!(lengths, [2, 1]);
    }

    #[test]
    fn history_comes_before_what_was_heard_and_not_over_it() {
        let mut trend = Trend::default();
        trend.add(&live(500.0, 3.0, 50_000), 100_000);
        let known = |values: &[f64]| Envelope {
            mean: values.iter().map(|x| Some(*x)).collect(),
            ..Envelope::default()
        };
        let history = History {
            at_ms: vec![97_000, 98_000, 99_000, 100_000],
            power_w: known(&[1.0, 2.0, 3.0, 4.0]),
            l_h: known(&[19e-6, 20e-6, 21e-6, 22e-6]),
            ..History::default()
        };
        trend.fill(&history);
        let runs = trend.runs(Quantity::Power, 100_000);
        assert_eq!(
            runs,
            [vec![(-3.0, 1.0), (-2.0, 2.0), (-1.0, 3.0), (0.0, 500.0)]]
        );
        assert_eq!(trend.runs(Quantity::L, 100_000)[0][2].1.round(), 21.0);
        // A history whose lists are too short is no reason to fall over.
        let broken = History {
            at_ms: vec![1_000, 2_000],
            ..History::default()
        };
        trend.fill(&broken);
    }

    #[test]
    fn columns_share_the_span_evenly() {
        let mut trend = Trend::default();
        for at_s in 0..=SPAN_S {
            trend.add(&live(at_s as f64, 1.0, 1), at_s * 1000);
        }
        let columns = trend.columns(Quantity::Power, 10, SPAN_S * 1000);
        assert_eq!(columns.len(), 10);
        let values: Vec<f64> = columns.into_iter().flatten().collect();
        assert!(values.len() == 10 && values.is_sorted());
        assert!(trend.columns(Quantity::Power, 0, 0).is_empty());
    }
}
