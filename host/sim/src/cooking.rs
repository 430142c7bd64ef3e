//! Simulation of hours of cooking in seconds: the field model's table instead of waveforms, one half-cycle per step.
//!
//! Effects shorter than a half-cycle are omitted. A simple power control replaces the firmware's: a ramp from the highest
//! frequency, a dead band of 1 %, bursts of a second below a least power. R and L have the noise and bias measured for the firmware's
//! filter.

use std::f64::consts::{FRAC_2_PI, PI, TAU};

use ihd_firmware::limits::BURST_POWER_W;
use ihd_shared::hob::{BUS_PEAK_V, F_SW_MAX_HZ, F_SW_MIN_HZ, RESONANCE_CAPACITANCE_NF};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::contents::PotContents;
use crate::inverter::InverterError;
use crate::inverter::load::{AmplitudeLaw, Warmth};
use crate::pot::SimulatedPot;
use crate::recording::prepared::surrogate_pot;
use crate::surrogate::SurrogatePot;
use crate::thermal_model::ThermalModel;
use ihd_shared::hob::WINDING_R_OHM;

/// A half-cycle of 50 Hz, in seconds.
pub const HALF_CYCLE_S: f64 = 0.01;

/// White noise of the firmware's R and L at the crest, relative (host/thermal/tests/it/closed_loop.rs: 0.011 to 0.023 % and
/// 0.006 to 0.008 % over five pots and powers).
const NOISE: (f64, f64) = (2e-4, 8e-5);

/// Amplitude of the bias of R and L over the frequency (aliasing; the same measurement: 0.03 to 0.12 % and 0.001 to 0.012 %), and
/// its period in hertz.
const BIAS: (f64, f64, f64) = (6e-4, 1.2e-4, 6e3);

/// Lowest power without bursts in watt, and period of the bursts in half-cycles.
const BURST: (f64, u32) = (BURST_POWER_W as f64, 100);

/// Largest relative change of frequency between half-cycles, and the power's relative dead band.
const CONTROL: (f64, f64) = (0.033, 0.01);

/// Deviation of a pot from the prediction with nominal numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PotDeviation {
    /// Factors of R and L on the field's.
    pub scale: (f64, f64),
    /// Slopes of R and L over an e-fold of frequency.
    pub slope: (f64, f64),
    /// Additional relative change of resistivity and saturation with heat, beyond the metal's nominal law.
    pub alloy: f64,
    /// Decrease of the lift by the base's bow over 100 K, in metre.
    pub bow_m: f64,
}

/// Report of the device on one half-cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CookingReport {
    /// End of the half-cycle in seconds.
    pub t_s: f64,
    /// Switching frequency in hertz; 0 between bursts.
    pub f_hz: f64,
    /// Amplitude of the current at the crest in ampere.
    pub i_a: f64,
    /// The device's R at the crest in ohm.
    pub r_ohm: f64,
    /// The device's L at the crest in henry.
    pub l_h: f64,
    /// Mean power in watt.
    pub power_w: f64,
}

/// Pot on a hob.
#[derive(Clone, Debug)]
pub struct Cooking {
    pot: SimulatedPot,
    /// Tables at two lifts: between them R and L are exponential within 0.12 % (test), equivalent to 0.02 mm of lift.
    tables: [SurrogatePot; 2],
    lift_m: f64,
    thermal: ThermalModel,
    deviation: PotDeviation,
    asked_w: f64,
    f_hz: f64,
    i_a: f64,
    half_cycle: u32,
    phase: f64,
    rng: ChaCha8Rng,
}

/// Distance between the tables' lifts, in metre.
const LIFTS_M: f64 = 1.5e-3;

impl Cooking {
    /// Places a pot with contents, at its own temperature and lift; the lift may change by up to 1.5 mm from 0. `seed` is of the
    /// bias over the frequency, which is the hob's, and of the noise.
    ///
    /// # Errors
    /// If there is no model of that pot.
    pub fn new(
        pot: SimulatedPot,
        contents: PotContents,
        deviation: PotDeviation,
        seed: u64,
    ) -> Result<Self, InverterError> {
        let at = |lift_m| {
            let cold = SimulatedPot {
                lift_m,
                temperature_c: 20.0,
                ..pot
            };
            surrogate_pot(&cold, WINDING_R_OHM)
        };
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let normal: f64 = StandardNormal.sample(&mut rng);
        Ok(Self {
            pot,
            tables: [at(0.0)?, at(LIFTS_M)?],
            lift_m: pot.lift_m,
            thermal: ThermalModel::new(contents, &pot),
            deviation,
            asked_w: 0.0,
            f_hz: f64::from(F_SW_MAX_HZ),
            i_a: 10.0,
            half_cycle: 0,
            phase: TAU * normal,
            rng,
        })
    }

    /// Gives the same hob the noise of another seed.
    pub fn with_noise(self, seed: u64) -> Self {
        let rng = ChaCha8Rng::seed_from_u64(seed);
        Self { rng, ..self }
    }

    /// Requests a mean power in watt; 0 switches off.
    pub fn set_power(&mut self, asked_w: f64) {
        if self.asked_w <= 0.0 {
            self.f_hz = f64::from(F_SW_MAX_HZ);
        }
        self.asked_w = asked_w;
    }

    /// Sets the pot's height in metre above its usual place: 0 to 1.5 mm.
    pub fn set_lift(&mut self, lift_m: f64) {
        self.lift_m = lift_m;
    }

    /// Height in metre above its usual place.
    pub fn lift_m(&self) -> f64 {
        self.lift_m
    }

    /// True temperatures.
    pub fn thermal(&self) -> &ThermalModel {
        &self.thermal
    }

    /// Time in seconds.
    pub fn t_s(&self) -> f64 {
        f64::from(self.half_cycle) * HALF_CYCLE_S
    }

    /// Simulates the next half-cycle.
    pub fn half_cycle(&mut self) -> CookingReport {
        let in_burst = f64::from(self.half_cycle % BURST.1) / f64::from(BURST.1);
        self.half_cycle += 1;
        let heats = self.asked_w >= BURST.0 || in_burst < self.asked_w / BURST.0;
        if self.asked_w <= 0.0 || !heats {
            self.thermal.advance(0.0, HALF_CYCLE_S);
            return CookingReport {
                t_s: self.t_s(),
                ..CookingReport::default()
            };
        }
        let f_hz = self.f_hz;
        let base_c = self.thermal.temperature_c();
        let laws = self.laws(base_c);
        let crest = self.crest(&laws);
        let (r_ohm, l_h) = laws.r_l(crest);
        self.i_a = crest;
        // Mean of ½ R I² over the envelope.
        let points = 6;
        let power_w = (0..points)
            .map(|k| {
                let i_a = crest * (PI * (f64::from(k) + 0.5) / f64::from(2 * points)).sin();
                0.5 * laws.r_l(i_a).0 * i_a * i_a / f64::from(points)
            })
            .sum::<f64>();
        self.thermal.advance(power_w, HALF_CYCLE_S);
        self.control(power_w);
        let angle = TAU * f_hz / BIAS.2 + self.phase;
        let mut noise = |sigma: f64| {
            let normal: f64 = StandardNormal.sample(&mut self.rng);
            sigma * normal
        };
        CookingReport {
            t_s: f64::from(self.half_cycle) * HALF_CYCLE_S,
            f_hz,
            i_a: crest,
            r_ohm: r_ohm * (1.0 + BIAS.0 * angle.sin() + noise(NOISE.0)),
            l_h: l_h * (1.0 + BIAS.1 * angle.cos() + noise(NOISE.1)),
            power_w,
        }
    }

    fn control(&mut self, power_w: f64) {
        let asked_w = self.asked_w.max(BURST.0);
        let off = power_w / asked_w - 1.0;
        if off.abs() > CONTROL.1 {
            // Power falls about with the third power of the frequency.
            let step = (off / 3.0).clamp(-CONTROL.0, CONTROL.0);
            let (low, high) = (f64::from(F_SW_MIN_HZ), f64::from(F_SW_MAX_HZ));
            self.f_hz = (self.f_hz * (1.0 + step)).clamp(low, high);
        }
    }

    fn laws(&self, base_c: f64) -> Laws {
        let base = self.pot.base.unwrap_or(crate::pot::PotBase::Ferritic);
        let nominal = base.heat_factor(base_c) / base.heat_factor(20.0);
        let factor = nominal.powf(1.0 + self.deviation.alloy);
        let warmth = Warmth::new(factor, WINDING_R_OHM);
        let law_hz = warmth.law_hz(self.f_hz);
        let law = |table: &SurrogatePot| AmplitudeLaw::Surrogate(Box::new(table.at(law_hz)));
        let [low, high] = &self.tables;
        let bow_m = self.deviation.bow_m * (base_c - 20.0) / 100.0;
        let log = (self.f_hz / 50e3).ln();
        let (scale, slope) = (self.deviation.scale, self.deviation.slope);
        Laws {
            low: law(low),
            high: law(high),
            weight: (self.lift_m - bow_m) / LIFTS_M,
            warmth,
            factors: (1.0 + scale.0 + slope.0 * log, 1.0 + scale.1 + slope.1 * log),
        }
    }

    /// Amplitude at the mains' crest, from the tank and the bridge's fundamental.
    fn crest(&self, laws: &Laws) -> f64 {
        let omega = TAU * self.f_hz;
        let x_c = 1e9 / (omega * f64::from(RESONANCE_CAPACITANCE_NF));
        let v = FRAC_2_PI * BUS_PEAK_V;
        let mut i_a = self.i_a;
        for _ in 0..50 {
            let (r, l) = laws.r_l(i_a);
            let next = v / r.hypot(omega * l - x_c);
            let change = next - i_a;
            i_a += 0.7 * change;
            if change.abs() < 1e-4 {
                break;
            }
        }
        i_a
    }
}

/// R and L over current, at one frequency, temperature and lift.
struct Laws {
    low: AmplitudeLaw,
    high: AmplitudeLaw,
    weight: f64,
    warmth: Warmth,
    factors: (f64, f64),
}

impl Laws {
    fn r_l(&self, i_a: f64) -> (f64, f64) {
        let (low, high) = (
            self.warmth.bend(self.low.r_l(i_a)),
            self.warmth.bend(self.high.r_l(i_a)),
        );
        // R and L of a lifted pot are nearly exponential in the lift.
        let mix = |a: f64, b: f64| a * (b / a).powf(self.weight);
        (
            self.factors.0 * mix(low.0, high.0),
            self.factors.1 * mix(low.1, high.1),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hob::{HobConfig, SimHob};
    use crate::recording::settings::LoadKind;

    #[test]
    fn it_draws_what_is_asked_for_at_the_frequency_of_the_firmware() {
        let pot: SimulatedPot = "ferritic-21".parse().unwrap();
        let mut hob = SimHob::new(&HobConfig {
            load: LoadKind::Surrogate,
            pot,
            ..HobConfig::default()
        });
        hob.panel(crate::hob::PanelEvent::Level(7));
        let mut heated = None;
        while hob.t_s() < 3.0 {
            hob.step();
            heated = hob.take_reading().or(heated);
        }
        let heated = heated.unwrap();
        let mut fast = Cooking::new(pot, PotContents::Food, PotDeviation::default(), 1).unwrap();
        fast.set_power(heated.power_w());
        let cooked = (0..100).map(|_| fast.half_cycle()).last().unwrap();
        println!("{heated:?} {cooked:?}");
        // Sinusoidal half-cycles and no losses in the bridge; the peak has the harmonics, the amplitude has not.
        assert!(heated.power_w() > 800.0, "{heated:?}");
        assert!(
            (cooked.i_a / heated.i_peak_a - 1.0).abs() < 0.12,
            "{heated:?} {cooked:?}"
        );
        assert!(
            (cooked.power_w / heated.power_w() - 1.0).abs() < 0.02,
            "{heated:?} {cooked:?}"
        );
    }

    #[test]
    fn another_seeds_noise_leaves_the_hobs_bias() {
        let pot = SimulatedPot::new(crate::pot::PotBase::Ferritic, 0.18);
        let mean = |noise| {
            let hob = Cooking::new(pot, PotContents::Food, PotDeviation::default(), 1).unwrap();
            let mut hob = hob.with_noise(noise);
            hob.set_power(1500.0);
            let r_ohm = (0..400).map(|_| hob.half_cycle().r_ohm);
            let r_ohm: Vec<f64> = r_ohm.collect();
            (r_ohm[0], r_ohm.iter().sum::<f64>() / 400.0)
        };
        let (one, other) = (mean(2), mean(3));
        assert_ne!(one.0, other.0);
        // Five deviations of the difference of two means of 400.
        let limit = 5.0 * NOISE.0 * (2.0f64 / 400.0).sqrt();
        assert!((one.1 / other.1 - 1.0).abs() < limit, "{one:?} {other:?}");
    }

    #[test]
    fn between_its_lifts_it_is_the_field() {
        let pot = |lift_m| SimulatedPot {
            lift_m,
            ..SimulatedPot::new(crate::pot::PotBase::Ferritic, 0.18)
        };
        let mut fast =
            Cooking::new(pot(0.7e-3), PotContents::Food, PotDeviation::default(), 1).unwrap();
        fast.f_hz = 45e3;
        let exact = surrogate_pot(&pot(0.7e-3), WINDING_R_OHM).unwrap().at(45e3);
        for i_a in [5.0, 40.0] {
            let (found, truth) = (fast.laws(20.0).r_l(i_a), exact.r_l(i_a));
            assert!(
                (found.0 / truth.0 - 1.0).abs() < 2e-3,
                "{found:?} {truth:?}"
            );
            assert!(
                (found.1 / truth.1 - 1.0).abs() < 2e-3,
                "{found:?} {truth:?}"
            );
        }
    }

    #[test]
    fn its_heat_is_that_of_the_simulated_hob() {
        let config = HobConfig {
            load: LoadKind::Surrogate,
            warming: true,
            contents: PotContents::Water(0.5),
            ..HobConfig::default()
        };
        let mut hob = SimHob::new(&config);
        hob.panel(crate::hob::PanelEvent::Level(7));
        let mut energy_j = 0.0;
        while hob.t_s() < 3.0 {
            hob.step();
            if let Some(r) = hob.take_reading() {
                energy_j += r.energy_j - WINDING_R_OHM * r.i_square_a2 * r.duration_s;
            }
        }
        let mut thermal = ThermalModel::new(PotContents::Water(0.5), &config.pot);
        thermal.advance(energy_j / 2.5, 2.5);
        let hob_c = hob.thermal().unwrap().temperature_c();
        assert!(energy_j > 1.5e3, "{energy_j}");
        assert!(
            (hob_c - thermal.temperature_c()).abs() < 0.5,
            "{hob_c} {thermal:?}"
        );
    }
}
