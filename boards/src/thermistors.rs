//! Thermistors: the codes of their temperatures, and how far these stay from a broken wire's.

use std::fmt::Write as _;

use crate::board::Board;
use crate::error::BoardError;

/// Sensors, as their keys begin, in the order of the firmware's tables.
const SENSORS: [&str; 3] = ["heat_sink", "glass", "coil"];

/// First temperature of the tables in °C, their step and length: to 320 °C.
const FROM_C: i16 = -40;
const STEP_C: i16 = 10;
const ENTRIES: usize = 37;

/// Largest code at the first temperature: an open wire has 4095, less what leaks.
const COLD_MAX: f64 = 4_090.0;

/// Smallest code at the last temperature: a wire to ground has 0, and what is below a third of it is one.
const HOT_MIN: f64 = 3.0;

/// NTC to ground below its resistor to the converter's reference.
struct Thermistor {
    ohm_at_25c: f64,
    b_k: f64,
    pull_up_ohm: f64,
}

impl Thermistor {
    fn from_board(board: &Board, sensor: &str) -> Self {
        let value = |key: &str| board.value(&format!("thermistors.{sensor}_{key}")).0 as f64;
        Self {
            ohm_at_25c: value("ntc_ohm"),
            b_k: value("ntc_b_k"),
            pull_up_ohm: value("pull_up_ohm"),
        }
    }

    /// Code of 12 bit at an entry of the table.
    fn code(&self, entry: usize) -> f64 {
        let kelvin = 273.15 + f64::from(FROM_C) + f64::from(STEP_C) * entry as f64;
        let ohm = self.ohm_at_25c * (self.b_k * (1.0 / kelvin - 1.0 / 298.15)).exp();
        4_096.0 * ohm / (ohm + self.pull_up_ohm)
    }
}

/// Checks that a broken wire has a code of its own.
pub(crate) fn check(board: &Board) -> Result<(), BoardError> {
    for sensor in SENSORS {
        let thermistor = Thermistor::from_board(board, sensor);
        let (cold, hot) = (thermistor.code(0), thermistor.code(ENTRIES - 1));
        let name = format!("thermistors.{sensor}_pull_up_ohm");
        let (pull_up, line) = board.value(&name);
        let why = if cold > COLD_MAX {
            format!(
                "is {pull_up}, too small: at {FROM_C} °C the code is {cold:.0}, and an open wire's 4095; at most {COLD_MAX} is allowed"
            )
        } else if hot < HOT_MIN {
            let last_c = FROM_C + STEP_C * (ENTRIES as i16 - 1);
            format!(
                "is {pull_up}, too large: at {last_c} °C the code is {hot:.1}, and a shorted wire's 0; at least {HOT_MIN} is allowed"
            )
        } else {
            continue;
        };
        return Err(board.error(&name, line, why));
    }
    Ok(())
}

/// Source text of the tables, in Rust.
pub(crate) fn constants(board: &Board) -> String {
    let thermistors = SENSORS.map(|sensor| Thermistor::from_board(board, sensor));
    let codes = thermistors.each_ref().map(|thermistor| {
        let codes = (0..ENTRIES).map(|entry| thermistor.code(entry).round() as u16);
        codes.collect::<Vec<_>>()
    });
    let short = thermistors.map(|thermistor| (thermistor.code(ENTRIES - 1) / 3.0).ceil() as u16);
    let mut text = String::new();
    let _ = writeln!(
        text,
        "/// First temperature of [`NTC_CODES`], in °C.\npub const NTC_FROM_C: i16 = {FROM_C};\n\
         /// Step of [`NTC_CODES`], in kelvin.\npub const NTC_STEP_C: i16 = {STEP_C};\n\
         /// Codes of the thermistors of heat sink, glass and coil.\npub const NTC_CODES: [[u16; {ENTRIES}]; 3] = {codes:?};\n\
         /// Codes below which a thermistor is shorted.\npub const NTC_SHORT_BELOW: [u16; 3] = {short:?};"
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::tests::{reference, refused};

    #[test]
    fn codes_are_the_dividers() {
        let board = Board::parse("my.toml".as_ref(), &reference()).unwrap();
        let [sink, glass] =
            ["heat_sink", "glass"].map(|sensor| Thermistor::from_board(&board, sensor));
        // Tables of an NTC of 10 kohm, B = 3950 K: 25 °C between 20 °C (12.54 kohm) and 30 °C (8.04 kohm).
        let code = |ohm: f64| 4_096.0 * ohm / (ohm + 10e3);
        assert!((sink.code(6) / code(12_535.0) - 1.0).abs() < 1e-3);
        assert!((sink.code(7) / code(8_037.0) - 1.0).abs() < 1e-3);
        assert!((glass.code(7) / code(80_370.0) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_thermistor_that_looks_like_a_broken_wire_names_its_line() {
        let why = refused("glass_pull_up_ohm = 10_000", "glass_pull_up_ohm = 5_000");
        assert!(
            why.contains("thermistors.glass_pull_up_ohm: is 5000, too small"),
            "{why}"
        );
        assert!(why.starts_with("my.toml:"), "{why}");
        let why = refused(
            "heat_sink_pull_up_ohm = 10_000",
            "heat_sink_pull_up_ohm = 47_000",
        );
        assert!(
            why.contains("too large: at 320 °C the code is 1.2"),
            "{why}"
        );
    }
}
