//! Settling, overshoot and error of the power steps (docs/control.md has the definitions).

use super::record::{HalfCycle, Recovery, Step, Summary};

/// Settled: this near to what is asked for, as a share of it.
const SETTLED: f64 = 0.05;

/// And never asked to be nearer than this, in watt.
const SETTLED_LEAST_W: f64 = 5.0;

/// The end of a step over which its error is taken, in seconds.
const ERROR_OVER_S: f64 = 0.2;

/// What an event was to the power.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    /// Asked for anew, in watt.
    Power(u16),
    /// Mains or pot changed.
    Disturbed,
    /// Something else; ends a step too.
    Other,
}

/// An event and its time in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Mark {
    pub(super) at_s: f64,
    pub(super) kind: Kind,
}

/// Half-cycles that lie within a time, their ends with them.
fn within(half_cycles: &[HalfCycle], from_s: f64, to_s: f64) -> &[HalfCycle] {
    let from = half_cycles.partition_point(|h| h.t_s < from_s);
    let to = half_cycles.partition_point(|h| h.t_s < to_s).max(from);
    &half_cycles[from..to]
}

/// Time after `from_s` from which on the power stays near; the last half-cycle of `span` may reach
/// beyond it and does not count.
fn settled_after_s(span: &[HalfCycle], from_s: f64, asked_w: f64) -> Option<f64> {
    let tolerance_w = (SETTLED * asked_w).max(SETTLED_LEAST_W);
    let whole = &span[..span.len().saturating_sub(1)];
    let near = |h: &HalfCycle| (h.power_w - asked_w).abs() <= tolerance_w;
    let stays = whole.iter().rev().take_while(|h| near(h)).count();
    let first = whole.get(whole.len() - stays)?;
    // Settled with the half-cycle before at its end, which is where the first near one begins.
    Some((first.t_s - from_s).max(0.0))
}

fn error_pct(span: &[HalfCycle], to_s: f64, asked_w: f64) -> Option<f64> {
    let last = within(span, to_s - ERROR_OVER_S, to_s);
    let whole = &last[..last.len().saturating_sub(1)];
    if whole.is_empty() || asked_w == 0.0 {
        return None;
    }
    let mean_w = whole.iter().map(|h| h.power_w).sum::<f64>() / whole.len() as f64;
    Some(100.0 * (mean_w - asked_w).abs() / asked_w)
}

/// All of it but what the run itself knows.
pub(super) fn of(half_cycles: &[HalfCycle], marks: &[Mark], duration_s: f64) -> Summary {
    let (mut steps, mut recoveries) = (Vec::new(), Vec::new());
    let mut asked_w = 0.0;
    for (n, mark) in marks.iter().enumerate() {
        let later = marks[n + 1..].iter().find(|m| m.at_s > mark.at_s);
        let to_s = later.map_or(duration_s, |m| m.at_s);
        let span = within(half_cycles, mark.at_s, to_s);
        match mark.kind {
            Kind::Power(power_w) => {
                let before_w = std::mem::replace(&mut asked_w, f64::from(power_w));
                let most_w = span.iter().map(|h| h.power_w).fold(0.0, f64::max);
                let over_pct = 100.0 * (most_w / asked_w - 1.0).max(0.0);
                steps.push(Step {
                    at_s: mark.at_s,
                    power_w: asked_w,
                    settled_after_s: settled_after_s(span, mark.at_s, asked_w),
                    overshoot_pct: (asked_w > before_w).then_some(over_pct),
                    error_pct: error_pct(span, to_s, asked_w),
                });
            }
            Kind::Disturbed => recoveries.push(Recovery {
                at_s: mark.at_s,
                after_s: settled_after_s(span, mark.at_s, asked_w),
            }),
            Kind::Other => {}
        }
    }
    let largest = |of: fn(&Step) -> Option<f64>| steps.iter().filter_map(of).fold(0.0, f64::max);
    Summary {
        settled_after_s: steps.iter().map(|s| s.settled_after_s).collect(),
        overshoot_pct: largest(|s| s.overshoot_pct),
        error_pct: largest(|s| s.error_pct),
        steps,
        recoveries,
        ..Summary::default()
    }
}
