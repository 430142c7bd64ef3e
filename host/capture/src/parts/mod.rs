//! Capture in parts that fit into memory, each cut where the mains is close to zero, so that no half-cycle is lost.
//!
//! A file of ours is read as it is cut; of other formats the samples are read at once. A capture that is not longer than one and a half
//! parts is one part. The cuts depend on the samples alone.

mod quiet;

use std::ops::Range;
use std::path::{Path, PathBuf};

use ihd_signal::{Capture, TimeBase};

use crate::error::CaptureError;
use crate::format::{Opener, recognise};
use crate::mcap::{CaptureStream, FileLosses};
use crate::open::{adjusted, salvage_with};
use crate::options::OpenOptions;

/// Pairs of a part: 42 ms of 50 MS/s. Memory of a command is a multiple of it.
pub const PART_PAIRS: usize = 1 << 21;

/// Least duration of a part in seconds: two half-cycles of a mains of 45 Hz and some. It counts at more than 84 MS/s.
const MIN_S: f64 = 25e-3;

/// Most pairs of a part, whatever its duration.
const MAX_PAIRS: usize = 1 << 24;

/// Reader of a capture's parts.
pub struct PartReader {
    path: PathBuf,
    options: OpenOptions,
    source: Source,
    pairs: usize,
    /// Pairs of the parts so far.
    taken: usize,
    /// Time of the first pair in seconds.
    start_s: f64,
}

enum Source {
    /// File that is read as its parts are taken.
    Stream(Box<CaptureStream>),
    /// Capture in memory.
    Whole(Box<Capture>),
}

impl PartReader {
    /// Opens a capture; parts have about [`PART_PAIRS`] pairs. `progress` is called with the share read, from 0 to 1, where all
    /// samples are read at once.
    ///
    /// # Errors
    /// [`CaptureError`] as [`open`](crate::open()).
    pub fn open(
        path: &Path,
        options: &OpenOptions,
        progress: &mut dyn FnMut(f64),
    ) -> Result<Self, CaptureError> {
        Self::open_in(path, options, PART_PAIRS, progress)
    }

    /// Opens a capture; parts have about `pairs` pairs.
    ///
    /// # Errors
    /// [`CaptureError`] as [`open`](crate::open()).
    pub fn open_in(
        path: &Path,
        options: &OpenOptions,
        pairs: usize,
        progress: &mut dyn FnMut(f64),
    ) -> Result<Self, CaptureError> {
        let source = match recognise(path)? {
            Opener::Whole(_) => Source::Stream(Box::new(CaptureStream::open(path)?)),
            Opener::Channels(_) => {
                let opened = salvage_with(path, options, progress)?;
                Source::Whole(Box::new(opened.capture))
            }
        };
        Ok(Self {
            path: path.to_owned(),
            options: options.clone(),
            source,
            pairs: pairs.max(1),
            taken: 0,
            start_s: 0.0,
        })
    }

    /// Returns the next part; `None` at the end.
    ///
    /// # Errors
    /// [`CaptureError`] when the file cannot be read, or the options do not fit it.
    pub fn next_part(&mut self) -> Result<Option<Capture>, CaptureError> {
        if let Source::Stream(stream) = &mut self.source {
            stream.fill(most(self.pairs) + 1)?;
        }
        let pairs = lasting(self.rest().0, self.pairs);
        if let Source::Stream(stream) = &mut self.source {
            stream.fill(most(pairs) + 1)?;
        }
        let (held, rest) = self.rest();
        if rest.is_empty() {
            return Ok(None);
        }
        let n = match rest.len() > most(pairs) {
            true => quiet::place(held, rest.start..rest.start + pairs) - rest.start,
            false => rest.len(),
        };
        if self.taken == 0 {
            self.start_s = held.time.at(rest.start).unwrap_or(0.0);
        }
        let mut part = match &mut self.source {
            Source::Stream(stream) => adjusted(&self.path, stream.take(n), &self.options)?,
            Source::Whole(capture) if n == capture.len() => std::mem::take(&mut **capture),
            Source::Whole(capture) => capture.part(rest.start..rest.start + n),
        };
        if let (Some(rate_hz), Source::Stream(_)) = (self.options.rate_hz, &self.source) {
            // The stated rate counts from the capture's beginning.
            let t0_s = self.start_s + self.taken as f64 / rate_hz;
            let dt_s = 1.0 / rate_hz;
            part.time = TimeBase::Even { t0_s, dt_s };
        }
        self.taken += n;
        Ok(Some(part))
    }

    /// Capture in memory, and the pairs of it that were not taken.
    fn rest(&self) -> (&Capture, Range<usize>) {
        match &self.source {
            Source::Stream(stream) => (stream.held(), 0..stream.held().len()),
            Source::Whole(capture) => (capture, self.taken.min(capture.len())..capture.len()),
        }
    }

    /// Returns `true` if all parts were taken.
    pub fn is_at_end(&mut self) -> Result<bool, CaptureError> {
        if let Source::Stream(stream) = &mut self.source {
            stream.fill(1)?;
        }
        Ok(self.rest().1.is_empty())
    }

    /// Share of the capture that was read, from 0 to 1.
    pub fn share(&self) -> f64 {
        match &self.source {
            Source::Stream(stream) => stream.share(),
            Source::Whole(capture) => {
                self.taken as f64 / capture.len().max(self.taken).max(1) as f64
            }
        }
    }

    /// Unreadable parts of the file met so far.
    pub fn losses(&self) -> FileLosses {
        match &self.source {
            Source::Stream(stream) => stream.losses(),
            Source::Whole(_) => FileLosses::default(),
        }
    }
}

/// Most pairs of a part of about `pairs` pairs: a shorter rest would be a poor part of its own.
fn most(pairs: usize) -> usize {
    pairs + pairs / 2
}

/// Pairs of a part that lasts long enough.
fn lasting(held: &Capture, pairs: usize) -> usize {
    let dt_s = match (held.time.at(0), held.time.at(1)) {
        (Some(first), Some(second)) => second - first,
        _ => return pairs,
    };
    let least = MIN_S / dt_s;
    if least.is_finite() && least > pairs as f64 {
        (least as usize).min(MAX_PAIRS).max(pairs)
    } else {
        pairs
    }
}
