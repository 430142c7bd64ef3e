//! `ihd-study hostile`.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::Args;
use ihd::ensure_usage;
use serde::Serialize;

use crate::hostile::table::{self, HostileSums};
use crate::hostile::{HostilePlan, HostileRun, study};
use ihd::cli::identify::MethodWord;

/// Estimators of a run without `--method`.
const DEFAULT: &str = "least-squares,pinn,lockin,firmware,kf";

/// Try to fool the identification: sound and faulty captures, and whether what is wrong was said.
///
/// Every capture goes the way of `ihd identify`, without hints. Ends with 1 where a result is wrong without a word, or
/// more than 2 % of the right results of sound captures are refused.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd-study hostile --short\n  \
    ihd-study hostile --only skew --method least-squares --seeds 1\n  \
    ihd-study hostile --docs docs/identification.md")]
pub struct HostileArgs {
    /// Estimators, with commas between them, or all
    #[arg(
        long,
        short,
        alias = "methods",
        value_name = "NAME,…",
        value_delimiter = ',',
        default_value = DEFAULT
    )]
    method: Vec<MethodWord>,
    /// Seeds of the noise [default: 3, and 1 in the short form]
    #[arg(long)]
    seeds: Option<u64>,
    /// Only captures whose name contains this
    #[arg(long, value_name = "TEXT")]
    only: Option<String>,
    /// Some twenty captures
    #[arg(long)]
    short: bool,
    /// Print the runs as JSON
    #[arg(long)]
    json: bool,
    /// Write the tables into this document, between its marks
    #[arg(long, value_name = "FILE")]
    docs: Option<PathBuf>,
}

/// Results as JSON.
#[derive(Serialize)]
struct Answer<'a> {
    sum: HostileSums,
    met: bool,
    runs: &'a [HostileRun],
}

impl HostileArgs {
    /// Runs the study.
    pub fn run(&self) -> Result<()> {
        let plan = HostilePlan {
            methods: MethodWord::chosen(&self.method),
            seeds: self.seeds.unwrap_or(if self.short { 1 } else { 3 }),
            only: self.only.clone(),
            short: self.short,
        };
        ensure_usage!(plan.seeds > 0, "--seeds is 0: give one at least");
        ensure_usage!(!plan.cases().is_empty(), "no capture has that in its name");
        let runs = super::with_bar("captures", |progress| study(&plan, progress))??;
        let section = table::markdown(&runs, plan.seeds);
        let sum = HostileSums::summarise(&runs);
        let results = self.json.then(|| Answer {
            sum,
            met: sum.is_met(),
            runs: &runs,
        });
        let marks = (table::BEGIN, table::END);
        super::publish(&section, self.docs.as_deref(), marks, results.as_ref())?;
        if sum.is_met() {
            return Ok(());
        }
        bail!(
            "goals missed: {} of {} results are wrong without a word (0), {:.1} % of the right ones of sound captures are \
             refused (at most {} %)",
            sum.silent,
            sum.runs,
            sum.false_refusals_pct(),
            table::FALSE_REFUSALS_PCT
        )
    }
}
