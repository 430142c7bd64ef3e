//! Numbers within a tagged type: serde buffers those, and serde_json's arbitrary-precision numbers are then neither floats nor integers.

use serde::de::Error;
use serde::{Deserialize, Deserializer};
use serde_json::Value;

/// Reads a number.
pub(crate) fn number<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    number_or_none(from)?.ok_or_else(|| Error::custom("a number is expected here"))
}

/// Reads a number, or `null`.
pub(crate) fn number_or_none<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    match Value::deserialize(from)? {
        Value::Null => Ok(None),
        Value::Number(number) if number.as_f64().is_some() => Ok(number.as_f64()),
        other => Err(Error::custom(format!(
            "a number is expected here, not {other}"
        ))),
    }
}

/// Reads a power in whole watt; also one with a zero behind its point, as some languages write it.
pub(crate) fn whole_w<'de, D: Deserializer<'de>>(from: D) -> Result<u16, D::Error> {
    whole(&Value::deserialize(from)?)
}

/// Reads a list of such powers.
pub(crate) fn whole_w_list<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<u16>, D::Error> {
    let all = Vec::<Value>::deserialize(from)?;
    all.iter().map(whole).collect()
}

fn whole<E: Error>(value: &Value) -> Result<u16, E> {
    value
        .as_f64()
        .filter(|x| x.fract() == 0.0 && (0.0..=f64::from(u16::MAX)).contains(x))
        .map(|x| x as u16)
        .ok_or_else(|| {
            let most = u16::MAX;
            Error::custom(format!(
                "a whole number of watt from 0 to {most} is expected here, not {value}"
            ))
        })
}

#[cfg(test)]
mod tests {
    use crate::Command;

    #[test]
    fn a_power_is_a_whole_number_however_it_is_written() {
        let read = |text: &str| serde_json::from_str::<Command>(text);
        for number in ["1200", "1200.0", "1.2e3"] {
            let power = read(&format!(r#"{{"command":"power","power_w":{number}}}"#));
            assert_eq!(power.unwrap(), Command::Power { power_w: 1_200 });
        }
        let powers = read(r#"{"command":"sweep","powers_w":[700,1e3]}"#).unwrap();
        assert_eq!(
            powers,
            Command::Sweep {
                powers_w: vec![700, 1_000]
            }
        );
        for number in ["1200.5", "-1", "65536", "\"1200\"", "null", "true"] {
            let refused = read(&format!(r#"{{"command":"power","power_w":{number}}}"#));
            let why = refused.unwrap_err().to_string();
            assert!(why.contains("whole number of watt"), "{number}: {why}");
        }
    }
}
