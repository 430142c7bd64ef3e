//! Windows of samples as a scope shows them.

use ihd_link::Window;
use ihd_model::{Scope, Trajectory, WindowQuery, WindowSummary};
use ihd_signal::interpolation::linear;
use ihd_store::{Curves, ResultRow, StoreError, StoredCurve, WindowRow};

use super::measurement::measure;
use super::{View, finite};
use crate::error::DaemonError;
use crate::history::MAX_COLUMNS;

/// Largest number of windows in a list.
const MAX_WINDOWS: usize = 10_000;

impl View {
    /// Returns the last windows of a device, newest first.
    ///
    /// # Errors
    /// [`DaemonError::NoDevice`], or an error of the store.
    pub async fn windows(
        &self,
        device: &str,
        limit: usize,
    ) -> Result<Vec<WindowSummary>, DaemonError> {
        let limit = limit.min(MAX_WINDOWS);
        let rows = self.read_device(device, move |reader, device| {
            reader.last_windows(device, limit, false)
        });
        Ok(rows.await?.iter().map(summary).collect())
    }

    /// Returns a window, decimated to the columns of a display; `None` if it does not exist or its samples are not stored.
    ///
    /// # Errors
    /// [`DaemonError::NoDevice`], or an error of the store.
    pub async fn scope(
        &self,
        device: &str,
        query: WindowQuery,
    ) -> Result<Option<Scope>, DaemonError> {
        self.read_device(device, move |reader, device| {
            let newest = || -> Result<_, StoreError> {
                let last = reader.last_windows(device, 1, true)?;
                Ok(last.first().map(|row| (row.boot, row.seq)))
            };
            let which = match query.which {
                Some(which) => Some(which),
                None => newest()?,
            };
            let Some((boot, seq)) = which else {
                return Ok(None);
            };
            let Some((row, window, curves)) = reader.whole_window(device, boot, seq)? else {
                return Ok(None);
            };
            let result = reader.result_of(device, boot, seq)?;
            Ok(Some(scope(&row, &window, &curves, result.as_ref(), query)))
        })
        .await
    }
}

fn summary(row: &WindowRow) -> WindowSummary {
    WindowSummary {
        boot: row.boot,
        seq: row.seq,
        at_ms: row.at_ms,
        f_sw_hz: row.f_sw_hz,
        half_cycle: row.half_cycle,
        samples: row.not_kept.is_none(),
    }
}

fn scope(
    row: &WindowRow,
    window: &Window,
    curves: &Curves,
    result: Option<&ResultRow>,
    query: WindowQuery,
) -> Scope {
    let (dt_s, n) = (window.dt_s(), window.pairs.len());
    let duration_s = n as f64 * dt_s;
    let first = first_pair(query.from_s, dt_s, n);
    let end = first_pair(query.to_s, dt_s, n).max(first);
    let segment = window.segment();
    let load = (&segment.v_v[first..end], &segment.i_a[first..end]);
    let sampled_v = window.v_volt();
    let mut scope = Scope {
        boot: row.boot,
        seq: row.seq,
        at_ms: row.at_ms,
        half_cycle: window.half_cycle,
        f_sw_hz: window.f_sw_hz,
        sample_rate_hz: dt_s.recip(),
        duration_s,
        pairs: u32::try_from(n).unwrap_or(u32::MAX),
        saturated: u32::from(window.saturated),
        from_s: first as f64 * dt_s,
        to_s: end as f64 * dt_s,
        measured: measure(load.0, load.1, f64::from(window.f_sw_hz)),
        ekf: ekf(window),
        ..Scope::default()
    };
    decimate(
        &mut scope,
        (&sampled_v[first..end], load.1),
        query.columns,
        first as f64 * dt_s,
        dt_s,
    );
    let start_s = f64::from(window.first_pair_ns) * 1e-9;
    scope.network = curves.network.as_ref().map(|c| trajectory(c, start_s));
    scope.truth = curves.truth.as_ref().map(|c| trajectory(c, start_s));
    if let Some(result) = result {
        scope.pass = Some(result.pass);
        scope.why.clone_from(&result.why);
        scope.r_mean_ohm = finite(result.r_ohm);
        scope.l_mean_h = finite(result.l_h);
    }
    let weights = curves.network.as_ref().or(curves.truth.as_ref());
    if let Some((truth, weights)) = curves.truth.as_ref().zip(weights) {
        scope.r_true_mean_ohm = mean_of(truth, &truth.r_ohm, weights);
        scope.l_true_mean_h = mean_of(truth, &truth.l_h, weights);
    }
    scope
}

/// Returns the index of the first pair at `at_s` after the window's first pair or later, at most `n`.
fn first_pair(at_s: f64, dt_s: f64, n: usize) -> usize {
    // Tolerance for the rounding of a pair's own time.
    let pair = (at_s / dt_s - 1e-6).ceil();
    // Out of range, infinite, or NaN.
    (pair.max(0.0) as usize).min(n)
}

/// Fills in the minimum and maximum of each column, or the pairs themselves if there are no more than columns.
fn decimate(
    scope: &mut Scope,
    (v_v, i_a): (&[f64], &[f64]),
    columns: usize,
    from_s: f64,
    dt_s: f64,
) {
    let n = v_v.len();
    let columns = columns.clamp(1, MAX_COLUMNS).min(n);
    scope.decimated = n > columns;
    let extremes = |x: &[f64]| {
        let both = (f64::INFINITY, f64::NEG_INFINITY);
        x.iter().fold(both, |(a, b), x| (a.min(*x), b.max(*x)))
    };
    for column in 0..columns {
        let (a, b) = (column * n / columns, (column + 1) * n / columns);
        let (v, i) = (extremes(&v_v[a..b]), extremes(&i_a[a..b]));
        scope.t_s.push(from_s + 0.5 * (a + b - 1) as f64 * dt_s);
        scope.v_min_v.push(v.0);
        scope.v_max_v.push(v.1);
        scope.i_min_a.push(i.0);
        scope.i_max_a.push(i.1);
    }
}

fn ekf(window: &Window) -> Trajectory {
    let start_s = f64::from(window.first_pair_ns) * 1e-9;
    let entries = window.trajectory.iter();
    let times = 0..window.trajectory.len();
    Trajectory {
        t_s: times
            .map(|k| window.trajectory_time_s(k) - start_s)
            .collect(),
        r_ohm: entries.clone().map(|entry| entry.r.ohm()).collect(),
        l_h: entries.map(|entry| entry.l.henry()).collect(),
        ..Trajectory::default()
    }
}

/// Shifts the times of a curve from the mains zero crossing to the first pair, `start_s` after it.
fn trajectory(curve: &StoredCurve, start_s: f64) -> Trajectory {
    Trajectory {
        t_s: curve.t_s.iter().map(|t| t - start_s).collect(),
        r_ohm: curve.r_ohm.clone(),
        l_h: curve.l_h.clone(),
        r_sigma_ohm: curve.r_sigma_ohm.clone(),
        l_sigma_h: curve.l_sigma_h.clone(),
    }
}

/// Returns the mean of a quantity over the times of `weights`, weighted with their squared current like the network's mean.
fn mean_of(curve: &StoredCurve, value: &[f64], weights: &StoredCurve) -> Option<f64> {
    let terms = weights.t_s.iter().zip(&weights.i_a);
    let (mut sum, mut weight) = (0.0, 0.0);
    for (t_s, i_a) in terms {
        sum += i_a * i_a * linear(&curve.t_s, value, *t_s)?;
        weight += i_a * i_a;
    }
    finite(sum / weight)
}

#[cfg(test)]
mod tests {
    use ihd_shared::sampling::{Pair, Scales};

    use super::*;

    fn window(pairs: usize) -> (WindowRow, Window) {
        let window = Window {
            seq: 5,
            half_cycle: 99,
            f_sw_hz: 45_000,
            half_cycle_ns: 10_000_000,
            first_pair_ns: 2_000,
            pairs: (0..pairs)
                .map(|k| Pair {
                    v: if k == 777 { 2_000 } else { (k % 100) as i16 },
                    i: -((k % 50) as i16),
                })
                .collect(),
            first_trajectory_ns: 35_000,
            trajectory: Vec::new(),
            saturated: 0,
            lookup_version: 1,
            scales: Scales {
                v_full_scale_mv: 2_048_000,
                i_full_scale_ma: 204_800,
            },
        };
        let row = WindowRow {
            device: "a".into(),
            boot: 1,
            seq: 5,
            at_ms: 3,
            half_cycle: 99,
            f_sw_hz: 45_000,
            pairs: pairs as u32,
            not_kept: None,
            packed_bytes: 1,
        };
        (row, window)
    }

    fn scope_of_view(query: WindowQuery) -> Scope {
        let (row, window) = window(9_150);
        scope(&row, &window, &Curves::default(), None, query)
    }

    #[test]
    fn no_spike_is_lost_in_a_column_and_a_zoom_shows_the_samples() {
        let whole = scope_of_view(WindowQuery {
            to_s: f64::INFINITY,
            columns: 1_000,
            ..WindowQuery::default()
        });
        assert!(whole.decimated && whole.t_s.len() == 1_000);
        assert_eq!(whole.v_max_v.iter().copied().fold(0.0, f64::max), 2_000.0);
        // 61 pairs in three periods of 45 kHz: 9150 pairs are 10 ms.
        assert!(
            (whole.sample_rate_hz - 915e3).abs() < 1e-6 && (whole.duration_s - 0.01).abs() < 1e-12
        );
        assert_eq!(whole.measured.periods, 450);
        let dt_s = whole.sample_rate_hz.recip();
        let zoom = scope_of_view(WindowQuery {
            from_s: 700.0 * dt_s,
            to_s: 800.0 * dt_s,
            columns: 1_000,
            ..WindowQuery::default()
        });
        assert!(!zoom.decimated);
        assert_eq!(
            (zoom.t_s.len(), zoom.v_min_v[77], zoom.v_max_v[77]),
            (100, 2_000.0, 2_000.0)
        );
        assert!((zoom.t_s[77] - 777.0 * dt_s).abs() < 1e-12);
        assert_eq!(zoom.i_min_a[49], -4.9);
        assert_eq!(zoom.measured.periods, 3);
    }

    #[test]
    fn whatever_is_asked_for_is_answered() {
        for (from_s, to_s, columns) in [
            (f64::NAN, f64::NAN, 0),
            (-1.0, -0.5, 10),
            (1.0, 2.0, 10),
            (0.005, 0.004, 10),
            (f64::NEG_INFINITY, f64::INFINITY, usize::MAX),
        ] {
            let scope = scope_of_view(WindowQuery {
                which: None,
                from_s,
                to_s,
                columns,
            });
            assert!(scope.t_s.len() <= 4_000 && scope.t_s.len() == scope.i_max_a.len());
            assert!(scope.from_s <= scope.to_s && scope.to_s <= scope.duration_s * 1.001);
        }
    }

    #[test]
    fn the_truths_mean_is_weighted_as_the_networks() {
        let curve = |r: [f64; 3], i: [f64; 3]| StoredCurve {
            t_s: vec![0.0, 5e-3, 10e-3],
            r_ohm: r.to_vec(),
            l_h: vec![3e-5; 3],
            i_a: i.to_vec(),
            ..StoredCurve::default()
        };
        let (row, window) = window(610);
        let curves = Curves {
            network: Some(curve([2.0, 4.0, 6.0], [0.0, 2.0, 1.0])),
            truth: Some(curve([1.0, 3.0, 8.0], [9.0, 9.0, 9.0])),
        };
        let query = WindowQuery::default();
        let scope = scope(&row, &window, &curves, None, query);
        // (4 * 3 + 1 * 8) / 5.
        assert!((scope.r_true_mean_ohm.unwrap() - 4.0).abs() < 1e-12);
        assert!((scope.l_true_mean_h.unwrap() - 3e-5).abs() < 1e-12);
        assert!(
            (scope.network.unwrap().t_s[0] + 2e-6).abs() < 1e-15,
            "after the first pair"
        );
    }
}
