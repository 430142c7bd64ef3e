//! The two ADC channels: current transformer, anti-alias filter, noise, 12-bit codes, saturation.

use std::f64::consts::TAU;

use ihd_shared::sampling::{
    AMPERE_PER_CODE, CODE_HALF_RANGE, CURRENT_TRANSFORMER_TAU_US, Pair, VOLT_PER_CODE,
};
use ihd_signal::quantise::code;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::inverter::Instant;
use super::low_pass::LowPass;

/// Resolution of the board's converters.
const BITS: u32 = 12;

const _: () = assert!(CODE_HALF_RANGE == 1 << (BITS - 1));

/// Time from the beginning of a sampling period to the hold of both channels, in seconds, as the program sets up the chip: HRTIM's
/// compare 3 of 0x60 ticks, then 2.125 cycles of trigger latency and 2.5 of sampling at 42.5 MHz.
pub const HOLD_DELAY_S: f64 = 0x60 as f64 / 1.36e9 + (2.125 + 2.5) / 42.5e6;

/// White noise of the two channels, standard deviations.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ConverterNoise {
    /// Standard deviation of the voltage, in volt.
    pub v_v: f64,
    /// Standard deviation of the current, in ampere.
    pub i_a: f64,
}

impl ConverterNoise {
    /// Noise of a signal-to-noise ratio in decibel over signals of the given rms values, by the
    /// paper's definition σ² = P_signal / 10^(SNR/10).
    pub fn from_snr_db(snr_db: f64, v_rms_v: f64, i_rms_a: f64) -> Self {
        let ratio = libm::pow(10.0, -snr_db / 20.0);
        Self {
            v_v: v_rms_v * ratio,
            i_a: i_rms_a * ratio,
        }
    }
}

/// Current transformer, and the anti-alias filters of coil voltage and current.
#[derive(Clone, Copy, Debug)]
pub struct SensorFilters {
    /// Magnetising current of the transformer as the primary's, in ampere, which the secondary lacks: the low pass that its high
    /// pass leaves; `None` for a sensor that shows direct current.
    magnetising: Option<LowPass>,
    filters: [LowPass; 2],
}

impl SensorFilters {
    /// Creates filters at rest with a corner in hertz; 0 passes everything.
    fn new(corner_hz: f64) -> Self {
        Self {
            magnetising: None,
            filters: [LowPass::settled(corner_hz, 0.0); 2],
        }
    }

    /// Sets the duration of a step, in seconds.
    pub fn set_step(&mut self, dt_s: f64) {
        let filters = self.filters.iter_mut().chain(&mut self.magnetising);
        filters.for_each(|filter| filter.set_step(dt_s));
    }

    /// Advances by a step that ends with these coil voltage and current.
    #[inline(always)]
    pub fn step(&mut self, now: &Instant) {
        self.filters[0].step_mean(now.coil_mean_v, now.coil_v);
        let mut i_a = now.i_a;
        if let Some(magnetising) = &mut self.magnetising {
            magnetising.step(i_a);
            i_a -= magnetising.output();
        }
        self.filters[1].step(i_a);
    }

    /// Present outputs: voltage in volt, and current in ampere, at the pin of the comparators.
    #[inline(always)]
    pub fn outputs(&self) -> [f64; 2] {
        self.filters.map(|filter| filter.output())
    }

    /// Ends outputs that have decayed.
    pub fn end_decay(&mut self) {
        let filters = self.filters.iter_mut().chain(&mut self.magnetising);
        filters.for_each(LowPass::end_decay);
    }
}

/// Sampler; deterministic for a seed.
#[derive(Clone, Debug)]
pub struct SimulatedAdc {
    noise: ConverterNoise,
    rng: ChaCha8Rng,
    /// Sensors and filters before it.
    pub filters: SensorFilters,
}

impl SimulatedAdc {
    /// Creates an ADC with a noise and a seed.
    pub fn new(noise: ConverterNoise, seed: u64) -> Self {
        Self {
            noise,
            rng: ChaCha8Rng::seed_from_u64(seed),
            filters: SensorFilters::new(0.0),
        }
    }

    /// Creates the ADC of this build's board with a noise and a seed: behind its current transformer, and anti-alias filters with a
    /// corner in hertz, 0 for none.
    pub fn of_board(noise: ConverterNoise, seed: u64, anti_alias_hz: f64) -> Self {
        let corner_hz = 1e6 / (TAU * f64::from(CURRENT_TRANSFORMER_TAU_US));
        Self {
            filters: SensorFilters {
                magnetising: Some(LowPass::settled(corner_hz, 0.0)),
                ..SensorFilters::new(anti_alias_hz)
            },
            ..Self::new(noise, seed)
        }
    }

    /// Converts one pair of voltage in volt and current in ampere.
    pub fn convert(&mut self, v_v: f64, i_a: f64) -> Pair {
        let mut noisy = |value: f64, sigma: f64| {
            if sigma > 0.0 {
                let normal: f64 = StandardNormal.sample(&mut self.rng);
                value + sigma * normal
            } else {
                value
            }
        };
        Pair {
            v: code(noisy(v_v, self.noise.v_v) / VOLT_PER_CODE, BITS),
            i: code(noisy(i_a, self.noise.i_a) / AMPERE_PER_CODE, BITS),
        }
    }
}

#[cfg(test)]
mod tests {
    use ihd_shared::sampling::{CODE_MAX, CODE_MIN};

    use super::*;
    use ihd_shared::sampling::{I_FULL_SCALE_A, V_FULL_SCALE_V};

    /// 600 V over 258.1 kΩ in 665 Ω are 1.54591 V of 3.3 V, 76.07 A over 200 in 4.12 Ω are 1.56704 V.
    #[test]
    fn codes_are_those_of_the_schematics_parts() {
        let mut adc = SimulatedAdc::new(ConverterNoise::default(), 0);
        for (v_v, i_a) in [(600.0, 76.07), (-600.0, -76.07)] {
            let sign = f64::signum(v_v);
            let (pin_v, pin_i) = (600.0 * 665.0 / 258.1e3, 76.07 / 200.0 * 4.12);
            let [v, i] = [pin_v, pin_i].map(|pin| (sign * pin / 3.3 * 4_096.0).round() as i16);
            assert_eq!(adc.convert(v_v, i_a), Pair { v, i });
        }
    }

    #[test]
    fn codes_round_and_saturate() {
        let mut adc = SimulatedAdc::new(ConverterNoise::default(), 0);
        assert_eq!(
            adc.convert(V_FULL_SCALE_V, -I_FULL_SCALE_A),
            Pair {
                v: CODE_MAX,
                i: CODE_MIN
            }
        );
        assert_eq!(adc.convert(1.4 * VOLT_PER_CODE, 0.0), Pair { v: 1, i: 0 });
        assert!(adc.convert(f64::NAN, 0.0).is_saturated());
        assert!(adc.convert(0.0, f64::INFINITY).is_saturated());
    }

    /// 7.12 Ω over ω · 80 mH: the secondary's current leads by 0.417 mrad at 34 kHz, and a direct one decays in 11.24 ms.
    #[test]
    fn the_current_transformer_leads_and_shows_no_direct_current() {
        let board = || SimulatedAdc::of_board(ConverterNoise::default(), 0, 0.0).filters;
        let instant = |i_a| Instant {
            i_a,
            ..Instant::default()
        };
        let (mut ac, steps) = (board(), 400);
        let step_rad = TAU / f64::from(steps);
        ac.set_step(step_rad / (TAU * 34e3));
        let mut lead = [0.0; 2];
        // From the crest on no direct current comes in.
        for k in 1..=20 * steps {
            let (sin, cos) = (step_rad * f64::from(k)).sin_cos();
            ac.step(&instant(cos));
            if k > 19 * steps {
                let i_a = ac.outputs()[1];
                lead = [lead[0] - i_a * sin, lead[1] + i_a * cos];
            }
        }
        let lead_mrad = 1e3 * lead[0].atan2(lead[1]);
        assert!((lead_mrad - 0.4166).abs() < 1e-3, "{lead_mrad}");
        let mut dc = board();
        dc.set_step(11.236e-6);
        (0..=1_000).for_each(|_| dc.step(&instant(50.0)));
        let left = dc.outputs()[1] / 50.0;
        assert!((left / (-1f64).exp() - 1.0).abs() < 2e-3, "{left}");
    }

    #[test]
    fn noise_has_the_stated_ratio_and_repeats_with_its_seed() {
        let noise = ConverterNoise::from_snr_db(30.0, 178.0, 20.0);
        assert!((noise.v_v / 178.0 - 0.031_622_8).abs() < 1e-6);
        let run = |seed| {
            let mut adc = SimulatedAdc::new(noise, seed);
            (0..20_000)
                .map(|_| adc.convert(0.0, 0.0))
                .collect::<Vec<_>>()
        };
        let pairs = run(1);
        let rms = |channel: fn(&Pair) -> f64| {
            (pairs.iter().map(|p| channel(p).powi(2)).sum::<f64>() / pairs.len() as f64).sqrt()
        };
        assert!((rms(|p| f64::from(p.v) * VOLT_PER_CODE) / noise.v_v - 1.0).abs() < 0.02);
        assert!((rms(|p| f64::from(p.i) * AMPERE_PER_CODE) / noise.i_a - 1.0).abs() < 0.02);
        assert_eq!(pairs, run(1));
        assert_ne!(pairs, run(2));
    }
}
