//! CSV with the heading `time_s,v_V,i_A`.

use std::io::{self, Write};

use ihd_signal::{Capture, TimeBase};

use super::{REPORT_EVERY, time_s};

/// Heading of the columns.
pub const HEADING: &str = "time_s,v_V,i_A";

/// Writes time, voltage and current. Times of an even grid are rounded to a thousandth of the interval; all other numbers are
/// exact.
///
/// # Errors
/// What the operating system reports.
pub fn write(
    capture: &Capture,
    out: &mut impl Write,
    progress: &mut dyn FnMut(f64),
) -> io::Result<()> {
    writeln!(out, "{HEADING}")?;
    let decimals = match capture.time {
        TimeBase::Even { dt_s, .. } => Some(decimals(dt_s)),
        TimeBase::Stamps(_) => None,
    };
    for (k, (v_v, i_a)) in capture.v_v.iter().zip(&capture.i_a).enumerate() {
        let t_s = time_s(&capture.time, k);
        match decimals {
            Some(decimals) => write!(out, "{t_s:.decimals$}")?,
            None => write!(out, "{t_s:e}")?,
        }
        writeln!(out, ",{v_v},{i_a}")?;
        if k.is_multiple_of(REPORT_EVERY) {
            progress(k as f64 / capture.len() as f64);
        }
    }
    Ok(())
}

/// Number of decimals that show a thousandth of an interval.
fn decimals(dt_s: f64) -> usize {
    libm::ceil(3.0 - libm::log10(dt_s)).clamp(3.0, 18.0) as usize
}
