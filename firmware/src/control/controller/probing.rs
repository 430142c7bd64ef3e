//! Search for a pot: probes, their judgement, and the time that a bridge may switch without one.

use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::Pot;

use crate::control::controller::state::ControlState;
use crate::control::controller::{Control, GOOD_HALF_CYCLES};
use crate::control::heating::Heating;
use crate::control::pot::{FirstProbe, classify};
use crate::control::status::{Action, SamplingStatus};
use crate::control::waiting::Waiting;
use crate::drive::bridge::Drive;
use crate::drive::pwm;
use crate::drive::sequencer::PotProbe;
use crate::limits::UNJUDGED_MS;
use crate::sampling::half_cycle::HalfCycle;

/// Probes in a row without any current that are a fault: even an empty coil carries 5 A.
const DARK_PROBES: u8 = 2;

impl Control {
    /// Starts for a request, if a start is permitted.
    pub(super) fn start(&mut self, status: &SamplingStatus) -> Action {
        // A bridge that was just switched off ends its half-cycle first, which is no probe.
        if status.replaying
            || status.switching
            || status.fault != Fault::NONE
            || self.parts.supply_share.is_sought()
            || self.good_half_cycles < GOOD_HALF_CYCLES
            || !self.parts.restart.permits(status.now_ms)
        {
            return Action::Keep;
        }
        if !core::mem::take(&mut self.resumes) {
            self.parts.power.restart();
        }
        self.enter(ControlState::Probing {
            unjudged_since_ms: status.now_ms,
        });
        self.start_with_probe(status)
    }

    /// Begins the first pot probe; the restart policy counts it as a start.
    pub(super) fn start_with_probe(&mut self, status: &SamplingStatus) -> Action {
        self.parts.restart.started(status.now_ms);
        self.begin_first_probe(status)
    }

    /// Begins the first pot probe without counting a start.
    pub(super) fn begin_first_probe(&mut self, status: &SamplingStatus) -> Action {
        self.doubtful = None;
        self.request_probe(PotProbe::FIRST, status)
    }

    /// Lets the bridge switch for a probe: the time without a judgement counts from now.
    fn request_probe(&mut self, probe: PotProbe, status: &SamplingStatus) -> Action {
        if let Some(unjudged_since_ms) = self.state.unjudged_since_ms() {
            *unjudged_since_ms = status.now_ms;
        }
        Action::ProbePot(probe)
    }

    /// Judges a pot probe. What may be a sheet is probed a second time.
    pub(super) fn judge(&mut self, summary: &HalfCycle, status: &SamplingStatus) -> Action {
        let heats = match &mut self.state {
            ControlState::Probing { .. } | ControlState::WaitingForPot(_) => false,
            // Between two bursts, or two half-cycles.
            ControlState::Heating(heating) => {
                heating.on_probe(summary, status.now_ms);
                true
            }
            ControlState::Idle | ControlState::Pausing | ControlState::LockedOut => {
                return Action::Keep;
            }
        };
        if self.is_dark_again(summary) {
            return Action::Fault(Fault::NO_COIL_CURRENT);
        }
        let first = self.doubtful.take();
        // Meanwhile a sheet may have taken the pot's place.
        let judged_before = if heats { Pot::Unknown } else { self.parts.pot };
        let before = first.as_ref().map_or(judged_before, |first| first.pot);
        let pot = match classify(summary, before) {
            Pot::Ferromagnetic | Pot::Small
                if first.is_some_and(|first| first.shows_sheet(summary)) =>
            {
                Pot::Unsuitable
            }
            pot => pot,
        };
        if first.is_none() {
            // One with the pot shows little, and would end what is known of a drift.
            let is_pot = matches!(pot, Pot::Ferromagnetic | Pot::Small);
            if !(heats && is_pot)
                && let Some(fault) = self.plausibility.on_pot_probe(summary)
            {
                return Action::Fault(fault);
            }
            self.doubtful = FirstProbe::doubtful(summary, pot);
            if self.doubtful.is_some() {
                return self.request_probe(PotProbe::SECOND, status);
            }
        }
        match (pot, &mut self.state) {
            (Pot::Ferromagnetic | Pot::Small, ControlState::Heating(heating)) => {
                // Another pot may take too much where the last one was heated.
                if !self.parts.power.permits(summary, self.parts.heated_hz) {
                    self.parts.heated_hz = pwm::MAX_HZ;
                }
                heating.go_on(self.parts.heated_hz)
            }
            (Pot::Ferromagnetic | Pot::Small, _) => {
                (self.parts.pot, self.parts.heated_hz) = (pot, pwm::MAX_HZ);
                self.enter(ControlState::Heating(Heating::new(status.now_ms)));
                self.parts.supply_share.note(summary.power_mw);
                if self.parts.supply_share.claim() {
                    Action::Drive(Drive::switching(pwm::MAX_HZ))
                } else {
                    Action::Drive(Drive::OFF)
                }
            }
            (pot, _) => self.lose_pot(pot, status),
        }
    }

    /// Counts probes in a row that saw a mains and no current; returns `true`, and begins anew, once there are [`DARK_PROBES`].
    fn is_dark_again(&mut self, summary: &HalfCycle) -> bool {
        let dark = summary.is_comparable() && !summary.has_coil_current();
        self.dark_probes = if dark { self.dark_probes + 1 } else { 0 };
        let is_again = self.dark_probes >= DARK_PROBES;
        if is_again {
            self.dark_probes = 0;
        }
        is_again
    }

    /// Opens a bridge in time that switches without a pot that was judged, whatever the reason.
    pub(super) fn watch_judgement(&mut self, status: &SamplingStatus) -> Action {
        let Some(unjudged_since_ms) = self.state.unjudged_since_ms() else {
            return Action::Keep;
        };
        if !status.switching {
            // It charges the bootstrap capacitor, or waits for the mains.
            *unjudged_since_ms = status.now_ms;
        } else if status.now_ms.wrapping_sub(*unjudged_since_ms) >= UNJUDGED_MS - 1 {
            return self.lose_pot(Pot::Unknown, status);
        }
        Action::Keep
    }

    /// Switches off without a pot to heat, and schedules the next probe.
    #[inline(never)]
    pub(super) fn lose_pot(&mut self, pot: Pot, status: &SamplingStatus) -> Action {
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
}
