//! Reports to the host: telemetry of a half-cycle, status, load of the controller.

use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{NO_PANEL, NO_SENSOR_C, Status, Telemetry, Utilisation};

use crate::control::controller::Control;
use crate::estimate::tank::Tank;
use crate::sampling::half_cycle::HalfCycle;
use crate::sampling::path::SamplingPath;
use crate::sense::product_sums::PairArithmetic;

/// Telemetry of a half-cycle.
pub fn telemetry(
    seq: u32,
    dropped: u32,
    s: &HalfCycle,
    fault: Fault,
    control: &Control,
    lookup_version: u32,
) -> Telemetry {
    let phase_mrad = if s.f_sw_hz > 0 && s.crest.i_ma > 0 {
        Tank::new(s.f_sw_hz, s.crest.r, s.crest.l).phase_mrad()
    } else {
        0
    };
    Telemetry {
        seq,
        dropped,
        half_cycle: s.half_cycle,
        state: control.state(),
        fault,
        pot: control.pot(),
        f_sw_hz: s.f_sw_hz,
        r: s.crest.r,
        l: s.crest.l,
        i_crest_ma: s.crest.i_ma,
        power_mw: s.power_mw,
        phase_mrad,
        lookup_version,
        asked_w: control.asked_w(),
        limit: control.limit(),
        bus_peak_dv: s.bus_peak_dv,
        v_coil_peak_dv: u16::try_from(s.v_peak_dv.max(s.v_crest_dv())).unwrap_or(u16::MAX),
        i_turn_off_min_ma: if s.i_turn_off_min_ma == i32::MAX {
            0
        } else {
            s.i_turn_off_min_ma
        },
        off_reason: control.off_reason(),
        glass_hot: control.temperatures().is_glass_hot(),
    }
}

/// Status of sampling path and control; the link's counters are left at 0.
pub fn status(
    path: &mut SamplingPath<impl PairArithmetic>,
    control: &Control,
    last: &HalfCycle,
    lookup_version: u32,
) -> Status {
    let [heat_sink_c, glass_c, coil_c] = control
        .temperatures()
        .celsius()
        .map(|celsius| celsius.unwrap_or(NO_SENSOR_C));
    let drive = path.drive();
    let windows = path.recorder().counters();
    Status {
        state: control.state(),
        fault: path.fault(),
        pot: control.pot(),
        asked_w: control.asked_w(),
        // The last half-cycle is long over where the mains are away.
        delivered_mw: if drive.is_switching() {
            last.power_mw
        } else {
            0
        },
        f_sw_hz: if drive.is_switching() {
            drive.f_sw_hz
        } else {
            0
        },
        lookup_version,
        half_cycles: path.half_cycles(),
        windows_recorded: windows.recorded,
        windows_dropped: windows.dropped,
        telemetry_dropped: 0,
        frames_bad: 0,
        frames_lost: 0,
        saturated_pairs: path.saturated_pairs(),
        limit: control.limit(),
        tries_left: control.restart().tries_left(),
        heat_sink_c,
        glass_c,
        coil_c,
        fan: control.temperatures().fan(),
        panel_level: control.request().level().unwrap_or(NO_PANEL),
        key_locked: control.request().is_key_locked(),
        off_reason: control.off_reason(),
        glass_hot: control.temperatures().is_glass_hot(),
        timer_min: control.timer_min(),
    }
}

/// Load of the controller since the last call.
pub fn utilisation(path: &mut SamplingPath<impl PairArithmetic>) -> Utilisation {
    let shares = path.utilisation().take();
    Utilisation {
        blocks: shares.blocks,
        mean_permille: shares.mean_permille,
        worst_permille: shares.worst_permille,
        longest_gap_us: path.housekeeping_gap().take_longest_us(),
    }
}
