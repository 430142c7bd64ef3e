//! `ihd study paper`.

use std::fmt::{self, Display, Formatter};
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Context, Result, ensure};
use clap::Args;
use ihd_identify::Method;
use ihd_pinn::Preset;
use ihd_sim::recording::settings::LoadKind;
use indicatif::{ProgressBar, ProgressStyle};

use crate::cli::simulate::LoadWord;
use crate::study::estimators::{F_SW_HZ, SNR_DB};
use crate::study::paper::{Contender, Job, publish, study};

/// Epochs of the paper's presets with `--quick`.
const QUICK_EPOCHS: usize = 100;

/// A signal-to-noise ratio in decibel, or none.
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

/// The paper's Tables 1 to 3 with the PINN's presets, the EKF and the lock-in, on the behavioural
/// reference load and on the field model; report.md, cells.json and figures.
///
/// Every finished cell is a file in the folder, every training a checkpoint: run it again with the
/// same --out and it goes on.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd study paper --quick\n  \
    ihd study paper --out study --seeds 3 --preset hybrid,paper-repaired\n  \
    ihd study paper --out study --preset hybrid-fractional --load field --khz 45 --snr none,30\n  \
    ihd study paper --out study --epochs 500 --json")]
pub struct PaperArgs {
    /// Presets, with commas between them
    #[arg(
        long,
        value_name = "NAME,…",
        value_delimiter = ',',
        default_value = "hybrid,paper-literal,literal-scaled,paper-repaired"
    )]
    preset: Vec<Preset>,
    /// Loads, with commas between them: behavioural is the reference load, where v = R i +
    /// L di/dt holds
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

impl PaperArgs {
    /// Runs the study.
    pub fn run(&self) -> Result<()> {
        ensure!(self.seeds > 0, "--seeds is 0: give one at least");
        ensure!(self.epochs != Some(0), "--epochs is 0: give one at least");
        std::fs::create_dir_all(&self.out)
            .with_context(|| format!("cannot make the folder {}", self.out.display()))?;
        let jobs = self.jobs();
        let bar = ProgressBar::new(jobs.len() as u64);
        let style = ProgressStyle::with_template("{bar:24} {pos}/{len} cells {wide_msg}");
        bar.set_style(style.context("progress bar")?);
        let cells = study(&jobs, &self.out, &mut |done, text| {
            bar.set_position(done as u64);
            bar.set_message(text.to_owned());
        })?;
        bar.finish_and_clear();
        let report = publish(&cells, &self.out)?;
        if self.json {
            println!("{}", serde_json::to_string_pretty(&cells)?);
        } else {
            let text = std::fs::read_to_string(&report)
                .with_context(|| format!("cannot read {}", report.display()))?;
            print!("{text}");
            println!("kept in {}", self.out.display());
        }
        Ok(())
    }

    /// All cells, by load and frequency, so that each capture is simulated once.
    fn jobs(&self) -> Vec<Job> {
        let presets = self.preset.iter().map(|preset| Contender::Pinn(*preset));
        let others = [Method::Ekf, Method::Lockin].map(Contender::Other);
        let contenders: Vec<Contender> = presets.chain(others).collect();
        let mut jobs = Vec::new();
        for &load in &self.load {
            for khz in &self.khz {
                for snr in &self.snr {
                    for &contender in &contenders {
                        for seed in 1..=self.seeds {
                            let epochs = self.epochs_of(contender);
                            jobs.push(Job {
                                load: load.into(),
                                f_sw_hz: 1e3 * khz,
                                snr_db: snr.0,
                                contender,
                                seed,
                                epochs,
                            });
                        }
                    }
                }
            }
        }
        jobs.retain(|job| self.wants(job));
        jobs
    }

    fn epochs_of(&self, contender: Contender) -> Option<usize> {
        match contender {
            Contender::Pinn(preset) if preset.config().vi_mlp.is_some() => {
                self.epochs.or(self.quick.then_some(QUICK_EPOCHS))
            }
            _ => None,
        }
    }

    /// What `--quick` leaves out, and seeds of what has neither noise nor a network.
    fn wants(&self, job: &Job) -> bool {
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
