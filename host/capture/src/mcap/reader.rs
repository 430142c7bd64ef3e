//! A capture file, message by message, up to the last whole chunk.

use std::collections::BTreeMap;
use std::path::Path;

use ::mcap::records::op;

use super::McapFileError;
use super::framing::{Frames, Step, record_at};
use super::records;
use super::topics::{Layout, PROFILE, SAMPLES_I16, Topic};

/// What our own writer puts into the header: its files have every channel in their first chunk.
const OUR_LIBRARY: &str = "ihd ";

/// One thing in the file.
#[derive(Clone, Debug, PartialEq)]
pub enum Item<'a> {
    /// A named table of text.
    Metadata {
        /// Its name.
        name: String,
        /// Its entries.
        entries: BTreeMap<String, String>,
    },
    /// A message of a known topic.
    Message(Message<'a>),
}

/// A message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Message<'a> {
    /// Which topic it belongs to.
    pub topic: Topic,
    /// Whether samples are codes (or f32).
    pub as_codes: bool,
    /// Nanoseconds after the beginning of the capture.
    pub log_time_ns: u64,
    /// Its bytes, laid out as in [`super::topics`].
    pub data: &'a [u8],
}

/// A channel that this version knows.
#[derive(Clone, Copy)]
struct Channel {
    topic: Topic,
    as_codes: bool,
}

/// A capture file being read. What it does not know it passes over.
pub struct Reader {
    frames: Frames,
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Option<Channel>>,
    /// Where the next record of the unpacked chunk begins; `None` between chunks.
    in_chunk: Option<usize>,
    /// Parts of the file may be passed over.
    indexed: bool,
    wanted_ns: (u64, u64),
}

impl Reader {
    /// Opens a file and checks its profile.
    ///
    /// # Errors
    /// [`McapFileError`] when it cannot be read or is no capture of this version.
    pub fn open(path: &Path) -> Result<Self, McapFileError> {
        let mut reader = Self {
            frames: Frames::open(path)?,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            in_chunk: None,
            indexed: false,
            wanted_ns: (0, u64::MAX),
        };
        match reader.frames.step()? {
            Step::Record(op::HEADER) => {}
            _ => return Err(McapFileError::NotMcap { path: path.into() }),
        }
        let header = records::header(reader.frames.record());
        let (profile, library) = header.map_err(|why| reader.frames.damaged(why))?;
        if profile != PROFILE {
            let kind = PROFILE.split(' ').next().unwrap_or_default();
            let hint = if profile.starts_with(kind) {
                "; it was written by a later ihd: use that one, or newer"
            } else {
                "; it was not recorded by ihd"
            };
            return Err(McapFileError::Profile {
                path: path.into(),
                found: profile,
                hint,
            });
        }
        reader.indexed = library.starts_with(OUR_LIBRARY);
        Ok(reader)
    }

    /// Reads only samples and truth from `from_ns` to `to_ns` after the beginning of the capture;
    /// chunks that hold nothing of that time are not even read from disk.
    pub fn between(mut self, from_ns: u64, to_ns: u64) -> Self {
        self.wanted_ns = (from_ns, to_ns);
        self
    }

    /// Whether the file ends before its end mark; what is whole has been read.
    pub fn is_cut(&self) -> bool {
        self.frames.is_cut()
    }

    /// Bytes from the file's beginning to where the record that was read last begins.
    pub fn at(&self) -> u64 {
        self.frames.at()
    }

    /// The file.
    pub fn path(&self) -> &Path {
        self.frames.path()
    }

    /// An error at the place that was read last.
    pub fn damaged(&self, what: impl ToString) -> McapFileError {
        self.frames.damaged(what)
    }

    /// The next item; `None` at the end.
    ///
    /// # Errors
    /// [`McapFileError`]. After one that [`McapFileError::is_damage`] the next call goes on behind the damage.
    pub fn next_item(&mut self) -> Result<Option<Item<'_>>, McapFileError> {
        let found = loop {
            if let Some(at) = self.in_chunk {
                match self.advance_in_chunk(at)? {
                    Some(message) => break message,
                    None => continue,
                }
            }
            match self.step()? {
                Step::End => return Ok(None),
                Step::Passed => {}
                Step::Chunk => self.in_chunk = Some(0),
                Step::Record(op::METADATA) => return self.metadata().map(Some),
                Step::Record(opcode) => {
                    let body = self.frames.record();
                    let taken = take(opcode, body, &mut self.schemas, &mut self.channels);
                    let taken = taken.map_err(|why| self.frames.damaged(why))?;
                    if let Some(message) = taken.filter(|m| self.wants(m)) {
                        break Found {
                            from: self.frames.record().len() - message.data_len,
                            to: self.frames.record().len(),
                            in_chunk: false,
                            message,
                        };
                    }
                }
            }
        };
        let bytes = if found.in_chunk {
            self.frames.chunk()
        } else {
            self.frames.record()
        };
        Ok(Some(Item::Message(Message {
            topic: found.message.channel.topic,
            as_codes: found.message.channel.as_codes,
            log_time_ns: found.message.log_time_ns,
            data: &bytes[found.from..found.to],
        })))
    }

    /// The next record or chunk. Channels that a damaged chunk held are taken from the summary, where there is one.
    fn step(&mut self) -> Result<Step, McapFileError> {
        let step = self.frames.step();
        if self.channels.is_empty() && step.as_ref().is_err_and(McapFileError::is_damage) {
            let summary = self.frames.summary()?;
            let mut at = 0;
            while let Ok(Some((raw, next))) = record_at(&summary, at) {
                at = next;
                if matches!(raw.opcode, op::SCHEMA | op::CHANNEL) {
                    // The damage is reported already.
                    let _ = take(raw.opcode, raw.body, &mut self.schemas, &mut self.channels);
                }
            }
        }
        step
    }

    fn wants(&self, message: &Header) -> bool {
        let bulk = matches!(
            message.channel.topic,
            Topic::Samples | Topic::CleanSamples | Topic::Truth
        );
        !bulk || (self.wanted_ns.0..=self.wanted_ns.1).contains(&message.log_time_ns)
    }

    /// The chunk's record at `at`, if it is a message that is wanted.
    fn advance_in_chunk(&mut self, at: usize) -> Result<Option<Found>, McapFileError> {
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
            // From now on every channel is known.
            if self.indexed {
                self.frames.wanted_ns = self.wanted_ns;
            }
            return Ok(None);
        };
        self.in_chunk = Some(next);
        let taken = take(raw.opcode, raw.body, &mut self.schemas, &mut self.channels);
        let taken = taken.map_err(|why| self.frames.damaged(why))?;
        Ok(taken.filter(|m| self.wants(m)).map(|message| Found {
            from: next - message.data_len,
            to: next,
            in_chunk: true,
            message,
        }))
    }

    fn metadata(&self) -> Result<Item<'static>, McapFileError> {
        let (name, entries) =
            records::metadata(self.frames.record()).map_err(|why| self.frames.damaged(why))?;
        Ok(Item::Metadata { name, entries })
    }
}

/// A message by its place.
struct Found {
    from: usize,
    to: usize,
    in_chunk: bool,
    message: Header,
}

/// A message without its bytes, which are the last of its record.
struct Header {
    channel: Channel,
    log_time_ns: u64,
    data_len: usize,
}

/// Takes a schema or a channel; a message of a known channel is returned.
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

/// A channel by its topic; `None` for one that this version does not know.
fn known(name: &str, schema: &str) -> Result<Option<Channel>, String> {
    let Some(topic) = Topic::named(name) else {
        return Ok(None);
    };
    let fits = match topic.layout() {
        Layout::Cdr(layouts) => layouts.iter().any(|(name, _)| *name == schema),
        Layout::Json(name, _) => name == schema,
        Layout::Link => true,
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
