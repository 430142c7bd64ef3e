//! State of a session: connection, ring, and what is armed or under way.

use std::path::PathBuf;
use std::time::Instant;

use ihd_model::RecordSettings;
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::messages::{AnyMessage, FaultEvent, FrontEnd, Hello, Message, Telemetry};

use super::ring::{ByteChunk, Ring};
use super::trigger::TriggerState;
use super::under_way::{OngoingRecording, RecordingLimit};

/// State of a session.
#[derive(Default)]
pub struct SessionState {
    /// Connected device; `None` between connections.
    pub device: Option<(Hello, FrontEnd)>,
    /// Number of the present connection; data of earlier ones are ignored.
    pub connection: u64,
    /// Last minute of the link.
    pub ring: Ring,
    deframer: Deframer,
    trigger_state: TriggerState,
    /// `true` if the device's last byte lies within a frame.
    pub mid_frame: bool,
    /// Recording that is armed or under way.
    pub phase: Phase,
    /// Files that receive no more data and are not complete yet.
    pub finishing: Vec<PathBuf>,
    /// Reason for which the last recording failed; `None` if it has not.
    pub failure: Option<String>,
}

/// Phase of a session.
#[derive(Default)]
pub enum Phase {
    /// Nothing is armed or under way.
    #[default]
    Idle,
    /// Waiting for the trigger.
    Armed {
        /// Settings of the recording.
        settings: RecordSettings,
        /// Time of the request.
        since: Instant,
    },
    /// A recording is under way.
    Recording(Box<OngoingRecording>),
}

impl SessionState {
    /// Ends the connection: no device, and nothing left of its bytes.
    pub fn disconnect(&mut self) {
        self.device = None;
        self.connection += 1;
        self.ring.clear();
        self.deframer = Deframer::new();
        self.mid_frame = false;
    }

    /// Writes a chunk to the recording under way. If `ends_at_limit`, a chunk beyond its limits ends it instead.
    pub fn write_chunk(&mut self, chunk: &ByteChunk, ends_at_limit: bool) {
        let Phase::Recording(recording) = &mut self.phase else {
            return;
        };
        recording.last_data = Instant::now();
        let exceeded = recording.exceeded(chunk.at).filter(|_| ends_at_limit);
        if let Some(limit) = exceeded {
            self.end_by(limit);
        } else if let Some(writer) = &recording.writer
            && !writer.write(chunk.clone())
        {
            // The writer's thread publishes the reason.
            let path = recording.path.clone();
            self.finishing.push(path);
            self.phase = Phase::Idle;
        }
    }

    /// Ends the recording under way for its limit.
    pub fn end_by(&mut self, limit: RecordingLimit) {
        if let Phase::Recording(recording) = std::mem::take(&mut self.phase) {
            let why = recording.limit_text(limit);
            if let Some(writer) = recording.writer {
                self.finishing.push(recording.path);
                writer.finish(&why);
            }
        }
    }

    /// Adds a chunk to the ring, after it was written.
    pub fn remember(&mut self, chunk: ByteChunk) {
        if chunk.from_device {
            self.mid_frame = chunk.bytes.last().map_or(self.mid_frame, |&b| b != 0);
        }
        self.ring.push(chunk);
    }

    /// Checks the device's bytes for the armed trigger. If it has come, disarms it and returns the settings and the cause.
    pub fn check_trigger(&mut self, bytes: &[u8]) -> Option<(RecordSettings, String)> {
        let armed = match &self.phase {
            Phase::Armed { settings, .. } => Some(*settings),
            _ => None,
        };
        let mut trigger = armed.as_ref().map(|settings| &settings.trigger);
        let mut began = None;
        let mut rest = bytes;
        while !rest.is_empty() {
            let (used, is_end) = self.deframer.collect(rest);
            rest = &rest[used..];
            if !is_end {
                continue;
            }
            // All other messages, which are most of the bytes, are skipped undecoded.
            if !matches!(self.deframer.id(), Some(Telemetry::ID | FaultEvent::ID)) {
                self.deframer.skip();
                continue;
            }
            let Some(Ok(frame)) = self.deframer.frame() else {
                continue;
            };
            let cause = match AnyMessage::decode(frame.id, frame.split().1) {
                Ok(AnyMessage::Telemetry(t)) => self.trigger_state.telemetry(t, trigger),
                Ok(AnyMessage::FaultEvent(event)) => self.trigger_state.fault(&event, trigger),
                _ => None,
            };
            if let Some(cause) = cause {
                trigger = None;
                self.phase = Phase::Idle;
                began = armed.map(|settings| (settings, cause));
            }
        }
        began
    }
}
