//! Recordings on disk: capture files (docs/captures.md) with the converters' codes, the truth of
//! every switching period, and the settings that made them.

use std::path::Path;

use ihd_capture::mcap::McapFileError;
use ihd_capture::mcap::cdr;
use ihd_capture::mcap::cdr::BatchTime;
use ihd_capture::mcap::save::{PairBatch, batches, write_head, write_truth};
use ihd_capture::mcap::topics::Topic;
use ihd_capture::mcap::writer::{Existing, Writer};

use super::run::SimulatedRecording;

/// Key of the settings among a capture's metadata, as JSON.
pub const SETTINGS_KEY: &str = "simulation";

/// Key of the name of the writing program.
const MADE_BY_KEY: &str = "made_by";

/// Writes a recording, replacing an existing file; `clean` adds the waveforms without noise and quantising.
///
/// [`McapFileError`] if the file cannot be written.
pub fn write(
    recording: &SimulatedRecording,
    path: &Path,
    clean: bool,
) -> Result<(), McapFileError> {
    let s = &recording.settings;
    let name = format!("ihd simulate: {} at {} kHz", s.pot, s.f_sw_hz / 1e3);
    let mut capture = recording.capture(&name);
    let settings = serde_json::to_string(s).map_err(|e| McapFileError::Write {
        path: path.to_owned(),
        source: std::io::Error::from(e).into(),
    })?;
    let made_by = concat!("ihd ", env!("CARGO_PKG_VERSION")).to_owned();
    capture.metadata.insert(SETTINGS_KEY.to_owned(), settings);
    capture.metadata.insert(MADE_BY_KEY.to_owned(), made_by);
    let mut writer = Writer::create(path, Existing::Replace, false)?;
    write_head(&mut writer, &capture)?;
    let mut truth = capture.truth.iter().peekable();
    let units = [recording.volt_per_code(), recording.ampere_per_code()];
    for PairBatch { from, to, time } in batches(&capture.time, capture.len()) {
        let t0_s = time.t0_s();
        write_truth(&mut writer, &mut truth, capture.time.at(to))?;
        let code = |k: usize| [recording.v_code[k], recording.i_code[k]];
        let message = cdr::codes(&time, units, (from..to).map(code));
        writer.message(Topic::Samples, t0_s, &message)?;
        if clean {
            let message = clean_samples(recording, &time, from, to);
            writer.message(Topic::CleanSamples, t0_s, &message)?;
        }
    }
    write_truth(&mut writer, &mut truth, None)?;
    writer.finish()
}

fn clean_samples(
    recording: &SimulatedRecording,
    time: &BatchTime<'_>,
    from: usize,
    to: usize,
) -> Vec<u8> {
    let pair = |k: usize| [&recording.v_clean_v, &recording.i_clean_a].map(|x| x[k] as f32);
    cdr::singles(time, (from..to).map(pair))
}

#[cfg(test)]
mod tests {
    use ihd_capture::mcap;
    use ihd_capture::mcap::McapReader;
    use ihd_capture::mcap::reader::McapItem;
    use ihd_signal::TimeBase;

    use super::super::run::record;
    use super::super::sensing::Rate;
    use super::super::settings::{CaptureSpec, LoadKind};
    use super::*;

    fn short(rate: Rate) -> SimulatedRecording {
        let mut s = CaptureSpec {
            load: LoadKind::Behavioural,
            duration_s: 1e-3,
            ..CaptureSpec::default()
        };
        s.sensing.rate = rate;
        s.sensing.snr_db = Some(40.0);
        record(&s, |_| ()).unwrap()
    }

    #[test]
    fn what_is_written_is_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        for rate in [Rate::Locked, Rate::Hz(50e6)] {
            let r = short(rate);
            write(&r, &path, false).unwrap();
            let back = mcap::read(&path).unwrap();
            let expected = r.capture(&path.display().to_string());
            assert!(back.v_v == expected.v_v && back.i_a == expected.i_a);
            assert_eq!(back.truth.len(), expected.truth.len());
            assert_eq!(back.truth[9], expected.truth[9]);
            assert_eq!(
                (back.f_sw, back.mains_hz),
                (expected.f_sw, expected.mains_hz)
            );
            let settings: CaptureSpec = serde_json::from_str(&back.metadata[SETTINGS_KEY]).unwrap();
            assert_eq!(settings, r.settings);
            let exact =
                (0..back.v_v.len()).all(|k| (back.time.at(k).unwrap() - r.t_s[k]).abs() < 1e-12);
            assert!(exact, "{rate:?}");
            assert!(matches!(back.time, TimeBase::Even { .. }));
        }
        let again = dir.path().join("b.mcap");
        write(&short(Rate::Hz(50e6)), &again, false).unwrap();
        let bytes = |path| std::fs::read(path).unwrap();
        assert!(bytes(&path) == bytes(&again), "same settings, same bytes");
    }

    #[test]
    fn clean_waveforms_lie_beside_the_samples() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.mcap");
        let r = short(Rate::Hz(50e6));
        write(&r, &path, true).unwrap();
        let mut reader = McapReader::open(&path).unwrap();
        let (mut clean_v, mut clean_a) = (Vec::new(), Vec::new());
        while let Some(item) = reader.next_item().unwrap() {
            if let McapItem::Message(m) = item
                && m.topic == Topic::CleanSamples
            {
                let samples = cdr::read_samples(m.data, m.as_codes).unwrap();
                samples.append_to([&mut clean_v, &mut clean_a]);
            }
        }
        assert_eq!(clean_v.len(), r.v_clean_v.len());
        assert_eq!(clean_a[777], r.i_clean_a[777] as f32);
    }
}
