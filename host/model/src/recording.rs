//! Recordings of a device: settings, triggers, files.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

pub use ihd_capture::recording::{
    ActiveRecording, Quantity, RecordSettings, RecordingPhase, Trigger,
};

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
}
