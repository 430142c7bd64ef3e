//! `ihd-study pots`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use ihd::ensure_usage;
use ihd_sim::perturbation::Perturbation;
use ihd_sim::recording::settings::LoadKind;
use serde::Serialize;

use crate::map::places::PotPlacement;
use crate::pots::{PotsPlan, PotsRun, study, table};
use ihd::cli::simulate::LoadWord;
use ihd::cli::usage::Usage;

/// Pots of the second hob.
const POTS: [&str; 8] = [
    "ferritic-21",
    "ferritic-18",
    "ferritic-15",
    "ferritic-12",
    "cast-iron-21",
    "cast-iron-16",
    "ferritic-18+offset-20mm",
    "ferritic-18+120C",
];

/// Pots that the first hob knows in addition.
const OTHERS: [&str; 20] = [
    "ferritic-22",
    "ferritic-21",
    "ferritic-20",
    "ferritic-19",
    "ferritic-18",
    "ferritic-17",
    "ferritic-16",
    "ferritic-15",
    "ferritic-14",
    "ferritic-13",
    "ferritic-12",
    "ferritic-11",
    "ferritic-10",
    "cast-iron-22",
    "cast-iron-21",
    "cast-iron-20",
    "cast-iron-18",
    "cast-iron-16",
    "cast-iron-14",
    "cast-iron-12",
];

/// Judge what a library of pots is worth: how far a map is off after its first window, and how many it needs, with and without
/// what another hob knows of the pot; and what a library that is wrong does.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd-study pots --pot ferritic-18,ferritic-12\n  \
    ihd-study pots --perturb tail,sharp-knee --seeds 1\n  \
    ihd-study pots --docs docs/map.md")]
pub struct PotsArgs {
    /// Pots, with commas between them, as `ihd hob` names them; a place behind: +lift-10mm, +offset-30mm, +150C
    #[arg(long, value_name = "POT,…", value_delimiter = ',', default_values = POTS)]
    pot: Vec<PotPlacement>,
    /// Pots that the first hob knows in addition
    #[arg(long, value_name = "POT,…", value_delimiter = ',', default_values = OTHERS)]
    others: Vec<PotPlacement>,
    /// Load model; field takes minutes
    #[arg(long, value_name = "MODEL", default_value = "reduced")]
    load: LoadWord,
    /// Let the pots depart from the standard field model on both hobs, each by one of these in turn, beside the standard one: tail,
    /// sharp-knee, rings, fine-gap, ferrite, wall or coil-gap
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    perturb: Vec<Perturbation>,
    /// Seeds of the noise
    #[arg(long, default_value_t = 2)]
    seeds: u64,
    /// Print the lines and every run as JSON
    #[arg(long)]
    json: bool,
    /// Write the tables into this document, between its marks
    #[arg(long, value_name = "FILE")]
    docs: Option<PathBuf>,
}

/// Results as JSON.
#[derive(Serialize)]
struct Answer<'a> {
    summary: Vec<table::PotsLine>,
    by_pot: Vec<table::PotsLine>,
    runs: &'a [PotsRun],
}

impl PotsArgs {
    /// Runs the study.
    pub fn run(&self) -> Result<()> {
        let plan = self.plan()?;
        let runs = super::with_bar("pots", |progress| study(&plan, progress))??;
        let section = table::markdown(&plan, &runs);
        let results = self.json.then(|| Answer {
            summary: table::summary(&plan, &runs),
            by_pot: table::by_pot(&plan, &runs),
            runs: &runs,
        });
        let marks = (table::BEGIN, table::END);
        super::publish(&section, self.docs.as_deref(), marks, results.as_ref())
    }

    fn plan(&self) -> Result<PotsPlan> {
        ensure_usage!(self.seeds > 0, "--seeds is 0: give one at least");
        let load = LoadKind::from(self.load);
        ensure_usage!(
            load != LoadKind::Behavioural,
            "--load behavioural is a formula that knows no lift: use --load reduced or field"
        );
        ensure_usage!(
            load != LoadKind::Field || !self.perturb.contains(&Perturbation::Rings),
            "--perturb rings goes with --load reduced: the rings of the time domain are compiled in"
        );
        for placed in self.pot.iter().chain(&self.others) {
            placed.pot.field_settings(0.0).map_err(Usage::from_error)?;
        }
        let mut perturbations = vec![None];
        perturbations.extend(self.perturb.iter().copied().map(Some));
        Ok(PotsPlan {
            pots: self.pot.clone(),
            perturbations,
            others: self.others.clone(),
            load,
            seeds: self.seeds,
        })
    }
}
