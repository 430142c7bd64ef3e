//! Choice of the voltage and current channel and their units: by flags, else by unit, else by name; otherwise an error asks the
//! user.

use std::fmt;

use ihd_signal::printable;

use super::formats::channel::FileChannel;
use super::formats::stated_unit::StatedUnit;
use super::formats::unit::{ColumnQuantity, Unit};

/// A channel as the user names it: by its number, the first is 1, or by its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ChannelRef {
    /// Number in the file, from 1.
    Number(usize),
    /// Name in the file; case is ignored.
    Name(String),
}

impl ChannelRef {
    /// Parses a number if the text is one, else takes it as a name.
    pub fn parse(text: &str) -> Self {
        let text = text.trim();
        text.parse()
            .map_or_else(|_| Self::Name(text.to_owned()), Self::Number)
    }

    /// Returns `true` for `-`, which stands for no column.
    pub fn is_none_column(&self) -> bool {
        matches!(self, Self::Name(name) if name == "-")
    }

    /// Returns the index of the channel among `names`; a name counts before a number.
    pub fn find<'a>(&self, mut names: impl Iterator<Item = &'a str>) -> Option<usize> {
        match self {
            Self::Number(number) => number.checked_sub(1).filter(|k| names.nth(*k).is_some()),
            Self::Name(name) => names.position(|n| n.eq_ignore_ascii_case(name)),
        }
    }
}

impl fmt::Display for ChannelRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Name(name) => write!(f, "`{name}`"),
        }
    }
}

/// User's options for the channels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ChannelOptions {
    /// Voltage and current channel; `None` to detect them by unit and name.
    pub channels: Option<[ChannelRef; 2]>,
    /// Units of both; `None` for the file's.
    pub units: Option<[Unit; 2]>,
    /// Factors on both: a probe's ratio for the voltage, ampere per volt for the current.
    pub probe: Option<[f64; 2]>,
    /// Set to change the sign of the voltage.
    pub invert_v: bool,
    /// Set to change the sign of the current.
    pub invert_i: bool,
    /// Set to exchange voltage and current.
    pub swap: bool,
}

/// One chosen channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChosenChannel {
    /// Index in the file.
    pub index: usize,
    /// Volt or ampere per unit of the file.
    pub factor: f64,
}

/// Chooses voltage and current.
///
/// # Errors
/// The ambiguity, with the channels and the flag that resolves it.
pub fn choose(
    channels: &[FileChannel],
    options: &ChannelOptions,
) -> Result<[ChosenChannel; 2], String> {
    let mut pair = match &options.channels {
        Some([v, i]) => [named(channels, v)?, named(channels, i)?],
        None => detected(channels, options.swap)?,
    };
    if options.swap {
        pair.reverse();
    }
    let [v, i] = pair;
    if v == i {
        return Err(format!(
            "voltage and current would both be channel {}; {}",
            v + 1,
            listed(channels)
        ));
    }
    Ok([
        chosen(channels, v, ColumnQuantity::Voltage, options)?,
        chosen(channels, i, ColumnQuantity::Current, options)?,
    ])
}

fn named(channels: &[FileChannel], reference: &ChannelRef) -> Result<usize, String> {
    let names = channels.iter().map(|c| c.name.as_str());
    reference
        .find(names)
        .ok_or_else(|| format!("no channel {reference}; {}", listed(channels)))
}

/// Detects both channels: by unit first, then by name; if one of two is detected, the other follows.
fn detected(channels: &[FileChannel], swap: bool) -> Result<[usize; 2], String> {
    if channels.is_empty() {
        return Err("no channel beside the time".to_owned());
    }
    if channels.len() < 2 {
        return Err(format!(
            "one channel only; give the file with the other one too. {}",
            listed(channels)
        ));
    }
    let only = |is: &dyn Fn(&FileChannel) -> bool| {
        let mut all = (0..channels.len()).filter(|k| is(&channels[*k]));
        all.next().filter(|_| all.next().is_none())
    };
    let find = |quantity: ColumnQuantity| {
        let of_unit = |c: &FileChannel| c.unit.known().is_some_and(|u| u.quantity == quantity);
        let of_name = |c: &FileChannel| quantity_of_name(&c.name) == Some(quantity);
        // A current probe's channel is in volt, so a name may overrule that unit.
        only(&|c| of_unit(c) && of_name(c))
            .or_else(|| only(&|c| of_unit(c) && quantity_of_name(&c.name).is_none()))
            .or_else(|| only(&of_name))
            .or_else(|| only(&of_unit))
    };
    let other = |k: usize| (channels.len() == 2).then(|| 1 - k);
    let pair = match (find(ColumnQuantity::Voltage), find(ColumnQuantity::Current)) {
        (Some(v), Some(i)) if v != i => Some([v, i]),
        (None, Some(i)) => other(i).map(|v| [v, i]),
        (Some(v), None) => other(v).map(|i| [v, i]),
        // Neither unit nor name decides: only with `swap` has the user specified which is which.
        _ => None,
    };
    pair.ok_or_else(|| {
        let advice = if swap {
            "--input swap changes what is detected, and nothing is"
        } else {
            "cannot distinguish voltage from current"
        };
        format!("{advice}; {}", listed(channels))
    })
}

/// Quantity that a channel's name indicates; `None` if it indicates none.
pub fn quantity_of_name(name: &str) -> Option<ColumnQuantity> {
    let lower = name.to_lowercase();
    let parts = || lower.split(|c: char| !c.is_alphabetic());
    let is = |list: &[&str]| parts().any(|part| list.contains(&part));
    if is(&[
        "current", "amp", "amps", "ampere", "strom", "i", "icoil", "ic", "il",
    ]) {
        Some(ColumnQuantity::Current)
    } else if is(&[
        "voltage", "volt", "volts", "spannung", "v", "u", "vcoil", "vc", "vl",
    ]) {
        Some(ColumnQuantity::Voltage)
    } else {
        None
    }
}

/// Returns the factor to volt or ampere, from flags and the file's unit.
fn chosen(
    channels: &[FileChannel],
    index: usize,
    quantity: ColumnQuantity,
    options: &ChannelOptions,
) -> Result<ChosenChannel, String> {
    let side = usize::from(quantity == ColumnQuantity::Current);
    let ratio = options.probe.map_or(1.0, |probe| probe[side]);
    let stated = options.units.map(|units| units[side]);
    // A ratio or an exchange given by the user overrides what a unit measures.
    let settled = options.probe.is_some() || options.swap;
    let in_file = channels.get(index).map(|c| &c.unit);
    if let (None, Some(StatedUnit::Unknown(unit))) = (stated, in_file) {
        return Err(format!(
            "channel {} is in `{}`, which is neither volt nor ampere: give the units, as in --input units=V,A, with the volt and ampere of one \
             as --input probe=V,A if the samples are other numbers",
            labelled((index, &channels[index])),
            printable(unit)
        ));
    }
    let scale = match stated.or_else(|| in_file?.known()) {
        None => 1.0,
        Some(unit) if unit.quantity == quantity || settled => unit.scale,
        Some(unit) => {
            let (what, flag) = match quantity {
                ColumnQuantity::Current => (
                    "current",
                    "give ampere per volt of the current probe, as in --input probe=1,10",
                ),
                _ => (
                    "voltage",
                    "exchange the channels with --input swap or channels",
                ),
            };
            let stated = match stated {
                Some(_) => " by --input units=V,I",
                None => "",
            };
            return Err(format!(
                "channel {} for the {what} is in {unit}{stated}; {flag}",
                index + 1
            ));
        }
    };
    let inverted = [options.invert_v, options.invert_i][side];
    let sign = if inverted { -1.0 } else { 1.0 };
    Ok(ChosenChannel {
        index,
        factor: sign * ratio * scale,
    })
}

/// Largest number of channels listed in a message.
const LISTED: usize = 12;

/// Number of a channel, and its name if it has one.
fn labelled((index, channel): (usize, &FileChannel)) -> String {
    match channel.name.as_str() {
        "" => format!("{}", index + 1),
        name => format!("{} `{}`", index + 1, printable(name)),
    }
}

fn listed(channels: &[FileChannel]) -> String {
    let one = |(k, c): (usize, &FileChannel)| match &c.unit {
        StatedUnit::Nothing => labelled((k, c)),
        unit => format!("{} in {unit}", labelled((k, c))),
    };
    let shown: Vec<_> = channels.iter().enumerate().take(LISTED).map(one).collect();
    let rest = channels.len().saturating_sub(LISTED);
    let more = if rest > 0 {
        format!(" and {rest} more")
    } else {
        String::new()
    };
    format!(
        "channels are {}{more}; name them with --input channels=V,I by number or name",
        shown.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn channel(name: &str, unit: Option<&str>) -> FileChannel {
        FileChannel {
            name: name.to_owned(),
            unit: unit.map_or(StatedUnit::Nothing, StatedUnit::parse),
            full_scale: None,
        }
    }

    fn indices(channels: &[FileChannel], options: &ChannelOptions) -> Result<[usize; 2], String> {
        choose(channels, options).map(|c| c.map(|c| c.index))
    }

    #[test]
    fn by_unit_then_by_name() {
        let none = ChannelOptions::default();
        let by_unit = [channel("CH1", Some("A")), channel("CH2", Some("mV"))];
        assert_eq!(indices(&by_unit, &none), Ok([1, 0]));
        assert_eq!(choose(&by_unit, &none).unwrap()[0].factor, 1e-3);
        let by_name = [channel("i_coil", None), channel("v_coil", None)];
        assert_eq!(indices(&by_name, &none), Ok([1, 0]));
        let one_known = [channel("CH1", None), channel("CH2", Some("A"))];
        assert_eq!(indices(&one_known, &none), Ok([0, 1]));
        let three = [
            channel("gate voltage", Some("V")),
            channel("CH2", Some("V")),
            channel("CH3", Some("A")),
        ];
        assert_eq!(indices(&three, &none), Ok([0, 2]));
    }

    #[test]
    fn what_cannot_be_decided_is_asked_with_the_flags() {
        let both_volt = [channel("CH1", Some("V")), channel("CH2", Some("V"))];
        let asked = choose(&both_volt, &ChannelOptions::default()).unwrap_err();
        assert!(
            asked.contains("--input channels") && asked.contains("2 `CH2` in V"),
            "{asked}"
        );
        let chosen_only = ChannelOptions {
            channels: Some([ChannelRef::Number(1), ChannelRef::Name("ch2".to_owned())]),
            ..ChannelOptions::default()
        };
        let asked = choose(&both_volt, &chosen_only).unwrap_err();
        assert!(asked.contains("--input probe=1,10"), "{asked}");
        let settled = ChannelOptions {
            probe: Some([100.0, 10.0]),
            invert_i: true,
            ..chosen_only
        };
        let [v, i] = choose(&both_volt, &settled).unwrap();
        assert_eq!((v.factor, i.factor), (100.0, -10.0));
        let exchanged = ChannelOptions {
            units: Some([Unit::AMPERE, Unit::VOLT]),
            ..ChannelOptions::default()
        };
        let names = [channel("v", None), channel("i", None)];
        let asked = choose(&names, &exchanged).unwrap_err();
        assert!(asked.contains("--input units=V,I"), "{asked}");
        let missing = ChannelOptions {
            channels: Some([ChannelRef::Number(0), ChannelRef::Number(9)]),
            ..ChannelOptions::default()
        };
        assert!(
            choose(&both_volt, &missing)
                .unwrap_err()
                .contains("no channel 0")
        );
        let single = choose(&both_volt[..1], &ChannelOptions::default()).unwrap_err();
        assert!(single.contains("one channel only"), "{single}");
        let none = choose(&[], &ChannelOptions::default()).unwrap_err();
        assert!(none.contains("no channel"), "{none}");
    }

    /// Counts of a converter and mean values as volt or ampere gave a wrong R, and no doubt.
    #[test]
    fn a_unit_that_is_neither_volt_nor_ampere_is_asked_for() {
        for unit in ["counts", "div", "Vrms", "MV", "W", "%"] {
            let pair = [channel("v", Some(unit)), channel("i", Some("A"))];
            let asked = choose(&pair, &ChannelOptions::default()).unwrap_err();
            for part in ["channel 1 `v`", unit, "--input units=V,A"] {
                assert!(asked.contains(part), "{asked}");
            }
            let stated = ChannelOptions {
                units: Some([Unit::VOLT, Unit::AMPERE]),
                probe: Some([0.01, 1.0]),
                ..ChannelOptions::default()
            };
            assert_eq!(choose(&pair, &stated).unwrap()[0].factor, 0.01);
        }
        // A channel that is not chosen may be in anything.
        let three = [
            channel("v", Some("V")),
            channel("i", Some("A")),
            channel("power", Some("W")),
        ];
        assert_eq!(indices(&three, &ChannelOptions::default()), Ok([0, 1]));
    }

    #[test]
    fn one_known_channel_of_three_leaves_a_choice() {
        let three = [
            channel("CH1", None),
            channel("CH2", None),
            channel("i", Some("A")),
        ];
        let asked = choose(&three, &ChannelOptions::default()).unwrap_err();
        assert!(asked.contains("--input channels=V,I"), "{asked}");
    }

    #[test]
    fn swap_and_units() {
        let pair = [channel("v", None), channel("i", None)];
        let swapped = ChannelOptions {
            swap: true,
            units: Unit::parse("mV")
                .zip(Unit::parse("mA"))
                .map(|(v, i)| [v, i]),
            ..ChannelOptions::default()
        };
        let [v, i] = choose(&pair, &swapped).unwrap();
        assert_eq!((v.index, i.index, v.factor, i.factor), (1, 0, 1e-3, 1e-3));
    }

    #[test]
    fn thousands_of_channels_are_not_all_listed() {
        let many: Vec<_> = (0..5000)
            .map(|k| channel(&format!("CH{k}"), None))
            .collect();
        let asked = choose(&many, &ChannelOptions::default()).unwrap_err();
        assert!(
            asked.contains("and 4988 more") && asked.len() < 600,
            "{asked}"
        );
    }
}
