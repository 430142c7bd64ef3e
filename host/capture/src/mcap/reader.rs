//! Capture file read message by message, up to the last complete chunk.

use std::collections::BTreeMap;
use std::path::Path;

use ::mcap::records::op;

use super::McapFileError;
use super::chunk::record_at;
use super::framing::{FrameStep, McapFrames};
use super::records;
use super::topics::{MessageLayout, PROFILE, SAMPLES_I16, Topic};

/// Item of a capture file.
#[derive(Clone, Debug, PartialEq)]
pub enum McapItem<'a> {
    /// Named table of text.
    Metadata {
        /// Name of the table.
        name: String,
        /// Entries.
        entries: BTreeMap<String, String>,
    },
    /// Message of a known topic.
    Message(McapMessage<'a>),
}

/// A message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct McapMessage<'a> {
    /// Topic.
    pub topic: Topic,
    /// Set if samples are codes; otherwise they are f32.
    pub as_codes: bool,
    /// Nanoseconds after the beginning of the capture.
    pub log_time_ns: u64,
    /// Contents, laid out as in [`super::topics`].
    pub data: &'a [u8],
}

/// Channel that this version knows.
#[derive(Clone, Copy)]
struct Channel {
    topic: Topic,
    as_codes: bool,
}

/// Capture file being read. Unknown contents are skipped.
pub struct McapReader {
    frames: McapFrames,
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Option<Channel>>,
    /// Offset of the next record in the unpacked chunk; `None` between chunks.
    in_chunk: Option<usize>,
}

impl McapReader {
    /// Opens a file and checks its profile.
    ///
    /// # Errors
    /// [`McapFileError`] when it cannot be read or is no capture of this version.
    pub fn open(path: &Path) -> Result<Self, McapFileError> {
        let mut reader = Self {
            frames: McapFrames::open(path)?,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            in_chunk: None,
        };
        match reader.frames.step()? {
            FrameStep::Record(op::HEADER) => {}
            _ => return Err(McapFileError::NotMcap { path: path.into() }),
        }
        let header = records::header(reader.frames.record());
        let (profile, _library) = header.map_err(|why| reader.frames.damaged(why))?;
        if profile != PROFILE {
            let kind = PROFILE.split(' ').next().unwrap_or_default();
            let hint = if profile.starts_with(kind) {
                "; it was written by a later ihd: use that one, or newer"
            } else {
                "; it was not recorded by ihd"
            };
            return Err(McapFileError::Profile {
                path: path.into(),
                profile,
                hint,
            });
        }
        Ok(reader)
    }

    /// Returns `true` if the file ends without its end mark; the complete part was read.
    pub fn is_cut(&self) -> bool {
        self.frames.is_cut()
    }

    /// Offset of the record read last, in bytes.
    pub fn at(&self) -> u64 {
        self.frames.at()
    }

    /// Share of the file before the record read last, from 0 to 1.
    pub fn share(&self) -> f64 {
        self.frames.at() as f64 / self.frames.length().max(1) as f64
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        self.frames.path()
    }

    /// Creates an error at the place read last.
    pub fn damaged(&self, what: impl ToString) -> McapFileError {
        self.frames.damaged(what)
    }

    /// Returns the next item; `None` at the end.
    ///
    /// # Errors
    /// [`McapFileError`]. After one that [`McapFileError::is_damage`] the next call continues after the damage.
    pub fn next_item(&mut self) -> Result<Option<McapItem<'_>>, McapFileError> {
        let message_place = loop {
            if let Some(at) = self.in_chunk {
                match self.advance_in_chunk(at)? {
                    Some(message) => break message,
                    None => continue,
                }
            }
            match self.step()? {
                FrameStep::End => return Ok(None),
                FrameStep::Skipped => {}
                FrameStep::Chunk => self.in_chunk = Some(0),
                FrameStep::Record(op::METADATA) => return self.metadata().map(Some),
                FrameStep::Record(opcode) => {
                    let body = self.frames.record();
                    let taken = take(opcode, body, &mut self.schemas, &mut self.channels);
                    let taken = taken.map_err(|why| self.frames.damaged(why))?;
                    if let Some(message) = taken {
                        break MessagePlace {
                            from: self.frames.record().len() - message.data_len,
                            to: self.frames.record().len(),
                            in_chunk: false,
                            message,
                        };
                    }
                }
            }
        };
        let bytes = if message_place.in_chunk {
            self.frames.chunk()
        } else {
            self.frames.record()
        };
        Ok(Some(McapItem::Message(McapMessage {
            topic: message_place.message.channel.topic,
            as_codes: message_place.message.channel.as_codes,
            log_time_ns: message_place.message.log_time_ns,
            data: &bytes[message_place.from..message_place.to],
        })))
    }

    /// Reads the next record or chunk. Channels lost with a damaged chunk are taken from the summary, if there is one.
    fn step(&mut self) -> Result<FrameStep, McapFileError> {
        let step = self.frames.step();
        if self.channels.is_empty() && step.as_ref().is_err_and(McapFileError::is_damage) {
            let summary = self.frames.summary()?;
            let mut at = 0;
            while let Ok(Some((raw, next))) = record_at(&summary, at) {
                at = next;
                if matches!(raw.opcode, op::SCHEMA | op::CHANNEL) {
                    // The damage has been reported.
                    let _ = take(raw.opcode, raw.body, &mut self.schemas, &mut self.channels);
                }
            }
        }
        step
    }

    /// Returns the chunk's record at `at` if it is a message of a known topic.
    fn advance_in_chunk(&mut self, at: usize) -> Result<Option<MessagePlace>, McapFileError> {
        let record = record_at(self.frames.chunk(), at);
        let record = match record {
            Ok(record) => record,
            Err(why) => {
                self.in_chunk = None;
                return Err(self.frames.damaged(why));
            }
        };
        let Some((raw, next)) = record else {
            self.in_chunk = None;
            return Ok(None);
        };
        self.in_chunk = Some(next);
        let taken = take(raw.opcode, raw.body, &mut self.schemas, &mut self.channels);
        let taken = taken.map_err(|why| self.frames.damaged(why))?;
        Ok(taken.map(|message| MessagePlace {
            from: next - message.data_len,
            to: next,
            in_chunk: true,
            message,
        }))
    }

    fn metadata(&self) -> Result<McapItem<'static>, McapFileError> {
        let (name, entries) =
            records::metadata(self.frames.record()).map_err(|why| self.frames.damaged(why))?;
        Ok(McapItem::Metadata { name, entries })
    }
}

/// Place of a message.
struct MessagePlace {
    from: usize,
    to: usize,
    in_chunk: bool,
    message: Header,
}

/// Message without its contents, which are the last bytes of its record.
struct Header {
    channel: Channel,
    log_time_ns: u64,
    data_len: usize,
}

/// Registers a schema or a channel; returns a message of a known channel.
fn take(
    opcode: u8,
    body: &[u8],
    schemas: &mut BTreeMap<u16, String>,
    channels: &mut BTreeMap<u16, Option<Channel>>,
) -> Result<Option<Header>, String> {
    match opcode {
        op::SCHEMA => {
            let (id, name) = records::schema(body)?;
            schemas.insert(id, name);
        }
        op::CHANNEL => {
            let channel = records::channel(body)?;
            let schema = schemas.get(&channel.schema_id).map_or("", String::as_str);
            channels.insert(channel.id, known(&channel.topic, schema)?);
        }
        op::MESSAGE => {
            let head = records::message(body)?;
            let channel = channels.get(&head.channel_id);
            let channel = channel.ok_or_else(|| {
                format!("a message of channel {}, which is missing", head.channel_id)
            })?;
            return Ok(channel.map(|channel| Header {
                channel,
                log_time_ns: head.log_time_ns,
                data_len: head.data_len,
            }));
        }
        _ => {}
    }
    Ok(None)
}

/// Channel of a topic; `None` for one that this version does not know.
fn known(name: &str, schema: &str) -> Result<Option<Channel>, String> {
    let Some(topic) = Topic::named(name) else {
        return Ok(None);
    };
    let fits = match topic.layout() {
        MessageLayout::Cdr(layouts) => layouts.iter().any(|(name, _)| *name == schema),
        MessageLayout::Json(name, _) => name == schema,
        MessageLayout::Link => true,
    };
    if !fits {
        return Err(format!(
            "topic {name} has the schema {schema:?}, which this version does not know"
        ));
    }
    Ok(Some(Channel {
        topic,
        as_codes: schema == SAMPLES_I16,
    }))
}
