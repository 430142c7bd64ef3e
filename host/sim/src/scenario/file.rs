//! Format of a scenario file.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use serde::de::{MapAccess, Visitor, value::MapAccessDeserializer};
use serde::{Deserialize, Deserializer};
use toml::Spanned;

use super::limits::Limits;
use super::{ScenarioError, number};
use crate::adc::ConverterNoise;
use crate::contents::PotContents;
use crate::hob::HobConfig;
use crate::injection::{FaultChannel, InjectionKind};
use crate::pot::SimulatedPot;
use crate::recording::settings::LoadKind;

/// Scenario. Unknown fields are rejected.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScenarioFile {
    /// Title for a table of scenarios.
    #[serde(default)]
    pub title: String,
    /// Length, in seconds.
    #[serde(deserialize_with = "number::duration_s")]
    pub duration_s: f64,
    /// Load model.
    #[serde(default = "reduced")]
    pub load: LoadKind,
    /// Seed of the noise.
    #[serde(default = "one")]
    pub seed: u64,
    /// The mains at the start.
    #[serde(default)]
    pub mains: MainsField,
    /// Pot on the coil at the start.
    #[serde(default)]
    pub pot: PotField,
    /// `true` if the pot warms up.
    #[serde(default)]
    pub warming: bool,
    /// Contents of the pot, which then warms up: `water-1.5`, `oil-0.5`, `food`, `empty`.
    #[serde(default)]
    pub contents: Option<PotContents>,
    /// Conductance from the pot to the glass, as a multiple of a flat base's: 0.1 to 3, default 1.
    #[serde(default, deserialize_with = "number::some_contact")]
    pub glass_contact: Option<f64>,
    /// Bus capacitance in microfarad, 0 for none; default: the hob's.
    #[serde(default, deserialize_with = "number::some_bus_uf")]
    pub bus_capacitance_uf: Option<f64>,
    /// Inductance of the line in microhenry, 0 for none; default: the hob's.
    #[serde(default, deserialize_with = "number::some_line_uh")]
    pub line_inductance_uh: Option<f64>,
    /// `true` if the board has a sensor of the DC link's current.
    #[serde(default)]
    pub dc_link: bool,
    /// `true` if a panel is fitted; without one, events of the panel are invalid.
    #[serde(default = "yes")]
    pub panel: bool,
    /// `true` if heat sink, glass and coil have temperature sensors; default: they have.
    #[serde(default)]
    pub ntc: Option<bool>,
    /// Temperature around the hob in °C; default 25.
    #[serde(default, deserialize_with = "number::some_temperature_c")]
    pub ambient_c: Option<f64>,
    /// Corner of the anti-alias filters in hertz, 0 for none.
    #[serde(default, deserialize_with = "number::some_corner_hz")]
    pub anti_alias_hz: Option<f64>,
    /// Noise of the fast channels; default half a code.
    #[serde(default)]
    pub noise: Option<NoiseField>,
    /// Time limit of the device's search for a pot, in seconds; default: the device's.
    #[serde(default, deserialize_with = "number::some_give_up_s")]
    pub give_up_s: Option<f64>,
    /// Change of the frequency between half-cycles, in permille; default: none.
    #[serde(default, deserialize_with = "number::some_permille")]
    pub dither_permille: Option<f64>,
    /// Events, in any order.
    #[serde(default)]
    pub event: Vec<Spanned<EventField>>,
    /// Limits on the record.
    #[serde(default)]
    pub limits: Limits,
    /// Values that [`variants`](super::variants::read) inserts into the file, by path; ignored by a run.
    #[serde(default)]
    pub matrix: Vec<BTreeMap<String, Vec<toml::Value>>>,
}

impl ScenarioFile {
    /// Configuration of the hob from the file's head.
    pub fn hob(&self) -> HobConfig {
        let usual = HobConfig::default();
        HobConfig {
            mains_hz: self.mains.hz.unwrap_or(usual.mains_hz),
            mains_v: self.mains.v_rms.unwrap_or(usual.mains_v),
            is_line_open: self.mains.open.unwrap_or(usual.is_line_open),
            supply: usual.supply.with(
                self.bus_capacitance_uf.map(|uf| uf * 1e-6),
                self.line_inductance_uh.map(|uh| uh * 1e-6),
            ),
            pot: self.pot.pot,
            load: self.load,
            warming: self.warming || self.contents.is_some(),
            contents: self.contents.unwrap_or_default(),
            glass_contact: self.glass_contact.unwrap_or(usual.glass_contact),
            ambient_c: self.ambient_c.unwrap_or(usual.ambient_c),
            ntc: self.ntc.unwrap_or(usual.ntc),
            dc_link: self.dc_link,
            anti_alias_hz: self.anti_alias_hz.unwrap_or(usual.anti_alias_hz),
            noise: self.noise.map_or(usual.noise, |n| ConverterNoise {
                v_v: n.v_v,
                i_a: n.i_a,
            }),
            seed: self.seed,
            ..usual
        }
    }
}

fn reduced() -> LoadKind {
    LoadKind::Surrogate
}

fn yes() -> bool {
    true
}

fn one() -> u64 {
    1
}

/// White noise, standard deviations.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoiseField {
    /// Standard deviation of the voltage channel, in volt.
    #[serde(default, deserialize_with = "number::noise_v")]
    pub v_v: f64,
    /// Standard deviation of the current channel, in ampere.
    #[serde(default, deserialize_with = "number::noise_a")]
    pub i_a: f64,
}

/// Mains; missing fields keep their values.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MainsField {
    /// Voltage in volt rms; 0 is the dropout of IEC 61000-4-11, a short circuit behind the line.
    #[serde(default, deserialize_with = "number::some_v_rms")]
    pub v_rms: Option<f64>,
    /// `true` for an open line, as with the plug pulled.
    #[serde(default)]
    pub open: Option<bool>,
    /// Frequency in hertz.
    #[serde(default, deserialize_with = "number::some_hz")]
    pub hz: Option<f64>,
    /// In an event: duration in seconds, then restored.
    #[serde(default, deserialize_with = "number::some_time_s")]
    pub for_s: Option<f64>,
}

/// Pot and its place: a table, or just its name.
#[derive(Clone, Copy, Debug)]
pub struct PotField {
    /// The pot.
    pub pot: SimulatedPot,
    /// In an event: duration in seconds, then restored.
    pub for_s: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PotTable {
    #[serde(deserialize_with = "named_pot")]
    name: SimulatedPot,
    #[serde(default, deserialize_with = "number::lift_mm")]
    lift_mm: f64,
    #[serde(default, deserialize_with = "number::offset_mm")]
    offset_mm: f64,
    #[serde(default, deserialize_with = "number::some_temperature_c")]
    temperature_c: Option<f64>,
    #[serde(default, deserialize_with = "number::some_time_s")]
    for_s: Option<f64>,
}

fn named_pot<'de, D: Deserializer<'de>>(from: D) -> Result<SimulatedPot, D::Error> {
    let name = String::deserialize(from)?;
    name.parse().map_err(serde::de::Error::custom)
}

fn some_named_pot<'de, D: Deserializer<'de>>(from: D) -> Result<Option<SimulatedPot>, D::Error> {
    named_pot(from).map(Some)
}

impl Default for PotField {
    fn default() -> Self {
        Self {
            pot: SimulatedPot::new(crate::pot::PotBase::Ferritic, 0.21),
            for_s: None,
        }
    }
}

impl From<PotTable> for PotField {
    fn from(table: PotTable) -> Self {
        let pot = SimulatedPot {
            lift_m: table.lift_mm * 1e-3,
            offset_m: table.offset_mm * 1e-3,
            temperature_c: table.temperature_c.unwrap_or(table.name.temperature_c),
            ..table.name
        };
        Self {
            pot,
            for_s: table.for_s,
        }
    }
}

impl<'de> Deserialize<'de> for PotField {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Either;
        impl<'de> Visitor<'de> for Either {
            type Value = PotField;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a pot's name, or a table of name, lift_mm, offset_mm and for_s")
            }
            fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<PotField, E> {
                let pot = name.parse().map_err(E::custom)?;
                Ok(PotField { pot, for_s: None })
            }
            fn visit_map<M: MapAccess<'de>>(self, map: M) -> Result<PotField, M::Error> {
                PotTable::deserialize(MapAccessDeserializer::new(map)).map(PotField::from)
            }
        }
        from.deserialize_any(Either)
    }
}

/// Action of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HostWord {
    /// Sends nothing until the next event that makes it send.
    Silent,
    /// Clears the fault.
    ClearFault,
    /// Clears the fault repeatedly, every `every_s`.
    ClearFaultEvery,
    /// Pushes a lookup from `file`, one of a constant `r_ohm` and `l_uh`, or that of the pot `of_pot`.
    PushLookup,
    /// Restores the device's built-in lookup.
    ResetLookup,
    /// Requests `power_w` repeatedly, every `every_s`; with `toggle` alternating with 0.
    SetPowerEvery,
}

/// Event: a time and at least one more field.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EventField {
    /// Time in seconds after the start.
    #[serde(deserialize_with = "number::time_s")]
    pub at_s: f64,
    /// Duration in seconds, for mains, pot, inject and repeated actions of the host; then restored.
    #[serde(default, deserialize_with = "number::some_time_s")]
    pub for_s: Option<f64>,
    /// Power requested by the host, in watt.
    #[serde(default, deserialize_with = "number::some_power_w")]
    pub power_w: Option<f64>,
    /// New pot, or the same at another place.
    pub pot: Option<PotField>,
    /// New mains.
    pub mains: Option<MainsField>,
    /// A user sets the panel's power level: 0 (off) to 9.
    #[serde(default, deserialize_with = "number::some_level")]
    pub panel: Option<f64>,
    /// A user sets the panel to keep warm (`true`).
    pub keep_warm: Option<bool>,
    /// A user sets the panel's timer, in minutes; 0 takes it back.
    #[serde(default, deserialize_with = "number::some_timer_min")]
    pub timer_min: Option<f64>,
    /// A user locks the panel's keys (`true`) or unlocks them.
    pub key_lock: Option<bool>,
    /// Minutes that pass at once for the times of cooking.
    #[serde(default, deserialize_with = "number::some_pass_min")]
    pub pass_min: Option<f64>,
    /// New temperature around the hob, in °C.
    #[serde(default, deserialize_with = "number::some_temperature_c")]
    pub ambient_c: Option<f64>,
    /// New temperature of the heat sink, in °C.
    #[serde(default, deserialize_with = "number::some_temperature_c")]
    pub heat_sink_c: Option<f64>,
    /// New temperature of the glass, in °C.
    #[serde(default, deserialize_with = "number::some_temperature_c")]
    pub glass_c: Option<f64>,
    /// Fault of sensors or sampling.
    pub inject: Option<InjectionKind>,
    /// Value of the fault.
    pub value: Option<f64>,
    /// Channel of the fault.
    pub channel: Option<FaultChannel>,
    /// Action of the host.
    pub host: Option<HostWord>,
    /// Period of a repeated action of the host, in seconds.
    #[serde(default, deserialize_with = "number::some_time_s")]
    pub every_s: Option<f64>,
    /// `true` if a repeated power alternates with 0 W.
    #[serde(default)]
    pub toggle: bool,
    /// File of a lookup, relative to the scenario's.
    pub file: Option<PathBuf>,
    /// Name of the pot that a lookup describes exactly.
    #[serde(default, deserialize_with = "some_named_pot")]
    pub of_pot: Option<SimulatedPot>,
    /// Resistance of a lookup, in ohm.
    #[serde(default, deserialize_with = "number::some_r_ohm")]
    pub r_ohm: Option<f64>,
    /// Inductance of a lookup, in microhenry.
    #[serde(default, deserialize_with = "number::some_l_uh")]
    pub l_uh: Option<f64>,
    /// Version of a lookup; default: the number of pushes so far, plus 1.
    pub version: Option<u32>,
}

/// Reads the text of a file.
pub(super) fn text(path: &Path) -> Result<String, ScenarioError> {
    std::fs::read_to_string(path).map_err(|source| ScenarioError::Read {
        path: path.to_owned(),
        source,
    })
}

/// Folder of a file; paths in the file are relative to it.
pub(super) fn directory(path: &Path) -> PathBuf {
    path.parent().map(PathBuf::from).unwrap_or_default()
}

/// Parsed file.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Its content.
    pub file: ScenarioFile,
    /// Line on which each event begins.
    pub lines: Vec<usize>,
    /// Folder that paths in the file are relative to.
    pub directory: PathBuf,
}

impl Scenario {
    /// Reads a file.
    ///
    /// # Errors
    /// [`ScenarioError::Read`] and [`ScenarioError::Syntax`].
    pub fn read(path: &Path) -> Result<Self, ScenarioError> {
        Self::parse(&text(path)?, directory(path))
    }

    /// Parses text; paths in it are relative to a folder.
    ///
    /// # Errors
    /// [`ScenarioError::Syntax`].
    pub fn parse(text: &str, directory: PathBuf) -> Result<Self, ScenarioError> {
        let file: ScenarioFile =
            toml::from_str(text).map_err(|e| ScenarioError::Syntax(Box::new(e)))?;
        let line = |event: &Spanned<EventField>| {
            let before = text.as_bytes().iter().take(event.span().start);
            1 + before.filter(|b| **b == b'\n').count()
        };
        Ok(Self {
            lines: file.event.iter().map(line).collect(),
            file,
            directory,
        })
    }
}
