//! Pins of the controller that a board may choose: their names, and which are taken.

use std::fmt::Write as _;

use crate::board::Board;
use crate::error::BoardError;

/// Function whose pin a board chooses.
pub(crate) struct PinUse {
    /// Key in the section `pins`; in capitals, with `_PIN`, it is the constant's name.
    pub key: &'static str,
    /// Pins that can have it; all that are free, if empty.
    among: &'static [&'static str],
    /// Purpose, as the constant's documentation.
    pub doc: &'static str,
}

const fn any(key: &'static str, doc: &'static str) -> PinUse {
    let among = &[];
    PinUse { key, among, doc }
}

const fn thermistor(key: &'static str, doc: &'static str) -> PinUse {
    // All that ADC4 has on a package of 64 pins (DS12288, table "Pin definition").
    let among = &["PB12", "PB14", "PB15"];
    PinUse { key, among, doc }
}

/// Every function; a file has all of them and no other.
pub(crate) const PINS: &[PinUse] = &[
    any("fan", "Fan, on by a high level."),
    any("led", "LED, lit by a high level."),
    any("button_on_off", "On/off button, to ground."),
    any("button_plus", "Plus button, to ground."),
    any("button_minus", "Minus button, to ground."),
    any("button_timer", "Timer button, to ground."),
    any("light_power", "Light of power, on by a high level."),
    any("light_fault", "Light of a fault, on by a high level."),
    any("light_hot_glass", "Light of hot glass, on by a high level."),
    any(
        "share_wire",
        "Wire to the other zone of a shared supply, pulled low by either.",
    ),
    thermistor("heat_sink_ntc", "Thermistor of the heat sink."),
    thermistor("glass_ntc", "Thermistor of the glass."),
    thermistor("coil_ntc", "Thermistor of the coil."),
];

/// Pins that no board can choose, with the reason: functions that the chip has on these pins alone, and pins that are not quiet.
const RESERVED: &[(&str, &str)] = &[
    ("PA0", "the coil voltage's, ADC1"),
    ("PA1", "the coil current's, ADC2 and COMP1"),
    ("PA2", "the serial port's"),
    ("PA3", "the serial port's"),
    ("PA7", "the inverted coil current's, COMP2"),
    ("PA8", "the upper switch's, HRTIM"),
    ("PA9", "the lower switch's, HRTIM"),
    ("PA11", "USB's"),
    ("PA12", "USB's"),
    ("PA13", "the debug port's"),
    ("PA14", "the debug port's"),
    ("PA15", "pulled up in reset, for JTAG"),
    ("PB0", "the mains voltage's, ADC3"),
    ("PB1", "the bus voltage's, ADC3"),
    ("PB3", "driven in reset, for JTAG"),
    ("PB4", "pulled up in reset, for JTAG"),
    ("PB6", "pulled down in reset, for USB-C"),
    ("PB8", "BOOT0"),
    ("PC13", "weak: it drives 3 mA"),
    ("PC14", "weak: it drives 3 mA"),
    ("PC15", "weak: it drives 3 mA"),
];

/// Port, 0 for A, and line of a name; `None` if the chip has no such pin. Ports A to C are whole on a package of 64 pins.
fn parse(name: &str) -> Option<(u8, u8)> {
    let (port, line) = name.strip_prefix('P')?.split_at_checked(1)?;
    let port = "ABC".find(port)? as u8;
    let line: u8 = line.parse().ok().filter(|line| *line < 16)?;
    (name == self::name((port, line))).then_some((port, line))
}

fn name((port, line): (u8, u8)) -> String {
    format!("P{}{line}", char::from(b'A' + port))
}

/// Parses a function's pin and checks it by itself.
pub(crate) fn parse_for(function: &PinUse, name: &str) -> Result<(u8, u8), String> {
    let Some(pin) = parse(name) else {
        return Err("must be a pin from PA0 to PC15".to_owned());
    };
    if let Some((_, why)) = RESERVED.iter().find(|(reserved, _)| *reserved == name) {
        return Err(format!("{name} is {why}"));
    }
    if !function.among.is_empty() && !function.among.contains(&name) {
        return Err(format!("must be one of {}", function.among.join(", ")));
    }
    Ok(pin)
}

/// Checks that no two functions share a pin.
pub(crate) fn check(board: &Board) -> Result<(), BoardError> {
    for (at, function) in PINS.iter().enumerate() {
        let (pin, line) = board.pin(function.key);
        let before = PINS[..at]
            .iter()
            .find(|other| board.pin(other.key).0 == pin);
        if let Some(other) = before {
            let (_, other_line) = board.pin(other.key);
            let why = format!(
                "{} is that of {} in line {other_line}",
                name(pin),
                other.key
            );
            return Err(board.error(&format!("pins.{}", function.key), line, why));
        }
    }
    Ok(())
}

/// Source text of the constants, in Rust.
pub(crate) fn constants(board: &Board) -> String {
    let mut text = String::new();
    for function in PINS {
        let ((port, line), _) = board.pin(function.key);
        let (name, doc) = (function.key.to_uppercase(), function.doc);
        let _ = writeln!(
            text,
            "/// {doc}\npub const {name}_PIN: Pin = Pin {{ port: {port}, line: {line} }};"
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::tests::refused;

    #[test]
    fn names_are_pins_of_the_chip() {
        assert_eq!(parse("PA0"), Some((0, 0)));
        assert_eq!(parse("PC15"), Some((2, 15)));
        for wrong in ["PD2", "PB16", "PB05", "PB+5", "pb5", "B5", "P", ""] {
            assert_eq!(parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_pin_that_is_taken_or_unfit_is_refused_with_its_line() {
        let why = refused("fan = \"PB5\"", "fan = \"PC8\"");
        assert!(why.starts_with("my.toml:"), "{why}");
        assert!(
            why.contains("pins.button_plus: PC8 is that of fan in line"),
            "{why}"
        );
        assert!(refused("\"PB5\"", "\"PA8\"").contains("pins.fan: PA8 is the upper switch's"));
        assert!(refused("\"PB5\"", "\"PD2\"").contains("from PA0 to PC15"));
        assert!(refused("\"PB5\"", "5").contains("a pin's name"));
        assert!(refused("\"PB12\"", "\"PB13\"").contains("PB12, PB14, PB15"));
        assert!(refused("fan = ", "van = ").contains("pins.van: unknown"));
        assert!(refused("fan = \"PB5\"", "").contains("pins.fan is missing"));
    }
}
