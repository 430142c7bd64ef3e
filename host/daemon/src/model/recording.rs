//! Recordings of a device: what begins them, and what there is.

use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;

/// A quantity of a half-cycle that a level can be set on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Mean power, in watt.
    Power,
    /// Largest amplitude of the current's fundamental, in ampere.
    Current,
    /// The device's own R at the crest, in ohm.
    Resistance,
    /// The device's own L at the crest, in microhenry.
    Inductance,
    /// Switching frequency, in kilohertz.
    Frequency,
}

/// What begins a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "on", rename_all = "kebab-case")]
pub enum Trigger {
    /// The command itself.
    #[default]
    Now,
    /// A fault that trips.
    Fault,
    /// A quantity that crosses a level.
    Level {
        /// Which.
        quantity: Quantity,
        /// The level, in the quantity's unit.
        #[serde(deserialize_with = "number")]
        level: f64,
        /// Upwards; downwards where false.
        rising: bool,
    },
}

/// How a recording is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RecordSettings {
    /// What begins it.
    pub trigger: Trigger,
    /// Seconds before the trigger that are recorded too, 0 to 60.
    #[serde(deserialize_with = "number")]
    pub pre_trigger_s: f64,
    /// Seconds after the trigger at which it ends by itself; none until it is told to.
    #[serde(deserialize_with = "number_or_none")]
    pub duration_s: Option<f64>,
}

/// A number within a tagged type: serde buffers those, and serde_json's numbers of any length are then no floats.
fn number<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    let wrong = || serde::de::Error::custom("a number is wanted here");
    number_or_none(from)?.ok_or_else(wrong)
}

fn number_or_none<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    match serde_json::Value::deserialize(from)? {
        serde_json::Value::Null => Ok(None),
        serde_json::Value::Number(number) if number.as_f64().is_some() => Ok(number.as_f64()),
        other => {
            let why = format!("a number is wanted here, not {other}");
            Err(serde::de::Error::custom(why))
        }
    }
}

/// Where a recording is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RecordingPhase {
    /// It waits for its trigger.
    Armed,
    /// It was told to stop before its trigger came.
    Disarmed,
    /// It has begun, or goes on in a second file after the link was away.
    Begun,
    /// Its file is complete; where the link went away, it goes on in a second one when that is back.
    Ended,
    /// It could not be written on. What was written until then is in its file.
    Failed,
}

/// A recording that waits for its trigger, or is under way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RecordingNow {
    /// How it is made.
    pub settings: RecordSettings,
    /// Its file's name in the store's folder `recordings`, or the last one's while the link is away; none while it waits for
    /// its trigger.
    pub file: Option<String>,
    /// Seconds since it was asked for, or since its trigger.
    pub since_s: f64,
}

/// A recording that there is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RecordingFile {
    /// Its name in the store's folder `recordings`.
    pub file: String,
    /// Its device, where it is known.
    pub device: String,
    /// When it was last written, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Its size in bytes.
    pub bytes: u64,
    /// Whether it is being written.
    pub under_way: bool,
}

#[cfg(test)]
mod tests {
    use super::super::Command;
    use super::*;

    #[test]
    fn a_command_is_read_as_people_and_pages_write_it() {
        let read = |text: &str| serde_json::from_str::<Command>(text);
        let plain = read(r#"{"command":"record-start"}"#).unwrap();
        assert_eq!(plain, Command::RecordStart(RecordSettings::default()));
        for (level, value) in [("1000", 1e3), ("1e3", 1e3), ("5.00", 5.0), ("-0.25", -0.25)] {
            let text = format!(
                r#"{{"command":"record-start","trigger":{{"on":"level","quantity":"power","level":{level},"rising":true}},
                    "pre_trigger_s":{level},"duration_s":30}}"#
            );
            let trigger = Trigger::Level {
                quantity: Quantity::Power,
                level: value,
                rising: true,
            };
            let wanted = Command::RecordStart(RecordSettings {
                trigger,
                pre_trigger_s: value,
                duration_s: Some(30.0),
            });
            assert_eq!(read(&text).unwrap(), wanted, "{text}");
            let written = serde_json::to_string(&wanted).unwrap();
            assert_eq!(read(&written).unwrap(), wanted, "{written}");
        }
        for wrong in [
            r#"{"command":"record-start","pre_triger_s":5}"#,
            r#"{"command":"record-start","pre_trigger_s":"5"}"#,
            r#"{"command":"record-start","pre_trigger_s":null}"#,
            r#"{"command":"record-start","duration_s":1e999}"#,
            r#"{"command":"record-start","trigger":{"on":"full-moon"}}"#,
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
