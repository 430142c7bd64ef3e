//! Windows of the last hour, by the order in which they came, so that a jump of the clock makes no window old.

use std::collections::VecDeque;

/// Length of the last hour, counted in time in which windows came.
pub(crate) const LAST_MS: i64 = 3_600_000;

/// Longest counted step between two windows. A longer one is a pause or a jump of the clock, and counts as this.
pub(crate) const MAX_STEP_MS: i64 = 60_000;

/// Time between two marks.
const MARK_EVERY_MS: i64 = 60_000;

/// Marks of the rows at which the windows of the last hour begin.
#[derive(Debug, Default)]
pub(crate) struct Recent {
    marks: VecDeque<Mark>,
    /// Sum of the steps between windows.
    recorded_ms: i64,
    last_ms: Option<i64>,
}

#[derive(Debug)]
struct Mark {
    day: String,
    id: i64,
    recorded_ms: i64,
}

impl Recent {
    /// Adds a window: its day's file, its row there, and the time at which it was stored in milliseconds since 1970, UTC.
    pub(crate) fn note(&mut self, day: &str, id: i64, at_ms: i64) {
        let last_ms = self.last_ms.replace(at_ms).unwrap_or(at_ms);
        self.recorded_ms += at_ms.saturating_sub(last_ms).clamp(0, MAX_STEP_MS);
        let is_marked = self.marks.back().is_some_and(|mark| {
            mark.day == day && self.recorded_ms - mark.recorded_ms < MARK_EVERY_MS
        });
        if !is_marked {
            self.mark(day, id);
        }
        let is_over = |mark: &Mark| self.recorded_ms - mark.recorded_ms >= LAST_MS;
        while self.marks.get(1).is_some_and(is_over) {
            self.marks.pop_front();
        }
    }

    /// Adds the rows that another process stored in a day's file: those from this one on are of the last hour. Newest days first.
    pub(crate) fn resume(&mut self, day: &str, id: i64) {
        if self.first_of(day).is_none() {
            let recorded_ms = self.recorded_ms;
            let day = day.to_owned();
            self.marks.push_front(Mark {
                day,
                id,
                recorded_ms,
            });
        }
    }

    /// Returns the first row of the last hour in a day's file; `None` if there is none in it.
    pub(crate) fn first_of(&self, day: &str) -> Option<i64> {
        let mark = self.marks.iter().find(|mark| mark.day == day)?;
        Some(mark.id)
    }

    fn mark(&mut self, day: &str, id: i64) {
        self.marks.push_back(Mark {
            day: day.to_owned(),
            id,
            recorded_ms: self.recorded_ms,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW_MS: i64 = 1_795_348_800_000;
    const YEAR_MS: i64 = 365 * 86_400_000;

    /// A window a second, from row `from` on.
    fn record(recent: &mut Recent, day: &str, from: i64, seconds: i64, at_ms: i64) {
        for k in 0..seconds {
            recent.note(day, from + k, at_ms + 1_000 * k);
        }
    }

    #[test]
    fn the_last_hour_is_that_in_which_windows_came() {
        let mut recent = Recent::default();
        assert_eq!(recent.first_of("a"), None);
        record(&mut recent, "a", 1, 7_200, NOW_MS);
        let first = recent.first_of("a").unwrap();
        assert!((3_540..=3_601).contains(&first), "{first}");
        // A night without windows makes none of them old.
        recent.note("b", 1, NOW_MS + 50_000_000);
        assert!(recent.first_of("a").unwrap() <= first + 60);
        assert_eq!(recent.first_of("b"), Some(1));
        record(&mut recent, "b", 2, 3_700, NOW_MS + 50_001_000);
        assert_eq!(recent.first_of("a"), None);
    }

    #[test]
    fn no_jump_of_the_clock_makes_a_window_old_or_young() {
        for jump_ms in [YEAR_MS, -YEAR_MS, 3_600_000, -3_600_000] {
            let mut recent = Recent::default();
            record(&mut recent, "a", 1, 600, NOW_MS);
            record(&mut recent, "a", 601, 600, NOW_MS + jump_ms);
            assert_eq!(recent.first_of("a"), Some(1), "{jump_ms}");
            record(&mut recent, "a", 1_201, 3_600, NOW_MS + jump_ms + 600_000);
            let first = recent.first_of("a").unwrap();
            assert!((1_080..=1_201).contains(&first), "{jump_ms}: {first}");
        }
    }
}
