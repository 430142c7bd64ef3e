//! The controller: requests, half-cycles and faults in, one action for the sampling path out.

use ihd_shared::fault::{Fault, RestartClass};
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::{Limit, OffReason, Pot, State};

use crate::control::controller::state::ControlState;
use crate::control::cooking_times::CookingTimes;
use crate::control::heating::HeatingStep;
use crate::control::panel::PanelState;
use crate::control::parts::ControlParts;
use crate::control::plausibility::Plausibility;
use crate::control::pot::FirstProbe;
use crate::control::request::PowerRequest;
use crate::control::restart::{RestartPolicy, RestartVerdict};
use crate::control::status::{Action, SamplingStatus};
use crate::control::temperature::Temperatures;
use crate::drive::bridge::Drive;
use crate::limits::{BUS_MIN_DV, BUS_TRIP_DV, GIVE_UP_MS, RESUME_ABOVE_PERCENT};
use crate::retained::control::{PanelSetting, RetainedControl};
use crate::sampling::half_cycle::HalfCycle;
use crate::sense::supply::SupplyScale;

mod probing;
mod requests;
mod state;

/// Half-cycles in a row with the mains as it must be, before a pause for its sake ends and before a start.
pub(super) const GOOD_HALF_CYCLES: u8 = 3;

/// State machine, requests, and everything that outlives a state.
#[derive(Clone, Debug)]
pub struct Control {
    state: ControlState,
    parts: ControlParts,
    plausibility: Plausibility,
    /// Half-cycles in a row of a mains that is as it must be.
    good_half_cycles: u8,
    /// Probes in a row that saw a mains and no current.
    dark_probes: u8,
    /// First probe of what may be a sheet, until the second.
    doubtful: Option<FirstProbe>,
    /// Longest wait for a pot, in milliseconds.
    give_up_ms: u32,
    /// The fault that control has reacted to.
    seen_fault: Fault,
    /// A fault interrupted heating: the pot is probably the same.
    resumes: bool,
    off_reason: OffReason,
}

impl Default for Control {
    fn default() -> Self {
        Self {
            state: ControlState::Idle,
            parts: ControlParts::default(),
            plausibility: Plausibility::default(),
            good_half_cycles: 0,
            dark_probes: 0,
            doubtful: None,
            give_up_ms: GIVE_UP_MS,
            seen_fault: Fault::NONE,
            resumes: false,
            off_reason: OffReason::None,
        }
    }
}

/// Status for panel, host and telemetry.
impl Control {
    /// The present state.
    pub fn state(&self) -> State {
        self.state.wire()
    }

    /// Returns `true` while nothing heats, searches or is recorded: another lookup need not wait for a half-cycle, which without mains
    /// never ends.
    pub fn needs_no_lookup(&self, status: &SamplingStatus) -> bool {
        let heats = matches!(
            self.state,
            ControlState::Probing { .. } | ControlState::Heating(_)
        );
        !heats && !status.switching && !status.requested.is_switching() && !status.replaying
    }

    /// The pot that was judged last.
    pub fn pot(&self) -> Pot {
        self.parts.pot
    }

    /// Requested power, in watt.
    pub fn asked_w(&self) -> u16 {
        self.parts.request.power_w()
    }

    /// Limit that holds the power below what was requested.
    pub fn limit(&self) -> Limit {
        let ControlState::Heating(heating) = &self.state else {
            return Limit::None;
        };
        match heating.limit() {
            Limit::None if self.parts.request.is_held_by_panel() => Limit::Panel,
            Limit::None => self.parts.power.limit(),
            limit => limit,
        }
    }

    /// Reason for which the hob has switched itself off.
    pub fn off_reason(&self) -> OffReason {
        self.off_reason
    }

    /// State that the panel shows.
    pub fn panel_state(&self) -> PanelState {
        PanelState {
            state: self.state(),
            level: self.parts.request.level(),
            is_on: self.asked_w() > 0,
            keeps_warm: self.parts.request.keeps_warm(),
            timer_min: self.timer_min(),
            glass_hot: self.parts.temperatures.is_glass_hot(),
        }
    }

    /// Time left on the timer in minutes; 0 without one.
    pub fn timer_min(&self) -> u8 {
        self.parts.times.timer.left_min()
    }

    /// Panel and host.
    pub fn request(&self) -> &PowerRequest {
        &self.parts.request
    }

    /// Tries and pauses.
    pub fn restart(&self) -> &RestartPolicy {
        &self.parts.restart
    }

    /// Correction of every reading for the analogue supply.
    pub fn supply_scale(&self) -> SupplyScale {
        self.parts.supply.scale()
    }

    /// Heat sink, glass, coil and fan.
    pub fn temperatures(&self) -> &Temperatures {
        &self.parts.temperatures
    }
}

/// State that outlives a reset.
impl Control {
    /// State to be kept through a reset.
    pub fn retained(&self) -> RetainedControl {
        let (request, restart) = (&self.parts.request, &self.parts.restart);
        // A reset forgets the time left, and so ends it.
        let has_timer = self.timer_min() > 0;
        RetainedControl {
            locked_out: restart.is_locked_out(),
            tries_used: restart.tries_used(),
            panel: if has_timer {
                PanelSetting::OFF
            } else {
                request.setting()
            },
            key_locked: request.is_key_locked(),
            unattended: self.parts.times.unattended.used_share(),
        }
    }

    /// Goes on with what was kept; a fault that is active then has been seen. To be called once, before anything else.
    pub fn restore(&mut self, kept: RetainedControl, status: &SamplingStatus) {
        self.parts.request = PowerRequest::restored(kept.panel, kept.key_locked);
        self.parts.times = CookingTimes::restored(kept.unattended, status.now_ms);
        let (tries_used, locked_out) = (kept.tries_used, kept.locked_out);
        self.parts.restart = RestartPolicy::restored(tries_used, locked_out, status.now_ms);
        if locked_out {
            self.seen_fault = status.fault;
            self.enter(ControlState::LockedOut);
        }
    }
}

/// Half-cycles, and the search for a frequency between them.
impl Control {
    /// Takes a half-cycle, or a pot probe.
    #[inline(never)]
    pub fn on_half_cycle(&mut self, summary: &HalfCycle, status: &SamplingStatus) -> Action {
        if summary.is_pot_probe {
            return self.judge(summary, status);
        }
        let in_range = (BUS_MIN_DV..BUS_TRIP_DV).contains(&summary.bus_peak_dv);
        self.good_half_cycles = if summary.is_in_time() && in_range {
            self.good_half_cycles.saturating_add(1)
        } else {
            0
        };
        if status.replaying {
            return Action::Keep;
        }
        let implausible = self.plausibility.on_half_cycle(summary);
        if let Some(fault) = implausible.filter(|_| status.fault == Fault::NONE) {
            return Action::Fault(fault);
        }
        self.parts.is_balance_off = self.plausibility.is_balance_off();
        self.parts.power.note(summary, status.now_ms);
        let ControlState::Heating(heating) = &mut self.state else {
            return Action::Keep;
        };
        match heating.on_half_cycle(summary, status, &mut self.parts) {
            HeatingStep::Act(action) => action,
            HeatingStep::PotLost(pot) => self.lose_pot(pot, status),
            HeatingStep::Probe => self.begin_first_probe(status),
        }
    }

    /// Takes a step of the search for a frequency, after each block (instructions: `search-step` in firmware/budget.toml).
    #[inline(never)]
    pub fn advance(&mut self, lookup: &RlLookup, status: &SamplingStatus) -> Action {
        let requested = status.requested;
        // A soft limit has raised the request since: what is searched below it would undo that.
        self.parts.power.keep_search_from(requested.f_sw_hz);
        match self.parts.power.advance(lookup) {
            Some(f_sw_hz) if f_sw_hz != requested.f_sw_hz && requested.is_switching() => {
                Action::Drive(Drive::switching(f_sw_hz))
            }
            _ => Action::Keep,
        }
    }
}

/// Faults, pauses and times, after each block.
impl Control {
    /// Takes a step after each block.
    #[inline(never)]
    pub fn tick(&mut self, status: &SamplingStatus) -> Action {
        if status.replaying {
            // A recording has no mains and no bridge of its own; the half-cycle in which it begins or ends is cut.
            self.plausibility.reset();
            self.good_half_cycles = 0;
        }
        if status.fault != self.seen_fault {
            self.seen_fault = status.fault;
            if status.fault != Fault::NONE {
                self.tripped(status);
                return Action::Keep;
            }
        }
        // A bare board has no sensors, and heats nothing; recordings can be replayed on it.
        let condition = self.parts.condition();
        let elapsed_ms = self.parts.times.elapsed_ms(status.now_ms);
        if elapsed_ms > 0 {
            self.parts.pot_heat.pass_time(elapsed_ms);
            self.parts.restart.pass_time(status.now_ms);
            let action = self.count_time(elapsed_ms);
            if action != Action::Keep {
                return action;
            }
        }
        let is_on = self.parts.request.power_w() > 0;
        // Switched off meanwhile: the next pot may be another one.
        self.resumes &= is_on;
        if condition != Fault::NONE && is_on && !status.replaying && status.fault == Fault::NONE {
            return Action::Fault(condition);
        }
        match &self.state {
            ControlState::Idle if is_on => {
                self.off_reason = OffReason::None;
                self.start(status)
            }
            ControlState::Idle | ControlState::LockedOut => Action::Keep,
            ControlState::Pausing => self.end_pause(status),
            ControlState::WaitingForPot(waiting) if !status.requested.is_switching() => {
                if waiting.is_over(status.now_ms, self.give_up_ms) {
                    self.off_reason = OffReason::NoPot;
                    self.parts.request.switch_off();
                    self.enter(ControlState::Idle);
                    return Action::Drive(Drive::OFF);
                }
                if waiting.is_probe_due(status.now_ms) && self.parts.restart.permits(status.now_ms)
                {
                    return self.start_with_probe(status);
                }
                Action::Keep
            }
            ControlState::Probing { .. }
            | ControlState::Heating(_)
            | ControlState::WaitingForPot(_) => self.watch_judgement(status),
        }
    }

    /// Reacts to a fault that has tripped: a pause, or a lock-out.
    fn tripped(&mut self, status: &SamplingStatus) {
        self.good_half_cycles = 0;
        self.plausibility.reset();
        if let ControlState::Heating(_) = self.state {
            self.resumes = true;
            let above = 100 + RESUME_ABOVE_PERCENT;
            self.parts.power.pause(self.parts.heated_hz * above / 100);
            let too_much = [
                Fault::OVER_CURRENT,
                Fault::HARDWARE_OVER_CURRENT,
                Fault::BUS_OVER_VOLTAGE,
            ];
            if too_much.contains(&status.fault) {
                self.parts.power.note_trip();
            }
        }
        // A recording costs no try, as no power flows, and ends no lock-out.
        let locked_out = self.parts.restart.is_locked_out()
            || (!status.replaying
                && self.parts.restart.tripped(status.fault, status.now_ms)
                    == RestartVerdict::LockOut);
        self.enter(if locked_out {
            ControlState::LockedOut
        } else {
            ControlState::Pausing
        });
    }

    /// Ends a pause that is over, once its reason has passed.
    fn end_pause(&mut self, status: &SamplingStatus) -> Action {
        let is_on = self.parts.request.power_w() > 0;
        let lasts = status.fault.class() == RestartClass::Passing
            && (self.good_half_cycles < GOOD_HALF_CYCLES
                || (self.parts.condition() != Fault::NONE && is_on));
        // What a recording tripped stands until it is over.
        if lasts || status.replaying || !self.parts.restart.permits(status.now_ms) {
            return Action::Keep;
        }
        self.leave_fault()
    }

    /// Leaves the safe state; power that is requested starts anew.
    fn leave_fault(&mut self) -> Action {
        self.enter(ControlState::Idle);
        // One that stands, or comes again at once, counts anew.
        self.seen_fault = Fault::NONE;
        Action::ClearFault
    }

    /// Changes the state, with what any change ends.
    #[inline(never)]
    fn enter(&mut self, state: ControlState) {
        if !matches!(state, ControlState::Heating(_)) {
            self.parts.restart.stopped();
            self.parts.supply_share.release();
        }
        if matches!(state, ControlState::Idle) {
            self.parts.pot = Pot::Unknown;
        }
        self.parts.power.cancel();
        self.state = state;
    }
}

#[cfg(test)]
mod tests;
