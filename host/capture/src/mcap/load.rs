//! Reading of whole captures.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use ihd_signal::{Capture, FrequencyStep, TimeBase};

use super::McapFileError;
use super::cdr::{self, SamplesMessage};
use super::reader::{McapItem, McapMessage, McapReader};
use super::save::key;
use super::topics::{FSw, META_CAPTURE, META_FREE, MainsCrossing, Topic};

/// Limit of pairs of a capture in memory: 2.7 s of 50 MS/s, 1 GiB.
pub const MAX_PAIRS: usize = 1 << 27;

/// Parts of a file that could not be read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FileLosses {
    /// Offset up to which a file without its end mark is complete; `None` if it has one.
    pub cut_at: Option<u64>,
    /// Number of damaged records that were skipped, each a chunk at most.
    pub damaged: u32,
    /// First of them: file, byte and description.
    pub first_damage: Option<String>,
}

impl FileLosses {
    /// Returns `true` if the whole file was read.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    pub(crate) fn take(&mut self, damage: &McapFileError) {
        self.damaged = self.damaged.saturating_add(1);
        self.first_damage.get_or_insert_with(|| damage.to_string());
    }
}

impl fmt::Display for FileLosses {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(at) = self.cut_at {
            write!(
                f,
                "the file is cut: it ends without its end mark, what is whole ends at byte {at}"
            )?;
        }
        if let Some(first) = &self.first_damage {
            let and = if self.cut_at.is_some() { "; " } else { "" };
            let n = self.damaged;
            write!(
                f,
                "{and}{n} damaged records were passed over, the first: {first}"
            )?;
        }
        Ok(())
    }
}

/// Readable part of a file, and the losses.
#[derive(Clone, Debug, PartialEq)]
pub struct SalvagedCapture {
    /// Readable part.
    pub capture: Capture,
    /// Unreadable parts.
    pub losses: FileLosses,
}

/// Reads a whole capture; of a cut file the complete part.
///
/// # Errors
/// [`McapFileError`].
pub fn read(path: &Path) -> Result<Capture, McapFileError> {
    let salvaged = gather(McapReader::open(path)?, &mut Err)?;
    Ok(salvaged.capture)
}

/// Reads the undamaged part of a capture: a damaged chunk is skipped, data after a cut is missing.
///
/// # Errors
/// [`McapFileError`] when the file cannot be read, is none, or holds nothing but damage.
pub fn salvage(path: &Path) -> Result<SalvagedCapture, McapFileError> {
    let mut losses = FileLosses::default();
    let mut first = None;
    let mut salvaged = gather(McapReader::open(path)?, &mut |error| {
        if !error.is_damage() {
            return Err(error);
        }
        losses.take(&error);
        first.get_or_insert(error);
        Ok(())
    })?;
    if let (true, Some(first)) = (salvaged.capture.is_empty(), first) {
        return Err(first);
    }
    losses.cut_at = salvaged.losses.cut_at;
    salvaged.losses = losses;
    Ok(salvaged)
}

/// Handler of an error: ends with it, or continues.
pub(super) type OnError<'a> = &'a mut dyn FnMut(McapFileError) -> Result<(), McapFileError>;

fn gather(mut reader: McapReader, on_error: OnError<'_>) -> Result<SalvagedCapture, McapFileError> {
    let mut builder = CaptureBuilder::new(reader.path());
    while take_item(&mut reader, &mut builder, on_error)? {
        if builder.capture.len() > MAX_PAIRS {
            return Err(McapFileError::TooManyPairs {
                path: reader.path().into(),
                limit: MAX_PAIRS,
            });
        }
    }
    let losses = FileLosses {
        cut_at: reader.is_cut().then(|| reader.at()),
        ..FileLosses::default()
    };
    Ok(SalvagedCapture {
        capture: builder.capture,
        losses,
    })
}

/// Takes the next item of a file into the capture; `false` at the end.
pub(super) fn take_item(
    reader: &mut McapReader,
    builder: &mut CaptureBuilder,
    on_error: OnError<'_>,
) -> Result<bool, McapFileError> {
    let result = match reader.next_item() {
        Ok(None) => return Ok(false),
        Err(error) => return on_error(error).map(|()| true),
        Ok(Some(McapItem::Metadata { name, entries })) => builder.take_metadata(&name, entries),
        Ok(Some(McapItem::Message(message))) => builder.take_message(message),
    };
    if let Err(why) = result {
        on_error(reader.damaged(why))?;
    }
    Ok(true)
}

/// Capture under construction.
pub(super) struct CaptureBuilder {
    pub(super) capture: Capture,
}

impl CaptureBuilder {
    pub(super) fn new(path: &Path) -> Self {
        let name = path.display().to_string();
        Self {
            capture: Capture {
                name,
                ..Capture::default()
            },
        }
    }

    fn take_metadata(
        &mut self,
        name: &str,
        entries: BTreeMap<String, String>,
    ) -> Result<(), String> {
        match name {
            META_CAPTURE => {
                let number = |key: &str| -> Result<Option<f64>, String> {
                    let Some(text) = entries.get(key) else {
                        return Ok(None);
                    };
                    let value = text.parse::<f64>().ok().filter(|x| x.is_finite());
                    let value = value.ok_or_else(|| format!("its {key} is {text:?}"))?;
                    Ok(Some(value))
                };
                self.capture.v_full_scale_v = number(key::V_FULL_SCALE)?;
                self.capture.i_full_scale_a = number(key::I_FULL_SCALE)?;
            }
            META_FREE => self.capture.metadata.extend(entries),
            _ => {}
        }
        Ok(())
    }

    fn take_message(&mut self, m: McapMessage<'_>) -> Result<(), String> {
        let wrong =
            |what: &dyn std::fmt::Display| format!("a message of {}: {what}", m.topic.name());
        match m.topic {
            Topic::Samples => {
                let samples = cdr::read_samples(m.data, m.as_codes).map_err(|e| wrong(&e))?;
                self.take_samples(&samples);
            }
            Topic::Truth => {
                let truth = cdr::read_truth(m.data).map_err(|e| wrong(&e))?;
                self.capture.truth.push(truth);
            }
            Topic::FSw => {
                let step: FSw = serde_json::from_slice(m.data).map_err(|e| wrong(&e))?;
                let f_sw = &mut self.capture.f_sw;
                // The recorder repeats the frequency so that each part of the file has it.
                if f_sw.last().is_none_or(|last| last.f_sw_hz != step.f_sw_hz) {
                    f_sw.push(FrequencyStep {
                        t_s: step.t_s,
                        f_sw_hz: step.f_sw_hz,
                    });
                }
            }
            Topic::Mains => {
                let mains: MainsCrossing = serde_json::from_slice(m.data).map_err(|e| wrong(&e))?;
                let capture = &mut self.capture;
                capture.mains_hz = capture.mains_hz.or(mains.mains_hz);
                capture.zero_crossing_s = capture.zero_crossing_s.or(mains.zero_crossing_s);
            }
            Topic::CleanSamples
            | Topic::Telemetry
            | Topic::Window
            | Topic::Fault
            | Topic::Lookup
            | Topic::LinkCounters
            | Topic::FromDevice
            | Topic::ToDevice => {}
        }
        Ok(())
    }

    fn take_samples(&mut self, samples: &SamplesMessage) {
        if samples.is_empty() {
            return;
        }
        let capture = &mut self.capture;
        let have = capture.len();
        if have == 0 {
            capture.time = TimeBase::Even {
                t0_s: samples.at(0),
                dt_s: samples.dt_s,
            };
        }
        if let TimeBase::Even { t0_s, dt_s } = capture.time {
            let due_s = t0_s + have as f64 * dt_s;
            let even = samples.t_s.is_empty()
                && samples.dt_s == dt_s
                && (samples.at(0) - due_s).abs() <= 1e-3 * dt_s;
            if !even {
                let stamps = (0..have).map(|k| t0_s + k as f64 * dt_s).collect();
                capture.time = TimeBase::Stamps(stamps);
            }
        }
        samples.append_to([&mut capture.v_v, &mut capture.i_a]);
        if let TimeBase::Stamps(stamps) = &mut capture.time {
            stamps.extend((0..samples.len()).map(|k| samples.at(k)));
        }
    }
}

#[cfg(test)]
mod tests {
    use ihd_sim::recording::run::record;
    use ihd_sim::recording::sensing::Rate;
    use ihd_sim::recording::settings::{CaptureSpec, LoadKind, RecordingChange, RecordingEvent};

    use super::super::write;
    use super::*;

    fn capture(rate: Rate) -> Capture {
        let mut settings = CaptureSpec {
            load: LoadKind::Behavioural,
            duration_s: 4e-3,
            events: vec![RecordingEvent {
                t_s: 2e-3,
                change: RecordingChange::Frequency(50e3),
            }],
            ..CaptureSpec::default()
        };
        settings.sensing.rate = rate;
        let recording = record(&settings, |_| ()).unwrap();
        let mut capture = recording.capture("of a test");
        capture.metadata.insert("coil".into(), "23 turns".into());
        // Without current there is no impedance, and NaN equals nothing.
        capture.truth.retain(|t| t.r_ohm[0].is_finite());
        capture
    }

    /// Without assert_eq, whose output would be unreadably long.
    fn assert_same(a: &Capture, b: &Capture, path: &Path) {
        let b = &Capture {
            name: path.display().to_string(),
            ..b.clone()
        };
        assert!(a.time == b.time, "times differ");
        assert!(a.v_v == b.v_v && a.i_a == b.i_a, "samples differ");
        assert_eq!(a.truth.len(), b.truth.len());
        assert!(a.truth == b.truth, "truth differs");
        assert_eq!(a.f_sw, b.f_sw);
        assert!(a == b, "all but samples, truth and frequency differs");
    }

    #[test]
    fn what_is_written_is_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        let even = capture(Rate::Hz(50e6));
        write(&even, &path).unwrap();
        assert_same(&read(&path).unwrap(), &even, &path);
        let again = dir.path().join("b.mcap");
        write(&even, &again).unwrap();
        let bytes = |path| std::fs::read(path).unwrap();
        assert!(bytes(&path) == bytes(&again), "same capture, same bytes");
    }

    #[test]
    fn times_that_follow_the_frequency_come_back_within_a_picosecond() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        let locked = capture(Rate::Locked);
        write(&locked, &path).unwrap();
        let back = read(&path).unwrap();
        let (TimeBase::Stamps(written), TimeBase::Stamps(read)) = (&locked.time, &back.time) else {
            panic!("one even run");
        };
        assert_eq!(written.len(), read.len());
        assert!(written.iter().zip(read).all(|(a, b)| (a - b).abs() < 1e-12));
        let size = std::fs::metadata(&path).unwrap().len();
        // 8 bytes a pair of f32, 104 a period of truth, schemas; a stamp each would cost 30 kB more.
        assert!(size < 8 * 3800 + 104 * 190 + 15_000, "{size}");
    }

    #[test]
    fn jittering_times_come_back_exactly() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        let mut jittering = capture(Rate::Hz(10e6));
        let n = jittering.len();
        let t_s = (0..n).map(|k| (k as f64 + 0.3 * f64::from(k as u32 % 7)) * 1e-7);
        jittering.time = TimeBase::Stamps(t_s.collect());
        write(&jittering, &path).unwrap();
        assert_same(&read(&path).unwrap(), &jittering, &path);
    }
}
