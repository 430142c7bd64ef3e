//! Output of a log, as text or JSON.

use std::time::{Duration, Instant};

use anyhow::Result;
use ihd_flash::log::decoder::Decoded;
use ihd_flash::log::follow::LogEvent;
use ihd_flash::log::message::{LogLevel, LogMessage, SourceLocation};
use jiff::Timestamp;
use serde::Serialize;

use crate::cli::output::{self, Colour, complain};

/// Period of reporting invalid frames: a hostile board sends a hundred thousand a second.
const REPORT_PERIOD: Duration = Duration::from_secs(5);

/// Prints messages to standard output. Events of the connection go to standard output as JSON, or to standard error as text.
pub(super) struct Screen {
    json: bool,
    coloured: bool,
    /// Lost messages and bytes, and invalid frames, since the last message.
    lost: u64,
    lost_bytes: u64,
    malformed: u64,
    /// Frames without texts since the last report.
    unread: u64,
    reported_at: Instant,
}

#[derive(Serialize)]
struct Line<'a> {
    /// Time of the host.
    t: String,
    level: Option<LogLevel>,
    message: &'a str,
    module: Option<&'a str>,
    location: Option<&'a SourceLocation>,
    #[serde(skip_serializing_if = "Option::is_none")]
    uptime: Option<&'a str>,
    /// Messages that the board had no room for, bytes lost in transmission, and invalid frames before this message.
    dropped: u64,
    lost_bytes: u64,
    malformed: u64,
}

impl Screen {
    /// Creates one; coloured for a terminal that supports it.
    pub(super) fn new(json: bool, coloured: bool) -> Self {
        Self {
            json,
            coloured,
            lost: 0,
            lost_bytes: 0,
            malformed: 0,
            unread: 0,
            reported_at: Instant::now(),
        }
    }

    /// Shows an event.
    pub(super) fn show(&mut self, what: LogEvent<'_>) -> Result<()> {
        match what {
            LogEvent::Began {
                device,
                running,
                table,
            } => {
                let why = table.err().map(ToString::to_string);
                if self.json {
                    return event(serde_json::json!({
                        "event": "connected", "device": device, "build": running.build,
                        "build_id": running.build_id, "image": table.ok(), "why": why,
                    }));
                }
                let running = running.describe();
                complain(format_args!("ihd: {device}: {running}; ^C ends"));
                match (table, why) {
                    (Ok(image), _) => complain(format_args!("ihd: texts of {image}")),
                    (_, why) => complain(format_args!("ihd: {}", why.unwrap_or_default())),
                }
                Ok(())
            }
            LogEvent::Away { why } if self.json => {
                event(serde_json::json!({"event": "away", "why": why.to_string()}))
            }
            LogEvent::Away { why } => {
                complain(format_args!("ihd: {why}; waiting for it, ^C ends"));
                Ok(())
            }
            LogEvent::Back { away } if self.json => {
                event(serde_json::json!({"event": "back", "away_s": away.as_secs_f64()}))
            }
            LogEvent::Back { away } => {
                let away_s = away.as_secs_f64();
                complain(format_args!("ihd: back after {away_s:.1} s"));
                Ok(())
            }
            LogEvent::Lost { messages, bytes } => {
                self.lost = self.lost.saturating_add(messages);
                self.lost_bytes = self.lost_bytes.saturating_add(bytes);
                Ok(())
            }
            LogEvent::Decoded(Decoded::Message(message)) => self.message(&message),
            LogEvent::Decoded(Decoded::Malformed) => {
                self.malformed = self.malformed.saturating_add(1);
                self.tell_now_and_then()
            }
            LogEvent::Decoded(Decoded::Unread) => {
                self.unread = self.unread.saturating_add(1);
                self.tell_now_and_then()
            }
        }
    }

    /// Reports the remaining counts.
    pub(super) fn end(&mut self) -> Result<()> {
        self.report_counts()
    }

    fn message(&mut self, message: &LogMessage) -> Result<()> {
        let t = Timestamp::now();
        if self.json {
            let line = Line {
                t: written(t),
                level: message.level,
                message: &message.text,
                module: message.place.as_ref().map(|place| place.module.as_str()),
                location: message.place.as_ref(),
                uptime: message.uptime.as_deref(),
                dropped: std::mem::take(&mut self.lost),
                lost_bytes: std::mem::take(&mut self.lost_bytes),
                malformed: std::mem::take(&mut self.malformed),
            };
            return output::json_line(&line);
        }
        self.report_counts()?;
        output::parts(self.coloured, &parts(&written(t), message))
    }

    fn tell_now_and_then(&mut self) -> Result<()> {
        if self.reported_at.elapsed() < REPORT_PERIOD {
            return Ok(());
        }
        self.report_counts()
    }

    fn report_counts(&mut self) -> Result<()> {
        let counts = [
            &mut self.lost,
            &mut self.lost_bytes,
            &mut self.malformed,
            &mut self.unread,
        ];
        let [lost, lost_bytes, malformed, unread] = counts.map(std::mem::take);
        self.reported_at = Instant::now();
        if [lost, lost_bytes, malformed, unread] == [0; 4] {
            return Ok(());
        }
        if self.json {
            return event(serde_json::json!({
                "event": "counts", "dropped": lost, "lost_bytes": lost_bytes, "malformed": malformed,
                "unread": unread,
            }));
        }
        for (frames, what) in [
            (
                lost,
                "messages missing here: the board had no room for them",
            ),
            (lost_bytes, "bytes of log missing here: lost on the way"),
            (malformed, "frames that are no message of this image"),
            (unread, "messages whose texts are not here"),
        ] {
            if frames > 0 {
                complain(format_args!("ihd: {frames} {what}"));
            }
        }
        Ok(())
    }
}

fn event(mut what: serde_json::Value) -> Result<()> {
    if let Some(fields) = what.as_object_mut() {
        fields.insert("t".into(), written(Timestamp::now()).into());
    }
    output::json_line(&what)
}

/// Formats a time to the millisecond, in UTC.
fn written(t: Timestamp) -> String {
    format!("{t:.3}")
}

/// Parts of a message's line: time, level, module, text, place.
fn parts(t: &str, message: &LogMessage) -> Vec<(Colour, String)> {
    let (colour, word) = match message.level {
        Some(LogLevel::Error) => (Colour::Red, "error"),
        Some(LogLevel::Warn) => (Colour::Yellow, "warn"),
        Some(LogLevel::Info) => (Colour::Green, "info"),
        Some(level) => (Colour::Dim, level.as_str()),
        None => (Colour::Plain, "-"),
    };
    let mut parts = vec![
        (Colour::Dim, format!("{t} ")),
        (colour, format!("{word:<5} ")),
    ];
    if let Some(uptime) = &message.uptime {
        parts.push((Colour::Dim, format!("{uptime} ")));
    }
    if let Some(place) = &message.place {
        parts.push((Colour::Dim, format!("{}: ", place.module)));
    }
    parts.push((Colour::Plain, message.text.clone()));
    if let Some(place) = &message.place {
        parts.push((Colour::Dim, format!("  ({place})")));
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message() -> LogMessage {
        LogMessage {
            level: Some(LogLevel::Warn),
            text: "lookup 7 was not kept".into(),
            uptime: None,
            place: Some(SourceLocation {
                module: "ihd_firmware::board".into(),
                file: "firmware/src/board/mod.rs".into(),
                line: 54,
            }),
        }
    }

    #[test]
    fn a_line_has_time_level_module_text_and_place() {
        let line: String = parts("T", &message())
            .into_iter()
            .map(|(_, text)| text)
            .collect();
        assert_eq!(
            line,
            "T warn  ihd_firmware::board: lookup 7 was not kept  (firmware/src/board/mod.rs:54)"
        );
    }

    #[test]
    fn without_debug_information_the_text_stands_alone() {
        let message = LogMessage {
            level: None,
            place: None,
            ..message()
        };
        let line: String = parts("T", &message)
            .into_iter()
            .map(|(_, text)| text)
            .collect();
        assert_eq!(line, "T -     lookup 7 was not kept");
    }

    #[test]
    fn an_object_has_the_names_that_are_promised() {
        let message = message();
        let line = Line {
            t: "T".into(),
            level: message.level,
            message: &message.text,
            module: None,
            location: message.place.as_ref(),
            uptime: None,
            dropped: 3,
            lost_bytes: 0,
            malformed: 0,
        };
        assert_eq!(
            serde_json::to_string(&line).unwrap(),
            "{\"t\":\"T\",\"level\":\"warn\",\"message\":\"lookup 7 was not kept\",\"module\":null,\
             \"location\":\"firmware/src/board/mod.rs:54\",\"dropped\":3,\"lost_bytes\":0,\"malformed\":0}"
        );
    }
}
