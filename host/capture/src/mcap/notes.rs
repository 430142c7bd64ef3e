//! Conversion of a device's messages to the file's JSON messages: SI units and names instead of codes.

use ihd_link::{ClientCounters, Window, WindowDefect};
use ihd_shared::fault::Fault;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::grid::{CURRENT_KNOTS_A, FREQUENCY_KNOTS_HZ};
use ihd_shared::sampling::ADC_LOCK_Q;
use ihd_shared::wire::messages;

use super::topics::{FaultNote, LinkCounters, LookupRecord, Telemetry, WholeWindow, WindowNote};

/// Name of a fault, or its number if this version does not know it.
fn fault_name(fault: Fault) -> String {
    fault
        .name()
        .map_or_else(|| fault.number().to_string(), str::to_owned)
}

/// Converts a telemetry message.
pub fn telemetry(t: &messages::Telemetry) -> Telemetry {
    Telemetry {
        seq: t.seq,
        dropped: t.dropped,
        half_cycle: t.half_cycle,
        state: t.state.name().to_owned(),
        fault: fault_name(t.fault),
        pot: t.pot.name().to_owned(),
        f_sw_hz: t.f_sw_hz,
        r_ohm: t.r.ohm(),
        l_h: t.l.henry(),
        i_crest_a: f64::from(t.i_crest_ma) * 1e-3,
        power_w: f64::from(t.power_mw) * 1e-3,
        phase_rad: f64::from(t.phase_mrad) * 1e-3,
        lookup_version: t.lookup_version,
        asked_w: t.asked_w,
        limit: t.limit.name().to_owned(),
        bus_peak_v: f64::from(t.bus_peak_dv) * 0.1,
        v_coil_peak_v: f64::from(t.v_coil_peak_dv) * 0.1,
        i_turn_off_min_a: f64::from(t.i_turn_off_min_ma) * 1e-3,
        off_reason: t.off_reason.name().to_owned(),
        glass_hot: t.glass_hot,
    }
}

/// Converts a fault.
pub fn fault(f: &messages::FaultEvent) -> FaultNote {
    FaultNote {
        half_cycle: f.half_cycle,
        number: f.fault.number(),
        fault: fault_name(f.fault),
    }
}

/// Converts a rejected window.
pub fn rejected(seq: u32, reason: &WindowDefect) -> WindowNote {
    WindowNote {
        seq,
        rejected: Some(reason.to_string()),
        whole: None,
    }
}

/// Converts a complete window whose zero crossing is at a time in seconds.
pub fn window(w: &Window, zero_crossing_s: f64) -> WindowNote {
    WindowNote {
        seq: w.seq,
        rejected: None,
        whole: Some(WholeWindow {
            half_cycle: w.half_cycle,
            f_sw_hz: w.f_sw_hz,
            half_cycle_s: f64::from(w.half_cycle_ns) * 1e-9,
            zero_crossing_s,
            pairs: w.pairs.len(),
            saturated: w.saturated,
            lookup_version: w.lookup_version,
            track_t0_s: zero_crossing_s + w.trajectory_time_s(0),
            track_dt_s: f64::from(ADC_LOCK_Q) / f64::from(w.f_sw_hz),
            track_r_ohm: w.trajectory.iter().map(|e| e.r.ohm()).collect(),
            track_l_h: w.trajectory.iter().map(|e| e.l.henry()).collect(),
        }),
    }
}

/// Converts a lookup from its bytes; `None` if they are invalid.
pub fn lookup(what: &str, blob: &[u8]) -> Option<LookupRecord> {
    let lookup = RlLookup::from_bytes(blob).ok()?;
    Some(LookupRecord {
        what: what.to_owned(),
        version: lookup.version,
        observed_cells: lookup.observed_cells(),
        f_sw_hz: FREQUENCY_KNOTS_HZ.to_vec(),
        i_a: CURRENT_KNOTS_A.to_vec(),
        r_ohm: lookup.r_ohm().map(Vec::from).into(),
        l_h: lookup.l_h().map(Vec::from).into(),
    })
}

/// Converts the counters of a link.
pub fn link_counters(c: &ClientCounters) -> LinkCounters {
    LinkCounters {
        bytes: c.bytes,
        frames_good: c.frames_good,
        frames_bad: c.frames_bad,
        frames_lost: c.frames_lost,
        telemetry: c.telemetry.received,
        telemetry_missing: c.telemetry.missing,
        telemetry_dropped: c.telemetry.dropped_by_device,
        windows: c.windows.received,
        windows_missing: c.windows.missing,
        windows_dropped: c.windows.dropped_by_device,
        windows_rejected: c.windows_rejected_total(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_is_noted_by_its_name_or_else_its_number() {
        let note = |number| {
            fault(&messages::FaultEvent {
                half_cycle: 7,
                fault: Fault::from_number(number),
            })
        };
        assert_eq!(note(4).fault, "OverCurrent");
        assert_eq!((note(120).number, note(120).fault.as_str()), (120, "120"));
    }
}
