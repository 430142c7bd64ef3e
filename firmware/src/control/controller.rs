//! The controller: requests, half-cycles and faults in, one action for the sampling path out.

use ihd_shared::fault::{Fault, RestartClass};
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::{Limit, OffReason, Pot, State};

use crate::control::cooking_times::CookingTimes;
use crate::control::heating::{Heating, HeatingStep};
use crate::control::panel::PanelState;
use crate::control::parts::ControlParts;
use crate::control::plausibility::Plausibility;
use crate::control::pot::classify;
use crate::control::request::{PanelEvent, PanelResult, PowerRequest};
use crate::control::restart::{RestartPolicy, RestartVerdict};
use crate::control::status::{Action, SamplingStatus};
use crate::control::temperature::{TemperatureCodes, Temperatures};
use crate::control::waiting::Waiting;
use crate::drive::bridge::Drive;
use crate::drive::pwm;
use crate::limits::{
    BUS_MIN_DV, BUS_TRIP_DV, COMPARED_FROM_DV, GIVE_UP_MS, HALF_CYCLE_MAX_NS, HALF_CYCLE_MIN_NS,
    POT_CURRENT_MIN_MA, RESUME_ABOVE_PERCENT, UNJUDGED_MS,
};
use crate::retained::control::RetainedControl;
use crate::sampling::half_cycle::HalfCycle;
use crate::sense::supply::{Reference, SupplyScale};

/// Half-cycles of a mains that is as it must be before a pause for its sake ends.
const GOOD_HALF_CYCLES: u8 = 3;

/// Probes in a row without any current that are a fault: even an empty coil carries 5 A.
const DARK_PROBES: u8 = 2;

/// A state with what it alone needs.
#[derive(Clone, Debug)]
enum ControlState {
    Idle,
    Probing {
        /// Start of the probe, in milliseconds.
        judged_ms: u32,
    },
    Heating(Heating),
    WaitingForPot(Waiting),
    Pausing,
    LockedOut,
}

impl ControlState {
    /// The state as telemetry names it.
    fn wire(&self) -> State {
        match self {
            Self::Idle => State::Idle,
            Self::Probing { .. } => State::Probing,
            Self::Heating(_) => State::Heating,
            Self::WaitingForPot(_) => State::WaitingForPot,
            Self::Pausing => State::Pausing,
            Self::LockedOut => State::LockedOut,
        }
    }
}

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

/// What outlives a reset.
impl Control {
    /// State to be kept through a reset.
    pub fn retained(&self) -> RetainedControl {
        let (request, restart) = (&self.parts.request, &self.parts.restart);
        RetainedControl {
            locked_out: restart.is_locked_out(),
            tries_used: restart.tries_used(),
            panel_off: request.level() == Some(0),
            key_locked: request.is_key_locked(),
            unattended: self.parts.times.unattended.used_share(),
        }
    }

    /// Goes on with what was kept; a fault that is active then has been seen. To be called once, before anything else.
    pub fn restore(&mut self, kept: RetainedControl, status: &SamplingStatus) {
        self.parts.request = PowerRequest::restored(kept.panel_off, kept.key_locked);
        self.parts.times = CookingTimes::restored(kept.unattended, status.now_ms);
        let (tries_used, locked_out) = (kept.tries_used, kept.locked_out);
        self.parts.restart = RestartPolicy::restored(tries_used, locked_out, status.now_ms);
        if locked_out {
            self.seen_fault = status.fault;
            self.enter(ControlState::LockedOut);
        }
    }
}

/// Requests of panel and host.
impl Control {
    /// Sets the longest wait for a pot, in seconds.
    pub fn set_give_up_s(&mut self, give_up_s: u16) {
        self.give_up_ms = u32::from(give_up_s) * 1_000;
    }

    /// Takes a reading of the chip's reference voltage.
    pub fn set_reference(&mut self, reference: Reference) {
        self.parts.supply.update(reference);
    }

    /// Takes the codes of the temperature sensors.
    pub fn set_temperatures(&mut self, codes: TemperatureCodes) {
        self.parts.temperatures.update(codes);
        self.parts.pot_heat.take(self.parts.temperatures.glass());
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

    /// Lets minutes pass at once for the times of cooking, on a simulated hob.
    pub fn pass_minutes(&mut self, minutes: u16) -> Action {
        for _ in 0..minutes {
            match self.count_time(60) {
                Action::Keep => {}
                action => return action,
            }
        }
        Action::Keep
    }

    /// Counts the times of cooking, and switches off at the end of one.
    #[inline(never)]
    fn count_time(&mut self, elapsed_s: u32) -> Action {
        let asked_w = self.parts.request.power_w();
        let heats = matches!(self.state, ControlState::Heating(_));
        match self.parts.times.count(asked_w, heats, elapsed_s) {
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

    fn leave_fault(&mut self) -> Action {
        self.enter(ControlState::Idle);
        // One that stands, or comes again at once, counts anew.
        self.seen_fault = Fault::NONE;
        Action::ClearFault
    }

    fn follow_request(&mut self) -> Action {
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

/// Half-cycles, and the search for a frequency between them.
impl Control {
    /// Takes a half-cycle, or a pot probe.
    #[inline(never)]
    pub fn on_half_cycle(&mut self, summary: &HalfCycle, status: &SamplingStatus) -> Action {
        if summary.is_pot_probe {
            return self.judge(summary, status);
        }
        let in_time = (HALF_CYCLE_MIN_NS..=HALF_CYCLE_MAX_NS).contains(&summary.duration_ns);
        let in_range = (BUS_MIN_DV..BUS_TRIP_DV).contains(&summary.bus_peak_dv);
        self.good_half_cycles = if in_time && in_range {
            self.good_half_cycles.saturating_add(1)
        } else {
            0
        };
        if status.replaying {
            // A recording has no mains and no bridge of its own.
            self.plausibility.reset();
            return Action::Keep;
        }
        let implausible = self.plausibility.on_half_cycle(summary);
        if let Some(fault) = implausible.filter(|_| status.fault == Fault::NONE) {
            return Action::Fault(fault);
        }
        self.parts.power.note(summary, status.now_ms);
        let ControlState::Heating(heating) = &mut self.state else {
            return Action::Keep;
        };
        match heating.on_half_cycle(summary, status, &mut self.parts) {
            HeatingStep::Act(action) => action,
            HeatingStep::PotLost(pot) => self.lose_pot(pot, status),
        }
    }

    /// Judges a pot probe.
    fn judge(&mut self, summary: &HalfCycle, status: &SamplingStatus) -> Action {
        if !matches!(
            self.state,
            ControlState::Probing { .. } | ControlState::WaitingForPot(_)
        ) {
            return Action::Keep;
        }
        let dark =
            summary.i_crest_ma < POT_CURRENT_MIN_MA && summary.bus_peak_dv >= COMPARED_FROM_DV;
        self.dark_probes = if dark { self.dark_probes + 1 } else { 0 };
        if self.dark_probes >= DARK_PROBES {
            self.dark_probes = 0;
            return Action::Fault(Fault::NO_COIL_CURRENT);
        }
        if let Some(fault) = self.plausibility.on_pot_probe(summary) {
            return Action::Fault(fault);
        }
        match classify(summary, self.parts.pot) {
            pot @ (Pot::Ferromagnetic | Pot::Small) => {
                self.parts.pot = pot;
                self.enter(ControlState::Heating(Heating::new(status.now_ms)));
                Action::Drive(Drive::switching(pwm::HIGHEST_HZ))
            }
            pot => self.lose_pot(pot, status),
        }
    }

    /// Takes a step of the search for a frequency, after each block: at most
    /// [`crate::control::power::INSTRUCTIONS_PER_STEP`].
    #[inline(never)]
    pub fn advance(&mut self, lookup: &RlLookup, status: &SamplingStatus) -> Action {
        let requested = status.requested;
        match self.parts.power.advance(lookup) {
            Some(f_sw_hz) if f_sw_hz != requested.f_sw_hz && requested.is_switching() => {
                Action::Drive(Drive::switching(f_sw_hz))
            }
            _ => Action::Keep,
        }
    }
}

/// Faults, pauses and probes, after each block.
impl Control {
    /// Takes a step after each block.
    #[inline(never)]
    pub fn tick(&mut self, status: &SamplingStatus) -> Action {
        if status.fault != self.seen_fault {
            self.seen_fault = status.fault;
            if status.fault != Fault::NONE {
                self.tripped(status);
                return Action::Keep;
            }
        }
        // A bare board has no sensors, and heats nothing; recordings can be replayed on it.
        let condition = self.parts.condition();
        let elapsed_s = self.parts.times.elapsed_s(status.now_ms);
        if elapsed_s > 0 {
            self.parts.pot_heat.count(elapsed_s);
            let action = self.count_time(elapsed_s);
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
                    return self.probe(status);
                }
                Action::Keep
            }
            ControlState::Probing { .. }
            | ControlState::Heating(_)
            | ControlState::WaitingForPot(_) => self.watch_judgement(status),
        }
    }

    fn tripped(&mut self, status: &SamplingStatus) {
        self.good_half_cycles = 0;
        self.plausibility.reset();
        if let ControlState::Heating(_) = self.state {
            self.resumes = true;
            let above = 100 + RESUME_ABOVE_PERCENT;
            self.parts.power.pause(self.parts.heated_hz * above / 100);
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

    /// Starts for a request, if a start is permitted.
    fn start(&mut self, status: &SamplingStatus) -> Action {
        if status.replaying
            || status.fault != Fault::NONE
            || !self.parts.restart.permits(status.now_ms)
        {
            return Action::Keep;
        }
        if !core::mem::take(&mut self.resumes) {
            self.parts.power.restart();
        }
        self.enter(ControlState::Probing {
            judged_ms: status.now_ms,
        });
        self.probe(status)
    }

    /// Begins a pot probe.
    fn probe(&mut self, status: &SamplingStatus) -> Action {
        self.parts.restart.started(status.now_ms);
        if let Some(judged_ms) = self.judged_ms() {
            *judged_ms = status.now_ms;
        }
        Action::ProbePot
    }

    /// Opens a bridge in time that switches without a pot that was judged, whatever the reason.
    fn watch_judgement(&mut self, status: &SamplingStatus) -> Action {
        let Some(judged_ms) = self.judged_ms() else {
            return Action::Keep;
        };
        if !status.switching {
            // It charges the bootstrap capacitor, or waits for the mains.
            *judged_ms = status.now_ms;
        } else if status.now_ms.wrapping_sub(*judged_ms) >= UNJUDGED_MS - 1 {
            return self.lose_pot(Pot::Unknown, status);
        }
        Action::Keep
    }

    /// Time at which a pot was judged last, or the bridge began to probe for one.
    fn judged_ms(&mut self) -> Option<&mut u32> {
        match &mut self.state {
            ControlState::Probing { judged_ms } => Some(judged_ms),
            ControlState::Heating(heating) => Some(heating.judged_ms()),
            ControlState::WaitingForPot(waiting) => Some(waiting.judged_ms()),
            ControlState::Idle | ControlState::Pausing | ControlState::LockedOut => None,
        }
    }

    /// Switches off without a pot to heat, and schedules the next probe.
    #[inline(never)]
    fn lose_pot(&mut self, pot: Pot, status: &SamplingStatus) -> Action {
        if !matches!(self.state, ControlState::WaitingForPot(_)) {
            let may_return = matches!(self.state, ControlState::Heating(_));
            self.parts.power.pause(self.parts.heated_hz);
            let waiting = Waiting::new(status.now_ms, may_return);
            self.enter(ControlState::WaitingForPot(waiting));
        }
        if let ControlState::WaitingForPot(waiting) = &mut self.state {
            waiting.schedule_probe(status.now_ms);
        }
        self.parts.pot = pot;
        Action::Drive(Drive::OFF)
    }

    #[inline(never)]
    fn enter(&mut self, state: ControlState) {
        if !matches!(state, ControlState::Heating(_)) {
            self.parts.restart.stopped();
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
