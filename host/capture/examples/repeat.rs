//! Repeats a simulated capture end to end, for measurements of long files: `repeat IN.mcap TIMES OUT.mcap`. Its last sample, which is
//! the first one of the next round, is left out: the duration must be a whole number of mains and switching periods.

use std::error::Error;
use std::path::Path;

use ihd_capture::mcap::cdr::{self, BatchTime};
use ihd_capture::mcap::save::{write_head, write_truth};
use ihd_capture::mcap::topics::Topic;
use ihd_capture::mcap::writer::{Existing, PAIRS_PER_MESSAGE, Writer};
use ihd_signal::TimeBase;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [from, times, to] = &arguments[..] else {
        return Err("repeat IN.mcap TIMES OUT.mcap".into());
    };
    let times: usize = times.parse()?;
    let capture = ihd_capture::mcap::read(Path::new(from))?;
    let TimeBase::Even { t0_s, dt_s } = capture.time else {
        return Err("its samples must be evenly spaced".into());
    };
    let n = capture.len().saturating_sub(1);
    let mut writer = Writer::create(Path::new(to), Existing::Replace, true)?;
    write_head(&mut writer, &capture)?;
    for round in 0..times {
        let begin_s = round as f64 * n as f64 * dt_s;
        let mut truth = capture.truth.clone();
        truth.iter_mut().for_each(|t| t.t_s += begin_s);
        let mut truth = truth.iter().peekable();
        for first in (0..n).step_by(PAIRS_PER_MESSAGE) {
            let last = (first + PAIRS_PER_MESSAGE).min(n);
            let at = |k: usize| t0_s + (round * n + k) as f64 * dt_s;
            write_truth(&mut writer, &mut truth, Some(at(last)))?;
            let time = BatchTime::Even {
                t0_s: at(first),
                dt_s,
            };
            let pairs = (first..last).map(|k| [capture.v_v[k], capture.i_a[k]]);
            writer.message(Topic::Samples, at(first), &cdr::singles(&time, pairs))?;
        }
        write_truth(&mut writer, &mut truth, None)?;
    }
    writer.finish()?;
    Ok(())
}
