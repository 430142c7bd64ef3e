//! Reading of a capture as the user states it: the keys of `--input`.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, ValueEnum};
use ihd_capture::OpenOptions;
use ihd_capture::channels::{ChannelOptions, ChannelRef};
use ihd_capture::formats::unit::Unit;
use ihd_survey::{Hints, StatedRange};

use super::simulate::quantity::{list, quantity};

/// Channel whose sign is changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Invert {
    /// Voltage.
    V,
    /// Current.
    I,
}

/// Reading of a capture as the user states it: keys of `--input`.
#[derive(Clone, Debug, Args)]
pub struct InputOptions {
    /// Voltage and current channel, by number (from 1) or name; else found by unit and name
    #[arg(long, value_name = "V,I", value_parser = pair)]
    channels: Option<[ChannelRef; 2]>,
    /// Time, voltage and current column of a table, by number (from 1) or name; T is - for no time
    #[arg(long, value_name = "T,V,I", value_parser = triple, conflicts_with = "channels")]
    columns: Option<[ChannelRef; 3]>,
    /// Factors: ratio of the voltage probe, ampere per volt of the current probe
    #[arg(long, value_name = "V,I", value_parser = ratios)]
    probe: Option<[f64; 2]>,
    /// Units of voltage and current, as in mV,mA, instead of the file's
    #[arg(long, value_name = "V,I", value_parser = units)]
    units: Option<[Unit; 2]>,
    /// Change the sign of the voltage, the current, or both (v,i)
    #[arg(long, value_name = "CHANNELS", value_delimiter = ',')]
    invert: Vec<Invert>,
    /// Exchange voltage and current
    #[arg(long)]
    swap: bool,
    /// Sampling rate in S/s instead of the file's time
    #[arg(long, value_name = "HZ", value_parser = above_zero)]
    rate: Option<f64>,
    /// Switching frequency in Hz, instead of the capture's
    #[arg(long, value_name = "HZ", value_parser = switching_hz)]
    fsw: Option<f64>,
    /// Mains frequency in Hz, instead of the capture's
    #[arg(long, value_name = "HZ", value_parser = mains_hz)]
    mains: Option<f64>,
    /// Time of a mains zero crossing in s, instead of the capture's
    #[arg(long, value_name = "S", value_parser = quantity)]
    zero_crossing: Option<f64>,
    /// Value of the resonance capacitor in F (1080n): the gains are checked against it
    #[arg(long, value_name = "F", value_parser = capacitance_f)]
    resonance_capacitance: Option<f64>,
}

fn several<const N: usize>(text: &str) -> Result<[ChannelRef; N], String> {
    let all: Vec<_> = text.split(',').map(ChannelRef::parse).collect();
    all.try_into()
        .map_err(|_| format!("`{text}` must be {N} numbers or names with commas between them"))
}

fn pair(text: &str) -> Result<[ChannelRef; 2], String> {
    several(text)
}

fn triple(text: &str) -> Result<[ChannelRef; 3], String> {
    several(text)
}

fn units(text: &str) -> Result<[Unit; 2], String> {
    let both: Option<Vec<Unit>> = text.split(',').map(Unit::parse).collect();
    both.and_then(|units| units.try_into().ok())
        .ok_or_else(|| format!("`{text}` must be two units with a comma between them, as in mV,A"))
}

fn ratios(text: &str) -> Result<[f64; 2], String> {
    let both = list::<2>(text).map_err(|e| e.to_string())?;
    let zero = |ratio| StatedRange::ProbeRatio.check(ratio).err();
    match both.into_iter().find_map(zero) {
        Some(error) => Err(error.to_string()),
        None => Ok(both),
    }
}

fn above_zero(text: &str) -> Result<f64, String> {
    within(text, StatedRange::AboveZero)
}

fn capacitance_f(text: &str) -> Result<f64, String> {
    within(text, StatedRange::CapacitanceF)
}

fn switching_hz(text: &str) -> Result<f64, String> {
    within(text, StatedRange::SwitchingHz)
}

fn mains_hz(text: &str) -> Result<f64, String> {
    within(text, StatedRange::MainsHz)
}

fn within(text: &str, range: StatedRange) -> Result<f64, String> {
    let number = quantity(text).map_err(|e| e.to_string())?;
    range.check(number).map_err(|e| e.to_string())
}

impl InputOptions {
    /// Options for the readers of files, of which `second` is the other channel's.
    pub fn open_options(&self, second: Option<PathBuf>) -> OpenOptions {
        OpenOptions {
            second,
            channels: ChannelOptions {
                channels: self.channels.clone(),
                units: self.units,
                probe: self.probe,
                invert_v: self.invert.contains(&Invert::V),
                invert_i: self.invert.contains(&Invert::I),
                swap: self.swap,
            },
            columns: self.columns.clone(),
            rate_hz: self.rate,
        }
    }

    /// User's specifications for the survey.
    pub fn hints(&self) -> Hints {
        Hints {
            f_sw_hz: self.fsw,
            mains_hz: self.mains,
            zero_crossing_s: self.zero_crossing,
            swapped: self.swap,
            inverted: self.invert.len() == 1,
        }
    }

    /// Value of the resonance capacitor in F.
    pub fn capacitance_f(&self) -> Option<f64> {
        self.resonance_capacitance
    }

    /// Refuses keys that a command has no use for.
    ///
    /// # Errors
    /// [`Usage`](super::usage::Usage), naming the key.
    pub fn refuse(&self, keys: &[&str]) -> Result<()> {
        let given = [
            ("fsw", self.fsw.is_some()),
            ("mains", self.mains.is_some()),
            ("zero-crossing", self.zero_crossing.is_some()),
            (
                "resonance-capacitance",
                self.resonance_capacitance.is_some(),
            ),
        ];
        for (key, is_given) in given {
            ensure_usage!(
                !is_given || !keys.contains(&key),
                "--input {key}: this command has no use for it here: leave it out"
            );
        }
        Ok(())
    }
}
