//! Settling, overshoot and error of the power steps (docs/control.md has the definitions).

use ihd_firmware::limits::{BURST_PERIOD_MS, BURST_POWER_W};

use super::record::{PowerStep, Recovery, Summary, TrueHalfCycle};

/// Tolerance of a settled power, as a share of the requested one.
const SETTLED_TOLERANCE: f64 = 0.05;

/// Smallest tolerance, in watt.
const SETTLED_LEAST_W: f64 = 5.0;

/// Time before the end of a step over which its error is averaged, in seconds.
const ERROR_OVER_S: f64 = 0.2;

/// Power in watt below which bursts are used.
const BURSTS_BELOW_W: f64 = BURST_POWER_W as f64;

/// Longest start with its pot probe.
const START_S: f64 = 0.2;

/// Averaging time in bursts, in seconds: two periods.
const BURSTS_OVER_S: f64 = 2e-3 * BURST_PERIOD_MS as f64;

/// Kind of an event with respect to the power.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Power requested, in watt.
    Power(u16),
    /// Change of mains or pot.
    Disturbed,
    /// Other event; also ends a step.
    Other,
}

/// Event with its time in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Time in seconds.
    pub at_s: f64,
    /// Its kind.
    pub kind: Kind,
}

/// Half-cycles within a time, including their ends.
pub(super) fn within(half_cycles: &[TrueHalfCycle], from_s: f64, to_s: f64) -> &[TrueHalfCycle] {
    let from = half_cycles.partition_point(|h| h.t_s < from_s);
    let to = half_cycles.partition_point(|h| h.t_s < to_s).max(from);
    &half_cycles[from..to]
}

/// Powers that are judged, with the start of their half-cycles: each one, or in bursts the mean of those before. The last
/// half-cycle of `span` may extend beyond it and is skipped.
fn counting(span: &[TrueHalfCycle], asked_w: f64) -> Vec<(f64, f64)> {
    let whole = &span[..span.len().saturating_sub(1)];
    if !is_in_bursts(span, asked_w) {
        return whole.iter().map(|h| (h.t_s, h.power_w)).collect();
    }
    let begin_s = whole.first().map_or(0.0, |h| h.t_s);
    let late = whole.iter().filter(|h| h.t_s >= begin_s + BURSTS_OVER_S);
    late.map(|h| {
        let last = within(whole, h.t_s - BURSTS_OVER_S, h.t_s);
        (h.t_s, mean_w(last).unwrap_or(0.0))
    })
    .collect()
}

/// Returns `true` if it heats in bursts: the bridge pauses once a start is over, which pauses after its pot probe.
fn is_in_bursts(span: &[TrueHalfCycle], asked_w: f64) -> bool {
    let started_s = span.first().map_or(0.0, |h| h.t_s) + START_S;
    let pauses = |h: &TrueHalfCycle| h.t_s > started_s && h.state == "Heating" && !h.bridge_on;
    asked_w > 0.0 && asked_w < BURSTS_BELOW_W && span.iter().any(pauses)
}

fn mean_w(span: &[TrueHalfCycle]) -> Option<f64> {
    let sum_w: f64 = span.iter().map(|h| h.power_w).sum();
    (!span.is_empty()).then(|| sum_w / span.len() as f64)
}

/// Time after `from_s` from which on the power stays within the tolerance.
fn settled_after_s(counting: &[(f64, f64)], from_s: f64, asked_w: f64) -> Option<f64> {
    let tolerance_w = (SETTLED_TOLERANCE * asked_w).max(SETTLED_LEAST_W);
    let near = |(_, power_w): &&(f64, f64)| (power_w - asked_w).abs() <= tolerance_w;
    let stays = counting.iter().rev().take_while(near).count();
    // Its first half-cycle is where it begins; that takes no time.
    let (first_s, _) = counting.get(counting.len() - stays)?;
    Some((first_s - from_s).max(0.0))
}

fn error_pct(span: &[TrueHalfCycle], to_s: f64, asked_w: f64) -> Option<f64> {
    let bursts = is_in_bursts(span, asked_w);
    let over_s = if bursts { BURSTS_OVER_S } else { ERROR_OVER_S };
    let last = within(span, to_s - over_s, to_s);
    let whole = &last[..last.len().saturating_sub(1)];
    let enough = !bursts || span.first().is_some_and(|h| h.t_s <= to_s - over_s);
    let mean_w = mean_w(whole).filter(|_| asked_w > 0.0 && enough)?;
    Some(100.0 * (mean_w - asked_w).abs() / asked_w)
}

/// Computes the summary, except for the fields that only the run knows.
pub fn summarise(half_cycles: &[TrueHalfCycle], marks: &[Mark], duration_s: f64) -> Summary {
    let (mut steps, mut recoveries) = (Vec::new(), Vec::new());
    let mut asked_w = 0.0;
    for (n, mark) in marks.iter().enumerate() {
        let later = marks[n + 1..].iter().find(|m| m.at_s > mark.at_s);
        let to_s = later.map_or(duration_s, |m| m.at_s);
        let span = within(half_cycles, mark.at_s, to_s);
        match mark.kind {
            Kind::Power(power_w) => {
                let before_w = std::mem::replace(&mut asked_w, f64::from(power_w));
                let powers = counting(span, asked_w);
                let most_w = powers.iter().map(|(_, w)| *w).fold(0.0, f64::max);
                let over_pct = 100.0 * (most_w / asked_w - 1.0).max(0.0);
                steps.push(PowerStep {
                    at_s: mark.at_s,
                    power_w: asked_w,
                    settled_after_s: settled_after_s(&powers, mark.at_s, asked_w),
                    overshoot_pct: (asked_w > before_w).then_some(over_pct),
                    error_pct: error_pct(span, to_s, asked_w),
                });
            }
            Kind::Disturbed => recoveries.push(Recovery {
                at_s: mark.at_s,
                after_s: settled_after_s(&counting(span, asked_w), mark.at_s, asked_w),
            }),
            Kind::Other => {}
        }
    }
    let largest =
        |of: fn(&PowerStep) -> Option<f64>| steps.iter().filter_map(of).fold(0.0, f64::max);
    Summary {
        settled_after_s: steps.iter().map(|s| s.settled_after_s).collect(),
        overshoot_pct: largest(|s| s.overshoot_pct),
        error_pct: largest(|s| s.error_pct),
        steps,
        recoveries,
        ..Summary::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn half_cycles(powers: impl IntoIterator<Item = f64>) -> Vec<TrueHalfCycle> {
        let of = |(n, power_w): (usize, f64)| TrueHalfCycle {
            t_s: n as f64 * 0.01,
            power_w,
            bridge_on: power_w > 0.0,
            state: "Heating".to_owned(),
            ..TrueHalfCycle::default()
        };
        powers.into_iter().enumerate().map(of).collect()
    }

    fn mark(at_s: f64, kind: Kind) -> Mark {
        Mark { at_s, kind }
    }

    #[test]
    fn a_step_is_settled_where_it_stays_near() {
        // 5 half-cycles off, then 900, 1060 (6 % over), and 1020 for good.
        let powers = [0.0; 5]
            .into_iter()
            .chain([900.0, 1060.0])
            .chain([1020.0; 43]);
        let all = half_cycles(powers);
        let summary = summarise(&all, &[mark(0.0, Kind::Power(1000))], 0.5);
        let step = &summary.steps[0];
        assert!(
            (step.settled_after_s.unwrap() - 0.07).abs() < 1e-9,
            "{step:?}"
        );
        assert!((step.overshoot_pct.unwrap() - 6.0).abs() < 1e-9);
        assert!((step.error_pct.unwrap() - 2.0).abs() < 1e-9);
        assert_eq!(summary.settled_after_s, [step.settled_after_s]);
    }

    #[test]
    fn a_step_ends_with_the_next_event_and_what_is_too_little_never_settles() {
        let all = half_cycles([800.0; 50].into_iter().chain([1000.0; 50]));
        let marks = [
            mark(0.0, Kind::Power(1000)),
            mark(0.5, Kind::Disturbed),
            mark(0.9, Kind::Power(500)),
        ];
        let summary = summarise(&all, &marks, 1.0);
        assert_eq!(summary.settled_after_s, [None, None]);
        assert!((summary.error_pct - 100.0).abs() < 1e-9, "{summary:?}");
        assert_eq!(summary.overshoot_pct, 0.0, "a step down has none");
        assert_eq!(summary.recoveries[0].after_s, Some(0.0));
    }

    #[test]
    fn bursts_count_as_their_mean() {
        // 200 ms of each second at 700 W are 140 W.
        let all = half_cycles((0..600).map(|n| if n % 100 < 20 { 700.0 } else { 0.0 }));
        let summary = summarise(&all, &[mark(0.0, Kind::Power(140))], 6.0);
        let step = &summary.steps[0];
        assert!(step.error_pct.unwrap() < 1.0, "{step:?}");
        assert!(
            (1.9..2.2).contains(&step.settled_after_s.unwrap()),
            "{step:?}"
        );
        assert!(step.overshoot_pct.unwrap() < 1.0, "{step:?}");
    }

    #[test]
    fn off_is_settled_below_five_watt() {
        let all = half_cycles([1000.0, 4.0, 0.0, 0.0, 0.0, 0.0]);
        let summary = summarise(&all, &[mark(0.0, Kind::Power(0))], 0.06);
        assert_eq!(summary.settled_after_s, [Some(0.01)]);
        assert_eq!(summary.steps[0].error_pct, None);
    }
}
