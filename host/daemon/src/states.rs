//! Device state and live report from a half-cycle or a status.

use ihd_model::{DeviceState, Live};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{Limit, OffReason, Pot, State, Status, Telemetry};

use crate::live::recent_power::RecentPower;

/// State of a hob's controller, by a half-cycle's telemetry or by a status.
#[derive(Clone, Copy, Debug)]
pub struct ControllerState {
    state: State,
    fault: Fault,
    pot: Pot,
    off_reason: OffReason,
    limit: Limit,
}

impl From<&Telemetry> for ControllerState {
    fn from(t: &Telemetry) -> Self {
        Self {
            state: t.state,
            fault: t.fault,
            pot: t.pot,
            off_reason: t.off_reason,
            limit: t.limit,
        }
    }
}

impl From<&Status> for ControllerState {
    fn from(status: &Status) -> Self {
        Self {
            state: status.state,
            fault: status.fault,
            pot: status.pot,
            off_reason: status.off_reason,
            limit: status.limit,
        }
    }
}

/// Returns the device state and its reason; a pot probe keeps the state `before`.
pub fn device_state(
    controller: impl Into<ControllerState>,
    before: DeviceState,
) -> (DeviceState, String) {
    let c = controller.into();
    let fault = c.fault != Fault::NONE;
    match c.state {
        State::LockedOut => (
            DeviceState::Faulted,
            format!(
                "{}; it stays off until a person switches off and on",
                c.fault.text()
            ),
        ),
        State::Pausing if fault => (
            DeviceState::Faulted,
            format!("{}; it starts again by itself", c.fault.text()),
        ),
        _ if fault => (DeviceState::Faulted, c.fault.text().to_owned()),
        State::Pausing => (
            DeviceState::Idle,
            "it pauses, and starts again by itself".to_owned(),
        ),
        State::WaitingForPot => (DeviceState::WaitingForPot, pot_text(c.pot).to_owned()),
        State::Heating => (DeviceState::Learning, limit_text(c.limit)),
        State::Idle => (DeviceState::Idle, c.off_reason.text().to_owned()),
        State::Probing => match before {
            DeviceState::WaitingForPot => (DeviceState::WaitingForPot, pot_text(c.pot).to_owned()),
            DeviceState::Learning => (DeviceState::Learning, limit_text(c.limit)),
            _ => (DeviceState::Idle, "it looks at the coil".to_owned()),
        },
    }
}

/// Describes what is wrong with the pot of a hob that waits for one.
fn pot_text(pot: Pot) -> &'static str {
    match pot {
        Pot::Unsuitable => "what stands on the coil cannot be heated by induction",
        Pot::Small => "what stands on the coil is too small",
        Pot::Absent | Pot::Unknown | Pot::Ferromagnetic => "put a pot on",
    }
}

/// Describes a change of the pot, from the present detection.
pub fn pot_change(pot: Pot) -> &'static str {
    match pot {
        Pot::Absent => "lifted",
        Pot::Ferromagnetic => "put on",
        Pot::Small => "put on: too small, or far off the centre",
        Pot::Unsuitable => "put on: it cannot be heated by induction",
        Pot::Unknown => "not looked at yet",
    }
}

fn limit_text(limit: Limit) -> String {
    match limit {
        Limit::None => String::new(),
        // Near these limits it changes with every half-cycle.
        Limit::Frequency | Limit::Resonance | Limit::SoftSwitching => String::new(),
        limit => format!("{} keeps the power down", limit.name()),
    }
}

/// Returns the report of a half-cycle in SI units, with the mean power of the last second.
pub fn live(t: &Telemetry, power: &RecentPower) -> Live {
    Live {
        half_cycle: t.half_cycle,
        state: t.state.name().to_owned(),
        pot: t.pot.name().to_owned(),
        fault: t.fault.number(),
        fault_text: fault_text(t.fault),
        limit: t.limit.name().to_owned(),
        asked_w: t.asked_w,
        power_w: power.mean_w(),
        f_sw_hz: t.f_sw_hz,
        i_crest_a: f64::from(t.i_crest_ma) * 1e-3,
        r_ohm: t.r.ohm(),
        l_h: t.l.henry(),
        glass_hot: t.glass_hot,
    }
}

/// Returns the report of a status in SI units. Without a half-cycle's telemetry R, L and the crest are NaN, and the power is that of one
/// half-cycle.
pub fn live_of_status(status: &Status, telemetry: Option<&Telemetry>, power: &RecentPower) -> Live {
    let of = |number: fn(&Telemetry) -> f64| telemetry.map_or(f64::NAN, number);
    Live {
        half_cycle: status.half_cycles,
        state: status.state.name().to_owned(),
        pot: status.pot.name().to_owned(),
        fault: status.fault.number(),
        fault_text: fault_text(status.fault),
        limit: status.limit.name().to_owned(),
        asked_w: status.asked_w,
        power_w: match telemetry {
            Some(_) => power.mean_w(),
            None => f64::from(status.delivered_mw) * 1e-3,
        },
        f_sw_hz: status.f_sw_hz,
        i_crest_a: of(|t| f64::from(t.i_crest_ma) * 1e-3),
        r_ohm: of(|t| t.r.ohm()),
        l_h: of(|t| t.l.henry()),
        glass_hot: status.glass_hot,
    }
}

fn fault_text(fault: Fault) -> String {
    match fault {
        Fault::NONE => String::new(),
        fault => fault.text().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use ihd_fakes::telemetry;
    use tokio::time::Instant;

    use super::*;

    #[test]
    fn every_state_of_the_controller_is_one_of_the_devices() {
        use DeviceState as D;
        let none = Fault::NONE;
        let trip = Fault::OVER_CURRENT;
        for (state, fault, before, after) in [
            (State::Idle, none, D::Connected, D::Idle),
            (State::Idle, none, D::Learning, D::Idle),
            (State::Idle, trip, D::Idle, D::Faulted),
            (State::Probing, none, D::Connected, D::Idle),
            (State::Probing, none, D::WaitingForPot, D::WaitingForPot),
            (State::Probing, none, D::Learning, D::Learning),
            (State::Heating, none, D::Idle, D::Learning),
            (State::Heating, none, D::Suspended, D::Learning),
            (State::WaitingForPot, none, D::Learning, D::WaitingForPot),
            (State::Pausing, none, D::Learning, D::Idle),
            (State::Pausing, trip, D::Learning, D::Faulted),
            (State::LockedOut, trip, D::Faulted, D::Faulted),
            (State::LockedOut, none, D::Idle, D::Faulted),
        ] {
            let mut t = telemetry(state);
            t.fault = fault;
            let (now, detail) = device_state(&t, before);
            assert_eq!(now, after, "{state:?} {fault:?} after {before:?}");
            assert!(
                now != D::Faulted || !detail.is_empty(),
                "a fault says what it is"
            );
        }
    }

    #[test]
    fn numbers_are_shown_in_their_units() {
        let mut t = telemetry(State::Heating);
        t.power_mw = 1_234_500;
        t.i_crest_ma = 42_000;
        let mut power = RecentPower::default();
        power.push(&t, Instant::now());
        let live = live(&t, &power);
        assert_eq!((live.power_w, live.i_crest_a), (1_234.5, 42.0));
        assert!((live.l_h - 20e-6).abs() < 1e-12 && (live.r_ohm - 1.0).abs() < 1e-12);
        assert_eq!(
            (live.state.as_str(), live.fault_text.as_str()),
            ("Heating", "")
        );
    }
}
