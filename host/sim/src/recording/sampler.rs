//! Conversion of coil voltage and current to ADC codes: disturbances, filter, sampling, noise, quantising.

use std::f64::consts::TAU;

use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q};
use ihd_signal::noise::rms;
use ihd_signal::quantise::code;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::sensing::{Rate, Sensing};
use crate::adc::ConverterNoise;
use crate::inverter::Instant;
use crate::low_pass::LowPass;

/// Sampler of the running simulation. Noise and codes are added at the end, because the paper's noise is relative to the whole
/// record.
#[derive(Clone, Debug)]
pub struct Sampler {
    sensing: Sensing,
    last: Instant,
    /// Anti-alias filter of each channel.
    filters: [LowPass; 2],
    probes: Probes,
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
    /// Creates a sampler whose first sample is the given instant.
    pub fn new(sensing: &Sensing, start: Instant) -> Self {
        Self {
            sensing: sensing.clone(),
            last: start,
            filters: [start.coil_v, start.i_a].map(|x| LowPass::settled(sensing.pole_hz, x)),
            probes: Probes::new(sensing, start),
            ring: (0.0, 0.0),
            next_v_s: start.t_s,
            next_i_s: start.t_s + sensing.skew_s,
            t_s: Vec::new(),
            v_v: Vec::new(),
            i_a: Vec::new(),
        }
    }

    /// Adds the next instant of the simulation.
    pub fn push(&mut self, now: Instant, f_sw_hz: f64) {
        let dt_s = now.t_s - self.last.t_s;
        let before = self.filters.map(|f| f.output());
        self.advance_ringing(now.bridge_v - self.last.bridge_v, dt_s);
        let inputs = (self.probes).advance(&self.sensing, now.coil_v + self.ring.1, now.i_a, dt_s);
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

    /// Advances the damped oscillation that the bridge's edges excite; its value is the imaginary part.
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

    /// Removes samples from `end_s` on.
    pub fn cut(&mut self, end_s: f64) {
        let before = self.t_s.partition_point(|t| *t < end_s);
        let n = before.min(self.v_v.len()).min(self.i_a.len());
        self.t_s.truncate(n);
        self.v_v.truncate(n);
        self.i_a.truncate(n);
    }

    /// Adds gain, offset, noise and spikes, and converts to codes of voltage and current.
    pub fn finish(&self, seed: u64) -> (Vec<i16>, Vec<i16>) {
        convert(&self.sensing, &self.t_s, &self.v_v, &self.i_a, seed)
    }
}

/// Input stages of the channels before the anti-alias filters.
#[derive(Clone, Copy, Debug)]
struct Probes {
    poles: [LowPass; 2],
    /// Low-passed input, which the droop subtracts.
    droop: LowPass,
}

impl Probes {
    fn new(sensing: &Sensing, start: Instant) -> Self {
        let i_a = saturated(start.i_a, sensing.i_saturation_a);
        Self {
            poles: [
                LowPass::settled(sensing.v_pole_hz, start.coil_v),
                LowPass::settled(sensing.i_pole_hz, i_a),
            ],
            droop: LowPass::settled(sensing.i_droop_hz, 0.0),
        }
    }

    fn advance(&mut self, sensing: &Sensing, v_v: f64, i_a: f64, dt_s: f64) -> [f64; 2] {
        let mut seen_a = saturated(i_a, sensing.i_saturation_a);
        if sensing.i_droop_hz != 0.0 {
            seen_a -= self.droop.advance(seen_a, dt_s);
        }
        let [v, i] = &mut self.poles;
        [v.advance(v_v, dt_s), i.advance(seen_a, dt_s)]
    }
}

/// s·tanh(i/s); `saturation_a` of 0 means none.
fn saturated(i_a: f64, saturation_a: f64) -> f64 {
    if saturation_a == 0.0 {
        i_a
    } else {
        saturation_a * libm::tanh(i_a / saturation_a)
    }
}

/// Adds gain, offset, noise and spikes by `seed` to the output of the analogue chain of `s` at `t_s`, and converts to codes of
/// voltage and current.
pub fn convert(
    s: &Sensing,
    t_s: &[f64],
    v_v: &[f64],
    i_a: &[f64],
    seed: u64,
) -> (Vec<i16>, Vec<i16>) {
    let n = v_v.len().min(i_a.len());
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let noise = s.snr_db.map_or(ConverterNoise::default(), |snr| {
        ConverterNoise::from_snr_db(snr, rms(&v_v[..n]), rms(&i_a[..n]))
    });
    let span_s = t_s.last().map_or(0.0, |t| t - t_s[0]);
    let spike_chance = s.spikes_per_s * span_s / n.max(1) as f64;
    let codes = f64::from(1u32 << (s.bits - 1));
    let mut convert_one = |x: f64, gain: f64, offset: f64, sigma: f64, full_scale: f64| {
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
            let v = convert_one(v_v[k], s.v_gain, s.v_offset_v, noise.v_v, s.v_full_scale_v);
            let i = convert_one(i_a[k], s.i_gain, s.i_offset_a, noise.i_a, s.i_full_scale_a);
            (v, i)
        })
        .unzip()
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

    /// A sine of 1 A at 50 kHz behind first-order corners of its own: the textbook's gain and phase, and
    /// the other channel as it was.
    #[test]
    fn own_poles_and_droop_bend_one_channel_alone() {
        let s = Sensing {
            v_pole_hz: 200e3,
            i_droop_hz: 5e3,
            rate: Rate::Hz(25e6),
            ..Sensing::default()
        };
        let got = sampled(&s);
        let (low, high): (f64, f64) = (50.0 / 200.0, 5.0 / 50.0);
        for k in 3000..4900 {
            let angle = TAU * 50e3 * got.t_s[k];
            let v = (angle - low.atan()).sin() / low.hypot(1.0);
            let i = (angle + high.atan()).sin() / high.hypot(1.0);
            assert!((got.v_v[k] - v).abs() < 1e-4, "{} {v}", got.v_v[k]);
            // The high pass has e^(−2π · 5 kHz · 120 µs) = 2 % of its beginning left.
            assert!((got.i_a[k] - i).abs() < 3e-3, "{} {i}", got.i_a[k]);
        }
    }

    #[test]
    fn a_saturating_probe_compresses_crests_and_leaves_small_currents() {
        let s = Sensing {
            i_saturation_a: 1.0,
            ..Sensing::default()
        };
        let got = sampled(&s);
        let crest = got.i_a.iter().copied().fold(0.0, f64::max);
        assert!((crest - 1f64.tanh()).abs() < 1e-4, "{crest}");
        let slope = (got.i_a[1] - got.i_a[0]) / (got.t_s[1] - got.t_s[0]);
        assert!((slope / (TAU * 50e3) - 1.0).abs() < 1e-3, "{slope}");
        assert!((got.v_v.iter().copied().fold(0.0, f64::max) - 1.0).abs() < 1e-4);
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
