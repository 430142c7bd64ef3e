//! Opening of a capture of any known format; the format is recognised by the content, not by the name.

use std::path::Path;

use ihd_signal::Capture;

use super::assembly::{ChannelSamples, OpenFile, assembled};
use super::channels::{ChosenChannel, choose};
use super::error::CaptureError;
use super::format::{Opener, recognise};
use super::formats::FileChannel;
use super::formats::stated_unit::StatedUnit;
use super::formats::unit::Unit;
use super::mcap::{FileLosses, SalvagedCapture};
use super::options::OpenOptions;

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

/// Opens one file or two whose channels are read one by one.
fn separate(
    path: &Path,
    opener: &Opener,
    options: &OpenOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Capture, CaptureError> {
    if let (Some(second), Some(_)) = (&options.second, &options.columns) {
        let what = format!(
            "--input columns takes both channels from this file, and {} would not be read: leave that file out, or name a channel of \
             each with --input channels=V,I",
            second.display()
        );
        return Err(CaptureError::Choice {
            path: path.to_owned(),
            what,
        });
    }
    let mut files = vec![OpenFile::new(path, opener, options)?];
    if let Some(second) = &options.second {
        files.push(OpenFile::new(second, recognise(second)?, options)?);
    }
    assembled(files, options, progress)
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
        unit: StatedUnit::Known(unit),
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
    let mut adjusted = Capture {
        v_v: v.values,
        i_a: i.values,
        v_full_scale_v: v.full_scale,
        i_full_scale_a: i.full_scale,
        ..capture
    };
    if let Some(time) = options.stated_time(adjusted.time.at(0).unwrap_or(0.0)) {
        // Facts of the file refer to its own clock.
        adjusted = Capture {
            time,
            f_sw: Vec::new(),
            mains_hz: None,
            zero_crossing_s: None,
            truth: Vec::new(),
            ..adjusted
        };
    }
    Ok(adjusted)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use ihd_signal::{FrequencyStep, TimeBase};

    use super::*;
    use crate::channels::ChannelRef;

    fn written(name: &str, content: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(name);
        std::fs::write(&path, content).unwrap();
        (dir, path)
    }

    #[test]
    fn what_a_file_says_of_its_own_clock_does_not_outlast_another_rate() {
        let capture = Capture {
            time: TimeBase::Even {
                t0_s: 0.0,
                dt_s: 1e-6,
            },
            v_v: vec![1.0; 3],
            i_a: vec![2.0; 3],
            f_sw: vec![FrequencyStep {
                t_s: 0.0,
                f_sw_hz: 45e3,
            }],
            mains_hz: Some(50.0),
            zero_crossing_s: Some(0.0),
            ..Capture::default()
        };
        let of_rate = |rate_hz| {
            let options = OpenOptions {
                rate_hz,
                ..OpenOptions::default()
            };
            adjusted(Path::new("a.mcap"), capture.clone(), &options).unwrap()
        };
        assert_eq!(of_rate(None), capture);
        let halved = of_rate(Some(5e5));
        let facts = (halved.f_sw.len(), halved.truth.len());
        assert_eq!(
            (facts, halved.mains_hz, halved.zero_crossing_s),
            ((0, 0), None, None)
        );
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

    /// A voltage of one file and a current of another one, as scopes and scripts write them, without headings.
    #[test]
    fn no_file_of_two_is_left_out_in_silence() {
        let dir = tempfile::tempdir().unwrap();
        let [first, second] = ["v.csv", "i.csv"].map(|name| dir.path().join(name));
        std::fs::write(&first, b"0,1,7\n1,2,8\n2,3,9\n").unwrap();
        std::fs::write(&second, b"0,4\n1,5\n2,6\n").unwrap();
        let paired = |channels: Option<[usize; 2]>, columns: Option<[usize; 3]>| {
            let options = OpenOptions {
                second: Some(second.clone()),
                columns: columns.map(|of| of.map(ChannelRef::Number)),
                channels: crate::channels::ChannelOptions {
                    channels: channels.map(|of| of.map(ChannelRef::Number)),
                    ..Default::default()
                },
                ..OpenOptions::default()
            };
            open(&first, &options).map_err(|e| e.to_string())
        };
        let of_each = paired(Some([1, 3]), None).unwrap();
        assert_eq!(
            (of_each.v_v, of_each.i_a),
            (vec![1.0, 2.0, 3.0], vec![4.0, 5.0, 6.0])
        );
        for (channels, columns, key) in [
            (None, Some([1, 2, 2]), "--input columns"),
            (None, Some([1, 2, 3]), "--input columns"),
            (Some([1, 2]), None, "--input channels"),
        ] {
            let why = paired(channels, columns).unwrap_err();
            assert!(why.contains(key) && why.contains("i.csv"), "{why}");
        }
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
