//! Writing of whole captures, and the parts that other writers of captures share.

use std::collections::BTreeMap;
use std::iter::Peekable;
use std::path::Path;

use ihd_signal::truth::PeriodTruth;
use ihd_signal::{Capture, TimeBase};

use super::McapFileError;
use super::cdr::{self, BatchTime};
use super::topics::{FSw, META_CAPTURE, META_FREE, MainsCrossing, Topic};
use super::writer::{Existing, PAIRS_PER_MESSAGE, Writer};

/// Largest deviation of a sample from an even spacing, in seconds, that still counts as even.
const EVEN_WITHIN_S: f64 = 1e-12;

/// Keys of the table [`META_CAPTURE`].
pub mod key {
    /// Origin of the capture.
    pub const NAME: &str = "name";
    /// Largest magnitude of the voltage channel in volt.
    pub const V_FULL_SCALE: &str = "v_full_scale_v";
    /// Largest magnitude of the current channel in ampere.
    pub const I_FULL_SCALE: &str = "i_full_scale_a";
}

/// Writes a capture, its samples as f32. Reading it returns the same values; times of uneven samples are exact within a picosecond.
///
/// # Errors
/// [`McapFileError`].
pub fn write(capture: &Capture, path: &Path) -> Result<(), McapFileError> {
    let mut writer = Writer::create(path, Existing::Replace, true)?;
    write_head(&mut writer, capture)?;
    let pair = |k: usize| [capture.v_v[k], capture.i_a[k]];
    let mut truth = capture.truth.iter().peekable();
    for batch in batches(&capture.time, capture.len().min(capture.i_a.len())) {
        write_truth(&mut writer, &mut truth, capture.time.at(batch.to))?;
        let pairs = (batch.from..batch.to).map(pair);
        let message = cdr::singles(&batch.time, pairs);
        writer.message(Topic::Samples, batch.time.t0_s(), &message)?;
    }
    write_truth(&mut writer, &mut truth, None)?;
    writer.finish()
}

/// Contents of table [`META_CAPTURE`]: origin of the capture, and full scales of voltage in volt and current in ampere.
pub fn describe(name: &str, full_scale: [Option<f64>; 2]) -> BTreeMap<String, String> {
    let mut table = BTreeMap::from([(key::NAME.to_owned(), name.to_owned())]);
    for (key, value) in [key::V_FULL_SCALE, key::I_FULL_SCALE]
        .iter()
        .zip(full_scale)
    {
        table.extend(value.map(|x| ((*key).to_owned(), x.to_string())));
    }
    table
}

/// Writes everything of a capture that precedes its samples, and lets the file's times begin with them.
pub fn write_head(writer: &mut Writer, capture: &Capture) -> Result<(), McapFileError> {
    writer.begin_at(capture.time.at(0).unwrap_or(0.0));
    let full_scale = [capture.v_full_scale_v, capture.i_full_scale_a];
    writer.metadata(META_CAPTURE, describe(&capture.name, full_scale))?;
    if !capture.metadata.is_empty() {
        writer.metadata(META_FREE, capture.metadata.clone())?;
    }
    for step in &capture.f_sw {
        let message = FSw {
            t_s: step.t_s,
            f_sw_hz: step.f_sw_hz,
        };
        writer.json(Topic::FSw, step.t_s, &message)?;
    }
    let mains = MainsCrossing {
        zero_crossing_s: capture.zero_crossing_s,
        mains_hz: capture.mains_hz,
    };
    if mains.mains_hz.is_some() || mains.zero_crossing_s.is_some() {
        let begin_s = capture.time.at(0).unwrap_or(0.0);
        let t_s = mains.zero_crossing_s.unwrap_or(begin_s);
        writer.json(Topic::Mains, t_s, &mains)?;
    }
    Ok(())
}

/// Entries of the truth that are not written yet.
pub type Unwritten<'a> = Peekable<std::slice::Iter<'a, PeriodTruth>>;

/// Writes the truth before `end_s`, or all of it: before the samples of its time, so that who reads the file in parts has it with
/// them.
pub fn write_truth(
    writer: &mut Writer,
    truth: &mut Unwritten<'_>,
    end_s: Option<f64>,
) -> Result<(), McapFileError> {
    while let Some(truth) = truth.next_if(|t| end_s.is_none_or(|end_s| t.t_s < end_s)) {
        writer.message(Topic::Truth, truth.t_s, &cdr::truth(truth))?;
    }
    Ok(())
}

/// Samples of one message.
pub struct PairBatch<'a> {
    /// Index of the first pair.
    pub from: usize,
    /// Index after the last pair.
    pub to: usize,
    /// Times of the samples.
    pub time: BatchTime<'a>,
}

/// Cuts `n` pairs into messages of at most [`PAIRS_PER_MESSAGE`], each evenly spaced if its samples are.
pub fn batches(time: &TimeBase, n: usize) -> Vec<PairBatch<'_>> {
    let mut batches = Vec::new();
    let mut from = 0;
    while from < n {
        let full = (from + PAIRS_PER_MESSAGE).min(n);
        let (to, time) = match time {
            TimeBase::Even { t0_s, dt_s } => {
                let t0_s = t0_s + from as f64 * dt_s;
                (full, BatchTime::Even { t0_s, dt_s: *dt_s })
            }
            TimeBase::Stamps(t_s) => stamped(t_s.get(from..full).unwrap_or_default(), from),
        };
        // Pairs without a stamp have no time and are not written.
        if to == from {
            break;
        }
        batches.push(PairBatch { from, to, time });
        from = to;
    }
    batches
}

/// First batch of `t_s`: evenly spaced as far as that holds, else with its stamps.
fn stamped(t_s: &[f64], from: usize) -> (usize, BatchTime<'_>) {
    let (Some(&first), Some(&second)) = (t_s.first(), t_s.get(1)) else {
        return (from + t_s.len(), BatchTime::Stamps(t_s));
    };
    let step_s = second - first;
    // A step is known to the rounding of the times.
    let same =
        |w: &[f64]| (w[1] - w[0] - step_s).abs() <= EVEN_WITHIN_S + 4.0 * f64::EPSILON * w[1].abs();
    let even = 1 + t_s.windows(2).take_while(|w| same(w)).count();
    let evenly = &t_s[..even];
    let dt_s = (evenly[even - 1] - first) / (even - 1) as f64;
    let fits = |(k, t): (usize, &f64)| (first + k as f64 * dt_s - t).abs() <= EVEN_WITHIN_S;
    // Each batch costs a message: short even runs among jittering times are not separated.
    if even >= t_s.len().min(16) && evenly.iter().enumerate().all(fits) {
        (from + even, BatchTime::Even { t0_s: first, dt_s })
    } else {
        (from + t_s.len(), BatchTime::Stamps(t_s))
    }
}

#[cfg(test)]
mod tests {
    use super::super::load::read;
    use super::*;

    /// A scope's record of 40 ms, half of it before the trigger: its messages had no time but zero there.
    #[test]
    fn times_of_messages_begin_with_the_first_sample() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let (t0_s, dt_s, n) = (-20e-3, 1e-6, 40_000);
        let capture = Capture {
            name: "a".to_owned(),
            time: TimeBase::Even { t0_s, dt_s },
            v_v: vec![1.0; n],
            i_a: vec![2.0; n],
            mains_hz: Some(50.0),
            zero_crossing_s: Some(-15e-3),
            ..Capture::default()
        };
        write(&capture, &path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let times = |topic: &str| -> Vec<u64> {
            let messages = ::mcap::MessageStream::new(&bytes).unwrap();
            let messages = messages.map(Result::unwrap);
            let of_topic = messages.filter(|m| m.channel.topic == topic);
            of_topic.map(|m| m.log_time).collect()
        };
        let after_ns = |k: usize| (k * PAIRS_PER_MESSAGE) as u64 * 1000;
        let expected: Vec<u64> = (0..5).map(after_ns).collect();
        assert_eq!(times("/samples"), expected);
        assert_eq!(times("/mains"), [5_000_000]);
        let back = read(&path).unwrap();
        assert_eq!(back.zero_crossing_s, Some(-15e-3));
        for k in [0, 1, n - 1] {
            let (t, wanted) = (back.time.at(k).unwrap(), capture.time.at(k).unwrap());
            assert!((t - wanted).abs() < 1e-12, "{t}");
        }
    }
}
