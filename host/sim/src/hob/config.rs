//! Configuration of a simulated hob.

use std::time::{SystemTime, UNIX_EPOCH};

use ihd_shared::board::{self, ANTI_ALIAS_HZ};

use crate::adc::{ConverterNoise, SimulatedAdc};
use crate::behavioural::PotKind;
use crate::contents::PotContents;
use crate::inverter::InverterError;
use crate::inverter::supply::SupplyParts;
use crate::mains::SimulatedMains;
use crate::plant::Plant;
use crate::pot::SimulatedPot;
use crate::recording::settings::LoadKind;
use crate::temperatures::AMBIENT_C;

/// Secondary of the transformer that feeds the mains' detector on a bench, in volt rms.
pub const BENCH_TRANSFORMER_V: f64 = 24.0;

/// Configuration of a simulated hob.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HobConfig {
    /// Mains frequency in hertz.
    pub mains_hz: f64,
    /// Mains voltage in volt rms.
    pub mains_v: f64,
    /// `true` if the mains' line is open.
    pub is_line_open: bool,
    /// Parts between mains and bridge.
    pub supply: SupplyParts,
    /// DC voltage of a bench supply that feeds the bus instead of the mains, in volt, as in docs/bring-up.md; the mains'
    /// detector then sees a transformer of [`BENCH_TRANSFORMER_V`].
    pub bench_supply_v: Option<f64>,
    /// Pot on the coil at the start.
    pub pot: SimulatedPot,
    /// Temperature around the hob, in °C.
    pub ambient_c: f64,
    /// `true` if heat sink, glass and coil have temperature sensors.
    pub ntc: bool,
    /// `true` if the DC link has a current sensor.
    pub dc_link: bool,
    /// Load model.
    pub load: LoadKind,
    /// `true` if the pot warms up, so that R and L drift over minutes.
    pub warming: bool,
    /// Contents of the pot if it warms up.
    pub contents: PotContents,
    /// Conductance from the pot to the glass, as a multiple of a flat base's.
    pub glass_contact: f64,
    /// Corner of the anti-alias filter of both ADC channels in hertz; 0 for none. Without it the
    /// 121st and 123rd harmonics of the voltage's edges alias onto the fundamental and cost up to
    /// 0.6 % of R (measured on tests/fixtures/half_cycle, which have none).
    pub anti_alias_hz: f64,
    /// Noise of the ADC channels.
    pub noise: ConverterNoise,
    /// Seed of the noise.
    pub seed: u64,
    /// Number that distinguishes this boot; `None` for the seed, so that the same run gives the same bytes.
    pub boot: Option<u32>,
    /// Rate of the link in bytes per second of simulated time. USB full speed with single-buffered bulk endpoints reaches a few
    /// hundred kilobytes.
    pub link_bytes_per_s: f64,
}

impl Default for HobConfig {
    fn default() -> Self {
        Self {
            mains_hz: f64::from(board::MAINS_FREQUENCY_HZ),
            mains_v: f64::from(board::MAINS_VOLTAGE_V),
            is_line_open: false,
            supply: SupplyParts::SCHEMATIC,
            bench_supply_v: None,
            ambient_c: AMBIENT_C,
            ntc: true,
            dc_link: false,
            pot: PotKind::Ferromagnetic.into(),
            load: LoadKind::Behavioural,
            warming: false,
            contents: PotContents::default(),
            glass_contact: 1.0,
            anti_alias_hz: f64::from(ANTI_ALIAS_HZ),
            // Half an LSB: what a good 12-bit converter has left.
            noise: ConverterNoise {
                v_v: 0.16,
                i_a: 0.02,
            },
            seed: 1,
            boot: None,
            link_bytes_per_s: 400e3,
        }
    }
}

impl HobConfig {
    /// Power stage of the hob, at a mains zero crossing.
    ///
    /// # Errors
    /// If there is no model of the pot, or no such parts of the supply.
    pub fn plant(&self) -> Result<Plant, InverterError> {
        let adc = SimulatedAdc::of_board(self.noise, self.seed, self.anti_alias_hz);
        let mains_v = match self.bench_supply_v {
            Some(_) => BENCH_TRANSFORMER_V,
            None => self.mains_v,
        };
        let mains = SimulatedMains::new(self.mains_hz).changed(0.0, mains_v, self.mains_hz);
        let mut plant = Plant::assemble(mains, self.pot, self.load, self.supply, adc)?;
        plant.set_line_open(self.is_line_open);
        if let Some(supply_v) = self.bench_supply_v {
            plant.set_bench_supply(supply_v);
        }
        if self.warming {
            plant.enable_warming(self.contents);
        }
        plant.set_glass_contact(self.glass_contact);
        plant.set_surroundings(self.ambient_c, self.ambient_c);
        Ok(plant)
    }

    /// Sets the boot number to the present time: in a process of its own, a host that stores the hob's data must distinguish this
    /// boot from the one before.
    pub fn with_unique_boot(self) -> Self {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH);
        let boot = since_1970.map_or(0, |t| t.as_micros() as u32);
        Self {
            boot: Some(boot),
            ..self
        }
    }
}
