//! Reduction of dense data to the minimum and maximum of each column of pixels.

use std::ops::Range;

/// Column of pixels: the samples from `from` to `to`, and their range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Column {
    /// Middle of the column, in the units of the x axis.
    pub at: f64,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
}

/// Columns of a waveform: in each the extremes of its samples, and of those around it up to `period` samples. A carrier whose
/// period spans some columns thus becomes a band instead of a moiré pattern. Samples that are not finite are skipped.
pub fn columns(
    range: Range<usize>,
    most: usize,
    period: f64,
    at: impl Fn(usize) -> f64,
    value: impl Fn(usize) -> f64,
) -> Vec<Column> {
    let per_column = range.len() as f64 / most.max(1) as f64;
    let around = ((period - per_column) / 2.0).max(0.0).ceil() as usize;
    let count = if per_column < 1.0 {
        range.len()
    } else {
        most.max(1)
    };
    let edge = |k: usize| range.start + (k as f64 * per_column.max(1.0)).round() as usize;
    (0..count)
        .filter_map(|k| {
            let (from, to) = (edge(k), edge(k + 1).min(range.end));
            let wide = from.saturating_sub(around).max(range.start)..(to + around).min(range.end);
            let (min, max) = crate::span(wide.map(&value))?;
            let at = at((from + to) / 2);
            at.is_finite().then_some(Column { at, min, max })
        })
        .collect()
}

/// Columns of points over any axis: `unit` is the position of a point on it, from 0 to 1.
pub fn of_points(
    points: &[(f64, f64)],
    most: usize,
    unit: impl Fn(f64) -> f64,
    value: impl Fn(f64) -> f64,
) -> Vec<Column> {
    let most_f = most.max(1) as f64;
    let column = |x: f64| (unit(x) * most_f).floor().clamp(0.0, most_f - 1.0) as usize;
    let inside = points
        .iter()
        .filter(|p| (0.0..=1.0).contains(&unit(p.0)) && p.1.is_finite());
    let inside: Vec<_> = inside.copied().collect();
    let chunks = inside.chunk_by(|a, b| column(a.0) == column(b.0));
    chunks
        .filter_map(|chunk| {
            let (min, max) = crate::span(chunk.iter().map(|p| p.1))?;
            let first = chunk.first()?.0;
            // A single point keeps its place.
            let at = match chunk {
                [_] => first,
                _ => value((column(first) as f64 + 0.5) / most_f),
            };
            Some(Column { at, min, max })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// A carrier of 45 kHz at 50 MS/s under a rectified mains.
    fn carrier(k: usize) -> f64 {
        let t = k as f64 / 50e6;
        (TAU * 50.0 * t).sin().abs() * (TAU * 45e3 * t).sin()
    }

    #[test]
    fn each_column_holds_the_least_and_the_largest_of_its_samples() {
        let range = 0..1_000_003;
        let columns = columns(range.clone(), 976, 0.0, |k| k as f64, carrier);
        assert_eq!(columns.len(), 976);
        let per_column = range.len() as f64 / 976.0;
        for k in range {
            let at = ((k as f64 / per_column) as usize).min(975);
            let near = &columns[at.saturating_sub(1)..(at + 2).min(976)];
            let value = carrier(k);
            assert!(
                near.iter().any(|c| c.min <= value && value <= c.max),
                "{k} {value} {near:?}"
            );
        }
        let largest = columns.iter().map(|c| c.max).fold(0.0, f64::max);
        assert!(largest > 0.9999, "{largest}");
    }

    /// 20 ms on 976 columns is .92 of a period a column: without what is around it, a column misses a peak.
    #[test]
    fn a_carrier_of_about_a_column_makes_no_pattern() {
        let amplitude = |c: &Column| (TAU * 50.0 * c.at / 50e6).sin().abs();
        let period = 50e6 / 45e3;
        let worst = |columns: &[Column]| {
            let middle = columns.iter().filter(|c| amplitude(c) > 0.5);
            middle
                .map(|c| c.max / amplitude(c))
                .fold(f64::INFINITY, f64::min)
        };
        let plain = columns(0..1_000_000, 976, 0.0, |k| k as f64, carrier);
        assert!(worst(&plain) < 0.98, "{}", worst(&plain));
        let whole = columns(0..1_000_000, 976, period, |k| k as f64, carrier);
        assert!(worst(&whole) > 0.99, "{}", worst(&whole));
    }

    #[test]
    fn fewer_samples_than_columns_are_shown_as_they_are() {
        let shown = columns(10..15, 100, 0.0, |k| k as f64, |k| -(k as f64));
        let at: Vec<f64> = shown.iter().map(|c| c.at).collect();
        assert_eq!(at, [10.0, 11.0, 12.0, 13.0, 14.0]);
        assert!(shown.iter().all(|c| c.min == -c.at && c.max == -c.at));
        assert!(columns(5..5, 100, 3.0, |k| k as f64, |_| 0.0).is_empty());
        let holes = columns(0..10, 100, 0.0, |k| k as f64, |_| f64::NAN);
        assert!(holes.is_empty());
    }

    #[test]
    fn points_are_gathered_by_where_they_are_drawn() {
        let points: Vec<_> = (1..=1000)
            .map(|k| (f64::from(k), f64::from(k % 7)))
            .collect();
        let scale = crate::Scale::decades(1.0..1000.0);
        let columns = of_points(&points, 300, |x| scale.unit(x), |u| scale.value(u));
        // The first decades have fewer points than columns: each stands where it is.
        assert_eq!((columns[0].at, columns[1].at), (1.0, 2.0));
        assert!(columns.len() <= 300);
        let last = columns.last().unwrap();
        assert!(last.min == 0.0 && last.max == 6.0 && last.at < 1000.0);
    }
}
