//! An exact load, for which v = R i + L di/dt holds at every time: R = (2.2 + 3.5/(1 + I/15)) √(f/45 kHz) ohm,
//! L = 16 + (1 + 15/(1 + (I/14)^1.5)) (f/45 kHz)^-0.3 µH, I the amplitude of the current's envelope in A.
#![allow(dead_code)] // example and benchmark use a part of it each

use std::f64::consts::TAU;

use ihd_pinn::{Identification, Waveform};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A hob at one operating point, over one mains half-cycle.
#[derive(Debug, Clone, Copy)]
pub struct Hob {
    pub f_sw_hz: f64,
    pub f_mains_hz: f64,
    /// Amplitude of the current's fundamental at the crest of the envelope, A.
    pub crest_a: f64,
    /// R and L of the pot relative to the behavioural reference load: (1, 1) is a ferromagnetic one.
    pub pot: (f64, f64),
}

/// (order, amplitude relative to the fundamental, phase in rad): about what a half-bridge drives
/// through an inductance, with phases that keep the voltage within a channel of ±400 V.
const HARMONICS: [(f64, f64, f64); 4] = [
    (1.0, 1.0, -1.1),
    (3.0, 0.07, -3.0),
    (5.0, 0.025, 0.9),
    (7.0, 0.012, 2.0),
];

impl Hob {
    /// 54 A at 45 kHz; a hob's current falls as the frequency moves away from resonance.
    pub fn at(f_sw_hz: f64, f_mains_hz: f64) -> Self {
        Self {
            f_sw_hz,
            f_mains_hz,
            crest_a: 54.0 * (45e3 / f_sw_hz).powf(1.5),
            pot: (1.0, 1.0),
        }
    }

    pub fn half_cycle_s(&self) -> f64 {
        0.5 / self.f_mains_hz
    }

    /// Amplitude of the current's envelope, A.
    pub fn envelope_a(&self, t_s: f64) -> f64 {
        self.crest_a * (TAU * self.f_mains_hz * t_s).sin().abs()
    }

    pub fn r_ohm(&self, t_s: f64) -> f64 {
        let ohm = 2.2 + 3.5 / (1.0 + self.envelope_a(t_s) / 15.0);
        self.pot.0 * ohm * (self.f_sw_hz / 45e3).sqrt()
    }

    pub fn l_h(&self, t_s: f64) -> f64 {
        let bend = 1.0 + (self.envelope_a(t_s) / 14.0).powf(1.5);
        self.pot.1 * (16.0 + (1.0 + 15.0 / bend) * (self.f_sw_hz / 45e3).powf(-0.3)) * 1e-6
    }

    /// Voltage (V) and current (A) at `t_s` within the half-cycle, exactly.
    pub fn v_i(&self, t_s: f64) -> (f64, f64) {
        let mains = TAU * self.f_mains_hz;
        let (a, slope) = (
            self.envelope_a(t_s),
            self.crest_a * mains * (mains * t_s).cos(),
        );
        let (mut i, mut di) = (0.0, 0.0);
        for (order, share, phase) in HARMONICS {
            let omega = TAU * self.f_sw_hz * order;
            let (sin, cos) = (omega * t_s + phase).sin_cos();
            i += share * a * cos;
            di += share * (slope * cos - a * omega * sin);
        }
        (self.r_ohm(t_s) * i + self.l_h(t_s) * di, i)
    }

    /// The half-cycle as the device records it: 61/3 samples per switching period.
    pub fn record(&self) -> Recording {
        self.record_at(61.0 / 3.0 * self.f_sw_hz)
    }

    /// The half-cycle at a sampling rate in hertz.
    pub fn record_at(&self, rate_hz: f64) -> Recording {
        let dt_s = rate_hz.recip();
        let pairs = (self.half_cycle_s() / dt_s).floor() as usize;
        let (v, i) = (0..pairs).map(|n| self.v_i(n as f64 * dt_s)).unzip();
        Recording {
            hob: *self,
            dt_s,
            v,
            i,
        }
    }
}

/// A sampled half-cycle.
#[derive(Debug, Clone)]
pub struct Recording {
    pub hob: Hob,
    pub dt_s: f64,
    pub v: Vec<f64>,
    pub i: Vec<f64>,
}

impl Recording {
    pub fn waveform(&self) -> Waveform<'_> {
        Waveform {
            f_sw_hz: self.hob.f_sw_hz,
            f_mains_hz: self.hob.f_mains_hz,
            t0_s: 0.0,
            dt_s: self.dt_s,
            v_volt: &self.v,
            i_ampere: &self.i,
        }
    }

    /// Adds white noise of `snr_db` below each channel's mean power.
    pub fn with_noise(mut self, snr_db: f64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        for channel in [&mut self.v, &mut self.i] {
            let power = channel.iter().map(|x| x * x).sum::<f64>() / channel.len() as f64;
            let sigma = (power * 10f64.powf(-snr_db / 10.0)).sqrt();
            for x in channel {
                // Box-Muller.
                let (u, w): (f64, f64) = (1.0 - rng.random::<f64>(), rng.random());
                *x += sigma * (-2.0 * u.ln()).sqrt() * (TAU * w).cos();
            }
        }
        self
    }

    /// Rounds to 12-bit codes of +-400 V and +-80 A, and clips there.
    pub fn quantised(mut self) -> Self {
        for (channel, full_scale) in [(&mut self.v, 400.0), (&mut self.i, 80.0)] {
            let code = 2.0 * full_scale / 4096.0;
            for x in channel {
                *x = (*x / code).round().clamp(-2048.0, 2047.0) * code;
            }
        }
        self
    }
}

/// Mean relative errors (R, L) in % over the part of the half-cycle that leaves `margin` of it
/// away at either end, at times that no fit has seen.
pub fn mre_pct(found: &Identification, hob: &Hob, margin: f64) -> (f64, f64) {
    const TIMES: usize = 2000;
    let (mut r, mut l) = (0.0, 0.0);
    for k in 0..=TIMES {
        let x = margin + (1.0 - 2.0 * margin) * k as f64 / TIMES as f64;
        let t_s = x * hob.half_cycle_s();
        r += (found.r_at(t_s) / hob.r_ohm(t_s) - 1.0).abs();
        l += (found.l_at(t_s) / hob.l_h(t_s) - 1.0).abs();
    }
    let to_pct = 100.0 / (TIMES + 1) as f64;
    (r * to_pct, l * to_pct)
}

/// Largest voltage and current of an ideal half-cycle: both must fit the ADC's range.
pub fn fits_the_range(recording: &Recording) -> bool {
    let largest = |x: &[f64]| x.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    largest(&recording.v) < 400.0 && largest(&recording.i) < 80.0
}
