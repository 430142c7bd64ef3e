//! Telemetry that no device sent.

use ihd_shared::fault::Fault;
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::messages::{Limit, OffReason, Pot, State, Telemetry};

/// Telemetry of a half-cycle in this state, without power.
pub fn telemetry(state: State) -> Telemetry {
    Telemetry {
        seq: 0,
        dropped: 0,
        half_cycle: 0,
        state,
        fault: Fault::NONE,
        pot: Pot::Ferromagnetic,
        f_sw_hz: 0,
        r: MicroOhm(1_000_000),
        l: PicoHenry(20_000_000),
        i_crest_ma: 0,
        power_mw: 0,
        phase_mrad: 0,
        lookup_version: 0,
        asked_w: 0,
        limit: Limit::None,
        bus_peak_dv: 0,
        v_coil_peak_dv: 0,
        i_turn_off_min_ma: 0,
        off_reason: OffReason::None,
        glass_hot: false,
    }
}
