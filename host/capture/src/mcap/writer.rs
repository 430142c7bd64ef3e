//! Writer of a capture file, message by message. Each chunk is written at once: after a process is killed, everything up to the
//! last [`Writer::flush`] is readable.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ::mcap::records::{MessageHeader, Metadata};
use ::mcap::write::NoSeek;
use ::mcap::{Compression, WriteOptions};
use ihd_signal::atomic::Replacement;
use serde::Serialize;

use super::McapFileError;
use super::topics::{MessageLayout, PROFILE, SAMPLES_F32, Topic};

/// Uncompressed size from which a chunk is closed: 5 ms of 50 MS/s, or 2 s of a device's windows.
const CHUNK_BYTES: u64 = 1 << 20;

/// Pairs of a message: some 9 ms of a board's samples, and few enough for tools that show whole
/// messages.
pub const PAIRS_PER_MESSAGE: usize = 8192;

/// Treatment of an existing file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Replace it when the new one is complete.
    Replace,
    /// Keep it and fail.
    Keep,
}

/// Writer that counts the bytes of the file.
struct CountingWriter {
    file: Buffered,
    bytes: Arc<AtomicU64>,
}

/// File shared by the MCAP writer and [`Writer::end`]: the former leaves its last bytes in the buffer.
type Buffered = Arc<Mutex<BufWriter<File>>>;

fn locked(file: &Buffered) -> MutexGuard<'_, BufWriter<File>> {
    file.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Write for CountingWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = locked(&self.file).write(bytes)?;
        self.bytes.fetch_add(n as u64, Ordering::Relaxed);
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        locked(&self.file).flush()
    }
}

/// Capture file being written.
pub struct Writer {
    mcap: ::mcap::Writer<NoSeek<CountingWriter>>,
    path: PathBuf,
    /// Old file that the new one takes the place of at its end.
    replacement: Option<Replacement>,
    channels: BTreeMap<Topic, (u16, u32)>,
    file: Buffered,
    bytes: Arc<AtomicU64>,
    single: bool,
    begun: bool,
    begin_s: f64,
}

impl Writer {
    /// Creates a file. With `single` samples are f32, else codes.
    ///
    /// # Errors
    /// [`McapFileError::Exists`] if an existing file is to be kept, else the error of the operating system.
    pub fn create(path: &Path, existing: Existing, single: bool) -> Result<Self, McapFileError> {
        let opened = match existing {
            Existing::Replace => Replacement::begin(path).map(|(r, file)| (Some(r), file)),
            Existing::Keep => File::create_new(path).map(|file| (None, file)),
        };
        let (replacement, file) = opened.map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => McapFileError::Exists { path: path.into() },
            _ => McapFileError::Io {
                path: path.into(),
                offset: 0,
                source,
            },
        })?;
        let options = WriteOptions::new()
            .profile(PROFILE)
            .library(concat!("ihd ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            // Chunks are compressed on this thread, in sequence: the same bytes on every machine.
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            // A chunk is buffered in memory and written at once, completely or not at all.
            .disable_seeking(true);
        let bytes = Arc::new(AtomicU64::new(0));
        let file = Arc::new(Mutex::new(BufWriter::new(file)));
        let counted = CountingWriter {
            file: Arc::clone(&file),
            bytes: Arc::clone(&bytes),
        };
        let mcap = options.create(NoSeek::new(counted));
        let mcap = mcap.map_err(|source| McapFileError::Write {
            path: path.into(),
            source,
        })?;
        Ok(Self {
            mcap,
            path: path.into(),
            replacement,
            channels: BTreeMap::new(),
            file,
            bytes,
            single,
            begun: false,
            begin_s: 0.0,
        })
    }

    fn written<T>(&self, result: ::mcap::McapResult<T>) -> Result<T, McapFileError> {
        result.map_err(|source| McapFileError::Write {
            path: self.path.clone(),
            source,
        })
    }

    /// Size of the file in bytes, without the current chunk. It stays valid when the writer is moved.
    pub fn size(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.bytes)
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes a named table of text.
    ///
    /// # Errors
    /// Any error of [`Writer::message`].
    pub fn metadata(
        &mut self,
        name: &str,
        entries: BTreeMap<String, String>,
    ) -> Result<(), McapFileError> {
        let table = Metadata {
            name: name.to_owned(),
            metadata: entries,
        };
        let result = self.mcap.write_metadata(&table);
        self.written(result)
    }

    /// Registers every channel in the first chunk, so that a reader may skip any later one.
    fn begin(&mut self) -> Result<(), McapFileError> {
        self.begun = true;
        for topic in Topic::ALL {
            let (encoding, schema) = match topic.layout() {
                MessageLayout::Cdr(layouts) => {
                    let layout = layouts
                        .iter()
                        .find(|(name, _)| (*name == SAMPLES_F32) == self.is_f32(topic))
                        .or(layouts.first());
                    let schema = layout
                        .map(|(name, text)| self.mcap.add_schema(name, "ros2msg", text.as_bytes()));
                    ("cdr", schema)
                }
                MessageLayout::Json(name, text) => {
                    let text = text();
                    let schema = self.mcap.add_schema(name, "jsonschema", text.as_bytes());
                    ("json", Some(schema))
                }
                MessageLayout::Link => ("ihd-link", None),
            };
            let schema = self.written(schema.unwrap_or(Ok(0)))?;
            let none = BTreeMap::new();
            let channel = self.mcap.add_channel(schema, topic.name(), encoding, &none);
            let channel = self.written(channel)?;
            self.channels.insert(topic, (channel, 0));
        }
        Ok(())
    }

    /// Returns `true` if a topic's samples are f32; clean samples always are.
    fn is_f32(&self, topic: Topic) -> bool {
        topic == Topic::CleanSamples || self.single
    }

    /// Lets the times of messages count from `t_s` on, the time of the first sample in seconds: those of a scope begin before the trigger,
    /// and a message has no time before zero.
    pub fn begin_at(&mut self, t_s: f64) {
        self.begin_s = t_s;
    }

    /// Writes a message at a time in seconds on the capture's clock.
    ///
    /// # Errors
    /// [`McapFileError::Write`] when the disk is full or gone.
    pub fn message(&mut self, topic: Topic, t_s: f64, data: &[u8]) -> Result<(), McapFileError> {
        if !self.begun {
            self.begin()?;
        }
        let Some((channel_id, sequence)) = self.channels.get_mut(&topic) else {
            return Ok(());
        };
        let log_time = nanoseconds(t_s - self.begin_s);
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: *sequence,
            log_time,
            publish_time: log_time,
        };
        *sequence = sequence.wrapping_add(1);
        let result = self.mcap.write_to_known_channel(&header, data);
        self.written(result)
    }

    /// Writes a message of a JSON topic.
    ///
    /// # Errors
    /// Any error of [`Writer::message`].
    pub fn json(
        &mut self,
        topic: Topic,
        t_s: f64,
        value: &impl Serialize,
    ) -> Result<(), McapFileError> {
        let text = serde_json::to_vec(value).map_err(|e| McapFileError::Write {
            path: self.path.clone(),
            source: io::Error::from(e).into(),
        })?;
        self.message(topic, t_s, &text)
    }

    /// Closes the chunk and passes it to the operating system.
    ///
    /// # Errors
    /// Any error of [`Writer::message`].
    pub fn flush(&mut self) -> Result<(), McapFileError> {
        let result = self.mcap.flush();
        self.written(result)
    }

    /// Completes the file with its index; a file without it is still readable.
    ///
    /// # Errors
    /// Any error of [`Writer::message`].
    pub fn finish(mut self) -> Result<(), McapFileError> {
        self.end()
    }

    /// Completes the file like [`Writer::finish`]; nothing may be written after it.
    pub(super) fn end(&mut self) -> Result<(), McapFileError> {
        if !self.begun {
            self.begin()?;
        }
        let result = self.mcap.finish();
        self.written(result)?;
        let flushed = locked(&self.file).flush();
        let replaced = flushed.and_then(|()| match self.replacement.take() {
            Some(replacement) => replacement.complete(),
            None => Ok(()),
        });
        replaced.map_err(|source| McapFileError::Io {
            path: self.path.clone(),
            offset: self.bytes.load(Ordering::Relaxed),
            source,
        })
    }
}

/// Nanoseconds after the beginning of the capture; 0 for an earlier time.
pub fn nanoseconds(t_s: f64) -> u64 {
    // The cast saturates.
    libm::round(t_s * 1e9) as u64
}
