//! `ihd store ls`: results, or one of them with its window.

use anyhow::{Result, bail};
use clap::Args;
use ihd_store::clock::rfc3339;
use ihd_store::{ResultFilter, ResultId, ResultRow, WindowFilter};
use serde_json::{Value, json};

use super::super::output;
use super::place::{StorePlace, time};

/// List results, newest first; or show one with its window and its connection.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd store ls\n  \
    ihd store ls --device bench --since 2026-11-22 --json\n  \
    ihd store ls 4711 --json")]
pub struct LsArgs {
    /// The one result of this number
    #[arg(value_name = "ID", conflicts_with_all = ["device", "since", "limit"])]
    id: Option<ResultId>,
    /// Those of this device alone
    #[arg(long, value_name = "NAME")]
    device: Option<String>,
    /// Those stored from this day (UTC) or time on
    #[arg(long, value_name = "WHEN", value_parser = time)]
    since: Option<i64>,
    /// At most so many; 0 for all
    #[arg(long, value_name = "N", default_value_t = 100)]
    limit: u32,
}

impl LsArgs {
    pub fn run(&self, place: &StorePlace, json: bool) -> Result<()> {
        if let Some(id) = self.id {
            return show(id, place, json);
        }
        let filter = ResultFilter {
            device: self.device.clone(),
            since_ms: self.since,
            limit: Some(match self.limit {
                0 => u32::MAX,
                limit => limit,
            }),
        };
        let rows = place.read_of(self.device.as_deref())?.results(&filter)?;
        if json {
            let entries: Vec<Value> = rows.iter().map(entry).collect();
            return output::json(&entries);
        }
        if rows.is_empty() {
            return say!("no results in {}", place.folder.display());
        }
        say!(
            "    id  at                        device              boot     seq  kHz     A      R/ohm   L/µH    verdict"
        )?;
        for row in &rows {
            let line = format!(
                "{:6}  {}  {:12}  {:10}  {:6}  {:6.2}  {:5.1}  {:6.3}  {:6.2}  {}",
                row.id,
                rfc3339(row.at_ms),
                row.device,
                row.boot,
                row.seq,
                f64::from(row.f_sw_hz) * 1e-3,
                row.i_crest_a,
                row.r_ohm,
                row.l_h * 1e6,
                in_words(row),
            );
            say!("{line}")?;
        }
        Ok(())
    }
}

fn verdict(row: &ResultRow) -> &'static str {
    if row.pass { "pass" } else { "refused" }
}

fn in_words(row: &ResultRow) -> String {
    match (row.why.as_str(), row.changed_lookup) {
        ("", true) => format!("{}, changed the lookup", verdict(row)),
        ("", false) => verdict(row).to_owned(),
        (why, _) => format!("{}: {why}", verdict(row)),
    }
}

/// A result as JSON; numbers that are not finite become null.
fn entry(row: &ResultRow) -> Value {
    json!({
        "id": row.id,
        "device": row.device,
        "boot": row.boot,
        "seq": row.seq,
        "session": row.session,
        "half_cycle": row.half_cycle,
        "at": rfc3339(row.at_ms),
        "f_sw_hz": row.f_sw_hz,
        "i_crest_a": row.i_crest_a,
        "power_w": row.power_w,
        "r_ohm": row.r_ohm,
        "l_h": row.l_h,
        "sigma_r_pct": row.sigma_r_pct,
        "sigma_l_pct": row.sigma_l_pct,
        "verdict": verdict(row),
        "why": row.why,
        "changed_lookup": row.changed_lookup,
        "iterations": row.iterations,
    })
}

/// Shows a result, its window and its connection.
fn show(id: ResultId, place: &StorePlace, json: bool) -> Result<()> {
    let reader = place.read()?;
    let Some(row) = reader.result(id)? else {
        bail!("there is no result {id}; `ihd store ls` lists them");
    };
    let session = reader.session(row.session)?;
    let of_window = WindowFilter {
        device: Some(row.device.clone()),
        since_ms: None,
        boot: Some(row.boot),
        seq: Some(row.seq),
    };
    let window = reader.windows(&of_window)?.into_iter().next();
    if json {
        let mut whole = entry(&row);
        whole["window"] = serde_json::to_value(&window)?;
        whole["connection"] = serde_json::to_value(&session)?;
        return output::json(&whole);
    }
    say!("result      {}, {}", row.id, rfc3339(row.at_ms))?;
    say!("device      {}, boot {}", row.device, row.boot)?;
    if let Some(session) = session {
        say!("firmware    {} on {}", session.build, session.board)?;
    }
    say!("window      {}, half-cycle {}", row.seq, row.half_cycle)?;
    say!(
        "samples     {}",
        match window {
            None => "deleted with their day".to_owned(),
            Some(window) => match window.not_kept {
                None => format!("{} pairs in {} bytes", window.pairs, window.packed_bytes),
                Some(why) => format!("not kept: {why}"),
            },
        }
    )?;
    say!(
        "drive       {:.3} kHz, {:.2} A",
        f64::from(row.f_sw_hz) * 1e-3,
        row.i_crest_a
    )?;
    if let Some(power_w) = row.power_w {
        say!("power       {power_w:.1} W")?;
    }
    say!(
        "R           {:.4} ohm ± {:.3} %",
        row.r_ohm,
        row.sigma_r_pct
    )?;
    say!(
        "L           {:.3} µH ± {:.3} %",
        row.l_h * 1e6,
        row.sigma_l_pct
    )?;
    say!(
        "verdict     {}, after {} iterations",
        in_words(&row),
        row.iterations
    )
}
