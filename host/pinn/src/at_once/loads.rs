//! Simulated loads: half-cycles of an exact v = R i + L di/dt, with R and L smooth functions of the current's amplitude as those of
//! pots are, and loads unlike them.

use std::f64::consts::{PI, TAU};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::Waveform;

/// Kinds of loads. Those of [`Kind::LEARNED`] are learned from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// R and L fall with the current.
    Falling,
    /// R rises first, as below a steel's largest permeability.
    Hump,
    /// Constant R and L.
    Constant,
    /// R changes by up to 3 %, L by 1 %, over the half-cycle beside the law.
    Drifting,
    /// R and L step within an eighth of the current: no pot.
    Knee,
    /// R and L move by 5 and 2 % and back twice in the half-cycle: a moving pot.
    Moving,
}

impl Kind {
    pub const LEARNED: [Self; 4] = [Self::Falling, Self::Hump, Self::Constant, Self::Drifting];
}

/// A load with its operating point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Load {
    kind: Kind,
    pub f_sw_hz: f64,
    crest_a: f64,
    r: [f64; 4],
    l: [f64; 4],
    hump: [f64; 2],
    drift: f64,
    phases: [f64; 3],
}

impl Load {
    /// Draws a load.
    pub fn drawn(kind: Kind, rng: &mut ChaCha8Rng) -> Self {
        let mut within = |from: f64, to: f64| rng.random_range(from..to);
        // Even over the logarithm.
        let scale = within(f64::ln(0.3), f64::ln(1.5)).exp();
        Self {
            kind,
            f_sw_hz: within(30e3, 80e3),
            crest_a: within(f64::ln(8.0), f64::ln(75.0)).exp(),
            r: [
                scale * within(1.0, 4.0),
                scale * within(0.0, 5.0),
                within(f64::ln(5.0), f64::ln(60.0)).exp(),
                within(0.7, 2.0),
            ],
            l: [
                within(12.0, 45.0),
                within(0.0, 20.0),
                within(f64::ln(5.0), f64::ln(60.0)).exp(),
                within(0.8, 2.0),
            ],
            hump: [within(0.0, 0.5), within(f64::ln(3.0), f64::ln(30.0)).exp()],
            drift: within(-0.03, 0.03),
            phases: std::array::from_fn(|_| within(0.0, TAU)),
        }
    }

    fn envelope(&self, share: f64) -> f64 {
        self.crest_a * (PI * share).sin()
    }

    /// R in ohm and L in henry at a share of the half-cycle.
    pub fn r_l(&self, share: f64) -> (f64, f64) {
        let i_a = self.envelope(share);
        let law =
            |[low, more, knee, power]: [f64; 4]| low + more / (1.0 + (i_a / knee).powf(power));
        let (r, l) = (law(self.r), 1e-6 * law(self.l));
        match self.kind {
            Kind::Falling => (r, l),
            Kind::Hump => {
                let x = i_a / self.hump[1];
                (r * (1.0 + self.hump[0] * 2.0 * x / (1.0 + x * x)), l)
            }
            Kind::Constant => (self.r[0], 1e-6 * self.l[0]),
            Kind::Drifting => {
                let drift = 2.0 * share - 1.0;
                (
                    r * (1.0 + self.drift * drift),
                    l * (1.0 + self.drift / 3.0 * drift),
                )
            }
            Kind::Knee => {
                let step = ((i_a / self.crest_a - 0.5) * 16.0).tanh();
                (r * (1.0 + 0.3 * step), l * (1.0 - 0.1 * step))
            }
            Kind::Moving => {
                let turn = (2.0 * TAU * share + self.phases[0]).sin();
                (r * (1.0 + 0.05 * turn), l * (1.0 + 0.02 * turn))
            }
        }
    }

    /// The half-cycle at 61/3 samples a period with white noise of `snr_db`, in 12-bit codes.
    pub fn recorded(&self, snr_db: f64, rng: &mut ChaCha8Rng) -> Recorded {
        let half_cycle_s = 10e-3;
        let dt_s = 3.0 / (61.0 * self.f_sw_hz);
        let harmonics = [
            (1.0, 1.0, self.phases[0]),
            (3.0, 0.07, self.phases[1]),
            (5.0, 0.02, self.phases[2]),
        ];
        let (mut v_volt, mut i_ampere) = (Vec::new(), Vec::new());
        for n in 0..(half_cycle_s / dt_s) as u32 {
            let t_s = f64::from(n) * dt_s;
            let share = t_s / half_cycle_s;
            let a = self.envelope(share);
            let slope = self.crest_a * PI / half_cycle_s * (PI * share).cos();
            let (mut i, mut di) = (0.0, 0.0);
            for (order, part, phase) in harmonics {
                let omega = TAU * self.f_sw_hz * order;
                let (sin, cos) = (omega * t_s + phase).sin_cos();
                i += part * a * cos;
                di += part * (slope * cos - a * omega * sin);
            }
            let (r, l) = self.r_l(share);
            v_volt.push(r * i + l * di);
            i_ampere.push(i);
        }
        for x in [&mut v_volt, &mut i_ampere] {
            disturb(x, snr_db, rng);
        }
        Recorded {
            load: *self,
            dt_s,
            v_volt,
            i_ampere,
        }
    }
}

/// Adds white noise and rounds to 12 bit of 1.25 times the largest value.
fn disturb(x: &mut [f64], snr_db: f64, rng: &mut ChaCha8Rng) {
    let power = x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64;
    let sigma = (power * 10f64.powf(-snr_db / 10.0)).sqrt();
    let code = 1.25 * x.iter().fold(0.0, |m, x| f64::max(m, x.abs())) / 2048.0;
    for x in x {
        // Box-Muller.
        let (u, w): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
        *x += sigma * (-2.0 * u.ln()).sqrt() * (TAU * w).cos();
        *x = (*x / code).round().clamp(-2048.0, 2047.0) * code;
    }
}

/// Recorded half-cycle.
pub(super) struct Recorded {
    pub load: Load,
    dt_s: f64,
    v_volt: Vec<f64>,
    i_ampere: Vec<f64>,
}

impl Recorded {
    pub fn waveform(&self) -> Waveform<'_> {
        Waveform {
            f_sw_hz: self.load.f_sw_hz,
            f_mains_hz: 50.0,
            t0_s: 0.0,
            dt_s: self.dt_s,
            v_volt: &self.v_volt,
            i_ampere: &self.i_ampere,
        }
    }
}

/// Recordings of each kind in turn, between 25 and 75 dB.
pub(super) fn recordings(kinds: &[Kind], count: usize, seed: u64) -> Vec<Recorded> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|k| {
            let load = Load::drawn(kinds[k % kinds.len()], &mut rng);
            let snr_db = rng.random_range(25.0..75.0);
            load.recorded(snr_db, &mut rng)
        })
        .collect()
}
