//! Probes and scope: what becomes of the circuit's voltage and current on their way into a file.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::circuit::{Circuit, Truth, Waves};

/// Times of samples in seconds.
#[derive(Clone, Debug)]
pub enum Times {
    /// From zero on, with this interval.
    Even(f64),
    /// One a sample.
    Stamps(Vec<f64>),
}

/// Samples of the scope, and the truth.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// Declared times of the samples in seconds.
    pub t_s: Times,
    /// Coil voltage in volt.
    pub v_v: Vec<f32>,
    /// Coil current in ampere.
    pub i_a: Vec<f32>,
    /// Truth, one entry a switching period, at the declared times.
    pub truth: Vec<Truth>,
    /// Duration of a mains half-cycle in seconds.
    pub half_cycle_s: f64,
    /// Declared time of a zero crossing in seconds.
    pub crossing_s: f64,
    /// Capacitance in farad that the user knows; `None` if unknown.
    pub known_capacitance_f: Option<f64>,
}

/// Measuring chain and its faults. The default is a scope of 12 bit without noise.
#[derive(Clone, Debug)]
pub struct Sensors {
    /// Resolution in bits.
    pub bits: u32,
    /// Full scale over the largest magnitude of each channel.
    pub headroom: (f64, f64),
    /// Signal over white noise in dB.
    pub snr_db: f64,
    /// Signal over noise behind a first-order low-pass in dB, and the share of a new sample in that low-pass.
    pub coloured: Option<(f64, f64)>,
    /// Factors on voltage and current.
    pub gain: (f64, f64),
    /// Offsets in volt and ampere.
    pub offset: (f64, f64),
    /// Delay of the current in seconds.
    pub skew_s: f64,
    /// Corner of a first-order high-pass of the current in hertz.
    pub droop_hz: Option<f64>,
    /// Corner of a first-order low-pass of the current in hertz.
    pub slow_hz: Option<f64>,
    /// Current in ampere at which the sensor saturates (tanh).
    pub saturates_a: Option<f64>,
    /// Standard deviation of the sampling instants in seconds.
    pub jitter_s: f64,
    /// Declared over true sampling interval.
    pub wrong_rate: f64,
    /// Places, as shares of the capture, and numbers of the samples that are missing there.
    pub lost: Vec<(f64, usize)>,
    /// `true` if the samples have stamps, which show those that are missing.
    pub stamped: bool,
    /// Number of single samples of full scale.
    pub spikes: usize,
    /// `true` if voltage and current are exchanged.
    pub swapped: bool,
    /// `true` if the current's probe is reversed.
    pub inverted: bool,
    /// `true` if the user knows the capacitor.
    pub capacitor_known: bool,
}

impl Default for Sensors {
    fn default() -> Self {
        Self {
            bits: 12,
            headroom: (1.3, 1.3),
            snr_db: 50.0,
            coloured: None,
            gain: (1.0, 1.0),
            offset: (0.0, 0.0),
            skew_s: 0.0,
            droop_hz: None,
            slow_hz: None,
            saturates_a: None,
            jitter_s: 0.0,
            wrong_rate: 1.0,
            lost: Vec::new(),
            stamped: false,
            spikes: 0,
            swapped: false,
            inverted: false,
            capacitor_known: false,
        }
    }
}

impl Sensors {
    /// Records the waves.
    pub fn record(&self, seed: u64, circuit: &Circuit, waves: Waves) -> Recorded {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x005E_1150);
        let dt_s = 1.0 / circuit.rate_hz;
        let Waves {
            v_v,
            i_a,
            mut truth,
        } = waves;
        let current = self.sensed_current(&i_a, dt_s);
        let instants: Vec<f64> = (0..v_v.len())
            .map(|k| k as f64 + self.jitter_s / dt_s * normal(&mut rng))
            .collect();
        let at = |x: &[f64], delay_s: f64| -> Vec<f64> {
            if delay_s == 0.0 && self.jitter_s == 0.0 {
                return x.to_vec();
            }
            let of = |k: &f64| interpolated(x, k - delay_s / dt_s);
            instants.iter().map(of).collect()
        };
        let mut v = at(&v_v, 0.0);
        let mut i = at(&current, self.skew_s);
        self.channel(
            &mut v,
            self.gain.0,
            self.offset.0,
            self.headroom.0,
            &mut rng,
        );
        self.channel(
            &mut i,
            self.gain.1,
            self.offset.1,
            self.headroom.1,
            &mut rng,
        );
        if self.inverted {
            i.iter_mut().for_each(|x| *x = -*x);
        }
        if self.swapped {
            std::mem::swap(&mut v, &mut i);
        }
        let mut stamps: Vec<f64> = (0..v.len()).map(|k| k as f64 * dt_s).collect();
        for (share, count) in &self.lost {
            let from = (share * v.len() as f64) as usize;
            let to = (from + count).min(v.len());
            v.drain(from..to);
            i.drain(from..to);
            stamps.drain(from..to);
        }
        let stretch = self.wrong_rate;
        truth.iter_mut().for_each(|t: &mut Truth| t.t_s *= stretch);
        let bridge = &circuit.bridge;
        let half_cycle_s = 0.5 / bridge.mains_hz;
        let crossing_s = -bridge.phase / std::f64::consts::TAU / bridge.mains_hz;
        let narrow = |x: Vec<f64>| x.into_iter().map(|x| x as f32).collect();
        Recorded {
            t_s: match self.stamped {
                true => Times::Stamps(stamps),
                false => Times::Even(dt_s * stretch),
            },
            v_v: narrow(v),
            i_a: narrow(i),
            truth,
            half_cycle_s: half_cycle_s * stretch,
            crossing_s: crossing_s * stretch,
            known_capacitance_f: self.capacitor_known.then_some(circuit.capacitance_f),
        }
    }

    /// Current behind its sensor.
    fn sensed_current(&self, i_a: &[f64], dt_s: f64) -> Vec<f64> {
        let mut out = i_a.to_vec();
        if let Some(most_a) = self.saturates_a {
            out.iter_mut()
                .for_each(|x| *x = most_a * (*x / most_a).tanh());
        }
        // Bilinear transform of both filters.
        if let Some(hz) = self.slow_hz {
            let a = (std::f64::consts::PI * hz * dt_s).tan();
            let (mut before, mut state) = (0.0, 0.0);
            for x in &mut out {
                state = ((1.0 - a) * state + a * (*x + before)) / (1.0 + a);
                before = *x;
                *x = state;
            }
        }
        if let Some(hz) = self.droop_hz {
            let a = (std::f64::consts::PI * hz * dt_s).tan();
            let (mut before, mut state) = (0.0, 0.0);
            for x in &mut out {
                state = ((1.0 - a) * state + *x - before) / (1.0 + a);
                before = *x;
                *x = state;
            }
        }
        out
    }

    /// Gain, offset, noise, spikes and codes of one channel.
    fn channel(&self, x: &mut [f64], gain: f64, offset: f64, headroom: f64, rng: &mut ChaCha8Rng) {
        let rms = (x.iter().map(|x| x * x).sum::<f64>() / x.len().max(1) as f64).sqrt();
        let largest = x.iter().fold(0.0f64, |a, x| a.max(x.abs()));
        let white = rms * 10f64.powf(-self.snr_db / 20.0);
        let mut slow = 0.0;
        for x in x.iter_mut() {
            *x = gain * *x + offset + white * normal(rng);
            if let Some((snr_db, decay)) = self.coloured {
                let sigma = rms * 10f64.powf(-snr_db / 20.0);
                slow = (1.0 - decay) * slow + (2.0 * decay - decay * decay).sqrt() * normal(rng);
                *x += sigma * slow;
            }
        }
        for _ in 0..self.spikes {
            let at = rng.random_range(0..x.len());
            x[at] = if rng.random_bool(0.5) {
                largest
            } else {
                -largest
            };
        }
        let full = headroom * gain.abs() * largest;
        let codes = f64::from(1u32 << (self.bits - 1));
        for x in x.iter_mut() {
            *x = (*x / full * codes).round().clamp(-codes, codes - 1.0) * full / codes;
        }
    }
}

fn normal(rng: &mut impl Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Value between samples by a cubic through four of them.
fn interpolated(x: &[f64], at: f64) -> f64 {
    let last = x.len() as isize - 1;
    let k = at.floor() as isize;
    let w = at - k as f64;
    let of = |n: isize| x[(k + n).clamp(0, last) as usize];
    let (a, b, c, d) = (of(-1), of(0), of(1), of(2));
    b + 0.5 * w * (c - a + w * (2.0 * a - 5.0 * b + 4.0 * c - d + w * (3.0 * (b - c) + d - a)))
}
