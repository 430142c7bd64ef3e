//! From coil voltage and current to ADC codes: disturbances, filter, sampling, noise, quantising.

use std::f64::consts::TAU;

use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q};
use ihd_signal::quantise::code;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::sensing::{Rate, Sensing};
use crate::adc::Noise;
use crate::inverter::Instant;
use crate::low_pass::LowPass;

/// Samples the running simulation; noise and codes come at the end, because the paper's noise is
/// relative to the whole record.
#[derive(Clone, Debug)]
pub struct Sampler {
    sensing: Sensing,
    last: Instant,
    filters: [LowPass; 2],
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
            filters: [start.coil_v, start.i_a].map(|x| LowPass::settled(sensing.pole_hz, x)),
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
