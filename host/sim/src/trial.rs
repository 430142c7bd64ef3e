//! Captures with truth for studies and tests: simulated once per operating point, with noise added per seed, as in the paper
//! (section V.A).

use ihd_signal::Segment;
use ihd_signal::noise::rms;
use ihd_signal::truth::PeriodTruth;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::adc::ConverterNoise;
use crate::inverter::InverterError;
use crate::recording::prepared::field_models;
use crate::recording::run::record;
use crate::recording::settings::{CaptureSpec, LoadKind};
use crate::surrogate::exact;

/// Capture without noise, and its truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    /// Samples before noise and quantising.
    pub clean: Segment,
    /// Truth, one entry a switching period.
    pub truth: Vec<PeriodTruth>,
    /// Settings of the recording.
    spec: CaptureSpec,
}

impl Trial {
    /// Simulates one mains cycle (20 ms at 50 Hz) of the paper's operating point, 50 MS/s.
    ///
    /// # Errors
    /// [`InverterError`] for a frequency outside 20 to 100 kHz.
    pub fn simulate(load: LoadKind, f_sw_hz: f64) -> Result<Self, InverterError> {
        Self::record(&CaptureSpec {
            load,
            f_sw_hz,
            ..CaptureSpec::default()
        })
    }

    /// Simulates a recording with a fixed sampling rate.
    ///
    /// # Errors
    /// [`InverterError`] for invalid settings.
    pub fn record(settings: &CaptureSpec) -> Result<Self, InverterError> {
        let recording = record(settings, |_| ())?;
        Ok(Self {
            clean: recording.clean_segment(),
            truth: recording.truth,
            spec: settings.clone(),
        })
    }

    /// Returns the truth with R and L of the fundamental from the describing function at each period's current: the values that a
    /// sinusoidal current of that amplitude would see.
    ///
    /// # Errors
    /// [`InverterError`] if the field model has no solution.
    pub fn describing(&self) -> Result<Vec<PeriodTruth>, InverterError> {
        let models = field_models(&self.spec.pot, self.spec.winding_r_ohm)?;
        let mut found = self.truth.clone();
        for period in &mut found {
            let z = exact(&models, period.f_sw_hz, period.i_a)?;
            (period.r_ohm[0], period.l_h[0]) = (z.r_ohm, z.l_h);
        }
        Ok(found)
    }

    /// Adds white noise of an SNR in decibel to both channels, σ² = P_signal/10^(SNR/10) over the whole capture; no noise without
    /// `snr_db`.
    pub fn noisy(&self, snr_db: Option<f64>, seed: u64) -> Segment {
        let Some(snr_db) = snr_db else {
            return self.clean.clone();
        };
        let noise = ConverterNoise::from_snr_db(snr_db, rms(&self.clean.v_v), rms(&self.clean.i_a));
        self.with_noise(noise, seed)
    }

    /// Adds white noise of these deviations.
    pub fn with_noise(&self, noise: ConverterNoise, seed: u64) -> Segment {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut add = |x: &[f64], sigma: f64| {
            let noisy = |x: &f64| {
                let normal: f64 = StandardNormal.sample(&mut rng);
                x + sigma * normal
            };
            x.iter().map(noisy).collect()
        };
        let v_v = add(&self.clean.v_v, noise.v_v);
        let i_a = add(&self.clean.i_a, noise.i_a);
        self.clean.with_samples(v_v, i_a)
    }
}
