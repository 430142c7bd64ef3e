//! Plateaus: voltage and current between two edges, as coefficients of polynomials.

use std::rc::Rc;

use nalgebra::DVector;

use super::basis::{Bases, Basis, FEWEST};
use super::edges::{Carrier, Edges, LEAST, Stretch};

/// Times in seconds that are left out around edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Guards {
    /// Time before the next edge.
    pub before_s: f64,
    /// Time after the last edge, for ringing and filters.
    pub after_s: f64,
}

/// Voltage and current between two edges. Every list has one entry per polynomial, without the constant: the level is free.
#[derive(Clone, Debug)]
pub(super) struct Plateau {
    /// Half of the period, 0 or 1.
    pub side: usize,
    /// Carrier at the plateau's middle.
    pub carrier: Carrier,
    /// Number of samples.
    pub samples: usize,
    /// Voltage in volt.
    pub v: Vec<f64>,
    /// Charge in coulomb.
    pub charge: Vec<f64>,
    /// Current in ampere.
    pub current: Vec<f64>,
    /// Derivative of the current in ampere per second, and the second one.
    pub slopes: [Vec<f64>; 2],
    /// Integral of the charge in coulomb seconds.
    pub area: Vec<f64>,
    /// Integral of the cubed current.
    pub cubed: Vec<f64>,
    /// Time in seconds.
    pub time: Vec<f64>,
    basis: Rc<Basis>,
    since_edge_s: f64,
    dt_s: f64,
}

impl Plateau {
    /// Exponential decay from the edge with this time constant, as a filter leaves it.
    pub fn settling(&self, tau_s: f64) -> Vec<f64> {
        let at = |k: usize| libm::exp(-(self.since_edge_s + k as f64 * self.dt_s) / tau_s);
        without_level(&self.basis.project(at))
    }
}

fn without_level(coefficients: &DVector<f64>) -> Vec<f64> {
    coefficients.as_slice().get(1..).unwrap_or(&[]).to_vec()
}

/// Most plateaus of a stretch, taken evenly: with more, errors of the model dominate.
const MOST: usize = 6_000;

/// Plateaus of a stretch, between given edges.
pub(super) fn of_stretch(
    stretch: &Stretch,
    (track, between): &Edges,
    guards: Guards,
    bases: &mut Bases,
) -> Vec<Plateau> {
    let least_v = LEAST * track.largest_v();
    let charge_c = stretch.swinging_charge_c();
    let samples = stretch.v_v.len();
    let f_hz = stretch.f_sw_hz;
    let (begin, end) = (
        track.at(0).periods,
        track.at(samples.saturating_sub(1)).periods,
    );
    let every = ((2.0 * (end - begin)) as usize / MOST).max(1);
    let mut out = Vec::new();
    for (side, between) in between.iter().enumerate() {
        let (from, to) = (
            between.start + guards.after_s * f_hz,
            between.end - guards.before_s * f_hz,
        );
        if to <= from {
            continue;
        }
        // The sample at which the phase, nearly linear, reaches a number of periods.
        let place = |periods: f64| track.place(periods, stretch.per_period());
        let (first, last) = ((begin - from).ceil() as i64, (end - to).floor() as i64);
        for n in (first..=last).step_by(every) {
            let (a, b) = (place(n as f64 + from), place(n as f64 + to));
            if !(a >= 0.0 && b < samples as f64) {
                continue;
            }
            let (a, b) = (a.ceil() as usize, b.floor() as usize);
            let carrier = track.at((a + b) / 2);
            if b < a + FEWEST - 1 || carrier.v_v < least_v {
                continue;
            }
            let edge = n as f64 + between.start;
            let since_edge_s = (track.at(a).periods - edge) / f_hz;
            out.push(plateau(
                stretch,
                (a, b + 1),
                side,
                carrier,
                since_edge_s,
                (charge_c.as_slice(), &mut *bases),
            ));
        }
    }
    out
}

fn plateau(
    stretch: &Stretch,
    (from, to): (usize, usize),
    side: usize,
    carrier: Carrier,
    since_edge_s: f64,
    (charge_c, bases): (&[f64], &mut Bases),
) -> Plateau {
    let basis = bases.of(to - from);
    let half_s = 0.5 * (to - from - 1) as f64 * stretch.dt_s;
    let v = basis.project(|k| stretch.v_v[from + k]);
    let i = basis.project(|k| stretch.i_a[from + k]);
    let smooth = basis.at_samples(&i);
    let cubes = basis.project(|k| smooth[k].powi(3));
    let mut charge = basis.integrated(&i, half_s);
    // The charge's level enters its integral.
    charge[0] = basis.project(|k| charge_c[from + k])[0];
    let slope = basis.derived(&i, half_s);
    Plateau {
        side,
        carrier,
        samples: to - from,
        area: without_level(&basis.integrated(&charge, half_s)),
        cubed: without_level(&basis.integrated(&cubes, half_s)),
        slopes: [
            without_level(&slope),
            without_level(&basis.derived(&slope, half_s)),
        ],
        time: without_level(&(&basis.line * half_s)),
        v: without_level(&v),
        charge: without_level(&charge),
        current: without_level(&i),
        basis,
        since_edge_s,
        dt_s: stretch.dt_s,
    }
}
