//! Plateaus: voltage and current between two edges, as coefficients of polynomials.

use super::basis::{Bases, MIN_SAMPLES};
use super::charge::Charge;
use super::edges::{Carrier, Edges, MIN_AMPLITUDE_SHARE, Stretch};

/// Times in seconds that are left out around edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Guards {
    /// Time before the next edge.
    pub before_s: f64,
    /// Time after the last edge, for ringing and filters.
    pub after_s: f64,
}

/// Number of regressors of a plateau.
pub(super) const REGRESSORS: usize = 10;

/// Quantities that the models of a sensor are made of, by their place in a plateau's rows.
#[derive(Clone, Copy, Debug)]
pub(super) enum Regressor {
    /// Charge in coulomb.
    Charge,
    /// Current in ampere.
    Current,
    /// Derivative of the current in ampere per second.
    Slope,
    /// Second derivative of the current.
    Bend,
    /// Integral of the charge in coulomb seconds.
    Area,
    /// Integral of the cubed current.
    Cubed,
    /// Time in seconds.
    Time,
    /// Time times the change of the bridge's amplitude, in volt.
    Bus,
    /// Exponential decay from the edge, times the bridge's amplitude, in volt; zero where no filter leaves one.
    Tail,
    /// Voltage in volt.
    Voltage,
}

/// Voltage and current between two edges.
#[derive(Clone, Debug)]
pub(super) struct Plateau {
    /// Half of the period, 0 or 1.
    pub side: usize,
    /// Carrier at the plateau's middle.
    pub carrier: Carrier,
    /// Number of samples.
    pub samples: usize,
    /// Regressors, a row per polynomial without the constant: the level is free.
    pub rows: Vec<[f64; REGRESSORS]>,
}

/// Most plateaus of a stretch, taken evenly: with more, errors of the model dominate.
const MAX_PLATEAUS: usize = 6_000;

/// Plateaus of a stretch, between given edges. `settling_s` is the time constant of a filter's tail after each edge.
pub(super) fn of_stretch(
    stretch: &Stretch<'_>,
    edges: &Edges,
    guards: Guards,
    settling_s: Option<f64>,
    bases: &mut Bases,
) -> Vec<Plateau> {
    let track = &edges.track;
    let least_v = MIN_AMPLITUDE_SHARE * track.largest_v();
    let samples = stretch.v_v.len();
    let f_hz = stretch.f_sw_hz;
    let (begin, end) = (
        track.at(0).periods,
        track.at(samples.saturating_sub(1)).periods,
    );
    let every = ((2.0 * (end - begin)) as usize / MAX_PLATEAUS).max(1);
    let mut out = Vec::new();
    for (side, between) in edges.between.iter().enumerate() {
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
            if b < a + MIN_SAMPLES - 1 || carrier.v_v < least_v {
                continue;
            }
            let edge = n as f64 + between.start;
            let tail = settling_s.map(|tau_s| Tail {
                tau_s,
                since_edge_s: (track.at(a).periods - edge) / f_hz,
            });
            out.push(plateau(
                stretch,
                (a, b + 1),
                side,
                carrier,
                tail,
                (&edges.charge, &mut *bases),
            ));
        }
    }
    out
}

/// Tail that a filter leaves after an edge.
struct Tail {
    tau_s: f64,
    /// Time in seconds from the edge to the plateau's first sample.
    since_edge_s: f64,
}

fn plateau(
    stretch: &Stretch<'_>,
    (from, to): (usize, usize),
    side: usize,
    carrier: Carrier,
    tail: Option<Tail>,
    (charged, bases): (&Charge, &mut Bases),
) -> Plateau {
    let basis = bases.get_or_create(to - from);
    let dt_s = stretch.dt_s;
    let half_s = 0.5 * (to - from - 1) as f64 * dt_s;
    let mut buffer = Vec::new();
    let v = basis.project(stretch.v_v.block(from..to, &mut buffer));
    let i = basis.project(stretch.i_a.block(from..to, &mut buffer));
    let mut cubed = basis.at_samples(&i);
    cubed.iter_mut().for_each(|x| *x = x.powi(3));
    let cubes = basis.project(&cubed);
    let mut charge = basis.integrated(&i, half_s);
    // The charge's level enters its integral.
    charge[0] = basis.level(charged.swinging_c(&stretch.i_a, from..to));
    let slope = basis.derived(&i, half_s);
    let bend = basis.derived(&slope, half_s);
    let area = basis.integrated(&charge, half_s);
    let cubed = basis.integrated(&cubes, half_s);
    let tail = tail.map(|tail| {
        let at = |k: usize| libm::exp(-(tail.since_edge_s + k as f64 * dt_s) / tail.tau_s);
        basis.project(&(0..to - from).map(at).collect::<Vec<f64>>())
    });
    let row = |l: usize| {
        let time = basis.line[l] * half_s;
        let tail = tail.as_ref().map_or(0.0, |tail| tail[l] * carrier.v_v);
        // In the order of [`Regressor`].
        [
            charge[l],
            i[l],
            slope[l],
            bend[l],
            area[l],
            cubed[l],
            time,
            time * carrier.v_per_s,
            tail,
            v[l],
        ]
    };
    Plateau {
        side,
        carrier,
        samples: to - from,
        rows: (1..basis.len()).map(row).collect(),
    }
}
