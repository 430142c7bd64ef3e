//! Figures of the learner's load.

use std::collections::VecDeque;
use std::time::Duration;

/// Number of last fits that the percentiles are taken of.
const PERCENTILE_FITS: usize = 512;

/// Figures of the learner's load since its start.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LearnerFigures {
    /// Running threads; fewer than configured only if one has ended.
    pub threads: usize,
    /// Windows that wait.
    pub waiting: usize,
    /// Windows that were identified or refused.
    pub learned: u64,
    /// Windows that were dropped from the queue.
    pub unlearned: u64,
    /// Windows whose training panicked.
    pub panics: u64,
    /// Busy time of all threads together, in seconds.
    pub busy_s: f64,
    /// Median duration of the last fits in seconds; `None` before the first.
    pub fit_p50_s: Option<f64>,
    /// 99th percentile of the duration of the last fits in seconds; `None` before the first.
    pub fit_p99_s: Option<f64>,
}

/// Counters of the learner.
#[derive(Debug, Default)]
pub struct Meter {
    pub learned: u64,
    pub unlearned: u64,
    pub panics: u64,
    busy: Duration,
    last: VecDeque<Duration>,
}

impl Meter {
    /// Counts a window and its duration.
    pub fn add_fit(&mut self, took: Duration) {
        self.learned += 1;
        self.busy = self.busy.saturating_add(took);
        if self.last.len() == PERCENTILE_FITS {
            self.last.pop_front();
        }
        self.last.push_back(took);
    }

    /// Computes the figures.
    pub fn figures(&self, threads: usize, waiting: usize) -> LearnerFigures {
        let mut sorted: Vec<_> = self.last.iter().collect();
        sorted.sort();
        // The smallest duration that `percent` percent of the fits do not exceed.
        let percentile = |percent: usize| {
            let rank = (sorted.len() * percent).div_ceil(100);
            sorted.get(rank.saturating_sub(1)).map(|t| t.as_secs_f64())
        };
        LearnerFigures {
            threads,
            waiting,
            learned: self.learned,
            unlearned: self.unlearned,
            panics: self.panics,
            busy_s: self.busy.as_secs_f64(),
            fit_p50_s: percentile(50),
            fit_p99_s: percentile(99),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_the_last_fits() {
        let mut meter = Meter::default();
        assert_eq!(meter.figures(1, 0).fit_p50_s, None);
        for ms in 1..=100 {
            meter.add_fit(Duration::from_millis(ms));
        }
        let f = meter.figures(1, 3);
        assert_eq!((f.fit_p50_s, f.fit_p99_s), (Some(0.05), Some(0.099)));
        assert_eq!((f.learned, f.waiting), (100, 3));
        assert!((f.busy_s - 5.05).abs() < 1e-9);
        for _ in 0..PERCENTILE_FITS {
            meter.add_fit(Duration::from_millis(7));
        }
        assert_eq!(meter.figures(1, 0).fit_p99_s, Some(7e-3));
    }
}
