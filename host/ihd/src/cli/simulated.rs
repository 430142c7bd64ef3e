//! Options of the simulated hob, shared by the commands that start one.

use anyhow::Result;
use clap::Args;
use ihd_sim::adc::ConverterNoise;
use ihd_sim::contents::PotContents;
use ihd_sim::hob::HobConfig;
use ihd_sim::perturbation::Perturbation;
use ihd_sim::pot::SimulatedPot;
use ihd_sim::recording::settings::LoadKind;
use ihd_survey::mains::RANGE_HZ;

use super::keys;
use super::simulate::LoadWord;
use super::simulate::quantity::quantity;
use super::usage::Usage;

/// Simulated hob on the command line.
#[derive(Debug, Args)]
#[command(next_help_heading = "Simulated hob")]
pub struct SimulatedHobArgs {
    /// Simulated hob: pot, lift, offset, temperature, perturb, load, warming, contents, mains,
    /// bus-capacitance, line-inductance, bench-supply, snr, anti-alias, seed;
    /// `--sim help` explains them
    #[arg(long, value_name = "KEY=VALUE,…", value_parser = keys::text::<SimOptions>())]
    sim: Vec<String>,
    /// Pot on the coil, short for --sim pot=POT
    #[arg(long, value_name = "POT")]
    pot: Option<SimulatedPot>,
}

impl SimulatedHobArgs {
    /// Options, with what is not given by default.
    ///
    /// # Errors
    /// For an unknown key or an invalid value.
    pub fn options(&self) -> Result<SimOptions> {
        let mut texts = self.sim.clone();
        texts.extend(self.pot.map(|pot| format!("pot={pot}")));
        keys::parse("--sim", &texts)
    }

    /// Returns `true` if nothing but a seed is given.
    pub fn is_seed_only(&self) -> bool {
        self.pot.is_none()
            && self
                .sim
                .iter()
                .all(|text| text.starts_with("seed=") && !text.contains(','))
    }

    /// Converts the options to a configuration.
    ///
    /// # Errors
    /// For an unknown key or an invalid value.
    pub fn config(&self) -> Result<HobConfig> {
        self.options()?.config()
    }
}

/// Options of the simulated hob: keys of `--sim`, and of `sim` in the daemon's configuration.
#[derive(Debug, Args)]
pub struct SimOptions {
    /// Pot on the coil: METAL-DIAMETER with ferritic, cast-iron, stainless, aluminium, clad, foil, lid, spoon or ring and 4 to 28 cm, or none.
    #[arg(long, value_name = "POT", default_value = "ferritic-21")]
    pot: SimulatedPot,
    /// Lift the pot, in m (5mm).
    #[arg(long, value_parser = quantity, value_name = "M", default_value = "0")]
    lift: f64,
    /// Move the pot off centre, in m (20mm).
    #[arg(long, value_parser = quantity, value_name = "M", default_value = "0")]
    offset: f64,
    /// Temperature of the pot in °C, with the field model and its table.
    #[arg(long, value_name = "CELSIUS", default_value_t = SimulatedPot::NONE.temperature_c)]
    temperature: f64,
    /// Let the load depart from the standard field model: tail, sharp-knee, rings, fine-gap, ferrite, wall or coil-gap
    /// (docs/simulator.md).
    #[arg(long, value_name = "NAME")]
    perturb: Option<Perturbation>,
    /// Load model: field is the electromagnetic model (35 to 70 times slower than real time), reduced a table fitted to it.
    #[arg(long, value_name = "MODEL", default_value = "behavioural")]
    load: LoadWord,
    /// Let the pot warm up: R and L drift over minutes of simulated time.
    #[arg(long)]
    warming: bool,
    /// Contents of the pot, which then warms up: water-LITRE or oil-LITRE with 0.05 to 10 litre, empty, or food (the one lump of
    /// warming)
    #[arg(long, value_name = "CONTENTS")]
    contents: Option<PotContents>,
    /// Mains frequency in hertz.
    #[arg(long, value_name = "HZ", default_value_t = HobConfig::default().mains_hz)]
    mains: f64,
    /// Capacitance C2 of the DC link in farad (4.7u); 0 for none: the bus is the rectified mains.
    #[arg(long, value_parser = quantity, value_name = "F")]
    bus_capacitance: Option<f64>,
    /// Inductance of the house's line in henry (0.8m); 0 for none.
    #[arg(long, value_parser = quantity, value_name = "H")]
    line_inductance: Option<f64>,
    /// Voltage of a bench supply that feeds the bus instead of the mains of 230 V. A transformer of 24 V then feeds the mains'
    /// detector, as for a first switching on a desk (docs/bring-up.md, section E).
    #[arg(long, value_name = "V")]
    bench_supply: Option<f64>,
    /// White noise on both channels as a signal-to-noise ratio in decibel at 45 kHz and full
    /// power (179 V, 27.7 A rms); without it half an ADC step.
    #[arg(long, value_name = "DB")]
    snr: Option<f64>,
    /// Corner of the anti-alias filters in hertz; 0 for none.
    #[arg(long, value_name = "HZ", default_value_t = HobConfig::default().anti_alias_hz)]
    anti_alias: f64,
    /// Seed of the noise; the same seed gives the same digits [default: 1].
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
}

/// Rms voltage and current at 45 kHz and full power, which `snr` refers to (measured on tests/fixtures/half_cycle, and close to
/// the paper's Table 4).
pub const RATED_RMS: (f64, f64) = (179.1, 27.7);

impl SimOptions {
    /// Pot.
    pub fn pot(&self) -> SimulatedPot {
        SimulatedPot {
            lift_m: self.lift,
            offset_m: self.offset,
            temperature_c: self.temperature,
            perturbation: self.perturb,
            ..self.pot
        }
    }

    /// Seed; `None` if not given.
    pub fn seed(&self) -> Option<u64> {
        self.seed
    }

    /// Options in the form of `sim` in the daemon's configuration.
    #[cfg(feature = "daemon")]
    pub fn table(&self) -> toml::Table {
        use clap::ValueEnum;
        let load = self.load.to_possible_value();
        let given = [
            ("pot", Some(self.pot.to_string())),
            ("lift", Some(self.lift.to_string())),
            ("offset", Some(self.offset.to_string())),
            ("temperature", Some(self.temperature.to_string())),
            ("perturb", self.perturb.map(|p| p.to_string())),
            ("load", load.map(|load| load.get_name().to_owned())),
            ("contents", self.contents.map(|x| x.to_string())),
            ("mains", Some(self.mains.to_string())),
            (
                "bus-capacitance",
                self.bus_capacitance.map(|x| x.to_string()),
            ),
            (
                "line-inductance",
                self.line_inductance.map(|x| x.to_string()),
            ),
            ("bench-supply", self.bench_supply.map(|x| x.to_string())),
            ("snr", self.snr.map(|x| x.to_string())),
            ("anti-alias", Some(self.anti_alias.to_string())),
            ("seed", self.seed.map(|x| x.to_string())),
        ];
        let texts = given.into_iter().filter_map(|(key, text)| {
            let text = toml::Value::String(text?);
            Some((key.to_owned(), text))
        });
        let warming = ("warming".to_owned(), toml::Value::Boolean(self.warming));
        texts.chain([warming]).collect()
    }

    /// Converts the options to a configuration.
    ///
    /// # Errors
    /// If a value is out of its range.
    pub fn config(&self) -> Result<HobConfig> {
        let (least_hz, most_hz) = RANGE_HZ;
        ensure_usage!(
            (least_hz..=most_hz).contains(&self.mains),
            "--sim mains={}: must lie between {least_hz} and {most_hz} Hz",
            self.mains
        );
        ensure_usage!(
            self.anti_alias == 0.0 || (1e5..=1e7).contains(&self.anti_alias),
            "--sim anti-alias={}: must be 0 or lie between 100 kHz and 10 MHz",
            self.anti_alias
        );
        if let Some(supply_v) = self.bench_supply {
            ensure_usage!(
                (5.0..=400.0).contains(&supply_v),
                "--sim bench-supply={supply_v}: must lie between 5 and 400 V"
            );
        }
        let noise = match self.snr {
            None => HobConfig::default().noise,
            Some(db) => {
                ensure_usage!(
                    (10.0..=200.0).contains(&db),
                    "--sim snr={db}: must lie between 10 and 200 dB"
                );
                ConverterNoise::from_snr_db(db, RATED_RMS.0, RATED_RMS.1)
            }
        };
        let pot = self.pot();
        pot.field_settings(0.0).map_err(Usage::from_error)?;
        let formulas = LoadKind::from(self.load) == LoadKind::Behavioural;
        let standard = SimulatedPot {
            diameter_m: pot.diameter_m,
            base: pot.base,
            ..SimulatedPot::NONE
        };
        ensure_usage!(
            !formulas || pot == standard,
            "--sim load=behavioural knows no lift, offset, temperature and perturb: use load=reduced or load=field"
        );
        ensure_usage!(
            self.perturb != Some(Perturbation::Rings)
                || LoadKind::from(self.load) != LoadKind::Field,
            "--sim perturb=rings goes with load=reduced: the rings of the time domain are compiled in"
        );
        let default = HobConfig::default().supply;
        let supply = default.with(self.bus_capacitance, self.line_inductance);
        supply.check().map_err(Usage::from_error)?;
        Ok(HobConfig {
            mains_hz: self.mains,
            supply,
            bench_supply_v: self.bench_supply,
            pot,
            load: self.load.into(),
            warming: self.warming || self.contents.is_some(),
            contents: self.contents.unwrap_or_default(),
            anti_alias_hz: self.anti_alias,
            noise,
            seed: self.seed.unwrap_or(HobConfig::default().seed),
            ..HobConfig::default()
        })
    }
}
