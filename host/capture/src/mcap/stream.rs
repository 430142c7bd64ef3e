//! Capture read part by part, in the memory of a part.

use std::path::Path;

use ihd_signal::Capture;

use super::McapFileError;
use super::load::{CaptureBuilder, FileLosses, take_item};
use super::reader::McapReader;

/// Capture file of which the first part that was not taken yet is in memory. Damaged chunks are skipped and counted.
pub struct CaptureStream {
    reader: McapReader,
    builder: CaptureBuilder,
    losses: FileLosses,
    first_damage: Option<McapFileError>,
    taken: bool,
    ended: bool,
}

impl CaptureStream {
    /// Opens a file.
    ///
    /// # Errors
    /// [`McapFileError`] when it cannot be read or is no capture of this version.
    pub fn open(path: &Path) -> Result<Self, McapFileError> {
        Ok(Self {
            reader: McapReader::open(path)?,
            builder: CaptureBuilder::new(path),
            losses: FileLosses::default(),
            first_damage: None,
            taken: false,
            ended: false,
        })
    }

    /// Reads on until at least `pairs` pairs are in memory, or to the end.
    ///
    /// # Errors
    /// [`McapFileError`] when the file cannot be read, or holds nothing but damage.
    pub fn fill(&mut self, pairs: usize) -> Result<(), McapFileError> {
        let (losses, first) = (&mut self.losses, &mut self.first_damage);
        let mut skip = |error: McapFileError| {
            if !error.is_damage() {
                return Err(error);
            }
            losses.take(&error);
            first.get_or_insert(error);
            Ok(())
        };
        while !self.ended && self.builder.capture.len() < pairs {
            self.ended = !take_item(&mut self.reader, &mut self.builder, &mut skip)?;
        }
        let nothing = self.ended && !self.taken && self.held().is_empty();
        match self.first_damage.take() {
            Some(first) if nothing => Err(first),
            first => {
                self.first_damage = first;
                Ok(())
            }
        }
    }

    /// Part in memory that was not taken yet.
    pub fn held(&self) -> &Capture {
        &self.builder.capture
    }

    /// Takes the first `pairs` pairs of the part in memory.
    pub fn take(&mut self, pairs: usize) -> Capture {
        self.taken = true;
        let held = &mut self.builder.capture;
        if pairs >= held.len() && self.ended {
            return std::mem::take(held);
        }
        let part = held.part(0..pairs);
        held.forget(pairs);
        part
    }

    /// Unreadable parts met so far.
    pub fn losses(&self) -> FileLosses {
        FileLosses {
            cut_at: self.reader.is_cut().then(|| self.reader.at()),
            ..self.losses.clone()
        }
    }

    /// Share of the file that was read, from 0 to 1.
    pub fn share(&self) -> f64 {
        self.reader.share()
    }
}
