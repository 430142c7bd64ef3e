//! `ihd-study estimators`.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use ihd::ensure_usage;

use crate::document::write_into;
use crate::estimators::{EstimatorsPlan, study, table};
use ihd::cli::identify::MethodWord;
use ihd::cli::output;

/// Compare every estimator on simulated captures with truth: four switching frequencies, no noise and
/// 70, 50 and 30 dB.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd-study estimators --quick\n  \
    ihd-study estimators --seeds 10 --out study --docs docs/accuracy.md\n  \
    ihd-study estimators --quick --json --method lockin,least-squares")]
pub struct EstimatorsArgs {
    /// Estimators, with commas between them, or all
    #[arg(
        long,
        short,
        value_name = "NAME,…",
        value_delimiter = ',',
        default_value = "all"
    )]
    method: Vec<MethodWord>,
    /// Seeds of the noise
    #[arg(long, default_value_t = 10)]
    seeds: u64,
    /// Two seeds, and the behavioural reference load alone
    #[arg(long)]
    quick: bool,
    /// Print the cells as JSON
    #[arg(long)]
    json: bool,
    /// Write estimators.md and estimators.json into this folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write the tables into this document, between its marks
    #[arg(long, value_name = "FILE")]
    docs: Option<PathBuf>,
}

impl EstimatorsArgs {
    /// Runs the study.
    pub fn run(&self) -> Result<()> {
        ensure_usage!(self.seeds > 0, "--seeds is 0: give one at least");
        let plan = EstimatorsPlan {
            methods: MethodWord::chosen(&self.method),
            seeds: if self.quick { 2 } else { self.seeds },
            field: !self.quick,
        };
        let cells = super::with_bar("captures", |progress| study(&plan, progress))??;
        let section = table::markdown(&cells, plan.seeds);
        let json = serde_json::to_string_pretty(&cells)?;
        if let Some(folder) = &self.out {
            let cannot = || format!("cannot write into {}", folder.display());
            std::fs::create_dir_all(folder).with_context(cannot)?;
            std::fs::write(folder.join("estimators.md"), &section).with_context(cannot)?;
            std::fs::write(folder.join("estimators.json"), &json).with_context(cannot)?;
        }
        if let Some(path) = &self.docs {
            write_into(path, table::OVERVIEW_MARKS, &table::overview(&cells))?;
            write_into(path, table::MARKS, &section)?;
        }
        if self.json {
            output::json(&cells)
        } else {
            output::text(&format!("{section}\n"))
        }
    }
}
