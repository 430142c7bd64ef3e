//! Report of the study in Markdown.

use std::fmt::Write;

use ihd_pinn::{ImpedanceOrder, PresetLibrary};
use ihd_sim::recording::settings::LoadKind;

use super::{Contender, PaperCell, comparison, distinct, waveforms};
use crate::estimators::published::{ekf, pinn};

/// Mean and spread of a quantity over seeds.
struct Spread {
    mean: f64,
    least: f64,
    most: f64,
    seeds: usize,
}

impl Spread {
    fn from_values(values: &[f64]) -> Option<Self> {
        let seeds = values.len();
        (seeds > 0).then(|| Self {
            mean: values.iter().sum::<f64>() / seeds as f64,
            least: values.iter().copied().fold(f64::INFINITY, f64::min),
            most: values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            seeds,
        })
    }

    fn text(&self) -> String {
        if self.seeds == 1 {
            number(self.mean)
        } else {
            let (mean, least, most) = (number(self.mean), number(self.least), number(self.most));
            format!("{mean} ({least}–{most})")
        }
    }
}

/// Formats three digits, or as many as necessary.
pub(super) fn number(x: f64) -> String {
    match x.abs() {
        a if a >= 1e4 => format!("{x:.1e}"),
        a if a >= 100.0 => format!("{x:.0}"),
        a if a >= 10.0 => format!("{x:.1}"),
        a if a >= 0.1 => format!("{x:.2}"),
        _ => format!("{x:.4}"),
    }
}

/// Returns the report; `figures` are names of files beside it.
pub fn markdown(cells: &[PaperCell], presets: &PresetLibrary, figures: &[String]) -> String {
    let mut out = String::from("# The paper's tables, with truth from simulation\n\n");
    out.push_str(
        "Errors in percent over the last mains half-cycle, mean over the seeds and, in brackets, the \
         least and the largest. The paper's own figures are for its COMSOL model and are not the same \
         captures. NMSE is against the waveforms without noise as they are; behind the paper's filter it \
         is under Table 3. P/I² is the power over I_rms² against the waveform's own; DF: against the \
         describing function, what a sinusoidal current would see.\n",
    );
    for (load, title) in [
        (
            LoadKind::Behavioural,
            "Behavioural reference load: v = R i + L di/dt holds",
        ),
        (
            LoadKind::Surrogate,
            "Surrogate: a table fitted to the field model",
        ),
        (LoadKind::Field, "Field model: R and L of the fundamental"),
    ] {
        let of: Vec<&PaperCell> = cells.iter().filter(|c| c.job.load == load).collect();
        if !of.is_empty() {
            let _ = writeln!(out, "\n## {title}\n");
        }
        for snr_db in distinct(&of, |c| c.job.snr_db) {
            table(&mut out, &of, snr_db);
        }
    }
    out.push_str(&comparison::markdown(cells));
    out.push_str(&waveforms::markdown(cells));
    out.push_str("\n## Who\n\n");
    for contender in distinct(&cells.iter().collect::<Vec<_>>(), |c| {
        c.job.contender.clone()
    }) {
        if let Contender::Pinn(name) = contender
            && let Ok(preset) = presets.get(&name)
        {
            let _ = writeln!(out, "- `{name}`: {}.", preset.description);
        }
    }
    if !figures.is_empty() {
        out.push_str("\n## Figures\n\n");
        for name in figures {
            let _ = writeln!(out, "![{name}]({name})\n");
        }
    }
    out
}

/// One table: a row per frequency and contender.
fn table(out: &mut String, cells: &[&PaperCell], snr_db: Option<f64>) {
    let title = snr_db.map_or("Without noise (Table 1)".into(), |db| {
        format!("{db} dB (Tables 2 and 3)")
    });
    let _ = writeln!(out, "### {title}\n");
    out.push_str(
        "| kHz | who | MRE_R | MRE_L | middle 80 % R | L | DF R | DF L | DF P/I² | NMSE_v | NMSE_i | \
         P/I² | order | s | steps, why stopped |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let of_snr = cells.iter().copied().filter(|c| c.job.snr_db == snr_db);
    let of_snr: Vec<&PaperCell> = of_snr.collect();
    for f_sw_hz in distinct(&of_snr, |c| c.job.f_sw_hz) {
        let here = of_snr.iter().copied().filter(|c| c.job.f_sw_hz == f_sw_hz);
        let here: Vec<&PaperCell> = here.collect();
        for contender in distinct(&here, |c| c.job.contender.clone()) {
            let of = here
                .iter()
                .copied()
                .filter(|c| c.job.contender == contender);
            row(out, f_sw_hz, &contender, &of.collect::<Vec<_>>());
        }
        published(out, f_sw_hz, snr_db);
    }
    out.push('\n');
}

fn row(out: &mut String, f_sw_hz: f64, contender: &Contender, cells: &[&PaperCell]) {
    let column = |value: &dyn Fn(&PaperCell) -> Option<f64>| {
        let values: Vec<f64> = cells.iter().filter_map(|c| value(c)).collect();
        Spread::from_values(&values).map_or("–".into(), |s| s.text())
    };
    let mut reasons = distinct(cells, |c| c.stopped.clone());
    reasons.retain(|reason| !reason.is_empty());
    let steps = match reasons.is_empty() {
        true => "–".to_owned(),
        false => format!(
            "{}, {}",
            column(&|c| Some(c.steps as f64)),
            reasons.join(", ")
        ),
    };
    let _ = writeln!(
        out,
        "| {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {steps} |",
        f_sw_hz * 1e-3,
        contender.name(),
        column(&|c| Some(c.whole.r_pct)),
        column(&|c| Some(c.whole.l_pct)),
        column(&|c| Some(c.middle.r_pct)),
        column(&|c| Some(c.middle.l_pct)),
        column(&|c| c.describing.map(|d| d.r_pct)),
        column(&|c| c.describing.map(|d| d.l_pct)),
        column(&|c| c.power_describing_pct),
        column(&|c| c.nmse_pct.map(|n| n.0)),
        column(&|c| c.nmse_pct.map(|n| n.1)),
        column(&|c| c.power_r_pct),
        column(&|c| c.impedance_order.filter(|_| has_law(c))),
        column(&|c| Some(c.elapsed_s)),
    );
}

/// Returns `true` if the network has a law of the impedance's frequency, whatever order it found.
fn has_law(cell: &PaperCell) -> bool {
    let settings = cell.settings.as_ref();
    settings.is_some_and(|s| s.impedance_order != ImpedanceOrder::default())
}

/// The paper's own figures; its NMSE is behind its filter, under Table 3.
fn published(out: &mut String, f_sw_hz: f64, snr_db: Option<f64>) {
    let khz = f_sw_hz * 1e-3;
    if let Some(p) = pinn(f_sw_hz, snr_db) {
        let (r, l) = (p.mre.r_pct, p.mre.l_pct);
        let _ = writeln!(
            out,
            "| {khz} | *paper's PINN* | {r} | {l} | | | | | | | | | | 31.3 (GPU) | 5000 |"
        );
    }
    if let Some(e) = ekf(f_sw_hz, snr_db) {
        let (r, l) = (e.mre.r_pct, e.mre.l_pct);
        let _ = writeln!(
            out,
            "| {khz} | *paper's EKF* | {r} | {l} | | | | | | | | | | 13.2 | – |"
        );
    }
}

#[cfg(test)]
pub(super) mod tests {
    use ihd_identify::Method;

    use super::*;
    use crate::paper::{PaperErrors, PaperJob};

    pub(in crate::paper) fn cell(seed: u64, r_pct: f64) -> PaperCell {
        PaperCell {
            job: PaperJob {
                load: LoadKind::Behavioural,
                f_sw_hz: 45e3,
                snr_db: Some(30.0),
                contender: Contender::Other(Method::Lockin),
                seed,
                epochs: None,
                backend: None,
            },
            build: String::new(),
            settings: None,
            whole: PaperErrors { r_pct, l_pct: 1.0 },
            middle: PaperErrors { r_pct, l_pct: 1.0 },
            describing: None,
            impedance_order: None,
            nmse_pct: None,
            nmse_filtered_pct: None,
            nmse_both_filtered_pct: None,
            nmse_unfiltered_itself_pct: None,
            power_r_pct: None,
            power_describing_pct: None,
            elapsed_s: 1.0,
            steps: 0,
            stopped: String::new(),
            trajectory: Vec::new(),
            truth: Vec::new(),
            noise_in_samples: None,
            losses: Vec::new(),
        }
    }

    #[test]
    fn a_row_has_mean_and_spread_of_its_seeds_beside_the_papers_figures() {
        let text = markdown(
            &[cell(1, 2.0), cell(2, 4.0)],
            &PresetLibrary::default(),
            &["a.svg".into()],
        );
        assert!(
            text.contains("| 45 | lockin | 3.00 (2.00–4.00) | 1.00 (1.00–1.00) |"),
            "{text}"
        );
        assert!(text.contains("*paper's PINN* | 1.46 | 1.89 |"), "{text}");
        assert!(text.contains("*paper's EKF* | 11.24 | 4.28 |"), "{text}");
        assert!(text.contains("![a.svg](a.svg)") && !text.contains("Field model"));
    }
    #[test]
    fn every_seed_counts_in_the_order_and_in_the_reasons_to_stop() {
        let law = |seed, order, steps, stopped: &str| {
            let mut cell = cell(seed, 1.0);
            cell.settings = Some(ihd_pinn::PinnConfig {
                impedance_order: ImpedanceOrder::Named(ihd_pinn::NamedOrder::Identified),
                ..ihd_pinn::PinnConfig::default()
            });
            cell.impedance_order = Some(order);
            (cell.steps, cell.stopped) = (steps, stopped.to_owned());
            cell
        };
        let cells = [
            law(1, 0.5, 200, "converged"),
            law(2, 0.0, 400, "step limit"),
            law(3, 0.1, 300, "converged"),
        ];
        let text = markdown(&cells, &PresetLibrary::default(), &[]);
        assert!(text.contains("| 0.20 (0.0000–0.50) |"), "{text}");
        assert!(
            text.contains("| 300 (200–400), converged, step limit |"),
            "{text}"
        );
    }

    /// The report's columns are of the waveforms as they are; the paper's figures are behind a filter.
    #[test]
    fn the_papers_filtered_nmse_is_not_beside_unfiltered_ones() {
        let text = markdown(&[cell(1, 2.0)], &PresetLibrary::default(), &[]);
        assert!(
            text.contains("| 1.46 | 1.89 | | | | | | | | | | 31.3 (GPU) |"),
            "{text}"
        );
    }
}
