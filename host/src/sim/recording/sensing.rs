//! From coil voltage and current to ADC codes: disturbances, filter, sampling, noise, quantising.

use std::f64::consts::TAU;

use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q, I_FULL_SCALE_A, V_FULL_SCALE_V};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use crate::sim::adc::{Noise, code};
use crate::sim::inverter::{Instant, InverterError, in_range};
use crate::sim::pole::Pole;

/// When the converters sample.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rate {
    /// f_sw · 61/3, as the board does.
    Locked,
    /// A fixed rate in hertz, as an oscilloscope does.
    Hz(f64),
}

/// Everything between the coil and the numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensing {
    /// Sampling.
    pub rate: Rate,
    /// Accept a fixed rate that cannot show the voltage's edges.
    pub allow_aliasing: bool,
    /// Resolution, 8 to 16 bits.
    pub bits: u32,
    /// Half the voltage range in volt.
    pub v_full_scale_v: f64,
    /// Half the current range in ampere.
    pub i_full_scale_a: f64,
    /// Gain of the voltage channel, 1 is right.
    pub v_gain: f64,
    /// Gain of the current channel, 1 is right.
    pub i_gain: f64,
    /// Offset of the voltage channel in volt.
    pub v_offset_v: f64,
    /// Offset of the current channel in ampere.
    pub i_offset_a: f64,
    /// Corner of the first-order anti-alias filter in hertz; 0: none.
    pub pole_hz: f64,
    /// How much later the current is sampled than the voltage, in seconds.
    pub skew_s: f64,
    /// White noise on both channels: SNR in decibel, σ² = P_signal/10^(SNR/10) (paper, section V).
    pub snr_db: Option<f64>,
    /// Switching ringing on the voltage, as a share of each edge; 0: none.
    pub ringing: f64,
    /// Frequency of the ringing in hertz.
    pub ringing_hz: f64,
    /// Decay time of the ringing in seconds.
    pub ringing_decay_s: f64,
    /// Spikes per second on each channel, single samples of up to half the range.
    pub spikes_per_s: f64,
}

impl Default for Sensing {
    /// An oscilloscope of 50 MS/s and 16 bits, without any error.
    fn default() -> Self {
        Self {
            rate: Rate::Hz(50e6),
            allow_aliasing: false,
            bits: 16,
            v_full_scale_v: V_FULL_SCALE_V,
            i_full_scale_a: I_FULL_SCALE_A,
            v_gain: 1.0,
            i_gain: 1.0,
            v_offset_v: 0.0,
            i_offset_a: 0.0,
            pole_hz: 0.0,
            skew_s: 0.0,
            snr_db: None,
            ringing: 0.0,
            ringing_hz: 3.5e6,
            ringing_decay_s: 0.4e-6,
            spikes_per_s: 0.0,
        }
    }
}

impl Sensing {
    /// Checks every number; `edge_s` is the duration of the bridge's edges.
    pub fn check(&self, edge_s: f64) -> Result<(), InverterError> {
        if let Rate::Hz(rate_hz) = self.rate {
            in_range("rate_hz", rate_hz, 1e5, 1e9, "0.1 to 1000 MS/s")?;
            if !self.allow_aliasing && rate_hz * edge_s < 2.0 {
                return Err(InverterError::OutOfRange {
                    field: "rate_hz",
                    value: rate_hz,
                    allowed: "at least two samples an edge (10 MS/s for 0.2 µs), or locked; aliasing must be allowed on purpose",
                });
            }
        }
        in_range("bits", f64::from(self.bits), 8.0, 16.0, "8 to 16")?;
        in_range(
            "v_full_scale_v",
            self.v_full_scale_v,
            1.0,
            1e5,
            "1 V to 100 kV",
        )?;
        in_range(
            "i_full_scale_a",
            self.i_full_scale_a,
            0.1,
            1e4,
            "0.1 A to 10 kA",
        )?;
        in_range("v_gain", self.v_gain, 0.1, 10.0, "0.1 to 10")?;
        in_range("i_gain", self.i_gain, 0.1, 10.0, "0.1 to 10")?;
        in_range("v_offset_v", self.v_offset_v, -1e3, 1e3, "-1000 to 1000 V")?;
        in_range("i_offset_a", self.i_offset_a, -1e3, 1e3, "-1000 to 1000 A")?;
        if self.pole_hz != 0.0 {
            in_range("pole_hz", self.pole_hz, 1e4, 5e6, "0, or 10 kHz to 5 MHz")?;
        }
        in_range("skew_s", self.skew_s, -10e-6, 10e-6, "-10 to 10 µs")?;
        if let Some(snr_db) = self.snr_db {
            in_range("snr_db", snr_db, -20.0, 200.0, "-20 to 200 dB")?;
        }
        in_range("ringing", self.ringing, 0.0, 1.0, "0 to 1")?;
        in_range("ringing_hz", self.ringing_hz, 1e5, 10e6, "0.1 to 10 MHz")?;
        in_range(
            "ringing_decay_s",
            self.ringing_decay_s,
            1e-8,
            1e-4,
            "10 ns to 100 µs",
        )?;
        in_range("spikes_per_s", self.spikes_per_s, 0.0, 1e6, "0 to 1e6")
    }
}

/// Samples the running simulation; noise and codes come at the end, because the paper's noise is
/// relative to the whole record.
#[derive(Clone, Debug)]
pub struct Sampler {
    sensing: Sensing,
    last: Instant,
    filters: [Pole; 2],
    ring: (f64, f64),
    next_v_s: f64,
    next_i_s: f64,
    /// Sampling instants of the voltage in seconds.
    pub t_s: Vec<f64>,
    /// Voltage at these instants after the analogue chain, in volt.
    pub v_v: Vec<f64>,
    /// Current, later by the skew, in ampere.
    pub i_a: Vec<f64>,
}

impl Sampler {
    /// Starts at the given instant, which is the first sample.
    pub fn new(sensing: &Sensing, start: Instant) -> Self {
        Self {
            sensing: sensing.clone(),
            last: start,
            filters: [start.coil_v, start.i_a].map(|x| Pole::settled(sensing.pole_hz, x)),
            ring: (0.0, 0.0),
            next_v_s: start.t_s,
            next_i_s: start.t_s + sensing.skew_s,
            t_s: Vec::new(),
            v_v: Vec::new(),
            i_a: Vec::new(),
        }
    }

    /// Takes the next instant of the simulation.
    pub fn push(&mut self, now: Instant, f_sw_hz: f64) {
        let dt_s = now.t_s - self.last.t_s;
        let before = self.filters.map(|f| f.output());
        self.advance_ringing(now.bridge_v - self.last.bridge_v, dt_s);
        let inputs = [now.coil_v + self.ring.1, now.i_a];
        for (filter, input) in self.filters.iter_mut().zip(inputs) {
            filter.advance(input, dt_s);
        }
        let interval_s = match self.sensing.rate {
            Rate::Locked => f64::from(ADC_LOCK_Q) / (ADC_LOCK_P as f64 * f_sw_hz),
            Rate::Hz(rate_hz) => 1.0 / rate_hz,
        };
        let at = |t_s: f64, k: usize| {
            let w = ((t_s - self.last.t_s) / dt_s).clamp(0.0, 1.0);
            before[k] + w * (self.filters[k].output() - before[k])
        };
        while self.next_v_s <= now.t_s {
            self.v_v.push(at(self.next_v_s, 0));
            self.t_s.push(self.next_v_s);
            self.next_v_s += interval_s;
        }
        while self.next_i_s <= now.t_s {
            self.i_a.push(at(self.next_i_s, 1));
            self.next_i_s += interval_s;
        }
        self.last = now;
    }

    /// Damped oscillation kicked by the bridge's edges; its value is the imaginary part.
    fn advance_ringing(&mut self, edge_v: f64, dt_s: f64) {
        if self.sensing.ringing == 0.0 {
            return;
        }
        let decay = libm::exp(-dt_s / self.sensing.ringing_decay_s);
        let angle = TAU * self.sensing.ringing_hz * dt_s;
        let (c, s) = (decay * libm::cos(angle), decay * libm::sin(angle));
        let re = self.ring.0 + self.sensing.ringing * edge_v;
        let im = self.ring.1;
        self.ring = (re * c - im * s, re * s + im * c);
    }

    /// Adds gain, offset, noise and spikes, and converts: codes of voltage and current.
    pub fn finish(&self, seed: u64) -> (Vec<i16>, Vec<i16>) {
        let n = self.v_v.len().min(self.i_a.len());
        let s = &self.sensing;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let rms = |x: &[f64]| (x.iter().map(|x| x * x).sum::<f64>() / x.len().max(1) as f64).sqrt();
        let noise = s.snr_db.map_or(Noise::default(), |snr| {
            Noise::from_snr_db(snr, rms(&self.v_v[..n]), rms(&self.i_a[..n]))
        });
        let span_s = self.t_s.last().map_or(0.0, |t| t - self.t_s[0]);
        let spike_chance = s.spikes_per_s * span_s / n.max(1) as f64;
        let codes = f64::from(1u32 << (s.bits - 1));
        let mut convert = |x: f64, gain: f64, offset: f64, sigma: f64, full_scale: f64| {
            let mut y = gain * x + offset;
            if sigma > 0.0 {
                let normal: f64 = StandardNormal.sample(&mut rng);
                y += sigma * normal;
            }
            if spike_chance > 0.0 && rng.random::<f64>() < spike_chance {
                y += full_scale * (rng.random::<f64>() - 0.5);
            }
            code(y / full_scale * codes, s.bits)
        };
        (0..n)
            .map(|k| {
                let v = convert(
                    self.v_v[k],
                    s.v_gain,
                    s.v_offset_v,
                    noise.v_v,
                    s.v_full_scale_v,
                );
                let i = convert(
                    self.i_a[k],
                    s.i_gain,
                    s.i_offset_a,
                    noise.i_a,
                    s.i_full_scale_a,
                );
                (v, i)
            })
            .unzip()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sine of 1 V and 1 A at 50 kHz, in steps of 20 ns.
    fn sampled(sensing: &Sensing) -> Sampler {
        let at = |n: u32| {
            let t_s = f64::from(n) * 20e-9;
            let x = (TAU * 50e3 * t_s).sin();
            Instant {
                t_s,
                coil_v: x,
                i_a: x,
                ..Instant::default()
            }
        };
        let mut sampler = Sampler::new(sensing, at(0));
        (1..=10_000).for_each(|n| sampler.push(at(n), 50e3));
        sampler
    }

    #[test]
    fn skew_shows_as_phase_and_pole_as_gain_and_phase() {
        let s = Sensing {
            skew_s: 100e-9,
            pole_hz: 500e3,
            rate: Rate::Hz(25e6),
            ..Sensing::default()
        };
        let got = sampled(&s);
        let (gain, phase) = (1.0 / 1.01f64.sqrt(), 0.1f64.atan());
        for k in 2000..4000 {
            let t = got.t_s[k];
            assert!((got.v_v[k] - gain * (TAU * 50e3 * t - phase).sin()).abs() < 1e-4);
            let late = TAU * 50e3 * (t + 100e-9) - phase;
            assert!((got.i_a[k] - gain * late.sin()).abs() < 1e-4);
        }
    }

    #[test]
    fn locked_sampling_has_61_samples_in_three_periods() {
        let s = Sensing {
            rate: Rate::Locked,
            ..Sensing::default()
        };
        let got = sampled(&s);
        // 200 µs are ten periods of 50 kHz: 203.3 intervals, and the first sample.
        assert_eq!(got.t_s.len(), 204);
        assert!((got.t_s[61] - 60e-6).abs() < 1e-12);
    }

    #[test]
    fn noise_has_the_papers_ratio() {
        let s = Sensing {
            snr_db: Some(30.0),
            v_full_scale_v: 2.0,
            i_full_scale_a: 2.0,
            ..Sensing::default()
        };
        let got = sampled(&s);
        let (v, _) = got.finish(7);
        let noise: f64 = v
            .iter()
            .zip(&got.v_v)
            .map(|(&c, x)| (f64::from(c) * 2.0 / 32768.0 - x).powi(2))
            .sum::<f64>()
            / v.len() as f64;
        let snr_db = 10.0 * (0.5 / noise).log10();
        assert!((snr_db - 30.0).abs() < 0.2, "{snr_db}");
        assert_eq!(v, got.finish(7).0);
        assert_ne!(v, got.finish(8).0);
    }

    #[test]
    fn a_rate_below_the_edges_is_refused_unless_meant() {
        let mut s = Sensing {
            rate: Rate::Hz(1e6),
            ..Sensing::default()
        };
        assert!(s.check(0.2e-6).unwrap_err().to_string().contains("rate_hz"));
        s.allow_aliasing = true;
        assert_eq!(s.check(0.2e-6), Ok(()));
        s.rate = Rate::Hz(f64::NAN);
        assert!(s.check(0.2e-6).is_err());
    }

    #[test]
    fn ringing_follows_an_edge_and_dies_away() {
        let s = Sensing {
            ringing: 0.2,
            ..Sensing::default()
        };
        let mut sampler = Sampler::new(&s, Instant::default());
        for n in 1..=1000u32 {
            let bridge_v = if n >= 10 { 300.0 } else { 0.0 };
            sampler.push(
                Instant {
                    t_s: f64::from(n) * 20e-9,
                    bridge_v,
                    coil_v: bridge_v,
                    ..Instant::default()
                },
                50e3,
            );
        }
        let over = sampler.v_v[10..60]
            .iter()
            .fold(0.0f64, |m, v| m.max(v - 300.0));
        // The first crest comes a quarter period (71 ns) after the kick: 60 V · e^(−71/400).
        assert!((over / 50.2 - 1.0).abs() < 0.05, "{over}");
        assert!((sampler.v_v[900] - 300.0).abs() < 1e-3);
    }
}
