//! Time stamps of rows, and days that files of windows are named by.

use std::sync::Arc;

use jiff::{Timestamp, tz::Offset};

/// Clock in milliseconds since 1970, UTC: the machine's, or that of a test.
pub type Clock = Arc<dyn Fn() -> i64 + Send + Sync>;

/// Returns the machine's clock.
pub fn of_the_machine() -> Clock {
    Arc::new(|| Timestamp::now().as_millisecond())
}

/// Returns the day in UTC as `YYYY-MM-DD`, which sorts by time. A time out of the calendar's range
/// counts as 1970.
pub fn day(at_ms: i64) -> String {
    let at = Timestamp::from_millisecond(at_ms).unwrap_or(Timestamp::UNIX_EPOCH);
    Offset::UTC.to_datetime(at).date().to_string()
}

/// Formats a time by RFC 3339 in UTC: `2026-11-22T08:30:00.125Z`.
pub fn rfc3339(at_ms: i64) -> String {
    let at = Timestamp::from_millisecond(at_ms).unwrap_or(Timestamp::UNIX_EPOCH);
    format!("{at:.3}")
}

/// Returns `true` if a text is a day as [`day`] writes it.
pub fn is_day(word: &str) -> bool {
    word.parse::<jiff::civil::Date>()
        .is_ok_and(|date| date.to_string() == word)
}

/// Returns the beginning of a day in milliseconds since 1970; `None` if the text is no day.
pub fn of_day(word: &str) -> Option<i64> {
    if !is_day(word) {
        return None;
    }
    let date: jiff::civil::Date = word.parse().ok()?;
    let midnight = date.at(0, 0, 0, 0);
    let at = Offset::UTC.to_timestamp(midnight).ok()?;
    Some(at.as_millisecond())
}

/// Parses a day (UTC, its beginning) or a time to milliseconds since 1970: `2026-11-22`, `2026-11-22T08:30:00Z`.
pub fn parse(word: &str) -> Option<i64> {
    let at = || {
        word.parse::<Timestamp>()
            .ok()
            .map(Timestamp::as_millisecond)
    };
    of_day(word).or_else(at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_ends_at_midnight_in_utc() {
        // 2026-11-23T00:00:00Z by `date -u -d 2026-11-23 +%s`.
        let midnight = 1_795_392_000_000;
        assert_eq!(day(midnight - 1), "2026-11-22");
        assert_eq!(day(midnight), "2026-11-23");
        assert_eq!(of_day("2026-11-23"), Some(midnight));
        assert_eq!(rfc3339(midnight - 1), "2026-11-22T23:59:59.999Z");
        assert_eq!(day(i64::MAX), "1970-01-01");
        assert_eq!(parse("2026-11-23"), Some(midnight));
        assert_eq!(parse("2026-11-23T00:00:01.5Z"), Some(midnight + 1_500));
        assert_eq!(parse("2026-11-23T01:00:00+01:00"), Some(midnight));
        assert_eq!(
            (parse("yesterday"), parse("2026-02-30"), parse("")),
            (None, None, None)
        );
        assert!(is_day("2024-02-29") && !is_day("2025-02-29") && !is_day("2025-2-9"));
    }
}
