//! Readings of the sensors and requests of panel and host, between two blocks.

use ihd_shared::wire::messages::OffReason;

use crate::control::controller::Control;
use crate::control::controller::state::ControlState;
use crate::control::request::{PanelEvent, PanelResult};
use crate::control::share_wire::WireDrive;
use crate::control::status::Action;
use crate::control::temperature::TemperatureCodes;
use crate::drive::bridge::Drive;
use crate::sense::supply::Reference;

/// Readings.
impl Control {
    /// Takes a reading of the chip's reference voltage.
    pub fn set_reference(&mut self, reference: Reference) {
        self.parts.supply.update(reference);
    }

    /// Takes the codes of the temperature sensors.
    pub fn set_temperatures(&mut self, codes: TemperatureCodes) {
        self.parts.temperatures.update(codes);
        self.parts.pot_heat.take(self.parts.temperatures.glass());
    }
}

/// Requests.
impl Control {
    /// Takes the level of the wire to the other zone of a shared supply, every millisecond or more often; returns how this zone
    /// drives it from now on.
    pub fn share_supply(&mut self, is_high: bool, now_ms: u32) -> WireDrive {
        self.parts.supply_share.exchange(is_high, now_ms)
    }

    /// Sets the longest wait for a pot, in seconds.
    pub fn set_give_up_s(&mut self, give_up_s: u16) {
        self.give_up_ms = u32::from(give_up_s) * 1_000;
    }

    /// Takes a touch of the panel.
    pub fn panel(&mut self, event: PanelEvent) -> Action {
        let result = self.parts.request.panel(event);
        if result != PanelResult::Nothing {
            self.parts.times.unattended.touched();
            self.off_reason = OffReason::None;
        }
        match result {
            PanelResult::Timer(minutes) => {
                self.parts.times.timer.set(minutes);
                Action::Keep
            }
            PanelResult::SwitchedOn if self.parts.restart.is_locked_out() => {
                self.parts.restart.forgive();
                self.plausibility.reset();
                self.leave_fault()
            }
            _ => self.follow_request(),
        }
    }

    /// Takes a host's request, at most [`ihd_shared::hob::RATED_POWER_W`]; `None` if the panel is off.
    pub fn host(&mut self, power_w: u16) -> Option<Action> {
        let accepted = self.parts.request.host(power_w);
        accepted.then(|| self.follow_request())
    }

    /// Ends the host's request.
    pub fn host_lost(&mut self) -> Action {
        self.parts.request.host_lost();
        self.follow_request()
    }

    /// Switches off, for a reason of the hob's own.
    pub fn switch_off(&mut self) -> Action {
        self.parts.request.switch_off();
        self.follow_request()
    }

    /// Clears the active fault for the host; power must be requested again. A lock-out stays, and
    /// no pause becomes shorter.
    pub fn clear_fault(&mut self) -> Action {
        let off = self.switch_off();
        if matches!(self.state, ControlState::Pausing) {
            self.leave_fault()
        } else {
            off
        }
    }

    /// Lets minutes pass at once for the times of cooking, on a simulated hob.
    pub fn pass_minutes(&mut self, minutes: u16) -> Action {
        for _ in 0..minutes {
            match self.count_time(60_000) {
                Action::Keep => {}
                action => return action,
            }
        }
        Action::Keep
    }

    /// Counts the times of cooking, and switches off at the end of one.
    #[inline(never)]
    pub(super) fn count_time(&mut self, elapsed_ms: u32) -> Action {
        let asked_w = self.parts.request.power_w();
        let heats = matches!(self.state, ControlState::Heating(_));
        match self.parts.times.count(asked_w, heats, elapsed_ms) {
            OffReason::None => {
                if self.parts.times.boost.is_over() {
                    self.parts.request.end_boost();
                }
                Action::Keep
            }
            reason => {
                self.off_reason = reason;
                self.parts.request.switch_off_at_panel();
                self.follow_request()
            }
        }
    }

    /// Acts on a request of power that may have changed.
    fn follow_request(&mut self) -> Action {
        if self.parts.request.is_off_at_panel() {
            self.parts.times.timer.set(0);
        }
        let asked_w = self.parts.request.power_w();
        match &mut self.state {
            ControlState::Idle | ControlState::Pausing | ControlState::LockedOut => Action::Keep,
            // At the crest the line's current would charge the DC link.
            ControlState::Heating(_) if asked_w == 0 => {
                self.enter(ControlState::Idle);
                Action::OffAtCrossing
            }
            _ if asked_w == 0 => {
                self.enter(ControlState::Idle);
                Action::Drive(Drive::OFF)
            }
            ControlState::Heating(heating) => {
                heating.follow_request(&mut self.parts);
                Action::Keep
            }
            ControlState::Probing { .. } | ControlState::WaitingForPot(_) => Action::Keep,
        }
    }
}
