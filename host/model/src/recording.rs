//! Recordings of a device: settings, triggers, phases, files.

use std::fmt;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::json_number::{number, number_or_none};

/// Longest pre-trigger, in seconds; the ring keeps as much.
const MAX_PRE_TRIGGER_S: f64 = 60.0;

/// Longest set duration of a recording: a week, in seconds.
const MAX_DURATION_S: f64 = 604_800.0;

/// Quantity of a half-cycle that a trigger level can be set on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Mean power, in watt.
    Power,
    /// Largest amplitude of the current's fundamental, in ampere.
    Current,
    /// The device's estimate of R at the crest, in ohm.
    Resistance,
    /// The device's estimate of L at the crest, in microhenry.
    Inductance,
    /// Switching frequency, in kilohertz.
    Frequency,
}

/// Trigger of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "on", rename_all = "kebab-case")]
pub enum Trigger {
    /// The command itself: the recording begins at once.
    #[default]
    Now,
    /// A fault.
    Fault,
    /// A quantity that crosses a level.
    Level {
        /// The quantity.
        quantity: Quantity,
        /// Level, in the quantity's unit.
        #[serde(deserialize_with = "number")]
        level: f64,
        /// `true` for an upward crossing, `false` for a downward one.
        rising: bool,
    },
}

/// Settings of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RecordSettings {
    /// Trigger.
    pub trigger: Trigger,
    /// Seconds before the trigger that are also recorded, 0 to 60.
    #[serde(deserialize_with = "number")]
    pub pre_trigger_s: f64,
    /// Seconds after the trigger at which it ends; `None` to record until the stop command.
    #[serde(deserialize_with = "number_or_none")]
    pub duration_s: Option<f64>,
    /// Size of its file in bytes at which it ends; `None` without a limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_bytes: Option<u64>,
}

/// Phase of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RecordingPhase {
    /// Waiting for the trigger.
    Armed,
    /// Stopped before the trigger.
    Disarmed,
    /// Begun, or continued in another file after a break of the link.
    Begun,
    /// File complete; after a break of the link the recording continues in another file.
    Ended,
    /// Writing failed. The file holds what was written until then.
    Failed,
}

/// Recording that is armed or running.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = RecordingNow)]
pub struct ActiveRecording {
    /// Settings.
    pub settings: RecordSettings,
    /// Name of its file in the store's folder `recordings`, or of the last one while the link is down; `None` before the
    /// trigger.
    pub file: Option<String>,
    /// Seconds since it was requested, or since its trigger.
    pub since_s: f64,
}

/// Stored recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RecordingFile {
    /// File name in the store's folder `recordings`.
    pub file: String,
    /// Name of its device; empty if unknown.
    pub device: String,
    /// Time of the last write, in milliseconds since 1970, UTC.
    pub at_ms: i64,
    /// Size in bytes.
    pub bytes: u64,
    /// `true` while it is being written.
    pub under_way: bool,
}

impl RecordSettings {
    /// Checks the ranges of the settings.
    ///
    /// # Errors
    /// Description of the value that is out of range.
    pub fn check(&self) -> Result<(), String> {
        if !(0.0..=MAX_PRE_TRIGGER_S).contains(&self.pre_trigger_s) {
            return Err(format!(
                "the pre-trigger is {} s, but must lie between 0 and {MAX_PRE_TRIGGER_S} s",
                self.pre_trigger_s
            ));
        }
        if let Some(s) = self.duration_s
            && !(s > 0.0 && s <= MAX_DURATION_S)
        {
            return Err(format!(
                "the duration is {s} s, but must lie above 0 and up to {MAX_DURATION_S} s"
            ));
        }
        match self.trigger {
            Trigger::Level { level, .. } if !level.is_finite() => Err(format!(
                "the trigger's level is {level}, which is no number"
            )),
            _ => Ok(()),
        }
    }
}

impl Quantity {
    /// Returns its name on command lines, as in the API.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Power => "power",
            Self::Current => "current",
            Self::Resistance => "resistance",
            Self::Inductance => "inductance",
            Self::Frequency => "frequency",
        }
    }

    /// Returns the unit of its levels.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Power => "W",
            Self::Current => "A",
            Self::Resistance => "ohm",
            Self::Inductance => "µH",
            Self::Frequency => "kHz",
        }
    }
}

impl fmt::Display for Trigger {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Now => write!(f, "now"),
            Self::Fault => write!(f, "a fault"),
            Self::Level {
                quantity,
                level,
                rising,
            } => {
                let way = if *rising { "above" } else { "below" };
                write!(f, "{} {way} {level} {}", quantity.as_str(), quantity.unit())
            }
        }
    }
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
            let expected = Command::RecordStart(RecordSettings {
                trigger,
                pre_trigger_s: value,
                duration_s: Some(30.0),
                ..RecordSettings::default()
            });
            assert_eq!(read(&text).unwrap(), expected, "{text}");
            let written = serde_json::to_string(&expected).unwrap();
            assert_eq!(read(&written).unwrap(), expected, "{written}");
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

    #[test]
    fn settings_outside_their_ranges_are_refused() {
        let base = RecordSettings::default();
        base.check().unwrap();
        let longest = RecordSettings {
            pre_trigger_s: 60.0,
            duration_s: Some(604_800.0),
            ..base
        };
        longest.check().unwrap();
        for pre_trigger_s in [-0.1, 60.1, f64::NAN, f64::INFINITY] {
            let why = RecordSettings {
                pre_trigger_s,
                ..base
            }
            .check()
            .unwrap_err();
            assert!(why.contains("between 0 and 60"), "{why}");
        }
        for s in [0.0, -1.0, f64::NAN, 604_801.0] {
            let duration_s = Some(s);
            assert!(
                RecordSettings { duration_s, ..base }.check().is_err(),
                "{s}"
            );
        }
        let trigger = Trigger::Level {
            quantity: Quantity::Power,
            level: f64::NAN,
            rising: true,
        };
        assert!(RecordSettings { trigger, ..base }.check().is_err());
    }
}
