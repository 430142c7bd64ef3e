//! Trigger of a recording on the command line: `fault`, `level:power>1000`.

use ihd_capture::recording::{Quantity, Trigger};

const QUANTITIES: [Quantity; 5] = [
    Quantity::Power,
    Quantity::Current,
    Quantity::Resistance,
    Quantity::Inductance,
    Quantity::Frequency,
];

/// Parses a trigger.
///
/// # Errors
/// A description of the defect and of the syntax.
pub(super) fn trigger(text: &str) -> Result<Trigger, String> {
    match text.split_once(':') {
        None if text == "now" => Ok(Trigger::Now),
        None if text == "fault" => Ok(Trigger::Fault),
        Some(("level", level)) => crossing(level),
        _ => Err(format!(
            "`{text}` is no trigger: write now, fault, or a level like level:power>1000"
        )),
    }
}

fn crossing(text: &str) -> Result<Trigger, String> {
    let Some(at) = text.find(['<', '>']) else {
        let wrong = "has no < or >: write a level like power>1000, inductance<25";
        return Err(format!("`{text}` {wrong}"));
    };
    let (word, rising) = (text[..at].trim(), text[at..].starts_with('>'));
    let Some(quantity) = QUANTITIES.into_iter().find(|q| q.as_str() == word) else {
        let known: Vec<&str> = QUANTITIES.iter().map(|q| q.as_str()).collect();
        return Err(format!("`{word}` is no quantity: {}", known.join(", ")));
    };
    let unit = quantity.unit();
    let number = text[at + 1..].trim();
    let number = number.strip_suffix(unit).unwrap_or(number);
    let number = match quantity {
        Quantity::Inductance => number.strip_suffix("uH").unwrap_or(number),
        _ => number,
    };
    let level = number.trim().parse::<f64>().ok().filter(|x| x.is_finite());
    let level = level.ok_or_else(|| {
        let given = &text[at + 1..];
        format!("`{given}` is no level: a number in {unit}")
    })?;
    Ok(Trigger::Level {
        quantity,
        level,
        rising,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triggers_are_read_as_people_write_them() {
        let level = |quantity, level, rising| Trigger::Level {
            quantity,
            level,
            rising,
        };
        for (text, wanted) in [
            ("now", Trigger::Now),
            ("fault", Trigger::Fault),
            ("level:power>1000", level(Quantity::Power, 1e3, true)),
            ("level:power > 1e3 W", level(Quantity::Power, 1e3, true)),
            (
                "level:inductance<25µH",
                level(Quantity::Inductance, 25.0, false),
            ),
            (
                "level:inductance<25 uH",
                level(Quantity::Inductance, 25.0, false),
            ),
            (
                "level:frequency<30.5kHz",
                level(Quantity::Frequency, 30.5, false),
            ),
            ("level:resistance>2", level(Quantity::Resistance, 2.0, true)),
            ("level:current>40A", level(Quantity::Current, 40.0, true)),
        ] {
            assert_eq!(trigger(text), Ok(wanted), "{text}");
        }
        for (text, word) in [
            ("", "is no trigger"),
            ("faults", "is no trigger"),
            ("edge:power>1", "is no trigger"),
            ("level:power", "no < or >"),
            ("level:mood>3", "power, current"),
            ("level:power>", "a number in W"),
            ("level:power>1 kHz", "a number in W"),
            ("level:power>nan", "a number in W"),
        ] {
            let why = trigger(text).unwrap_err();
            assert!(why.contains(word), "{text}: {why}");
        }
    }
}
