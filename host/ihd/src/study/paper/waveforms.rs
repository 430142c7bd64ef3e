//! The paper's Table 3: NMSE of voltage and current against the waveforms without noise behind a 0.5 MHz
//! low-pass.

use std::fmt::Write;

use super::published::pinn;
use super::report::{distinct, number};
use super::{Cell, Contender};
use crate::study::estimators::published::ekf_nmse;

/// The table; nothing where nobody gives waveforms.
pub(super) fn markdown(cells: &[Cell]) -> String {
    let with = cells.iter().filter(|c| c.nmse_filtered_pct.is_some());
    let cells: Vec<&Cell> = with.collect();
    if cells.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "\n## Waveforms (Table 3)\n\nNMSE of v/i in %, mean over the seeds, against the waveforms without noise \
         behind a Butterworth low-pass of second order and 0.5 MHz, forwards and backwards · the \
         reconstruction behind it too · neither. `unfiltered` is what the waveforms without noise \
         themselves get: who gives every edge right is no better in Table 3's measure.\n\n\
         | load, SNR, kHz | who | reference filtered (Table 3) | both | neither |\n|---|---|---:|---:|---:|\n",
    );
    for point in distinct(&cells, |c| (c.job.load, c.job.snr_db, c.job.f_sw_hz)) {
        let (load, snr_db, f_sw_hz) = point;
        let at = |c: &&&Cell| (c.job.load, c.job.snr_db, c.job.f_sw_hz) == point;
        let here: Vec<&Cell> = cells.iter().filter(at).copied().collect();
        let snr = snr_db.map_or("noiseless".into(), |db| format!("{db} dB"));
        let place = format!("{load:?}, {snr}, {}", f_sw_hz * 1e-3).to_lowercase();
        let mut row = |who: &str, values: [Option<(f64, f64)>; 3]| {
            let text = |pair: Option<(f64, f64)>| {
                pair.map_or("".into(), |(v, i)| format!("{}/{}", number(v), number(i)))
            };
            let [filtered, both, neither] = values.map(text);
            let _ = writeln!(out, "| {place} | {who} | {filtered} | {both} | {neither} |");
        };
        for contender in distinct(&here, |c| c.job.contender.clone()) {
            let own = |value: fn(&Cell) -> Option<(f64, f64)>| mean(&here, &contender, value);
            row(
                contender.name(),
                [
                    own(|c| c.nmse_filtered_pct),
                    own(|c| c.nmse_both_filtered_pct),
                    own(|c| c.nmse_pct),
                ],
            );
        }
        row(
            "unfiltered",
            [here[0].nmse_unfiltered_itself_pct, None, None],
        );
        row(
            "*paper's PINN*",
            [pinn(f_sw_hz, snr_db).map(|p| p.nmse_pct), None, None],
        );
        row("*paper's EKF*", [ekf_nmse(f_sw_hz, snr_db), None, None]);
    }
    out
}

fn mean(
    cells: &[&Cell],
    contender: &Contender,
    value: fn(&Cell) -> Option<(f64, f64)>,
) -> Option<(f64, f64)> {
    let of = cells.iter().filter(|c| c.job.contender == *contender);
    let pairs: Vec<(f64, f64)> = of.filter_map(|c| value(c)).collect();
    let n = pairs.len() as f64;
    let sum = pairs.iter().fold((0.0, 0.0), |s, p| (s.0 + p.0, s.1 + p.1));
    (n > 0.0).then_some((sum.0 / n, sum.1 / n))
}
