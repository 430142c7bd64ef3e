//! Recipe of the widths: those of the greatest evidence over simulated loads.

use super::loads::{Kind, recordings};
use super::{LawFit, Widths, Window};
use crate::PinnConfig;
use crate::hybrid::law::window;

const SEED: u64 = 36;
const LOADS: usize = 240;

impl Widths {
    fn logarithms(&self) -> [f64; 5] {
        let [a, b] = self.law;
        let [c, d] = self.flanks;
        [a, b, c, d, self.length].map(f64::ln)
    }

    fn from_logarithms(x: [f64; 5]) -> Self {
        let [a, b, c, d, length] = x.map(f64::exp);
        Self {
            law: [a, b],
            flanks: [c, d],
            length,
        }
    }
}

/// Evidence of widths over all windows.
fn evidence(windows: &[Window], widths: &Widths) -> f64 {
    let of = |window: &Window| {
        LawFit::new(window, widths).map_or(f64::NEG_INFINITY, |law| law.log_evidence)
    };
    windows.iter().map(of).sum()
}

#[test]
#[ignore = "the recipe of a table of constants"]
fn widths_are_learned() {
    let config = PinnConfig::default();
    let recorded = recordings(&Kind::LEARNED, LOADS, SEED);
    let windows = recorded.iter().map(|r| window(&r.waveform(), &config));
    let windows: Vec<Window> = windows.collect();
    // From wide to narrow, as nothing is known.
    let mut best = [0.1_f64; 5].map(f64::ln);
    let mut most = evidence(&windows, &Widths::from_logarithms(best));
    let mut step = 0.5;
    while step > 0.02 {
        let before = most;
        for k in 0..best.len() {
            for direction in [step, -step] {
                let mut next = best;
                next[k] += direction;
                let found = evidence(&windows, &Widths::from_logarithms(next));
                if found > most {
                    (best, most) = (next, found);
                }
            }
        }
        if most <= before {
            step *= 0.5;
        }
    }
    let found = Widths::from_logarithms(best);
    println!("{found:.3?}, log evidence {most:.1}");
    assert!(evidence(&windows, &Widths::LEARNED) >= most);
    for (found, learned) in best.iter().zip(Widths::LEARNED.logarithms()) {
        assert!((found - learned).abs() < 0.1);
    }
}
