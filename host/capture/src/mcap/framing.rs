//! Records of an MCAP file in sequence, in bounded memory.
//!
//! The `mcap` crate's readers trust the lengths within a chunk: a hostile file makes them allocate without limit or panic.
//! Therefore the framing is done here; the records themselves are parsed by the crate.

use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use ::mcap::MAGIC;
use ::mcap::records::op;

use super::McapFileError;
use super::chunk;
use super::records::{self, CHUNK_HEADER, PACKING_AT, ZSTD};

/// Limit of a record and of an unpacked chunk, in bytes: `Writer` makes chunks of 1 MiB, other tools up to some 10 MiB.
pub const MAX_RECORD: u64 = 64 << 20;

/// Number of bytes read at once when searching for a chunk.
const SEARCH_BLOCK: u64 = 1 << 16;

/// Size of a record's opcode and length, in bytes.
const PREFIX: u64 = chunk::PREFIX as u64;

/// Result of [`McapFrames::step`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameStep {
    /// A record outside a chunk: see [`McapFrames::record`].
    Record(u8),
    /// A chunk, unpacked and checked: see [`McapFrames::chunk`].
    Chunk,
    /// A record that was skipped.
    Skipped,
    /// The end of the data, or of the file.
    End,
}

/// An MCAP file being read.
pub struct McapFrames {
    input: BufReader<File>,
    path: PathBuf,
    length: u64,
    /// Offset of the next record.
    next: u64,
    /// Offset of the record read last.
    at: u64,
    /// Offset of the first record skipped since the last one read: the lengths of skipped records are not checked.
    passed: Option<u64>,
    body: Vec<u8>,
    chunk: Vec<u8>,
    cut: bool,
    /// Set at the end; the position of the input then has no meaning.
    ended: bool,
}

impl McapFrames {
    /// Opens a file and checks that it is MCAP.
    pub fn open(path: &Path) -> Result<Self, McapFileError> {
        let failed = |source| McapFileError::Io {
            path: path.into(),
            offset: 0,
            source,
        };
        // Checked before opening: opening a pipe would block.
        let metadata = std::fs::metadata(path).map_err(failed)?;
        if !metadata.is_file() {
            let what = if metadata.is_dir() {
                "a directory"
            } else {
                "a pipe or a device"
            };
            let path = path.into();
            return Err(McapFileError::NotAFile { path, what });
        }
        let mut input = BufReader::new(File::open(path).map_err(failed)?);
        let mut magic = [0; MAGIC.len()];
        match input.read_exact(&mut magic) {
            Ok(()) if magic == *MAGIC => {}
            Err(e) if e.kind() != ErrorKind::UnexpectedEof => return Err(failed(e)),
            _ => return Err(McapFileError::NotMcap { path: path.into() }),
        }
        Ok(Self {
            input,
            path: path.into(),
            length: metadata.len(),
            next: MAGIC.len() as u64,
            at: 0,
            passed: None,
            body: Vec::new(),
            chunk: Vec::new(),
            cut: false,
            ended: false,
        })
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns `true` if the file ends within a record or without its end mark: the recorder was killed, or the copy is incomplete.
    pub fn is_cut(&self) -> bool {
        self.cut
    }

    /// Records of the unpacked chunk.
    pub fn chunk(&self) -> &[u8] {
        &self.chunk
    }

    /// Record outside a chunk that was read last.
    pub fn record(&self) -> &[u8] {
        &self.body
    }

    /// Creates an error at the record read last.
    pub fn damaged(&self, what: impl ToString) -> McapFileError {
        McapFileError::Damaged {
            path: self.path.clone(),
            offset: self.at,
            what: what.to_string(),
        }
    }

    fn failed(&self, source: std::io::Error) -> McapFileError {
        McapFileError::Io {
            path: self.path.clone(),
            offset: self.at,
            source,
        }
    }

    fn too_long(&self, what: &'static str, declared: u64) -> McapFileError {
        McapFileError::TooLong {
            path: self.path.clone(),
            offset: self.at,
            what,
            declared,
            limit: MAX_RECORD,
        }
    }

    /// Length of the file in bytes.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Offset of the record read last.
    pub fn at(&self) -> u64 {
        self.at
    }

    /// Advances to the next record. After an error that [`McapFileError::is_damage`] the next call continues after the damage;
    /// after the end it returns the end again.
    pub fn step(&mut self) -> Result<FrameStep, McapFileError> {
        if self.ended {
            return Ok(FrameStep::End);
        }
        let step = self.next_step();
        self.ended = matches!(step, Ok(FrameStep::End));
        if step.as_ref().is_err_and(McapFileError::is_damage) {
            self.resume()?;
        }
        step
    }

    /// Finds the next record after a damaged one: where its length says, or, since the length itself may be damaged, at the next
    /// recognisable chunk.
    fn resume(&mut self) -> Result<(), McapFileError> {
        if self.next <= self.at || !self.is_record_at(self.next)? {
            let chunk = self.chunk_from(self.unchecked() + 1)?;
            // A file with its end mark is damaged, not cut.
            self.ended = chunk.is_none() && self.has_end_mark()?;
            self.next = chunk.unwrap_or(self.length);
        }
        self.passed = None;
        self.seek(self.next)
    }

    /// Offset from which data may be damaged: a wrong length only shows at the place that it leads to.
    fn unchecked(&self) -> u64 {
        self.passed.unwrap_or(self.at)
    }

    /// Returns `true` if the file has the end mark of a complete file.
    fn has_end_mark(&mut self) -> Result<bool, McapFileError> {
        let mut end = [0; MAGIC.len()];
        self.seek(self.length.saturating_sub(MAGIC.len() as u64))?;
        let read = self.input.read_exact(&mut end);
        Ok(read.is_ok() && end == *MAGIC)
    }

    fn seek(&mut self, to: u64) -> Result<(), McapFileError> {
        let sought = self.input.seek(SeekFrom::Start(to));
        sought.map(drop).map_err(|e| self.failed(e))
    }

    /// Returns `true` if a record of a known kind begins at this offset and ends within the file.
    fn is_record_at(&mut self, at: u64) -> Result<bool, McapFileError> {
        let Some(left) = self.length.checked_sub(at + PREFIX) else {
            return Ok(at == self.length);
        };
        self.seek(at)?;
        let mut prefix = [0; chunk::PREFIX];
        self.input
            .read_exact(&mut prefix)
            .map_err(|e| self.failed(e))?;
        let [opcode, length @ ..] = prefix;
        let known = (op::HEADER..=op::DATA_END).contains(&opcode);
        Ok(known && u64::from_le_bytes(length) <= left)
    }

    /// Offset of the first chunk packed with zstd from `from` on.
    fn chunk_from(&mut self, from: u64) -> Result<Option<u64>, McapFileError> {
        /// Distance from a record's beginning to the name of its packing.
        const TO_PACKING: usize = chunk::PREFIX + PACKING_AT;
        const WHOLE: usize = chunk::PREFIX + CHUNK_HEADER;
        self.seek(from)?;
        let mut window = Vec::new();
        let mut at = from;
        loop {
            let mut block = self.input.by_ref().take(SEARCH_BLOCK);
            let read = block.read_to_end(&mut window);
            let read = read.map_err(|e| self.failed(e))?;
            let marks = window.windows(ZSTD.len()).enumerate();
            for (mark, _) in marks.filter(|(_, bytes)| **bytes == ZSTD) {
                let Some(begin) = mark.checked_sub(TO_PACKING) else {
                    continue;
                };
                let Some((&[op::CHUNK, ref length @ ..], head)) =
                    window[begin..].split_first_chunk::<{ chunk::PREFIX }>()
                else {
                    continue;
                };
                let length = u64::from_le_bytes(*length);
                if length <= MAX_RECORD && records::begins_as_chunk(head, length) {
                    return Ok(Some(at + begin as u64));
                }
            }
            if read == 0 {
                return Ok(None);
            }
            // The tail may be the beginning of a chunk: it is searched again.
            let keep = window.len().min(WHOLE - 1);
            at += (window.len() - keep) as u64;
            window.drain(..window.len() - keep);
        }
    }

    /// Records of the summary at the end of a complete file, which repeats schemas and channels; empty if there is none.
    pub fn summary(&mut self) -> Result<Vec<u8>, McapFileError> {
        const FOOTER: u64 = PREFIX + 20;
        let end = self.length.saturating_sub(FOOTER + MAGIC.len() as u64);
        let mut footer = [0; FOOTER as usize];
        self.seek(end)?;
        let read = self.input.read_exact(&mut footer);
        let mut summary = Vec::new();
        if let (Ok(()), [op::FOOTER, rest @ ..]) = (read, &footer)
            && let Some(start) = rest[8..].first_chunk::<8>()
            && let start = u64::from_le_bytes(*start)
            && start > 0
            && end.checked_sub(start).is_some_and(|l| l <= MAX_RECORD)
        {
            self.seek(start)?;
            let mut all = self.input.by_ref().take(end - start);
            let read = all.read_to_end(&mut summary);
            read.map_err(|e| self.failed(e))?;
        }
        self.seek(self.next)?;
        Ok(summary)
    }

    fn next_step(&mut self) -> Result<FrameStep, McapFileError> {
        self.at = self.next;
        let left = self.length.saturating_sub(self.at);
        if left < PREFIX {
            // The footer already implies the end mark.
            self.cut = true;
            return Ok(FrameStep::End);
        }
        let mut prefix = [0; chunk::PREFIX];
        self.input
            .read_exact(&mut prefix)
            .map_err(|e| self.failed(e))?;
        let [opcode, length @ ..] = prefix;
        let declared = u64::from_le_bytes(length);
        match (opcode, declared) {
            (op::DATA_END, 4) | (op::FOOTER, 20) => return Ok(FrameStep::End),
            (op::DATA_END | op::FOOTER, _) => {
                return Err(self.damaged(format!("an end mark of {declared} bytes")));
            }
            _ => {}
        }
        let needed = matches!(
            opcode,
            op::HEADER | op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA | op::CHUNK
        );
        if declared > MAX_RECORD && (needed || declared > left) {
            return Err(self.too_long("a record", declared));
        }
        if declared > left - PREFIX {
            // The file is cut here, or the length is wrong: then more data follows.
            let mut chunk = self.chunk_from(self.unchecked() + 1)?;
            if chunk == Some(self.at) {
                chunk = self.chunk_from(self.at + 1)?;
            }
            if chunk.is_some() || self.has_end_mark()? {
                let left = left - PREFIX;
                let what =
                    format!("a record declares {declared} bytes, {left} are left in the file");
                return Err(self.damaged(what));
            }
            self.cut = true;
            return Ok(FrameStep::End);
        }
        self.next = self.at + PREFIX + declared;
        match opcode {
            op::CHUNK => {
                self.passed = None;
                self.take_chunk(declared)
            }
            _ if needed => {
                self.passed = None;
                self.read_body(declared)?;
                Ok(FrameStep::Record(opcode))
            }
            _ => {
                self.reject_damaged_chunk(declared)?;
                self.passed.get_or_insert(self.at);
                self.pass()
            }
        }
    }

    fn read_body(&mut self, length: u64) -> Result<(), McapFileError> {
        // At most MAX_RECORD, and not beyond the end of the file.
        self.body.resize(length as usize, 0);
        let read = self.input.read_exact(&mut self.body);
        read.map_err(|e| self.failed(e))
    }

    fn pass(&mut self) -> Result<FrameStep, McapFileError> {
        let sought = self.input.seek(SeekFrom::Start(self.next));
        sought.map_err(|e| self.failed(e))?;
        Ok(FrameStep::Skipped)
    }

    /// Checks that a record of an unknown kind is not a chunk with a damaged opcode.
    fn reject_damaged_chunk(&mut self, length: u64) -> Result<(), McapFileError> {
        if length < CHUNK_HEADER as u64 {
            return Ok(());
        }
        let mut head = [0; CHUNK_HEADER];
        self.input
            .read_exact(&mut head)
            .map_err(|e| self.failed(e))?;
        if records::begins_as_chunk(&head, length) {
            return Err(self.damaged("a chunk that is marked as another record"));
        }
        Ok(())
    }

    fn take_chunk(&mut self, length: u64) -> Result<FrameStep, McapFileError> {
        self.read_body(length)?;
        let chunk = records::chunk(&self.body).map_err(|why| self.damaged(why))?;
        if chunk.unpacked > MAX_RECORD {
            return Err(self.too_long("a chunk", chunk.unpacked));
        }
        let unpacked = chunk::unpack(&chunk, &mut self.chunk);
        unpacked.map_err(|why| self.damaged(why))?;
        Ok(FrameStep::Chunk)
    }
}
