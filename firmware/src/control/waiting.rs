//! What happens by itself: faults, pauses, looks for a pot.

use ihd_shared::fault::{Fault, RestartClass};
use ihd_shared::wire::messages::{Pot, State};

use super::{Action, Control, Now};
use crate::half_cycle::Summary;
use crate::limits::{
    COMPARED_FROM_DV, LOOK_MS, POT_CURRENT_MIN_MA, QUICK_LOOK_MS, QUICK_LOOKS_FOR_MS, UNJUDGED_MS,
};
use crate::pot::classify;
use crate::pwm;
use crate::realtime::Drive;
use crate::restart::{Verdict, is_reached};

/// Half-cycles of a mains that is as it must be before a pause for its sake ends.
const GOOD_HALF_CYCLES: u8 = 3;

/// Looks in a row without any current that are a fault: even an empty coil carries 5 A.
const DARK_LOOKS: u8 = 2;

impl Control {
    /// To be called after each block: faults, pauses, looks.
    #[inline(never)]
    pub fn tick(&mut self, now: &Now) -> Action {
        if now.fault != self.seen_fault {
            self.seen_fault = now.fault;
            if now.fault != Fault::NONE {
                self.tripped(now);
                return Action::Keep;
            }
        }
        // A bare board has no sensors, and heats nothing; recordings can be replayed on it.
        let condition = self.temperatures.fault();
        let wants_heat = self.request.power_w() > 0 && !now.replaying;
        if condition != Fault::NONE && wants_heat && now.fault == Fault::NONE {
            return Action::Fault(condition);
        }
        match self.state {
            State::LockedOut => Action::Keep,
            State::Pausing => self.end_pause(now),
            State::Idle if self.request.power_w() > 0 => {
                if now.replaying || now.fault != Fault::NONE || !self.restart.permits(now.ms) {
                    return Action::Keep;
                }
                self.power.restart();
                self.enter(State::Probing);
                self.look(now)
            }
            State::Idle => Action::Keep,
            State::WaitingForPot if !now.wanted.is_switching() => self.wait(now),
            State::Probing | State::Heating | State::WaitingForPot => self.watch_judgement(now),
        }
    }

    fn tripped(&mut self, now: &Now) {
        self.good_half_cycles = 0;
        self.plausibility.reset();
        // A recording costs no try: no power flows.
        let locked_out =
            !now.replaying && self.restart.tripped(now.fault, now.ms) == Verdict::LockOut;
        self.enter(if locked_out {
            State::LockedOut
        } else {
            State::Pausing
        });
    }

    /// A pause ends when it is over and what led to it has passed.
    fn end_pause(&mut self, now: &Now) -> Action {
        let lasts = now.fault.class() == RestartClass::Passing
            && (self.good_half_cycles < GOOD_HALF_CYCLES
                || (self.temperatures.fault() != Fault::NONE && self.request.power_w() > 0));
        // What a recording tripped stands until it is over.
        if lasts || now.replaying || !self.restart.permits(now.ms) {
            return Action::Keep;
        }
        self.leave_fault()
    }

    /// Begins to look what stands on the coil.
    fn look(&mut self, now: &Now) -> Action {
        self.restart.started(now.ms);
        self.judged_ms = now.ms;
        Action::Look
    }

    fn wait(&mut self, now: &Now) -> Action {
        if is_reached(now.ms, self.waiting_since_ms.wrapping_add(self.give_up_ms)) {
            self.request.switch_off();
            self.enter(State::Idle);
            return Action::Drive(Drive::OFF);
        }
        if is_reached(now.ms, self.next_look_ms) && self.restart.permits(now.ms) {
            return self.look(now);
        }
        Action::Keep
    }

    /// A bridge that switches without a pot that was judged is off in time, whatever the reason.
    fn watch_judgement(&mut self, now: &Now) -> Action {
        if !now.switching {
            // It charges the bootstrap capacitor, or waits for the mains.
            self.judged_ms = now.ms;
        } else if now.ms.wrapping_sub(self.judged_ms) >= UNJUDGED_MS - 1 {
            return self.lose_pot(Pot::Unknown, now);
        }
        Action::Keep
    }

    /// No pot to heat: off, and look again later.
    pub(super) fn lose_pot(&mut self, pot: Pot, now: &Now) -> Action {
        if self.state != State::WaitingForPot {
            self.may_return = self.state == State::Heating;
            self.power.pause(self.heated_hz);
            self.enter(State::WaitingForPot);
            self.waiting_since_ms = now.ms;
        }
        self.pot = pot;
        let waited_ms = now.ms.wrapping_sub(self.waiting_since_ms);
        let pause_ms = if self.may_return && waited_ms < QUICK_LOOKS_FOR_MS {
            QUICK_LOOK_MS
        } else {
            LOOK_MS
        };
        self.next_look_ms = now.ms.wrapping_add(pause_ms);
        Action::Drive(Drive::OFF)
    }

    /// Judges what a look has shown.
    pub(super) fn judge(&mut self, summary: &Summary, now: &Now) -> Action {
        if !matches!(self.state, State::Probing | State::WaitingForPot) {
            return Action::Keep;
        }
        let dark =
            summary.i_crest_ma < POT_CURRENT_MIN_MA && summary.bus_peak_dv >= COMPARED_FROM_DV;
        self.dark_looks = if dark { self.dark_looks + 1 } else { 0 };
        if self.dark_looks >= DARK_LOOKS {
            self.dark_looks = 0;
            return Action::Fault(Fault::NO_COIL_CURRENT);
        }
        match classify(summary, self.pot) {
            pot @ (Pot::Ferromagnetic | Pot::Small) => {
                self.pot = pot;
                self.enter(State::Heating);
                self.judged_ms = now.ms;
                Action::Drive(Drive::switching(pwm::HIGHEST_HZ))
            }
            pot => self.lose_pot(pot, now),
        }
    }
}
