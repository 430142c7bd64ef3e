//! Opening of a capture of any known format; the format is recognised by the content, not by the name.

use std::path::{Path, PathBuf};

use ihd_signal::{Capture, TimeBase};

use super::channels::{ChannelOptions, ChannelRef, ChosenChannel, choose, quantity_of_name};
use super::error::CaptureError;
use super::format::{Opener, recognise, regular};
use super::formats::unit::Unit;
use super::formats::{CaptureFile, FileChannel, FileFacts, FileSamples};
use super::mcap::{FileLosses, SalvagedCapture};
use super::pair::overlap;

/// User's options for a file, and for a second one with the other channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OpenOptions {
    /// File with the other channel, of one acquisition; its channels are numbered after the first's.
    pub second: Option<PathBuf>,
    /// Channels, units, ratios and signs.
    pub channels: ChannelOptions,
    /// Columns of a table: time (`-` for none), voltage, current; they replace [`ChannelOptions::channels`].
    pub columns: Option<[ChannelRef; 3]>,
    /// Sampling rate in hertz; replaces the file's time.
    pub rate_hz: Option<f64>,
}

/// Opens a capture.
///
/// # Errors
/// [`CaptureError`] naming the file, the place in it and what to do.
pub fn open(path: &Path, options: &OpenOptions) -> Result<Capture, CaptureError> {
    open_with(path, options, &mut |_| ())
}

/// Opens a capture; `progress` is called with the share read, from 0 to 1.
///
/// # Errors
/// Any error of [`open`].
pub fn open_with(
    path: &Path,
    options: &OpenOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Capture, CaptureError> {
    Ok(salvage_with(path, options, progress)?.capture)
}

/// Opens the readable part of a capture and reports the losses; only MCAP can be read after a damage.
///
/// # Errors
/// Any error of [`open`], if nothing can be read.
pub fn salvage_with(
    path: &Path,
    options: &OpenOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<SalvagedCapture, CaptureError> {
    let opener = recognise(path)?;
    if let Opener::Whole(read) = opener {
        let SalvagedCapture { capture, losses } = read(path)?;
        let capture = adjusted(path, capture, options)?;
        return Ok(SalvagedCapture { capture, losses });
    }
    let capture = separate(path, opener, options, progress)?;
    let losses = FileLosses::default();
    Ok(SalvagedCapture { capture, losses })
}

/// Description of the only channel of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct LoneChannel {
    /// Format of the file.
    pub format: String,
    /// Name of the channel; may be empty.
    pub name: String,
    /// Unit; `None` if neither the file nor the user states one.
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
/// Any error of [`open`].
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
    let channel = channel.clone();
    let samples = file.source.read(&[0], &mut |_| ());
    let FileSamples { time, columns } = samples.map_err(|e| e.in_file(path))?;
    let x = columns.first().map_or(&[][..], Vec::as_slice);
    let n = x.len().max(1) as f64;
    let all = || x.iter().map(|x| f64::from(*x));
    let mean = all().sum::<f64>() / n;
    let square = all().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n;
    let time = options
        .rate_hz
        .map(|hz| TimeBase::Even {
            t0_s: 0.0,
            dt_s: 1.0 / hz,
        })
        .or(time);
    let at = |k: usize| time.as_ref().and_then(|t| t.at(k));
    let last_s = at(x.len().saturating_sub(1));
    Ok(Some(LoneChannel {
        format: file
            .source
            .metadata()
            .remove("format")
            .unwrap_or_else(|| "text".to_owned()),
        name: channel.name,
        unit: channel.unit.map(|u| u.to_string()),
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

/// Opens one file or two whose channels are read one by one.
fn separate(
    path: &Path,
    opener: &Opener,
    options: &OpenOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Capture, CaptureError> {
    let mut files = vec![OpenFile::new(path, opener, options)?];
    if let Some(second) = &options.second {
        files.push(OpenFile::new(second, recognise(second)?, options)?);
    }
    assembled(files, options, progress)
}

/// File whose header has been read.
struct OpenFile {
    path: PathBuf,
    source: Box<dyn CaptureFile>,
}

impl OpenFile {
    fn new(path: &Path, opener: &Opener, options: &OpenOptions) -> Result<Self, CaptureError> {
        let Opener::Channels(open) = opener else {
            return Err(CaptureError::Choice {
                path: path.to_owned(),
                what: "it holds both channels already and cannot be paired".to_owned(),
            });
        };
        let opened = open(Box::new(regular(path)?), options.columns.as_ref());
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

/// Samples of one chosen channel.
struct ChannelSamples {
    values: Vec<f32>,
    full_scale: Option<f64>,
}

impl ChannelSamples {
    /// Applies the factor to volt or ampere.
    ///
    /// # Errors
    /// The sample that the factor drives beyond f32.
    fn new(mut values: Vec<f32>, channel: &FileChannel, factor: f64) -> Result<Self, String> {
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
fn assembled(
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
    let mut metadata = files[0].source.metadata();
    // Facts of the file refer to its own clock; they do not hold with another rate.
    let facts = match options.rate_hz {
        None => files[0].source.facts().map_err(|e| e.in_file(&path))?,
        Some(_) => FileFacts::default(),
    };
    let mut read = |file: &mut OpenFile, selected: &[usize]| {
        let samples = file.source.read(selected, progress);
        samples.map_err(|e| e.in_file(&file.path))
    };
    let apart = chosen.map(|c| c.index >= of_first);
    let (mut columns, time) = if apart[0] == apart[1] {
        let k = usize::from(apart[0]);
        let selected = chosen.map(|c| c.index - k * of_first);
        let samples = read(&mut files[k], &selected)?;
        (samples.columns, samples.time)
    } else {
        let mut both = Vec::new();
        for (c, second) in chosen.iter().zip(apart) {
            let k = usize::from(second);
            both.push(read(&mut files[k], &[c.index - k * of_first])?);
        }
        metadata.insert(
            "paired_with".to_owned(),
            files[1].path.display().to_string(),
        );
        paired_columns(both, options).map_err(|what| CaptureError::Pair {
            first: files[0].path.clone(),
            second: files[1].path.clone(),
            what,
        })?
    };
    let stated = options.rate_hz.map(|rate_hz| TimeBase::Even {
        t0_s: 0.0,
        dt_s: 1.0 / rate_hz,
    });
    let no_time = "the file states no time: give the sampling rate, as in --input rate=50M";
    let time = stated.or(time).ok_or_else(|| choice(no_time.to_owned()))?;
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

/// Applies signs, ratios, units, swap and rate to a capture in a format of our own.
pub(super) fn adjusted(
    path: &Path,
    capture: Capture,
    options: &OpenOptions,
) -> Result<Capture, CaptureError> {
    let choice = |what: String| CaptureError::Choice {
        path: path.to_owned(),
        what,
    };
    if options.second.is_some() || options.columns.is_some() {
        let what = "it holds voltage and current: no second file and no --input columns are needed";
        return Err(choice(what.to_owned()));
    }
    let channel = |name: &str, unit, full_scale| FileChannel {
        name: name.to_owned(),
        unit: Some(unit),
        full_scale,
    };
    let channels = [
        channel("v", Unit::VOLT, capture.v_full_scale_v),
        channel("i", Unit::AMPERE, capture.i_full_scale_a),
    ];
    let chosen = choose(&channels, &options.channels).map_err(choice)?;
    let mut columns = [capture.v_v, capture.i_a];
    let mut side = |c: ChosenChannel| {
        let values = std::mem::take(&mut columns[c.index]);
        ChannelSamples::new(values, &channels[c.index], c.factor).map_err(choice)
    };
    let (v, i) = (side(chosen[0])?, side(chosen[1])?);
    let time = options.rate_hz.map(|rate_hz| TimeBase::Even {
        t0_s: capture.time.at(0).unwrap_or(0.0),
        dt_s: 1.0 / rate_hz,
    });
    Ok(Capture {
        time: time.unwrap_or(capture.time),
        v_v: v.values,
        i_a: i.values,
        v_full_scale_v: v.full_scale,
        i_full_scale_a: i.full_scale,
        ..capture
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(name: &str, content: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(name);
        std::fs::write(&path, content).unwrap();
        (dir, path)
    }

    #[test]
    fn a_plain_table_is_a_capture() {
        let text = "time_s,v_V,i_mA\n-1e-6,10,1000\n0,20,-500\n1e-6,30,250\n";
        let (_dir, path) = written("a.csv", text.as_bytes());
        let capture = open(&path, &OpenOptions::default()).unwrap();
        assert_eq!(capture.v_v, [10.0, 20.0, 30.0]);
        assert_eq!(capture.i_a, [1.0, -0.5, 0.25]);
        let TimeBase::Even { t0_s, dt_s } = capture.time else {
            panic!("{:?}", capture.time);
        };
        assert!((t0_s + 1e-6).abs() < 1e-18 && (dt_s - 1e-6).abs() < 1e-18);
    }

    #[test]
    fn columns_and_rate_by_the_user() {
        let text = "1,5,7,9\n2,6,8,10\n";
        let (_dir, path) = written("a.csv", text.as_bytes());
        let columns = ["-", "4", "2"].map(ChannelRef::parse);
        let options = OpenOptions {
            columns: Some(columns),
            rate_hz: Some(2.0),
            ..OpenOptions::default()
        };
        let capture = open(&path, &options).unwrap();
        assert_eq!(
            (capture.v_v, capture.i_a),
            (vec![9.0, 10.0], vec![5.0, 6.0])
        );
        let dt_s = 0.5;
        assert_eq!(capture.time, TimeBase::Even { t0_s: 0.0, dt_s });
        let no_rate = OpenOptions {
            rate_hz: None,
            ..options
        };
        let asked = open(&path, &no_rate).unwrap_err().to_string();
        assert!(asked.contains("--input rate=50M"), "{asked}");
    }

    #[test]
    fn what_is_no_file_or_no_capture_is_reported() {
        let refused = |path: &Path| open(path, &OpenOptions::default()).unwrap_err().to_string();
        let (dir, path) = written("a.bin", b"\x01\x02\x03");
        assert!(refused(&path).contains("binary"));
        assert!(refused(dir.path()).contains("is a directory"));
        std::fs::write(&path, b"").unwrap();
        assert!(refused(&path).contains("empty"));
        std::fs::write(&path, b"t,v,i\n").unwrap();
        assert!(refused(&path).contains("a.bin, line"), "{}", refused(&path));
        assert!(refused(&dir.path().join("none.csv")).contains("none.csv"));
    }
}
