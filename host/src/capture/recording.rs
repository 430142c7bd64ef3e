//! Recordings of `ihd simulate` as captures.

use std::collections::BTreeMap;
use std::path::Path;

use super::error::{CaptureError, FormatError};
use super::{Capture, FrequencyStep, TimeBase};
use crate::sim::inverter::meter::{ORDERS, PeriodTruth};
use crate::sim::recording::file::{self, Stored};
use crate::sim::recording::sensing::Rate;

/// Reads one.
///
/// # Errors
/// [`CaptureError::Recording`] for a file that is none or damaged.
pub fn open(path: &Path) -> Result<Capture, CaptureError> {
    let stored = file::read(path)?;
    let truth = truth(&stored).ok_or_else(|| {
        FormatError::at_byte(0, "its columns of truth differ in length").in_file(path)
    })?;
    let settings = &stored.settings;
    let time = match settings.sensing.rate {
        Rate::Locked => TimeBase::Stamps(stored.t_s),
        Rate::Hz(rate_hz) => TimeBase::Even {
            t0_s: 0.0,
            dt_s: 1.0 / rate_hz,
        },
    };
    let single = |x: &[f64]| x.iter().map(|x| *x as f32).collect();
    Ok(Capture {
        name: path.display().to_string(),
        time,
        v_v: single(&stored.v_v),
        i_a: single(&stored.i_a),
        v_full_scale_v: Some(settings.sensing.v_full_scale_v),
        i_full_scale_a: Some(settings.sensing.i_full_scale_a),
        f_sw: FrequencyStep::of_truth(&truth),
        mains_hz: Some(settings.mains_hz),
        zero_crossing_s: Some(-settings.start_s),
        truth,
        metadata: BTreeMap::from([("format".to_owned(), "recording of ihd simulate".to_owned())]),
    })
}

fn truth(stored: &Stored) -> Option<Vec<PeriodTruth>> {
    let column = |name: &str| stored.truth.get(name).map(Vec::as_slice);
    let t_s = column("truth_t_s")?;
    let scalars = [
        column("truth_f_sw_hz")?,
        column("truth_i_a")?,
        column("truth_r_power_ohm")?,
        column("truth_p_w")?,
    ];
    let (r, _) = column("truth_r_ohm")?.as_chunks::<{ ORDERS.len() }>();
    let (l, _) = column("truth_l_h")?.as_chunks::<{ ORDERS.len() }>();
    let period = |k: usize| {
        let [f_sw_hz, i_a, r_power_ohm, p_w] = scalars.map(|column| column.get(k).copied());
        Some(PeriodTruth {
            t_s: *t_s.get(k)?,
            f_sw_hz: f_sw_hz?,
            r_ohm: *r.get(k)?,
            l_h: *l.get(k)?,
            i_a: i_a?,
            r_power_ohm: r_power_ohm?,
            p_w: p_w?,
        })
    };
    (0..t_s.len()).map(period).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::recording::run::record;
    use crate::sim::recording::settings::{LoadKind, Settings};

    #[test]
    fn the_file_gives_the_capture_that_was_simulated() {
        let mut settings = Settings {
            load: LoadKind::Behavioural,
            duration_s: 1e-3,
            ..Settings::default()
        };
        for rate in [Rate::Locked, Rate::Hz(50e6)] {
            settings.sensing.rate = rate;
            let recording = record(&settings, |_| ()).unwrap();
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("a.safetensors");
            file::write(&recording, &path, false).unwrap();
            let name = path.display().to_string();
            let mut back = open(&path).unwrap();
            back.metadata.clear();
            assert!(
                back == Capture::from_recording(&recording, &name),
                "{rate:?}"
            );
        }
    }
}
