//! Reader of a recorded session: the same windows, rejections and counts as the live client had.

use std::collections::VecDeque;
use std::path::Path;

use ihd_link::receiver::Receiver;
use ihd_link::{ClientCounters, DeviceEvent};
use ihd_shared::wire::frame::{FrameError, MAX_ENCODED};
use ihd_shared::wire::hello::{ROLE_DEVICE, ROLE_HOST, check, ours};
use ihd_shared::wire::messages::Hello;

use super::McapFileError;
use super::reader::{McapItem, McapReader};
use super::topics::Topic;

/// Run of recorded bytes that is no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkDamage {
    /// Number of bytes from the device before it, the hello included.
    pub offset: u64,
    /// Defect.
    pub reason: FrameError,
}

/// Reader of a recorded session.
pub struct SessionReader {
    reader: McapReader,
    hello: Hello,
    receiver: Receiver,
    bytes: VecDeque<u8>,
    offset: u64,
    run_start: u64,
    first_damage: Option<LinkDamage>,
    file_damage: Option<McapFileError>,
    ended: bool,
}

impl SessionReader {
    /// Opens a recording and reads its hello.
    ///
    /// # Errors
    /// [`McapFileError`] when the file cannot be read, holds no session, or comes from a device of
    /// another major protocol version than ours.
    pub fn open(path: &Path) -> Result<Self, McapFileError> {
        let us = ours(ROLE_HOST, 0, 0, "", "");
        let mut session = Self {
            reader: McapReader::open(path)?,
            hello: us.clone(),
            receiver: Receiver::default(),
            bytes: VecDeque::new(),
            offset: 0,
            run_start: 0,
            first_damage: None,
            file_damage: None,
            ended: false,
        };
        let none = || McapFileError::Missing {
            path: path.into(),
            what: "holds no session of a device: its bytes do not begin with a device's hello",
        };
        while session.receiver.counters().frames_good == 0 {
            let damaged = session.first_damage.is_some() || session.file_damage.is_some();
            if damaged || session.offset > MAX_ENCODED as u64 || !session.step()? {
                return Err(none());
            }
        }
        let first = session.receiver.answers.pop_front();
        match first.and_then(|answer| answer.decode::<Hello>()) {
            Some(hello) if hello.role == ROLE_DEVICE => session.hello = hello,
            _ => return Err(none()),
        }
        check(&us, &session.hello).map_err(|why| McapFileError::Mismatch {
            path: path.into(),
            why,
        })?;
        // The recording may have begun long after the device.
        session.receiver.restart_sequence();
        Ok(session)
    }

    /// Hello of the recorded device.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Counters so far, the hello included.
    pub fn counters(&self) -> ClientCounters {
        self.receiver.counters()
    }

    /// First run of bytes so far that is no frame; [`SessionReader::counters`] has their number. `None` if there was none.
    pub fn first_damage(&self) -> Option<LinkDamage> {
        self.first_damage
    }

    /// First damage of the file that was skipped; `None` if there was none.
    pub fn file_damage(&self) -> Option<&McapFileError> {
        self.file_damage.as_ref()
    }

    /// Returns `true` if the file ends without its end mark.
    pub fn is_cut(&self) -> bool {
        self.reader.is_cut()
    }

    /// Returns the next event; `None` at the end of the file.
    ///
    /// # Errors
    /// [`McapFileError::Io`] when the file cannot be read on.
    pub fn next_event(&mut self) -> Result<Option<DeviceEvent>, McapFileError> {
        loop {
            if let Some(event) = self.receiver.events.pop_front() {
                return Ok(Some(event));
            }
            self.receiver.answers.clear();
            if !self.step()? && self.receiver.events.is_empty() {
                return Ok(None);
            }
        }
    }

    /// Processes one byte; returns `false` at the end of the file.
    fn step(&mut self) -> Result<bool, McapFileError> {
        if self.bytes.is_empty() {
            self.refill()?;
        }
        if let Some(byte) = self.bytes.pop_front() {
            self.offset += 1;
            self.push(byte);
            return Ok(true);
        }
        if !self.ended {
            self.ended = true;
            // A frame cut by the end of the file counts as bad.
            if self.run_start < self.offset {
                self.push(0);
            }
            self.receiver.finish();
        }
        Ok(false)
    }

    /// Loads the bytes of the next message. A damaged chunk is skipped; the frame that it cuts counts as bad.
    fn refill(&mut self) -> Result<(), McapFileError> {
        while self.bytes.is_empty() {
            match self.reader.next_item() {
                Ok(Some(McapItem::Message(m))) if m.topic == Topic::FromDevice => {
                    self.bytes.extend(m.data);
                }
                Ok(Some(_)) => {}
                Ok(None) => return Ok(()),
                Err(damage) if damage.is_damage() => {
                    self.file_damage.get_or_insert(damage);
                }
                Err(other) => return Err(other),
            }
        }
        Ok(())
    }

    fn push(&mut self, byte: u8) {
        if let Err(reason) = self.receiver.push(byte) {
            let offset = self.run_start;
            self.first_damage
                .get_or_insert(LinkDamage { offset, reason });
        }
        if byte == 0 {
            self.run_start = self.offset;
        }
    }
}
