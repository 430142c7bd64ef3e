//! Voltage and current of a capture, chosen among the channels of one file or two.

use std::path::{Path, PathBuf};

use ihd_signal::{Capture, TimeBase};

use super::channels::{ChannelOptions, ChannelRef, choose, quantity_of_name};
use super::error::CaptureError;
use super::format::{Opener, regular};
use super::formats::{CaptureFile, FileChannel, FileFacts, FileSamples};
use super::options::OpenOptions;
use super::pair::overlap;

/// File whose header has been read.
pub struct OpenFile {
    path: PathBuf,
    /// Channels and samples.
    pub source: Box<dyn CaptureFile>,
}

impl OpenFile {
    /// Reads the header.
    ///
    /// # Errors
    /// No file whose channels are read one by one, or any error of its format.
    pub fn new(path: &Path, opener: &Opener, options: &OpenOptions) -> Result<Self, CaptureError> {
        let Opener::Channels(open) = opener else {
            return Err(CaptureError::Choice {
                path: path.to_owned(),
                what: "it holds both channels already and cannot be paired".to_owned(),
            });
        };
        let opened = open(Box::new(regular(path)?), options.of_file());
        Ok(Self {
            path: path.to_owned(),
            source: opened.map_err(|e| e.in_file(path))?,
        })
    }

    /// Channels of the file; in a pair the file's name decides if the channel's does not.
    fn channels(&self, paired: bool) -> Vec<FileChannel> {
        let mut channels = self.source.channels().to_vec();
        let stem = self
            .path
            .file_stem()
            .map(|s| s.to_string_lossy().into_owned());
        if let ([channel], Some(stem), true) = (channels.as_mut_slice(), stem, paired)
            && quantity_of_name(&channel.name).is_none()
            && (channel.name.is_empty() || quantity_of_name(&stem).is_some())
        {
            channel.name = stem;
        }
        channels
    }
}

/// Magnitude from which a sample is a scope's mark: SCPI writes ±9.9E37 for an overflow, 9.91E37 for no number, some divide by ten.
const MARK: f32 = 9e36;

/// Samples that are searched for marks together.
const PART: usize = 1024;

/// Samples of one chosen channel.
pub struct ChannelSamples {
    /// Samples in volt or ampere.
    pub values: Vec<f32>,
    /// Largest magnitude it can show, in volt or ampere.
    pub full_scale: Option<f64>,
}

impl ChannelSamples {
    /// Applies the factor to volt or ampere. A scope's mark becomes infinite, and the survey cuts the capture there.
    ///
    /// # Errors
    /// The sample that the factor drives beyond f32.
    pub fn new(mut values: Vec<f32>, channel: &FileChannel, factor: f64) -> Result<Self, String> {
        let is_mark = |x: &f32| x.abs() >= MARK;
        for part in values.chunks_mut(PART) {
            // Without a branch, so that many samples are compared at once.
            if part.iter().fold(false, |any, x| any | is_mark(x)) {
                let marks = part.iter_mut().filter(|x| is_mark(x));
                marks.for_each(|x| *x = f32::INFINITY.copysign(*x));
            }
        }
        if factor != 1.0 {
            for (k, x) in values.iter_mut().enumerate() {
                let scaled = (f64::from(*x) * factor) as f32;
                if x.is_finite() && !scaled.is_finite() {
                    return Err(format!(
                        "sample {k} is {x:e} in the file, times {factor:e} is no voltage or current: \
                         see --input probe and units"
                    ));
                }
                *x = scaled;
            }
        }
        Ok(Self {
            values,
            full_scale: channel.full_scale.map(|full| full * factor.abs()),
        })
    }
}

/// Chooses the channels among those of all files, reads and combines them.
///
/// # Errors
/// [`CaptureError`] naming the file and what to do.
pub fn assembled(
    mut files: Vec<OpenFile>,
    options: &OpenOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Capture, CaptureError> {
    let paired = files.len() > 1;
    let path = files[0].path.clone();
    let choice = |what: String| CaptureError::Choice {
        path: path.clone(),
        what,
    };
    let channels: Vec<FileChannel> = files.iter().flat_map(|f| f.channels(paired)).collect();
    let of_first = files[0].source.channels().len();
    // A table then has these two channels, in this order.
    let of_columns = (options.columns.as_ref()).map(|_| [1, 2].map(ChannelRef::Number));
    let channel_options = ChannelOptions {
        channels: of_columns.or_else(|| options.channels.channels.clone()),
        ..options.channels.clone()
    };
    let chosen = choose(&channels, &channel_options).map_err(choice)?;
    let metadata = files[0].source.metadata();
    // Facts of the file refer to its own clock; they do not hold with another rate.
    let facts = match options.rate_hz {
        None => files[0].source.facts().map_err(|e| e.in_file(&path))?,
        Some(_) => FileFacts::default(),
    };
    let [v, i] = chosen.map(|c| c.index >= of_first);
    if paired {
        let [first, second] = [0, 1].map(|k| files[k].path.display().to_string());
        if v == i {
            let [used, unused] = if v { [second, first] } else { [first, second] };
            return Err(choice(format!(
                "voltage and current would both be of {used}, and {unused} would not be used: leave that file out, or name a channel of each \
                 with --input channels=V,I, numbered through both files"
            )));
        }
    }
    let places = chosen.map(|c| c.index);
    let (mut columns, time) = read_columns(&mut files, places, options, progress)?;
    let no_time = "the file states no time: give the sampling rate, as in --input rate=50M";
    let time = options
        .stated_time(0.0)
        .or(time)
        .ok_or_else(|| choice(no_time.to_owned()))?;
    let mut side = |k: usize| {
        let values = std::mem::take(columns.get_mut(k).unwrap_or(&mut Vec::new()));
        ChannelSamples::new(values, &channels[chosen[k].index], chosen[k].factor).map_err(choice)
    };
    let (v, i) = (side(0)?, side(1)?);
    Ok(Capture {
        name: path.display().to_string(),
        time,
        v_v: v.values,
        i_a: i.values,
        v_full_scale_v: v.full_scale,
        i_full_scale_a: i.full_scale,
        f_sw: facts.f_sw,
        mains_hz: facts.mains_hz,
        zero_crossing_s: facts.zero_crossing_s,
        truth: facts.truth,
        metadata,
    })
}

type Columns = (Vec<Vec<f32>>, Option<TimeBase>);

/// Reads two channels, by their places among those of all files.
fn read_columns(
    files: &mut [OpenFile],
    places: [usize; 2],
    options: &OpenOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Columns, CaptureError> {
    let of_first = files[0].source.channels().len();
    let mut read = |file: &mut OpenFile, selected: &[usize]| {
        let samples = file.source.read(selected, progress);
        samples.map_err(|e| e.in_file(&file.path))
    };
    let [v, i] = places.map(|k| usize::from(k >= of_first));
    if v == i {
        let samples = read(&mut files[v], &places.map(|k| k - v * of_first))?;
        return Ok((samples.columns, samples.time));
    }
    let both = vec![
        read(&mut files[v], &[places[0] - v * of_first])?,
        read(&mut files[i], &[places[1] - i * of_first])?,
    ];
    paired_columns(both, options).map_err(|what| CaptureError::Pair {
        first: files[0].path.clone(),
        second: files[1].path.clone(),
        what,
    })
}

/// Cuts voltage and current from two files to their common times. With a stated rate the files' times are ignored.
fn paired_columns(both: Vec<FileSamples>, options: &OpenOptions) -> Result<Columns, String> {
    let lengths: Vec<usize> = both
        .iter()
        .map(|s| s.columns.first().map_or(0, Vec::len))
        .collect();
    let times: Vec<_> = both.iter().map(|s| s.time.clone()).collect();
    let mut columns: Vec<_> = both.into_iter().flat_map(|s| s.columns).collect();
    let timed = options.rate_hz.is_none();
    let ([Some(a), Some(b)], true) = (&times[..], timed) else {
        let shortest = lengths.iter().copied().min().unwrap_or(0);
        columns.iter_mut().for_each(|c| c.truncate(shortest));
        return Ok((columns, None));
    };
    let common = overlap((a, lengths[0]), (b, lengths[1]))?;
    for (column, range) in columns.iter_mut().zip([&common.first, &common.second]) {
        column.truncate(range.end);
        column.drain(..range.start);
    }
    let time = match a {
        TimeBase::Even { dt_s, .. } => TimeBase::Even {
            t0_s: a.at(common.first.start).unwrap_or(0.0),
            dt_s: *dt_s,
        },
        TimeBase::Stamps(_) => a.clone(),
    };
    Ok((columns, Some(time)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::stated_unit::StatedUnit;

    /// SCPI's overflow mark, as a voltage of 9.9e37 V, made R -7.7e31 ohm; a probe's factor must not hide it.
    #[test]
    fn an_overflow_mark_is_not_finite() {
        let channel = FileChannel {
            name: "v".into(),
            unit: StatedUnit::Nothing,
            full_scale: None,
        };
        for factor in [1.0, 0.01, 100.0] {
            let marks = vec![9.9e37, -9.9e37, 9.91e37, 9.9e36, 325.0];
            let values = ChannelSamples::new(marks, &channel, factor).unwrap().values;
            let finite: Vec<bool> = values.iter().map(|x| x.is_finite()).collect();
            assert_eq!(finite, [false, false, false, false, true], "{values:?}");
            assert!(values[1] < 0.0);
        }
    }
}
