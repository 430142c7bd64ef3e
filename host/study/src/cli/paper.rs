//! `ihd-study paper`.

use std::fmt::{self, Display, Formatter};
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Context, Result};
use clap::Args;
use ihd::{ensure_usage, say};
use ihd_identify::Method;
use ihd_pinn::{Backend, PresetLibrary};
use ihd_sim::recording::settings::LoadKind;
use indicatif::{ProgressBar, ProgressStyle};

use crate::estimators::{F_SW_HZ, SNR_DB};
use crate::paper::{Contender, PaperJob, publish, study};
use ihd::cli::output;
use ihd::cli::simulate::LoadWord;

/// Presets of a study without `--preset`.
const DEFAULT_PRESETS: [&str; 5] = [
    "hybrid",
    "hybrid-waveform",
    "paper-literal",
    "literal-scaled",
    "paper-repaired",
];

/// Epochs of the paper's presets with `--quick`.
const QUICK_EPOCHS: usize = 100;

/// Contender with what the command line changes of its preset.
struct Entrant {
    contender: Contender,
    /// Limit of epochs; `None` for the preset's own number.
    epochs: Option<usize>,
    /// `None` for the preset's own.
    backend: Option<Backend>,
}

/// Signal-to-noise ratio in decibel, or none.
#[derive(Clone, Copy, Debug)]
struct SnrWord(Option<f64>);

impl FromStr for SnrWord {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        if word == "none" {
            return Ok(Self(None));
        }
        let db: f64 = word
            .parse()
            .map_err(|_| format!("{word} is neither a number of decibel nor none"))?;
        if (0.0..=120.0).contains(&db) {
            Ok(Self(Some(db)))
        } else {
            Err(format!("{db} dB is not within 0 to 120"))
        }
    }
}

impl Display for SnrWord {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some(db) => write!(f, "{db}"),
            None => f.write_str("none"),
        }
    }
}

/// The paper's Tables 1 to 3 with the PINN's presets, least squares, the EKF and the lock-in, on the
/// behavioural reference load and on the field model; report.md, cells.json and figures.
///
/// Every finished cell is a file in the folder, every training a checkpoint: run the same build again with the
/// same --out and it goes on.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd-study paper --quick\n  \
    ihd-study paper --out study --seeds 3 --preset hybrid,paper-repaired\n  \
    ihd-study paper --out study --preset hybrid-fractional --load field --khz 45 --snr none,30\n  \
    ihd-study paper --out study --epochs 500 --json\n  \
    ihd-study paper --out study --presets my-presets --preset mine,hybrid\n\n\
    A preset of your own is a TOML file as for ihd trainer --config: `preset` names the one that it\n\
    changes, `description` is for the report. Its name is the file's, without .toml.")]
pub struct PaperArgs {
    #[arg(
        long,
        value_name = "NAME,…",
        value_delimiter = ',',
        help = preset_help()
    )]
    preset: Vec<String>,
    /// Folder with presets of your own, *.toml
    #[arg(long, value_name = "DIR")]
    presets: Option<PathBuf>,
    /// Loads, with commas between them: behavioural is the reference load, where v = R i + L di/dt
    /// holds
    #[arg(
        long,
        value_enum,
        value_name = "LOAD,…",
        value_delimiter = ',',
        default_value = "behavioural,field"
    )]
    load: Vec<LoadWord>,
    /// Switching frequencies in kilohertz, with commas between them
    #[arg(
        long,
        value_name = "KHZ,…",
        value_delimiter = ',',
        default_values_t = F_SW_HZ.map(|f| f / 1e3)
    )]
    khz: Vec<f64>,
    /// Signal-to-noise ratios in decibel, with commas between them; none is without noise
    #[arg(
        long,
        value_name = "DB,…",
        value_delimiter = ',',
        default_values_t = SNR_DB.map(SnrWord)
    )]
    snr: Vec<SnrWord>,
    /// Seeds of noise and networks
    #[arg(long, default_value_t = 3)]
    seeds: u64,
    /// Most epochs of the presets with a VI-MLP; 5000 as the paper's if not given
    #[arg(long)]
    epochs: Option<usize>,
    /// Backend of the presets with a VI-MLP in place of their own: fused, ndarray, and in a build with
    /// this feature wgpu, a GPU
    #[arg(long, value_name = "NAME")]
    backend: Option<Backend>,
    /// One seed, the behavioural reference load, no noise and 30 dB; presets with a VI-MLP at 45 kHz
    /// without noise, cut after 100 epochs
    #[arg(long)]
    quick: bool,
    /// Folder of the cells, the report and the figures
    #[arg(
        long,
        alias = "resume",
        value_name = "DIR",
        default_value = "ihd-study-paper"
    )]
    out: PathBuf,
    /// Print the cells as JSON
    #[arg(long)]
    json: bool,
}

/// Help of `--preset`, with the available names.
fn preset_help() -> String {
    format!(
        "Presets, with commas between them: {}; without this {} and those of --presets",
        PresetLibrary::default().names().join(", "),
        DEFAULT_PRESETS.join(", ")
    )
}

impl PaperArgs {
    /// Runs the study.
    pub fn run(&self) -> Result<()> {
        ensure_usage!(self.seeds > 0, "--seeds is 0: give one at least");
        ensure_usage!(self.epochs != Some(0), "--epochs is 0: give one at least");
        std::fs::create_dir_all(&self.out)
            .with_context(|| format!("cannot make the folder {}", self.out.display()))?;
        let presets = match &self.presets {
            Some(folder) => PresetLibrary::with_folder(folder)?,
            None => PresetLibrary::default(),
        };
        let jobs = self.jobs(&presets)?;
        let bar = ProgressBar::new(jobs.len() as u64);
        let style = ProgressStyle::with_template("{bar:24} {pos}/{len} cells {wide_msg}");
        bar.set_style(style.context("progress bar")?);
        let cells = study(&jobs, &presets, &self.out, &|done, text| {
            bar.set_position(done as u64);
            bar.set_message(text.to_owned());
        })?;
        bar.finish_and_clear();
        let report = publish(&cells, &presets, &self.out)?;
        if self.json {
            output::json(&cells)?;
        } else {
            let text = std::fs::read_to_string(&report)
                .with_context(|| format!("cannot read {}", report.display()))?;
            output::text(&text)?;
            say!("kept in {}", self.out.display())?;
        }
        Ok(())
    }

    /// All cells, seed by seed: an interrupted study has the table of the first seeds.
    fn jobs(&self, presets: &PresetLibrary) -> Result<Vec<PaperJob>> {
        let contenders = self.contenders(presets)?;
        let mut jobs = Vec::new();
        for seed in 1..=self.seeds {
            for &load in &self.load {
                for khz in &self.khz {
                    for snr in &self.snr {
                        jobs.extend(contenders.iter().map(|entrant| PaperJob {
                            load: load.into(),
                            f_sw_hz: 1e3 * khz,
                            snr_db: snr.0,
                            contender: entrant.contender.clone(),
                            seed,
                            epochs: entrant.epochs,
                            backend: entrant.backend,
                        }));
                    }
                }
            }
        }
        jobs.retain(|job| self.wants(job));
        Ok(jobs)
    }

    /// Contenders; presets that have a VI-MLP with the limit of epochs and the backend.
    fn contenders(&self, presets: &PresetLibrary) -> Result<Vec<Entrant>> {
        let names: Vec<&str> = if self.preset.is_empty() {
            DEFAULT_PRESETS
                .into_iter()
                .chain(presets.folder_names())
                .collect()
        } else {
            self.preset.iter().map(String::as_str).collect()
        };
        let cut = self.epochs.or(self.quick.then_some(QUICK_EPOCHS));
        let mut contenders = Vec::new();
        for name in names {
            // Cells are files by name.
            let taken = Method::ALL.iter().any(|method| method.name() == name);
            ensure_usage!(!taken, "{name} is an estimator: rename the preset's file");
            let preset = presets.get(name)?;
            let (epochs, backend) = match preset.config.vi_mlp {
                Some(_) => (cut, self.backend),
                None => (None, None),
            };
            contenders.push(Entrant {
                contender: Contender::Pinn(preset.name),
                epochs,
                backend,
            });
        }
        let others = [Method::LeastSquares, Method::Ekf, Method::Lockin];
        contenders.extend(others.map(|method| Entrant {
            contender: Contender::Other(method),
            epochs: None,
            backend: None,
        }));
        Ok(contenders)
    }

    /// Returns `true` if the job is run: `--quick` omits some, and seeds of estimators without noise and network are redundant.
    fn wants(&self, job: &PaperJob) -> bool {
        let trained = matches!(job.contender, Contender::Pinn(_));
        if job.seed > 1 && !trained && job.snr_db.is_none() {
            return false;
        }
        if !self.quick {
            return true;
        }
        let reference_load = job.load == LoadKind::Behavioural;
        let known = job.snr_db.is_none() || job.snr_db == Some(30.0);
        let slow = job.epochs.is_some();
        let first = job.f_sw_hz == 1e3 * self.khz[0] && job.snr_db.is_none();
        reference_load && job.seed == 1 && known && (!slow || first)
    }
}
