//! Export of a recording to a CSV table: the samples of all windows, or one line per half-cycle.

use std::fmt::Write as _;
use std::io::Write;
use std::path::Path;

use super::{ByteBudget, ExportLimits, RecordingExportError, Row, nothing, rows};
use crate::mcap::FileLosses;
use crate::mcap::topics::Telemetry;

/// Heading of the samples; the last column is the device's number of the window.
const SAMPLES: &str = "time_s,v_V,i_A,window\n";

/// Heading of the half-cycles.
const HALF_CYCLES: &str = "time_s,half_cycle,state,pot,fault,limit,asked_W,power_W,f_sw_Hz,i_crest_A,R_ohm,L_H,\
    phase_deg,bus_peak_V,v_coil_peak_V,i_turn_off_min_A,lookup_version\n";

/// Writes the samples of all windows in sequence: time, voltage, current, number of the window. Returns what of the recording was lost.
///
/// # Errors
/// [`RecordingExportError`]; what was written until then is no table.
pub fn samples_csv(
    path: &Path,
    mut out: impl Write,
    limits: &ExportLimits<'_>,
) -> Result<FileLosses, RecordingExportError> {
    let mut budget = ByteBudget::from_limits(limits);
    let mut windows = 0;
    let mut text = String::from(SAMPLES);
    let losses = rows(path, limits, &mut |row| {
        let Row::Window(number, _, _, pairs) = row else {
            return Ok(());
        };
        windows += 1;
        for (t_s, v_v, i_a) in pairs {
            // Writing to a text cannot fail. A tenth of a nanosecond is a thousandth of a sample.
            let _ = writeln!(text, "{t_s:.10},{v_v},{i_a},{number}");
        }
        budget.write(&mut out, text.as_bytes())?;
        text.clear();
        Ok(())
    })?;
    if windows == 0 {
        let hint = "without heating there are none; half-cycles and the MCAP file have the rest";
        return Err(nothing(path, "window of samples", hint));
    }
    out.flush()?;
    Ok(losses)
}

/// Writes one line per half-cycle: the device's telemetry. Returns what of the recording was lost.
///
/// # Errors
/// Any error of [`samples_csv`].
pub fn half_cycles_csv(
    path: &Path,
    mut out: impl Write,
    limits: &ExportLimits<'_>,
) -> Result<FileLosses, RecordingExportError> {
    let mut budget = ByteBudget::from_limits(limits);
    let mut count = 0;
    budget.write(&mut out, HALF_CYCLES.as_bytes())?;
    let losses = rows(path, limits, &mut |row| {
        let Row::HalfCycle(t_s, t) = row else {
            return Ok(());
        };
        count += 1;
        budget.write(&mut out, line(t_s, &t).as_bytes())
    })?;
    if count == 0 {
        return Err(nothing(
            path,
            "half-cycle",
            "the MCAP file has what it holds",
        ));
    }
    out.flush()?;
    Ok(losses)
}

fn line(t_s: f64, t: &Telemetry) -> String {
    // Text of a message, reduced to plain characters for other programs.
    let plain = |text: &str| -> String { text.chars().filter(|c| c.is_alphanumeric()).collect() };
    let [state, pot, fault, limit] = [&t.state, &t.pot, &t.fault, &t.limit].map(|text| plain(text));
    // R and L are absent while the inverter is off.
    let (r, l) = match t.f_sw_hz {
        0 => (String::new(), String::new()),
        _ => (format!("{:.6}", t.r_ohm), format!("{:.12}", t.l_h)),
    };
    format!(
        "{t_s:.6},{},{state},{pot},{fault},{limit},{},{:.3},{},{:.3},{r},{l},{:.3},{:.1},{:.1},{:.3},{}\n",
        t.half_cycle,
        t.asked_w,
        t.power_w,
        t.f_sw_hz,
        t.i_crest_a,
        t.phase_rad.to_degrees(),
        t.bus_peak_v,
        t.v_coil_peak_v,
        t.i_turn_off_min_a,
        t.lookup_version
    )
}
