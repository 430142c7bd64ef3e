//! Quantities of a record that limits bound, by name.

use ihd_firmware::limits::BURST_POWER_W;

use super::record::{Record, TrueHalfCycle};

/// Reader of a word or a truth.
pub(super) type Word = fn(&Record) -> String;

/// Reader of numbers: none if the record lacks what they are about, NaN for what never happened.
pub(super) type Number = fn(&Record) -> Vec<f64>;

/// Reader of a mean over half-cycles; NaN without any.
pub(super) type Mean = fn(&[TrueHalfCycle]) -> f64;

/// Share of the largest power that a half-cycle of a burst exceeds; one with a look at the pot does not.
const OF_BURST: f64 = 0.35;

/// Longest half-cycle, in seconds: the end of a stretch that is known by the start of its last half-cycle.
const HALF_CYCLE_S: f64 = 0.01;

/// Quantities that are a word or a truth.
pub(super) const WORDS: [(&str, Word); 7] = [
    ("fault", |r| {
        r.faults.first().map_or("None", |f| &f.name).to_owned()
    }),
    ("latched", |r| r.summary.latched.to_string()),
    ("limit", |r| last(r, |h| &h.limit)),
    ("off_reason", |r| last(r, |h| &h.off_reason)),
    ("pot", |r| last(r, |h| &h.pot)),
    ("state", |r| last(r, |h| &h.state)),
    ("whole_cycles", |r| {
        r.bursts().iter().all(|n| n.is_multiple_of(2)).to_string()
    }),
];

/// Quantities that are numbers.
pub(super) const NUMBERS: [(&str, Number); 21] = [
    ("base_c", |r| r.hottest_c(|h| h.base_c)),
    ("burst_w", |r| {
        let least_w = r.burst_from_w();
        let on = r.half_cycles.iter().map(|h| h.power_w);
        let on: Vec<f64> = on.filter(|w| *w > least_w).collect();
        vec![on.iter().sum::<f64>() / on.len() as f64]
    }),
    ("contents_c", |r| r.hottest_c(|h| h.contents_c)),
    ("energy_j", |r| vec![r.summary.energy_j]),
    ("energy_per_start_j", |r| {
        vec![r.summary.energy_j / r.starts().len().max(1) as f64]
    }),
    ("error_pct", |r| vec![r.summary.error_pct]),
    ("fault_at_s", |r| {
        r.faults.first().map(|f| f.t_s).into_iter().collect()
    }),
    ("faults", |r| vec![r.faults.len() as f64]),
    ("hard_edges_start", |r| {
        let edges = r.half_cycles_with_start().filter(|(starts, _)| *starts);
        vec![
            edges
                .map(|(_, h)| h.hard_edges)
                .max()
                .map_or(0.0, f64::from),
        ]
    }),
    ("hard_edges_steady", |r| {
        let edges = r.half_cycles_with_start().filter(|(starts, _)| !starts);
        vec![f64::from(edges.map(|(_, h)| h.hard_edges).sum::<u32>())]
    }),
    ("i_peak_a", |r| vec![r.most(|h| h.i_peak_a)]),
    ("longest_on_s", |r| {
        let stretches = r.half_cycles.chunk_by(|a, b| a.bridge_on == b.bridge_on);
        let on = stretches.filter(|stretch| stretch[0].bridge_on);
        let length = |on: &[TrueHalfCycle]| on[on.len() - 1].t_s - on[0].t_s + HALF_CYCLE_S;
        vec![on.map(length).fold(0.0, f64::max)]
    }),
    ("off_after_s", |r| {
        r.faults
            .first()
            .map(|f| or_never(f.off_after_s))
            .into_iter()
            .collect()
    }),
    ("overshoot_pct", |r| vec![r.summary.overshoot_pct]),
    ("recovered_after_s", |r| {
        r.summary
            .recoveries
            .last()
            .map(|r| or_never(r.after_s))
            .into_iter()
            .collect()
    }),
    ("resettled_after_s", |r| {
        r.summary
            .steps
            .last()
            .map(|s| or_never(s.settled_after_s))
            .into_iter()
            .collect()
    }),
    // Bursts settle as a mean over seconds: power_share_at bounds them.
    ("settled_after_s", |r| {
        let whole = r
            .summary
            .steps
            .iter()
            .filter(|s| s.power_w >= f64::from(BURST_POWER_W));
        whole.map(|s| or_never(s.settled_after_s)).collect()
    }),
    ("start_every_s", |r| {
        r.starts()
            .windows(2)
            .map(|pair| pair[1] - pair[0])
            .collect()
    }),
    ("starts", |r| vec![r.starts().len() as f64]),
    ("v_coil_peak_v", |r| vec![r.most(|h| h.v_coil_peak_v)]),
    ("watchdog_bites", |r| {
        vec![f64::from(r.summary.watchdog_bites)]
    }),
];

/// Quantities that are means over a time.
pub(super) const MEANS: [(&str, Mean); 5] = [
    ("asked_w_at", |span| mean(span, |h| h.asked_w)),
    ("glass_hot_at", |span| {
        mean(span, |h| f64::from(u8::from(h.glass_hot)))
    }),
    ("on_share_at", |span| {
        mean(span, |h| f64::from(u8::from(h.bridge_on)))
    }),
    ("power_share_at", |span| {
        mean(span, |h| h.power_w) / mean(span, |h| h.asked_w)
    }),
    ("power_w_at", |span| mean(span, |h| h.power_w)),
];

fn last(record: &Record, of: fn(&TrueHalfCycle) -> &String) -> String {
    record
        .half_cycles
        .last()
        .map(of)
        .cloned()
        .unwrap_or_default()
}

fn or_never(time_s: Option<f64>) -> f64 {
    time_s.unwrap_or(f64::NAN)
}

fn mean(span: &[TrueHalfCycle], of: fn(&TrueHalfCycle) -> f64) -> f64 {
    span.iter().map(of).sum::<f64>() / span.len() as f64
}

impl Record {
    fn most(&self, of: fn(&TrueHalfCycle) -> f64) -> f64 {
        self.half_cycles.iter().map(of).fold(0.0, f64::max)
    }

    /// Highest of temperatures in °C; none where there are none.
    fn hottest_c(&self, of: fn(&TrueHalfCycle) -> Option<f64>) -> Vec<f64> {
        let all = self.half_cycles.iter().filter_map(of);
        all.reduce(f64::max).into_iter().collect()
    }

    /// Half-cycles, each with `true` if the bridge begins to switch in it.
    fn half_cycles_with_start(&self) -> impl Iterator<Item = (bool, &TrueHalfCycle)> {
        let before = self.half_cycles.iter().map(|h| h.bridge_on);
        let pairs = [false].into_iter().chain(before).zip(&self.half_cycles);
        pairs.map(|(was_on, h)| (!was_on && h.bridge_on, h))
    }

    /// Times at which the bridge began to switch, in seconds.
    fn starts(&self) -> Vec<f64> {
        let starts = self.half_cycles_with_start().filter(|(starts, _)| *starts);
        starts.map(|(_, h)| h.t_s).collect()
    }

    fn burst_from_w(&self) -> f64 {
        OF_BURST * self.most(|h| h.power_w)
    }

    /// Numbers of half-cycles of the bursts, without those at the record's ends, which may be cut.
    fn bursts(&self) -> Vec<usize> {
        let least_w = self.burst_from_w();
        let on = |h: &TrueHalfCycle| h.power_w > least_w;
        let all: Vec<_> = self.half_cycles.chunk_by(|a, b| on(a) == on(b)).collect();
        let inner = all.get(1..all.len().saturating_sub(1)).unwrap_or_default();
        let bursts = inner.iter().filter(|stretch| on(&stretch[0]));
        bursts.map(|stretch| stretch.len()).collect()
    }
}
