//! A recording as the very frames that came over the link, one after the other in a file.
//!
//! The first frame is the device's hello, so that the file says itself what made it. Nothing is
//! unpacked or rewritten: what the link damaged is damaged in the file too, and reading it back
//! gives the same windows, rejections and counts. This is the least that loses nothing; the real
//! capture container (MCAP, with an index and compression) is a later feature.

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::{Path, PathBuf};

use ihd_shared::wire::frame::{FrameError, MAX_ENCODED, encode};
use ihd_shared::wire::hello::{Mismatch, ROLE_DEVICE, ROLE_HOST, check, ours};
use ihd_shared::wire::messages::Hello;

use crate::link::incoming::{Answer, Incoming};
use crate::link::{Counters, Event, FrameSink};

/// Why a recording cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum FrameLogError {
    /// The file exists already.
    #[error("{} exists already; a recording is never overwritten", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The operating system refused.
    #[error("{} at byte {offset}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// How far it was read or written.
        offset: u64,
        /// What the operating system says.
        source: io::Error,
    },
    /// The file does not begin with a device's hello.
    #[error("{} is no recording: it does not begin with a device's hello", path.display())]
    NotARecording {
        /// The file.
        path: PathBuf,
    },
    /// The file was recorded from a device that this host does not understand.
    #[error("{} was recorded from a device that does not fit this host: {why}", path.display())]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// What differs.
        why: Mismatch,
    },
}

/// A recording being written.
///
/// Every append goes to the operating system at once, without a buffer of our own: a recorder that
/// is killed leaves everything it took, cut at worst within its last frame.
pub struct FrameLog {
    file: File,
}

impl FrameLog {
    /// Begins a recording of the device that said `hello`.
    ///
    /// # Errors
    /// [`FrameLogError::Exists`] when there is such a file, [`FrameLogError::Io`] for anything else.
    pub fn create(path: &Path, hello: &Hello) -> Result<Self, FrameLogError> {
        let failed = |source: io::Error| match source.kind() {
            io::ErrorKind::AlreadyExists => FrameLogError::Exists { path: path.into() },
            _ => FrameLogError::Io {
                path: path.into(),
                offset: 0,
                source,
            },
        };
        let mut frame = [0; MAX_ENCODED];
        let length = encode(hello, 0, &mut frame).map_err(|e| failed(io::Error::other(e)))?;
        let mut file = File::create_new(path).map_err(failed)?;
        file.write_all(&frame[..length]).map_err(failed)?;
        Ok(Self { file })
    }
}

impl FrameSink for FrameLog {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)
    }
}

/// A run of bytes in a recording that is no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Where the run begins in the file.
    pub offset: u64,
    /// What is wrong with it.
    pub reason: FrameError,
}

/// A recording being read.
pub struct FrameLogReader {
    bytes: io::Bytes<BufReader<File>>,
    path: PathBuf,
    hello: Hello,
    incoming: Incoming,
    offset: u64,
    run_start: u64,
    first_damage: Option<Damage>,
    ended: bool,
}

impl FrameLogReader {
    /// Opens a recording and reads its hello.
    ///
    /// # Errors
    /// [`FrameLogError`] when the file cannot be read, is no recording, or comes from a device of
    /// another major protocol version.
    pub fn open(path: &Path) -> Result<Self, FrameLogError> {
        let file = File::open(path).map_err(|source| FrameLogError::Io {
            path: path.into(),
            offset: 0,
            source,
        })?;
        let us = ours(ROLE_HOST, 0, 0, "", "");
        let mut reader = Self {
            bytes: BufReader::new(file).bytes(),
            path: path.into(),
            hello: us.clone(),
            incoming: Incoming::default(),
            offset: 0,
            run_start: 0,
            first_damage: None,
            ended: false,
        };
        while reader.incoming.counters().frames_good == 0 {
            let damaged = reader.first_damage.is_some();
            if damaged || reader.offset > MAX_ENCODED as u64 || !reader.step()? {
                return Err(FrameLogError::NotARecording { path: path.into() });
            }
        }
        match reader.incoming.answers.pop_front() {
            Some(Answer::Hello(hello)) if hello.role == ROLE_DEVICE => reader.hello = hello,
            _ => return Err(FrameLogError::NotARecording { path: path.into() }),
        }
        check(&us, &reader.hello).map_err(|why| FrameLogError::Mismatch {
            path: path.into(),
            why,
        })?;
        // The recording may have begun long after the device.
        reader.incoming.restart_sequence();
        Ok(reader)
    }

    /// What the recorded device said of itself.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Everything read and missed so far, the hello included.
    pub fn counters(&self) -> Counters {
        self.incoming.counters()
    }

    /// The first run of bytes so far that is no frame; [`FrameLogReader::counters`] tells how many
    /// there are.
    pub fn first_damage(&self) -> Option<Damage> {
        self.first_damage
    }

    /// The next event; `None` at the end of the file.
    ///
    /// # Errors
    /// [`FrameLogError::Io`] when the file cannot be read on.
    pub fn next_event(&mut self) -> Result<Option<Event>, FrameLogError> {
        loop {
            if let Some(event) = self.incoming.events.pop_front() {
                return Ok(Some(event));
            }
            self.incoming.answers.clear();
            if !self.step()? && self.incoming.events.is_empty() {
                return Ok(None);
            }
        }
    }

    /// Reads one byte; false at the end of the file.
    fn step(&mut self) -> Result<bool, FrameLogError> {
        match self.bytes.next() {
            Some(Ok(byte)) => {
                self.offset += 1;
                self.push(byte);
                Ok(true)
            }
            Some(Err(source)) => Err(FrameLogError::Io {
                path: self.path.clone(),
                offset: self.offset,
                source,
            }),
            None => {
                if !self.ended {
                    self.ended = true;
                    // A frame cut by the end of the file is no frame, and counts.
                    if self.run_start < self.offset {
                        self.push(0);
                    }
                    self.incoming.finish();
                }
                Ok(false)
            }
        }
    }

    fn push(&mut self, byte: u8) {
        if let Err(reason) = self.incoming.push(byte) {
            let offset = self.run_start;
            self.first_damage.get_or_insert(Damage { offset, reason });
        }
        if byte == 0 {
            self.run_start = self.offset;
        }
    }
}
