//! `ihd identify`: R(t) and L(t) of a capture, by one or all estimators.

mod crest;
mod page;
mod parts;
mod printed;
mod report;
mod results;
mod settings;

use std::num::NonZero;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::builder::{PathBufValueParser, TypedValueParser};
use clap::{Args, ValueEnum};
use ihd_gate::{ExamineOptions, Reconstruct, examine_taking};
use ihd_identify::pinn::preset_names;
use ihd_identify::{IdentifyOptions, Method};
use ihd_plot::file::{ENDING_NAMES, ENDINGS};
use indicatif::{ProgressBar, ProgressStyle};

use self::parts::ManyParts;
pub use self::results::RefusedResults;
use self::results::{ResultOptions, ResultWriter};
use super::capture_args::{CaptureArgs, CaptureParts};
use super::global::Global;
use super::interrupt;
use super::keys;
use super::sensor_args::SensorArgs;
use super::simulate::quantity::quantity;
use super::usage::Usage;

/// Identify R(t) and L(t) of the load in a capture.
///
/// Switching frequency and mains are found in the capture where they are not given. A method that
/// fails on a stretch reports why; the others go on. Every result is judged: by what the capture shows,
/// by its own uncertainty, and against least squares of the same stretch (docs/identification.md).
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd identify capture.csv\n  \
    ihd identify capture.csv --method all --out identified.svg\n  \
    ihd identify capture.mcap --method pinn --preset hybrid --network backend=ndarray\n  \
    ihd identify scope_ch1.isf scope_ch2.isf --input probe=50,0.1 --method rts --json\n\n\
    Exit codes: 0 done, 1 failed or every method failed, 2 wrong usage, 7 a result is refused (it is printed, with the\n\
    reason; --anyway makes it 0), or the file is empty or a cut MCAP (what could be read is identified)")]
pub struct IdentifyArgs {
    /// Estimators, with commas between them, or all
    #[arg(
        long,
        short,
        value_name = "NAME,…",
        value_delimiter = ',',
        default_value = "least-squares"
    )]
    method: Vec<MethodWord>,
    /// Compare with the truth from this time on, in s
    #[arg(long, value_name = "S", value_parser = quantity, allow_negative_numbers = true)]
    from: Option<f64>,
    /// TOML file with the estimators' settings; what it leaves out keeps its default
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    #[arg(
        long,
        value_name = "NAME",
        help = format!("With the method pinn: preset of the network: {}", preset_names())
    )]
    preset: Option<String>,
    /// With the method pinn: backend=fused or backend=ndarray; deterministic for no wall-clock limit, so that two runs give the same
    /// digits
    #[arg(long, value_name = "KEY=VALUE,…", value_parser = keys::text::<NetworkOptions>())]
    network: Vec<String>,
    /// Parts of a long capture that are identified at once; default: one a core, as far as 300 MB of memory allow
    #[arg(long, value_name = "N")]
    threads: Option<NonZero<usize>>,
    /// End with 0 even where a result is refused
    #[arg(long)]
    anyway: bool,
    /// Write to this file the estimates as a table (.csv), the curves of R, L and the reconstructed waveforms (.svg, .pdf, .png), or a page of
    /// what was captured, found and doubted, with curves to zoom (.html); give it again for another one
    #[arg(long, short, value_name = "FILE", value_parser = PathBufValueParser::new().try_map(output_file))]
    out: Vec<PathBuf>,
    // Last: its heading in the help applies to everything after it.
    #[command(flatten)]
    capture: CaptureArgs,
    #[command(flatten)]
    sensors: SensorArgs,
}

/// Options of the network: keys of `--network`.
#[derive(Debug, Args)]
struct NetworkOptions {
    /// Backend of the network, fused or ndarray
    #[arg(long, value_name = "NAME")]
    backend: Option<String>,
    /// No wall-clock limit, so that two runs give the same digits
    #[arg(long)]
    deterministic: bool,
}

/// Checks the name of a table, a figure or a report.
fn output_file(path: PathBuf) -> Result<PathBuf, String> {
    match path.extension().and_then(|ending| ending.to_str()) {
        Some(ending) if ["csv", "html"].contains(&ending) || ENDINGS.contains(&ending) => Ok(path),
        _ => Err(format!(
            "a table ends with .csv, a figure with {ENDING_NAMES}, a report with .html"
        )),
    }
}

/// Method, or all of this build.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MethodWord {
    /// Every method of this build.
    All,
    /// One method.
    One(Method),
}

impl MethodWord {
    /// Methods denoted by a list of words, in the order of tables.
    pub fn chosen(words: &[Self]) -> Vec<Method> {
        let chosen = |m: &Method| {
            let in_build = cfg!(feature = "pinn") || *m != Method::Pinn;
            words.contains(&Self::One(*m)) || (in_build && words.contains(&Self::All))
        };
        Method::ALL.into_iter().filter(chosen).collect()
    }
}

impl ValueEnum for MethodWord {
    fn value_variants<'a>() -> &'a [Self] {
        const WORDS: [MethodWord; Method::ALL.len() + 1] = {
            let mut words = [MethodWord::All; Method::ALL.len() + 1];
            let mut k = 0;
            while k < Method::ALL.len() {
                words[k] = MethodWord::One(Method::ALL[k]);
                k += 1;
            }
            words
        };
        &WORDS
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        Some(match self {
            Self::All => clap::builder::PossibleValue::new("all"),
            Self::One(method) => clap::builder::PossibleValue::new(method.name()),
        })
    }
}

impl IdentifyArgs {
    /// Opens and surveys the capture, identifies, and prints the results.
    pub fn run(&self, global: &Global) -> Result<()> {
        self.capture
            .ensure_not_read(self.out.iter().map(PathBuf::as_path))?;
        let settings = self.settings()?;
        let methods = MethodWord::chosen(&self.method);
        if self.preset.is_some() || !self.network.is_empty() {
            ensure_usage!(
                cfg!(feature = "pinn"),
                "this ihd is built without the method pinn, which --preset and --network are for: build it with \
                 --features pinn"
            );
            settings.pinn.check().map_err(Usage::from_error)?;
            ensure_usage!(
                methods.contains(&Method::Pinn),
                "--preset and --network are for the method pinn, which is not asked for: add --method pinn"
            );
        } else if methods.contains(&Method::Pinn) {
            settings.pinn.check()?;
        }
        let bar = ProgressBar::no_length();
        let style = ProgressStyle::with_template("{bar:16} {pos}/{len} {wide_msg}");
        bar.set_style(style.context("progress bar")?);
        let mut parts = self.capture.open_parts(&mut |_| ())?;
        let result = self.identify(&mut parts, &settings, &methods, (global.json, &bar));
        bar.finish_and_clear();
        parts.finish(result)
    }

    fn identify(
        &self,
        parts: &mut CaptureParts,
        settings: &IdentifyOptions,
        methods: &[Method],
        (json, bar): (bool, &ProgressBar),
    ) -> Result<()> {
        let input = self.capture.input()?;
        let tables: Vec<&Path> = self.ending("csv").collect();
        let figures: Vec<&Path> = self.figures().collect();
        let pages: Vec<&Path> = self.ending("html").collect();
        let request = ExamineOptions {
            hints: input.hints(),
            sensors: self.sensors.options(&input),
            methods,
            settings,
            reconstruct: if !(figures.is_empty() && pages.is_empty()) {
                Reconstruct::Waveforms
            } else {
                Reconstruct::Errors
            },
        };
        let Some(mut first) = parts.next_part()? else {
            return Ok(());
        };
        let is_whole = parts.is_at_end()?;
        if let Some(from_s) = self.from {
            let last_s = first.truth.last().map(|t| t.t_s);
            ensure_usage!(
                last_s.is_some(),
                "--from is for a capture with its truth, which this one has not"
            );
            ensure_usage!(
                !is_whole || last_s >= Some(from_s),
                "--from {from_s} s is after the capture's end"
            );
        }
        let mut results = ResultWriter::new(ResultOptions {
            capture: &self.capture,
            json,
            in_parts: !is_whole,
            from_s: self.from.unwrap_or(f64::NEG_INFINITY),
            tables: &tables,
            figures: &figures,
            pages: &pages,
            anyway: self.anyway,
        });
        if is_whole {
            let examined = examine_taking(&mut first, &request, &mut |text, done, of| {
                bar.set_length(of as u64);
                bar.set_position(done as u64);
                bar.set_message(text.to_owned());
            })?;
            bar.finish_and_clear();
            results.take(first, examined)?;
            results.finish(parts.incomplete().map(|i| i.to_string()))?;
        } else {
            let mut many = ManyParts {
                parts,
                request,
                bar,
                stop: interrupt::flag().context("cannot watch for Ctrl-C")?,
                threads: self.threads,
            };
            many.run(first, &mut results)?;
        }
        results.verdict()
    }

    /// Files of --out with an ending.
    fn ending(&self, ending: &'static str) -> impl Iterator<Item = &Path> {
        let files = self.out.iter().map(PathBuf::as_path);
        files.filter(move |file| file.extension().is_some_and(|e| e == ending))
    }

    /// Figures of --out.
    fn figures(&self) -> impl Iterator<Item = &Path> {
        ENDINGS.into_iter().flat_map(|ending| self.ending(ending))
    }

    fn settings(&self) -> Result<IdentifyOptions> {
        let mut settings = match &self.settings {
            Some(path) => settings::read(path)?,
            None => IdentifyOptions::default(),
        };
        let pinn = &mut settings.pinn;
        pinn.preset = self.preset.clone().or(pinn.preset.take());
        let network: NetworkOptions = keys::parse("--network", &self.network)?;
        pinn.backend = network.backend.or(pinn.backend.take());
        pinn.deterministic |= network.deterministic;
        Ok(settings)
    }
}
