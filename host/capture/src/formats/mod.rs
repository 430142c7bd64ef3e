//! Readers of what scopes and programs write, one module a format.
//!
//! A reader looks at the header first and lists the channels; samples are read only of the channels
//! that are wanted. Every declared length is compared with the file's before anything is allocated.

pub mod arrays;
pub mod csv;
pub mod input;
pub mod isf;
pub mod mat;
pub mod npz;
pub mod time;
pub mod trc;
pub mod unit;
pub mod wfm;

use std::collections::BTreeMap;

use ihd_signal::truth::PeriodTruth;
use ihd_signal::{FrequencyStep, TimeBase};

use self::unit::Unit;
use super::error::FormatError;

/// One channel, as its file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Name in the file; may be empty.
    pub name: String,
    /// Unit where the file states it.
    pub unit: Option<Unit>,
    /// Largest magnitude the channel can show, in [`Channel::unit`], where the file states
    /// it.
    pub full_scale: Option<f64>,
}

/// Samples of the channels that were asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Samples {
    /// When they were taken; `None` where the file does not state it.
    pub time: Option<TimeBase>,
    /// One column a wanted channel in the order asked for, in the channel's unit; equal lengths.
    pub columns: Vec<Vec<f32>>,
}

/// The samples of a file with one channel, repeated for each time it is wanted.
fn single_channel(values: Vec<f32>, time: TimeBase, wanted: &[usize]) -> Samples {
    let mut columns = vec![values; wanted.len().min(1)];
    while columns.len() < wanted.len() {
        columns.extend(columns.first().cloned());
    }
    Samples {
        time: Some(time),
        columns,
    }
}

/// What a file knows beside its samples, as a capture holds it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Known {
    /// What a simulation knows of its load.
    pub truth: Vec<PeriodTruth>,
    /// Steps of the switching frequency.
    pub f_sw: Vec<FrequencyStep>,
    /// Mains frequency in hertz.
    pub mains_hz: Option<f64>,
    /// Time of a mains zero crossing in seconds.
    pub zero_crossing_s: Option<f64>,
}

/// Hears how far a file has been read, from 0 to 1.
pub type Progress<'a> = &'a mut dyn FnMut(f64);

/// A file whose header has been read.
pub trait Source {
    /// Its channels, at least one.
    fn channels(&self) -> &[Channel];

    /// What else the header states, as text: the format, the instrument.
    fn metadata(&self) -> BTreeMap<String, String>;

    /// What the file knows beside the samples; nothing where it is of another program.
    ///
    /// # Errors
    /// [`FormatError`] where it is damaged.
    fn known(&mut self) -> Result<Known, FormatError> {
        Ok(Known::default())
    }

    /// Reads the samples of the channels with these indices into [`Source::channels`].
    ///
    /// # Errors
    /// [`FormatError`] where the samples are damaged, not finite or not in order of time.
    fn read(&mut self, wanted: &[usize], progress: Progress<'_>) -> Result<Samples, FormatError>;
}
