//! The limits of a scenario's file, and what a record is measured by: docs/control.md says what each name means.

use std::ops::RangeInclusive;

use anyhow::{Context, bail, ensure};
use serde::Deserialize;
use serde_json::Value as Json;
use toml::Value;

/// A half-cycle of the record, as far as limits look at it.
#[derive(Clone, Debug, Default, Deserialize)]
pub struct HalfCycle {
    t_s: f64,
    asked_w: f64,
    power_w: f64,
    state: String,
    pot: String,
    i_peak_a: f64,
    v_coil_peak_v: f64,
    hard_edges: u32,
    bridge_on: bool,
}

/// A fault of the record.
#[derive(Clone, Debug, Deserialize)]
pub struct Fault {
    t_s: f64,
    name: String,
    off_after_s: Option<f64>,
}

/// What `ihd scenario --json` prints.
#[derive(Clone, Debug, Deserialize)]
pub struct Record {
    half_cycles: Vec<HalfCycle>,
    faults: Vec<Fault>,
    summary: serde_json::Map<String, Json>,
}

/// A limit and what was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Checked {
    /// The limit's name.
    pub name: String,
    /// What is allowed.
    pub allowed: String,
    /// What was measured: numbers, or a word.
    pub measured: Measured,
    /// Whether it is within.
    pub ok: bool,
}

/// What a limit looks at.
#[derive(Clone, Debug, PartialEq)]
pub enum Measured {
    /// Numbers; NaN stands for what never came.
    Numbers(Vec<f64>),
    /// A word or a truth.
    Word(String),
}

/// A half-cycle of less than this share of the largest power is none of a burst: a look at the pot, say.
const OF_BURST: f64 = 0.35;

/// Steps to less, in watt, may be given in bursts (firmware/src/limits.rs, BURST_POWER_W).
const BURST_BELOW_W: f64 = 720.0;

/// A half-cycle at most, in seconds, for what ends with it.
const HALF_CYCLE_S: f64 = 0.01;

/// Checks every limit of a file's `[limits]`.
///
/// # Errors
/// A name or a form that is no limit's.
pub fn check(limits: &toml::Table, record: &Record) -> anyhow::Result<Vec<Checked>> {
    let one = |(name, allowed): (&String, &Value)| {
        check_one(name, allowed, record).with_context(|| format!("limit {name} = {allowed}"))
    };
    limits.iter().map(one).collect()
}

fn check_one(name: &str, allowed: &Value, record: &Record) -> anyhow::Result<Checked> {
    let (measured, ok) = match allowed {
        Value::Boolean(_) | Value::String(_) => {
            let word = record.word(name)?;
            let wanted = match allowed {
                Value::String(wanted) => wanted.clone(),
                other => other.to_string(),
            };
            let ok = wanted.split('|').any(|one| one == word);
            (Measured::Word(word), ok)
        }
        Value::Array(list) if list.first().is_some_and(Value::is_array) => {
            let rows: Vec<Vec<f64>> = list.iter().map(numbers).collect::<Result<_, _>>()?;
            record.spans(name, &rows)?
        }
        Value::Array(_) => {
            let range = range(&numbers(allowed)?)?;
            let measured = record.numbers(name)?;
            // A limit on nothing says nothing.
            let ok = !measured.is_empty() && measured.iter().all(|value| range.contains(value));
            (Measured::Numbers(measured), ok)
        }
        _ => bail!("give [least, most], a word or a truth"),
    };
    Ok(Checked {
        name: name.to_owned(),
        allowed: allowed.to_string(),
        measured,
        ok,
    })
}

fn numbers(list: &Value) -> anyhow::Result<Vec<f64>> {
    let number = |value: &Value| match value {
        Value::Float(x) => Ok(*x),
        Value::Integer(x) => Ok(*x as f64),
        other => bail!("{other} is no number"),
    };
    let list = list.as_array().context("give a list")?;
    list.iter().map(number).collect()
}

fn range(list: &[f64]) -> anyhow::Result<RangeInclusive<f64>> {
    match list {
        [least, most] => Ok(*least..=*most),
        _ => bail!("give [least, most]"),
    }
}

impl Record {
    fn word(&self, name: &str) -> anyhow::Result<String> {
        let last = self.half_cycles.last().cloned().unwrap_or_default();
        let first = self.faults.first().map_or("None", |fault| &fault.name);
        Ok(match name {
            "latched" => self.summary["latched"].to_string(),
            "fault" => first.to_owned(),
            "state" => last.state,
            "pot" => last.pot,
            "whole_cycles" => self.stretches().iter().all(|n| n % 2 == 0).to_string(),
            _ => bail!("unknown: words are for latched, fault, state, pot and whole_cycles"),
        })
    }

    fn numbers(&self, name: &str) -> anyhow::Result<Vec<f64>> {
        let number = |value: &Json| value.as_f64().unwrap_or(f64::NAN);
        let most =
            |of: fn(&HalfCycle) -> f64| vec![self.half_cycles.iter().map(of).fold(0.0, f64::max)];
        Ok(match name {
            "overshoot_pct" | "error_pct" | "energy_j" | "watchdog_bites" => {
                vec![number(&self.summary[name])]
            }
            // Bursts settle as a mean over seconds: power_share_at looks at them.
            "settled_after_s" => {
                let steps = self.summary["steps"].as_array().context("no list")?;
                let whole = |step: &&Json| number(&step["power_w"]) >= BURST_BELOW_W;
                steps
                    .iter()
                    .filter(whole)
                    .map(|s| number(&s[name]))
                    .collect()
            }
            "resettled_after_s" => {
                let steps = self.summary["steps"].as_array().context("no list")?;
                let last = steps.last().map(|s| number(&s["settled_after_s"]));
                last.into_iter().collect()
            }
            "longest_on_s" => {
                let on = self.half_cycles.chunk_by(|a, b| a.bridge_on == b.bridge_on);
                let length = |stretch: &[HalfCycle]| match stretch {
                    [first, .., last] if first.bridge_on => last.t_s - first.t_s + HALF_CYCLE_S,
                    [only] if only.bridge_on => HALF_CYCLE_S,
                    _ => 0.0,
                };
                vec![on.map(length).fold(0.0, f64::max)]
            }
            "fault_at_s" => self.faults.first().map(|f| f.t_s).into_iter().collect(),
            "recovered_after_s" => {
                let list = self.summary["recoveries"].as_array().context("no list")?;
                list.last()
                    .map(|r| number(&r["after_s"]))
                    .into_iter()
                    .collect()
            }
            "faults" => vec![self.faults.len() as f64],
            "off_after_s" => {
                let first = self.faults.first();
                first
                    .map(|f| f.off_after_s.unwrap_or(f64::NAN))
                    .into_iter()
                    .collect()
            }
            "i_peak_a" => most(|h| h.i_peak_a),
            "v_coil_peak_v" => most(|h| h.v_coil_peak_v),
            "hard_edges_steady" => vec![self.hard_edges(false)],
            "hard_edges_start" => vec![self.hard_edges(true)],
            "starts" => vec![self.starts().count() as f64],
            "energy_per_start_j" => {
                let energy_j = number(&self.summary["energy_j"]);
                vec![energy_j / self.starts().count().max(1) as f64]
            }
            "start_every_s" => {
                let times: Vec<f64> = self.starts().collect();
                times.windows(2).map(|pair| pair[1] - pair[0]).collect()
            }
            "burst_w" => {
                let least_w = self.burst_from_w();
                let on = self.half_cycles.iter().filter(|h| h.power_w > least_w);
                let (mut sum_w, mut n) = (0.0, 0.0);
                on.for_each(|h| (sum_w, n) = (sum_w + h.power_w, n + 1.0));
                vec![sum_w / n]
            }
            _ => bail!("unknown"),
        })
    }

    /// Limits that hold over times: rows of from, to in seconds, least, most.
    fn spans(&self, name: &str, rows: &[Vec<f64>]) -> anyhow::Result<(Measured, bool)> {
        let (mut all, mut ok) = (Vec::new(), true);
        for row in rows {
            let [from_s, to_s, least, most] = row[..] else {
                bail!("give rows of [from, to, least, most]");
            };
            let span: Vec<_> = self
                .half_cycles
                .iter()
                .filter(|h| (from_s..to_s).contains(&h.t_s))
                .collect();
            ensure!(!span.is_empty(), "no half-cycle from {from_s} to {to_s} s");
            let mean = |of: fn(&HalfCycle) -> f64| {
                span.iter().map(|h| of(h)).sum::<f64>() / span.len() as f64
            };
            let measured = match name {
                "power_w_at" => mean(|h| h.power_w),
                "power_share_at" => mean(|h| h.power_w) / mean(|h| h.asked_w),
                "asked_w_at" => mean(|h| h.asked_w),
                "on_share_at" => mean(|h| f64::from(u8::from(h.bridge_on))),
                _ => bail!(
                    "unknown: rows are for power_w_at, power_share_at, asked_w_at and on_share_at"
                ),
            };
            ok &= (least..=most).contains(&measured);
            all.push(measured);
        }
        Ok((Measured::Numbers(all), ok))
    }

    /// Times at which the bridge began to switch, in seconds.
    fn starts(&self) -> impl Iterator<Item = f64> {
        let before = [false]
            .into_iter()
            .chain(self.half_cycles.iter().map(|h| h.bridge_on));
        let pairs = before.zip(&self.half_cycles);
        pairs
            .filter(|(was, h)| !was && h.bridge_on)
            .map(|(_, h)| h.t_s)
    }

    /// Hard edges: the most of any half-cycle in which the bridge begins to switch, or the sum of all others.
    fn hard_edges(&self, start: bool) -> f64 {
        let before = [false]
            .into_iter()
            .chain(self.half_cycles.iter().map(|h| h.bridge_on));
        let pairs = before.zip(&self.half_cycles);
        let edges = pairs
            .filter(|(was, _)| *was != start)
            .map(|(_, h)| h.hard_edges);
        f64::from(if start {
            edges.max().unwrap_or(0)
        } else {
            edges.sum()
        })
    }

    fn burst_from_w(&self) -> f64 {
        OF_BURST
            * self
                .half_cycles
                .iter()
                .map(|h| h.power_w)
                .fold(0.0, f64::max)
    }

    /// Lengths of the stretches of half-cycles with power, those at the record's ends left out.
    fn stretches(&self) -> Vec<usize> {
        let least_w = self.burst_from_w();
        let all: Vec<_> = self
            .half_cycles
            .chunk_by(|a, b| (a.power_w > least_w) == (b.power_w > least_w))
            .collect();
        let inner = all.get(1..all.len().saturating_sub(1)).unwrap_or_default();
        let on = inner.iter().filter(|stretch| stretch[0].power_w > least_w);
        on.map(|stretch| stretch.len()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two stretches of power, of two and of one half-cycle; the second begins hard.
    fn record() -> Record {
        let half_cycle = |(n, power_w): (usize, f64)| HalfCycle {
            t_s: n as f64 * 0.01,
            asked_w: 1000.0,
            power_w,
            state: "Heating".to_owned(),
            hard_edges: u32::from(n == 4) * 2 + u32::from(n == 2),
            bridge_on: power_w > 0.0,
            ..HalfCycle::default()
        };
        let powers = [0.0, 950.0, 1050.0, 0.0, 900.0, 0.0];
        Record {
            half_cycles: powers.into_iter().enumerate().map(half_cycle).collect(),
            faults: Vec::new(),
            summary: serde_json::from_str(
                r#"{"latched": false, "energy_j": 29.0,
                    "steps": [{"power_w": 1000, "settled_after_s": null}]}"#,
            )
            .unwrap(),
        }
    }

    fn ok(limit: &str) -> bool {
        let limits: toml::Table = toml::from_str(limit).unwrap();
        check(&limits, &record()).unwrap()[0].ok
    }

    #[test]
    fn each_limit_is_two_sided() {
        for (inside, outside) in [
            ("latched = false", "latched = true"),
            ("fault = \"None\"", "fault = \"NoPot\""),
            ("state = \"Idle|Heating\"", "state = \"Idle\""),
            ("starts = [2, 2]", "starts = [0, 1]"),
            ("hard_edges_steady = [1, 1]", "hard_edges_steady = [0, 0]"),
            ("hard_edges_start = [0, 2]", "hard_edges_start = [0, 1]"),
            (
                "energy_per_start_j = [14, 15]",
                "energy_per_start_j = [0, 14]",
            ),
            ("burst_w = [960, 970]", "burst_w = [0, 960]"),
            (
                "power_w_at = [[0.01, 0.03, 999, 1001]]",
                "power_w_at = [[0.0, 0.03, 999, 1001]]",
            ),
            (
                "power_share_at = [[0.01, 0.03, 0.99, 1.01]]",
                "power_share_at = [[0.01, 0.03, 1.1, 2]]",
            ),
            (
                "start_every_s = [0.02, 0.04]",
                "start_every_s = [0.0, 0.02]",
            ),
        ] {
            assert!(ok(inside), "{inside}");
            assert!(!ok(outside), "{outside}");
        }
    }

    #[test]
    fn what_never_came_is_outside_and_an_odd_stretch_is_no_whole_cycle() {
        assert!(!ok("settled_after_s = [0.0, 10.0]"));
        assert!(!ok("off_after_s = [0.0, 1.0]"), "no fault, no time");
        assert!(ok("whole_cycles = false"));
    }

    #[test]
    fn an_unknown_limit_is_refused() {
        let limits = toml::from_str("overshot_pct = [0, 1]").unwrap();
        let why = format!("{:#}", check(&limits, &record()).unwrap_err());
        assert!(
            why.contains("overshot_pct") && why.contains("unknown"),
            "{why}"
        );
    }
}
