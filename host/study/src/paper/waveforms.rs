//! The paper's Table 3: NMSE of voltage and current against the waveforms without noise behind a 0.5 MHz
//! low-pass.

use std::fmt::Write;

use super::{Contender, PaperCell, distinct};
use crate::estimators::published::{ekf, pinn};
use crate::load_name::load_name;

/// Voltage and current in percent.
type Pair = (f64, f64);

/// Table; empty if no contender yields waveforms.
pub(super) fn markdown(cells: &[PaperCell]) -> String {
    let with = cells.iter().filter(|c| c.nmse_filtered_pct.is_some());
    let cells: Vec<&PaperCell> = with.collect();
    if cells.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "\n## Waveforms (Table 3)\n\nNMSE of v/i in %, mean over the seeds, against the waveforms without noise \
         behind a Butterworth low-pass of second order and 0.5 MHz, forwards and backwards · the same, \
         the reconstruction behind it too. `unfiltered` is what the waveforms without noise themselves get: \
         in Table 3's measure nobody who gives the edges right is better.\n\n|",
    );
    let frequencies = distinct(&cells, |c| c.job.f_sw_hz);
    for f_sw_hz in &frequencies {
        let _ = write!(out, " | {} kHz", f_sw_hz * 1e-3);
    }
    let _ = writeln!(out, " |\n|---|{}", "---:|".repeat(frequencies.len()));
    for place in distinct(&cells, |c| (c.job.load, c.job.snr_db)) {
        let here = cells.iter().filter(|c| (c.job.load, c.job.snr_db) == place);
        rows(&mut out, &here.copied().collect::<Vec<_>>(), &frequencies);
    }
    out
}

/// Rows of one load and SNR: all contenders, the waveforms themselves, the paper.
fn rows(out: &mut String, cells: &[&PaperCell], frequencies: &[f64]) {
    let snr_db = cells[0].job.snr_db;
    let snr = snr_db.map_or("noiseless".into(), |db| format!("{db} dB"));
    let place = format!("{}, {snr}", load_name(cells[0].job.load));
    let mut row = |who: &str, value: &dyn Fn(f64) -> (Option<Pair>, Option<Pair>)| {
        let _ = write!(out, "| {place}: {who}");
        for f_sw_hz in frequencies {
            let _ = match value(*f_sw_hz) {
                (Some(one), Some(both)) => write!(out, " | {} · {}", pair(one), pair(both)),
                (Some(one), None) => write!(out, " | {}", pair(one)),
                (None, _) => write!(out, " | –"),
            };
        }
        out.push_str(" |\n");
    };
    for contender in distinct(cells, |c| c.job.contender.clone()) {
        row(contender.name(), &|f| {
            let of = |value| mean(cells, &contender, f, value);
            (
                of(|c| c.nmse_filtered_pct),
                of(|c| c.nmse_both_filtered_pct),
            )
        });
    }
    row("unfiltered", &|f| {
        let here = cells.iter().find(|c| c.job.f_sw_hz == f);
        (here.and_then(|c| c.nmse_unfiltered_itself_pct), None)
    });
    row("*paper's PINN*", &|f| {
        (pinn(f, snr_db).map(|p| p.nmse_pct), None)
    });
    row("*paper's EKF*", &|f| {
        (ekf(f, snr_db).map(|p| p.nmse_pct), None)
    });
}

fn mean(
    cells: &[&PaperCell],
    contender: &Contender,
    f_sw_hz: f64,
    value: fn(&PaperCell) -> Option<Pair>,
) -> Option<Pair> {
    let of = |c: &&&PaperCell| c.job.contender == *contender && c.job.f_sw_hz == f_sw_hz;
    let pairs: Vec<Pair> = cells.iter().filter(of).filter_map(|c| value(c)).collect();
    let n = pairs.len() as f64;
    let sum = pairs.iter().fold((0.0, 0.0), |s, p| (s.0 + p.0, s.1 + p.1));
    (n > 0.0).then_some((sum.0 / n, sum.1 / n))
}

fn pair((v, i): Pair) -> String {
    format!("{}/{}", number(v), number(i))
}

/// Formats two significant digits, down to a thousandth of a percent.
fn number(x: f64) -> String {
    let text = match x {
        x if x >= 9.95 => format!("{x:.0}"),
        x if x >= 0.995 => format!("{x:.1}"),
        x if x >= 0.0995 => format!("{x:.2}"),
        x if x >= 0.0005 => format!("{x:.3}"),
        _ => "0".into(),
    };
    match text.strip_prefix("0.") {
        Some(decimals) => format!(".{decimals}"),
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use super::number;

    #[test]
    fn small_and_large_percentages_are_short() {
        let of = [0.0002, 0.0045, 0.19, 0.998, 12.4].map(number);
        assert_eq!(of, ["0", ".004", ".19", "1.0", "12"]);
    }
}
