//! `ihd-study map`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use ihd::ensure_usage;
use ihd_shared::hob::RATED_POWER_W;
use ihd_sim::perturbation::Perturbation;
use ihd_sim::pot::SimulatedPot;
use ihd_sim::recording::settings::LoadKind;
use serde::Serialize;

use crate::map::places::{POTS, PotPlacement};
use crate::map::{MapPlan, MapRun, figure, study, table};
use ihd::cli::simulate::LoadWord;
use ihd::cli::usage::Usage;

/// Judge the map: how far the cells of a lookup are from the truth that a pot has there, taught at a few powers.
///
/// Cells are judged where the hob comes with that pot; what it does not heat has none. The truth of the field model
/// comes from its waveform, cell by cell.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd-study map --pot ferritic-18,ferritic-12\n  \
    ihd-study map --load field --seeds 1 --figure map.svg\n  \
    ihd-study map --pot ferritic-18 --perturb tail,sharp-knee,wall --json\n  \
    ihd-study map --closed-loop --pot ferritic-18+lift-10mm")]
pub struct MapArgs {
    /// Pots, with commas between them, as `ihd hob` names them; a place behind: +lift-10mm, +offset-30mm, +150C
    #[arg(long, value_name = "POT,…", value_delimiter = ',', default_values = POTS)]
    pot: Vec<PotPlacement>,
    /// Load model; field takes minutes
    #[arg(long, value_name = "MODEL", default_value = "reduced")]
    load: LoadWord,
    /// Powers in watt at which the pots are shown
    #[arg(
        long,
        value_name = "W,W,…",
        value_delimiter = ',',
        default_value = "700,1200,2000"
    )]
    power: Vec<u16>,
    /// Let the loads depart from the standard field model, each by one of these in turn: tail, sharp-knee, rings, fine-gap, ferrite,
    /// wall or coil-gap
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    perturb: Vec<Perturbation>,
    /// Noise on both channels as a signal-to-noise ratio in decibel at the rated power
    #[arg(long, value_name = "DB", default_value_t = 40.0)]
    snr: f64,
    /// Seeds of the noise
    #[arg(long, default_value_t = 3)]
    seeds: u64,
    /// Ask the simulated hob for its windows, as `ihd trainer` does; without it the half-cycles are simulated alone
    #[arg(long)]
    closed_loop: bool,
    /// Print the lines and every cell as JSON
    #[arg(long)]
    json: bool,
    /// Draw the errors of the first two pots into this file
    #[arg(long, value_name = "FILE")]
    figure: Option<PathBuf>,
    /// Write the tables into this document, between its marks
    #[arg(long, value_name = "FILE")]
    docs: Option<PathBuf>,
}

/// Results as JSON.
#[derive(Serialize)]
struct Answer<'a> {
    lines: Vec<table::MapLine>,
    runs: &'a [MapRun],
}

impl MapArgs {
    /// Runs the study.
    pub fn run(&self) -> Result<()> {
        let plan = self.plan()?;
        let runs = super::with_bar("pots", |progress| study(&plan, progress))??;
        let section = table::markdown(&plan, &runs);
        if let Some(path) = &self.figure {
            figure::draw(path, &runs)?;
        }
        let results = self.json.then(|| Answer {
            lines: table::lines(&runs),
            runs: &runs,
        });
        let marks = (table::BEGIN, table::END);
        super::publish(&section, self.docs.as_deref(), marks, results.as_ref())
    }

    fn plan(&self) -> Result<MapPlan> {
        ensure_usage!(self.seeds > 0, "--seeds is 0: give one at least");
        ensure_usage!(
            !self.power.is_empty(),
            "--power is empty: give one at least"
        );
        for power_w in &self.power {
            ensure_usage!(
                (1..=RATED_POWER_W).contains(power_w),
                "--power holds {power_w} W, but the hob takes 1 to {RATED_POWER_W} W"
            );
        }
        ensure_usage!(
            (10.0..=200.0).contains(&self.snr),
            "--snr is {} dB, but must lie between 10 and 200",
            self.snr
        );
        let load = LoadKind::from(self.load);
        for placed in &self.pot {
            let pot = placed.pot;
            let moved = pot.lift_m != 0.0
                || pot.offset_m != 0.0
                || pot.temperature_c != SimulatedPot::NONE.temperature_c;
            ensure_usage!(
                load != LoadKind::Behavioural || !moved,
                "--load behavioural is a formula that knows no {}: choose pots with --pot, or use --load reduced or field",
                placed.name
            );
            pot.field_settings(0.0).map_err(Usage::from_error)?;
        }
        let perturbed = |p| self.perturb.contains(&p);
        ensure_usage!(
            self.perturb.is_empty() || load != LoadKind::Behavioural,
            "--load behavioural is a formula: use --load reduced or field with --perturb"
        );
        ensure_usage!(
            load != LoadKind::Field || !perturbed(Perturbation::Rings),
            "--perturb rings goes with --load reduced: the rings of the time domain are compiled in"
        );
        let perturbations = match self.perturb.as_slice() {
            [] => vec![None],
            some => some.iter().copied().map(Some).collect(),
        };
        Ok(MapPlan {
            pots: self.pot.clone(),
            powers_w: self.power.clone(),
            load,
            perturbations,
            seeds: self.seeds,
            snr_db: self.snr,
            closed_loop: self.closed_loop,
        })
    }
}
