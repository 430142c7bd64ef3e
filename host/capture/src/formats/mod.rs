//! Readers of the files of scopes and programs, one module per format.
//!
//! A reader parses the header first and lists the channels; only the samples of selected channels are read. Every declared length
//! is compared with the file's size before memory is allocated.

pub mod arrays;
pub mod channel;
pub mod csv;
pub mod input;
pub mod isf;
pub mod mat;
pub mod npz;
pub mod stated_unit;
pub mod time;
pub mod trc;
pub mod unit;
pub mod wfm;

use std::collections::BTreeMap;

use ihd_signal::truth::PeriodTruth;
use ihd_signal::{FrequencyStep, TimeBase};

pub use self::channel::FileChannel;
use super::error::FormatError;

/// Samples of the selected channels.
#[derive(Clone, Debug, PartialEq)]
pub struct FileSamples {
    /// Times of the samples; `None` if the file does not state them.
    pub time: Option<TimeBase>,
    /// One column for each selected channel in the order requested, in the channel's unit; equal lengths.
    pub columns: Vec<Vec<f32>>,
}

/// Samples of a file with one channel, repeated for each time it is selected.
fn single_channel(values: Vec<f32>, time: TimeBase, selected: &[usize]) -> FileSamples {
    let mut columns = vec![values; selected.len().min(1)];
    while columns.len() < selected.len() {
        columns.extend(columns.first().cloned());
    }
    FileSamples {
        time: Some(time),
        columns,
    }
}

/// Facts that a file holds beside its samples, in the form of a capture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FileFacts {
    /// Truth of a simulation.
    pub truth: Vec<PeriodTruth>,
    /// Steps of the switching frequency.
    pub f_sw: Vec<FrequencyStep>,
    /// Mains frequency in hertz.
    pub mains_hz: Option<f64>,
    /// Time of a mains zero crossing in seconds.
    pub zero_crossing_s: Option<f64>,
}

/// Called with the share of a file that has been read, from 0 to 1.
pub type ReadProgress<'a> = &'a mut dyn FnMut(f64);

/// File whose header has been read.
pub trait CaptureFile {
    /// Its channels, at least one.
    fn channels(&self) -> &[FileChannel];

    /// Other facts in the header, as text: the format, the instrument.
    fn metadata(&self) -> BTreeMap<String, String>;

    /// Facts beside the samples; empty for files of other programs.
    ///
    /// # Errors
    /// [`FormatError`] if they are damaged.
    fn facts(&mut self) -> Result<FileFacts, FormatError> {
        Ok(FileFacts::default())
    }

    /// Reads the samples of the channels with these indices into [`CaptureFile::channels`].
    ///
    /// # Errors
    /// [`FormatError`] where the samples are damaged, not finite or not in order of time.
    fn read(
        &mut self,
        selected: &[usize],
        progress: ReadProgress<'_>,
    ) -> Result<FileSamples, FormatError>;
}
