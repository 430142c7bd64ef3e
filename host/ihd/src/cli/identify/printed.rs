//! Table of `ihd identify`: a row a method, in text and in JSON.

use ihd_gate::{HalfCycleVerdict, MethodResult};
use ihd_identify::accuracy::Accuracy;
use ihd_signal::{Segment, WithSigma};
use ihd_survey::mains::{Mains, MainsSource};
use serde::Serialize;

use super::crest::{crest, squared_current};
use crate::report::table::TextTable;

/// Numbers of a result's row in the table.
#[derive(Serialize)]
pub struct Printed {
    /// Means over the whole half-cycles, else over the stretch, weighted with the squared current.
    r_mean_ohm: f64,
    l_mean_h: f64,
    /// Values at the last crest and their standard deviations; `None` without a crest.
    #[serde(flatten)]
    crest: Option<CrestValues>,
}

/// Values at a crest.
#[derive(Serialize)]
struct CrestValues {
    crest_t_s: f64,
    r_crest_ohm: f64,
    r_crest_sigma_ohm: Option<f64>,
    l_crest_h: f64,
    l_crest_sigma_h: Option<f64>,
}

/// Half-cycles of which the whole middle was captured, by their beginning in seconds; none if the mains' phase is assumed.
pub fn whole_half_cycles(outcome: &MethodResult, mains: &Mains) -> Vec<f64> {
    let is_known = mains.zero_crossing_source != MainsSource::Assumed;
    let whole = |h: &&HalfCycleVerdict| is_known && h.seen > 0.999;
    let half_cycles = outcome.judgement.half_cycles.iter();
    half_cycles.filter(whole).map(|h| h.from_s).collect()
}

impl Printed {
    /// Numbers of a result; `None` of a method that failed.
    pub fn of(segment: &Segment, outcome: &MethodResult, mains: &Mains) -> Option<Self> {
        let estimate = outcome.result.as_ref().ok()?;
        let whole = whole_half_cycles(outcome, mains);
        let half_s = segment.half_cycle_s();
        let inside = |t: f64| {
            whole.is_empty()
                || whole
                    .iter()
                    .any(|from_s| (0.0..half_s).contains(&(t - from_s)))
        };
        let weights = squared_current(segment, &estimate.t_s);
        let mean = |x: &[f64]| {
            let all = estimate.t_s.iter().zip(x).zip(&weights);
            let (sum, weight) = all
                .filter(|((t, _), _)| inside(**t))
                .fold((0.0, 0.0), |(sum, weight), ((_, x), w)| {
                    (sum + x * w, weight + w)
                });
            sum / weight
        };
        let at =
            crest(segment, estimate).filter(|_| mains.zero_crossing_source != MainsSource::Assumed);
        let at = at.and_then(|k| {
            Some(CrestValues {
                crest_t_s: *estimate.t_s.get(k)?,
                r_crest_ohm: *estimate.r_ohm.get(k)?,
                r_crest_sigma_ohm: estimate.r_sigma_ohm.get(k).copied(),
                l_crest_h: *estimate.l_h.get(k)?,
                l_crest_sigma_h: estimate.l_sigma_h.get(k).copied(),
            })
        });
        Some(Self {
            r_mean_ohm: mean(&estimate.r_ohm),
            l_mean_h: mean(&estimate.l_h),
            crest: at,
        })
    }

    /// Cells of R and L: mean, value at the crest, σ there.
    fn cells(&self) -> [String; 6] {
        let shown = |value: Option<f64>, sigma: Option<f64>| match (value, sigma) {
            (Some(value), Some(sigma)) => WithSigma::new(value, sigma).texts(),
            (Some(value), None) => [format!("{value:.3}"), "–".into()],
            _ => ["–".into(), "–".into()],
        };
        let c = self.crest.as_ref();
        let micro = |x: f64| x * 1e6;
        let [r, r_sigma] = shown(
            c.map(|c| c.r_crest_ohm),
            c.and_then(|c| c.r_crest_sigma_ohm),
        );
        let (l_h, l_sigma_h) = (c.map(|c| c.l_crest_h), c.and_then(|c| c.l_crest_sigma_h));
        let [l, l_sigma] = shown(l_h.map(micro), l_sigma_h.map(micro));
        let mean = |x: f64| format!("{x:.3}");
        [
            mean(self.r_mean_ohm),
            r,
            r_sigma,
            mean(self.l_mean_h * 1e6),
            l,
            l_sigma,
        ]
    }
}

/// Table of a stretch's results.
pub fn stretch(
    segment: &Segment,
    outcomes: &[(&MethodResult, &Option<Accuracy>)],
    mains: &Mains,
) -> String {
    let truth = outcomes.iter().any(|(_, accuracy)| accuracy.is_some());
    let mut heading = vec![
        "method",
        "R Ω, mean",
        "at last crest",
        "± 1σ",
        "L µH, mean",
        "at last crest",
        "± 1σ",
    ];
    if truth {
        heading.extend(["MRE R %", "MRE L %"]);
    }
    heading.extend(["NMSE v %", "NMSE i %", "ms"]);
    let mut table = TextTable::new(&heading);
    for (outcome, accuracy) in outcomes {
        let (Ok(estimate), Some(printed)) = (&outcome.result, Printed::of(segment, outcome, mains))
        else {
            continue;
        };
        let pct = |x: Option<f64>| x.map_or("–".into(), |x| format!("{x:.3}"));
        let mut row = vec![outcome.method.name().to_owned()];
        row.extend(printed.cells());
        if truth {
            row.push(pct(accuracy.map(|a| a.whole.r_pct)));
            row.push(pct(accuracy.map(|a| a.whole.l_pct)));
        }
        row.push(pct(estimate.nmse_v_pct));
        row.push(pct(estimate.nmse_i_pct));
        row.push(format!("{:.1}", estimate.elapsed.as_secs_f64() * 1e3));
        table.row(row);
    }
    table.render()
}
