//! Scales and poles at the converters' pins, by the parts of `[front_end]` (docs/board.md, "Scales").

use std::f64::consts::TAU;

use crate::board::{Board, constant};
use crate::error::BoardError;

/// Supply of the analogue parts and reference of the converters, in millivolt.
const NOMINAL_SUPPLY_MV: f64 = 3_300.0;

/// Value that the parts give.
struct Scale {
    /// Key, which no file has; in capitals it is the constant's name.
    key: &'static str,
    /// Part whose line an error names.
    part: &'static str,
    /// Smallest and largest number.
    range: (u32, u32),
    /// Number by the parts.
    number: fn(&Parts<'_>) -> f64,
    /// Purpose, as the constant's documentation.
    doc: &'static str,
}

const SCALES: [Scale; 9] = [
    Scale {
        key: "coil_voltage_full_scale_mv",
        part: "coil_divider_bottom_ohm",
        range: (50_000, 1_000_000),
        number: |p| p.amplified_mv("coil"),
        doc: "Half the input range of the coil voltage's channel, in millivolt.",
    },
    Scale {
        key: "coil_current_full_scale_ma",
        part: "burden_mohm",
        range: (5_000, 500_000),
        number: |p| {
            NOMINAL_SUPPLY_MV / 2.0 / p.value("burden_mohm")
                * 1e3
                * p.value("current_transformer_turns")
        },
        doc: "Half the input range of the coil current's channel, in milliampere.",
    },
    Scale {
        key: "current_transformer_tau_us",
        part: "current_transformer_mh",
        range: (500, 10_000_000),
        number: |p| {
            let ohm = (p.value("burden_mohm") + p.value("current_transformer_mohm")) * 1e-3;
            p.value("current_transformer_mh") * 1e3 / ohm
        },
        doc: "Time constant of the current transformer's first-order high pass, its inductance by the resistance of winding and burden, in microseconds.",
    },
    Scale {
        key: "bus_full_scale_dv",
        part: "bus_divider_bottom_ohm",
        range: (500, 15_000),
        number: |p| {
            let share = p.value("bus_divider_ohm") / p.value("bus_divider_bottom_ohm");
            NOMINAL_SUPPLY_MV / 100.0 * (1.0 + share)
        },
        doc: "Bus voltage at the end of the converter's range, in decivolt.",
    },
    Scale {
        key: "mains_full_scale_mv",
        part: "mains_divider_bottom_ohm",
        range: (50_000, 1_000_000),
        number: |p| p.amplified_mv("mains"),
        doc: "Half the input range of the mains voltage's channel, in millivolt.",
    },
    Scale {
        key: "anti_alias_hz",
        part: "fast_pin_pf",
        range: (100_000, 5_000_000),
        number: |p| p.pole_hz(p.value("pin_ohm"), "fast_pin_pf"),
        doc: "Corner of the first-order anti-alias filter of both fast channels, in hertz.",
    },
    Scale {
        key: "bus_pole_hz",
        part: "bus_divider_pf",
        range: (100, 5_000_000),
        number: |p| {
            let (top, bottom) = (
                p.value("bus_divider_ohm"),
                p.value("bus_divider_bottom_ohm"),
            );
            p.pole_hz(top * bottom / (top + bottom), "bus_divider_pf")
        },
        doc: "Pole of the bus divider, in hertz.",
    },
    Scale {
        key: "mains_pole_hz",
        part: "mains_amplifier_pf",
        range: (100, 5_000_000),
        number: |p| p.pole_hz(p.value("mains_divider_bottom_ohm"), "mains_amplifier_pf"),
        doc: "Pole of the mains amplifier, in hertz.",
    },
    Scale {
        key: "slow_pin_pole_hz",
        part: "slow_pin_pf",
        range: (100, 5_000_000),
        number: |p| p.pole_hz(p.value("pin_ohm"), "slow_pin_pf"),
        doc: "Pole at the pins of bus and mains, in hertz.",
    },
];

/// Parts of a board's front end.
struct Parts<'a>(&'a Board);

impl Parts<'_> {
    /// Value of a part, in the unit of its key.
    fn value(&self, key: &str) -> f64 {
        self.0.value(&format!("front_end.{key}")).0 as f64
    }

    /// Half the input range behind a difference amplifier with a chain and a bottom resistor on each side, in millivolt.
    fn amplified_mv(&self, of: &str) -> f64 {
        let chain = self.value(&format!("{of}_divider_ohm"));
        NOMINAL_SUPPLY_MV / 2.0 * chain / self.value(&format!("{of}_divider_bottom_ohm"))
    }

    /// Pole of a resistance with a capacitor, in hertz.
    fn pole_hz(&self, ohm: f64, capacitor: &str) -> f64 {
        1e12 / (TAU * ohm * self.value(capacitor))
    }
}

/// Values by the parts: section and key, number, line of the file.
///
/// # Errors
/// [`BoardError`]: parts whose scale or pole the firmware cannot count with.
pub(crate) fn values(board: &Board) -> Result<Vec<(String, i64, usize)>, BoardError> {
    let derived = SCALES.iter().map(|scale| {
        let part = format!("front_end.{}", scale.part);
        let (_, line) = board.value(&part);
        let number = (scale.number)(&Parts(board)).round();
        let (min, max) = scale.range;
        if !(f64::from(min)..=f64::from(max)).contains(&number) {
            let why = format!(
                "with the parts beside it {} is {number}, not {min} to {max}",
                scale.key
            );
            return Err(board.error(&part, line, why));
        }
        Ok((format!("front_end.{}", scale.key), number as i64, line))
    });
    derived.collect()
}

/// Source text of the constants, in Rust.
pub(crate) fn constants(board: &Board) -> String {
    let mut text = format!(
        "/// Supply of the analogue parts and reference of the converters, in millivolt.\npub const NOMINAL_SUPPLY_MV: u32 = {NOMINAL_SUPPLY_MV};\n"
    );
    for scale in &SCALES {
        let (number, _) = board.value(&format!("front_end.{}", scale.key));
        text += &constant(scale.key, "u32", number, scale.doc);
    }
    text
}

#[cfg(test)]
mod tests {
    use crate::board::tests::{constants, refused};

    /// Arithmetic of docs/board.md, "Scales", by hand.
    #[test]
    fn scales_and_poles_are_those_of_the_parts() {
        let constants = constants();
        for (name, expected, tolerance) in [
            ("COIL_VOLTAGE_FULL_SCALE_MV", 640_400, 50),
            ("COIL_CURRENT_FULL_SCALE_MA", 80_100, 5),
            // 80 mH / 7.12 Ω.
            ("CURRENT_TRANSFORMER_TAU_US", 11_236, 1),
            ("BUS_FULL_SCALE_DV", 4_980, 0),
            ("MAINS_FULL_SCALE_MV", 399_800, 50),
            ("ANTI_ALIAS_HZ", 503_700, 50),
            ("BUS_POLE_HZ", 11_770, 5),
            ("MAINS_POLE_HZ", 18_890, 5),
            ("SLOW_PIN_POLE_HZ", 50_370, 5),
        ] {
            let from = format!("pub const {name}: u32 = ");
            let line = constants
                .lines()
                .find_map(|l| l.strip_prefix(&from))
                .unwrap();
            let number: i64 = line.trim_end_matches(';').parse().unwrap();
            assert!(
                (number - expected).abs() <= tolerance,
                "{name} {number} {expected}"
            );
        }
    }

    #[test]
    fn parts_that_the_firmware_cannot_count_with_are_refused() {
        let why = refused("burden_mohm = 4_120", "burden_mohm = 412");
        assert!(
            why.contains("front_end.burden_mohm") && why.contains("full_scale"),
            "{why}"
        );
        assert!(refused("burden_mohm = 4_120", "burden_mohm = 4_320").contains("show the trip"));
    }
}
