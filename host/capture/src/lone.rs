//! Description of a file with one channel only, for which a second file is needed.

use std::path::Path;

use ihd_signal::TimeBase;

use super::assembly::OpenFile;
use super::channels::ChannelOptions;
use super::error::CaptureError;
use super::format::{Opener, recognise};
use super::formats::FileSamples;
use super::formats::stated_unit::StatedUnit;
use super::options::OpenOptions;

/// Description of the only channel of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct LoneChannel {
    /// Format of the file.
    pub format: String,
    /// Name of the channel; may be empty.
    pub name: String,
    /// Unit that the file states; `None` if it states none.
    pub unit: Option<String>,
    /// Largest magnitude it can show, in its unit; `None` if the file does not state it.
    pub full_scale: Option<f64>,
    /// Number of samples.
    pub samples: usize,
    /// Sampling rate in hertz; `None` for uneven or missing times.
    pub rate_hz: Option<f64>,
    /// Time of the first sample in seconds; `None` if the file states no times.
    pub start_s: Option<f64>,
    /// Time from first to last sample in seconds; `None` if the file states no times.
    pub duration_s: Option<f64>,
    /// Smallest sample, in the unit.
    pub min: f64,
    /// Largest sample.
    pub max: f64,
    /// Mean of the samples.
    pub mean: f64,
    /// Rms value without the mean.
    pub rms: f64,
}

/// Describes the only channel of a file; `None` if it has several, or if a second file is given.
///
/// # Errors
/// Any error of [`open`](crate::open()); options of voltage and current, neither of which the channel is known to be.
pub fn lone_channel(
    path: &Path,
    options: &OpenOptions,
) -> Result<Option<LoneChannel>, CaptureError> {
    let opener = recognise(path)?;
    if matches!(opener, Opener::Whole(_)) || options.second.is_some() {
        return Ok(None);
    }
    let mut file = OpenFile::new(path, opener, options)?;
    let [channel] = file.source.channels() else {
        return Ok(None);
    };
    if options.channels != ChannelOptions::default() {
        let what = "it holds one channel, which is shown as the file has it: leave --input channels, units, probe, invert and swap out, \
             or give the file with the other channel too";
        return Err(CaptureError::Choice {
            path: path.to_owned(),
            what: what.to_owned(),
        });
    }
    let channel = channel.clone();
    let samples = file.source.read(&[0], &mut |_| ());
    let FileSamples { time, columns } = samples.map_err(|e| e.in_file(path))?;
    let x = columns.first().map_or(&[][..], Vec::as_slice);
    let n = x.len().max(1) as f64;
    let all = || x.iter().map(|x| f64::from(*x));
    let mean = all().sum::<f64>() / n;
    let square = all().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n;
    let time = options.stated_time(0.0).or(time);
    let at = |k: usize| time.as_ref().and_then(|t| t.at(k));
    let last_s = at(x.len().saturating_sub(1));
    Ok(Some(LoneChannel {
        format: file
            .source
            .metadata()
            .remove("format")
            .unwrap_or_else(|| "text".to_owned()),
        name: channel.name,
        unit: (channel.unit != StatedUnit::Nothing).then(|| channel.unit.to_string()),
        full_scale: channel.full_scale,
        samples: x.len(),
        rate_hz: match time {
            Some(TimeBase::Even { dt_s, .. }) => Some(1.0 / dt_s),
            _ => None,
        },
        start_s: at(0),
        duration_s: at(0).zip(last_s).map(|(first, last)| last - first),
        min: all().fold(f64::INFINITY, f64::min),
        max: all().fold(f64::NEG_INFINITY, f64::max),
        mean,
        rms: libm::sqrt(square),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// They were ignored in silence: the channel was shown in its file's unit.
    #[test]
    fn options_of_voltage_and_current_are_refused_and_a_rate_is_applied() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.csv");
        std::fs::write(&path, b"time_s,v_V\n0,1\n1,2\n2,3\n").unwrap();
        let rated = OpenOptions {
            rate_hz: Some(2.0),
            ..OpenOptions::default()
        };
        let lone = lone_channel(&path, &rated).unwrap().unwrap();
        assert_eq!((lone.rate_hz, lone.duration_s), (Some(2.0), Some(1.0)));
        let scaled = OpenOptions {
            channels: ChannelOptions {
                probe: Some([10.0, 1.0]),
                ..ChannelOptions::default()
            },
            ..OpenOptions::default()
        };
        let why = lone_channel(&path, &scaled).unwrap_err().to_string();
        assert!(
            why.contains("one channel") && why.contains("probe"),
            "{why}"
        );
    }
}
