//! The controller's state machine.
//!
//! | state | entered by | left when |
//! |---|---|---|
//! | Idle | start; 0 W | power is asked for and a start is permitted: Probing |
//! | Probing | power asked for | a look, before the first crest: Heating with a pot, else WaitingForPot |
//! | Heating | a pot that can be heated | two half-cycles in a row without one: WaitingForPot |
//! | WaitingForPot | no pot, or one that cannot be heated | a look finds one: Heating; after a time without one: Idle |
//! | Pausing | a trip, or a mains that is not as it must be | its pause is over: Idle, and from there on |
//! | LockedOut | tries used up, or a fault of the controller | a person switches off and on |
//!
//! 0 W leads from Probing, Heating and WaitingForPot to Idle at once; it comes from panel and host
//! ([`crate::request`]), from a host that is not heard for 10 s, and from replay mode. A fault leads from
//! any state to Pausing or LockedOut, as [`crate::restart`] says, which every start passes too. In
//! Heating the bridge is off between bursts ([`crate::burst`]).
//!
//! It sees one summary per half-cycle and answers with a drive or a fault. The frequency of a new
//! drive is searched in steps, one after each block ([`Control::advance`]), and found within the
//! half-cycle. It takes effect at the next zero crossing, so a summary of another frequency is of the
//! past for power control, but shows the pot.

mod heating;
mod waiting;

use ihd_shared::fault::Fault;
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::{Limit, Pot, State};

use crate::burst::Burst;
use crate::half_cycle::Summary;
use crate::limits::{BUS_MIN_DV, BUS_TRIP_DV, GIVE_UP_MS, HALF_CYCLE_MAX_NS, HALF_CYCLE_MIN_NS};
use crate::plausibility::Plausibility;
use crate::power::PowerControl;
use crate::pwm;
use crate::realtime::{Drive, RealTime};
use crate::request::{PanelEvent, Request, Touched};
use crate::restart::Restart;
use crate::temperature::{TemperatureCodes, Temperatures};

/// What the half-cycle asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Nothing changes.
    Keep,
    /// Drive the bridge so.
    Drive(Drive),
    /// Look what stands on the coil, with the next zero crossing.
    Look,
    /// Open both switches at the next zero crossing.
    OffAtCrossing,
    /// Enter the safe state.
    Fault(Fault),
    /// Leave it.
    ClearFault,
}

/// What the sampling path is at.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// Time since boot, in milliseconds.
    pub ms: u32,
    /// The active fault.
    pub fault: Fault,
    /// What the bridge is asked for.
    pub wanted: Drive,
    /// Whether the bridge switches.
    pub switching: bool,
    /// Whether samples come from a host.
    pub replaying: bool,
}

impl Now {
    /// Of the sampling path.
    pub fn of(realtime: &RealTime) -> Self {
        Self {
            ms: realtime.now_ms(),
            fault: realtime.fault(),
            wanted: realtime.wanted(),
            switching: realtime.drive().is_switching(),
            replaying: realtime.is_replaying(),
        }
    }
}

/// State, pot, requests and everything that control remembers.
#[derive(Clone, Debug)]
pub struct Control {
    state: State,
    pot: Pot,
    limit: Limit,
    request: Request,
    restart: Restart,
    plausibility: Plausibility,
    temperatures: Temperatures,
    power: PowerControl,
    burst: Burst,
    bursting: bool,
    /// At the highest frequency with more power than was asked for, in a row.
    at_floor: u8,
    /// Power that is given in bursts until another is granted, as no frequency gives as little; 0 for none.
    bursts_for_w: u16,
    /// Half-cycles since the bridge switches.
    half_cycles_on: u32,
    without_pot: u8,
    good_half_cycles: u8,
    /// When a pot was judged last, or the bridge began to look for one.
    judged_ms: u32,
    waiting_since_ms: u32,
    next_look_ms: u32,
    /// A pot was heated before it went away: it may be on its way back.
    may_return: bool,
    /// Looks in a row that saw a mains and no current.
    dark_looks: u8,
    give_up_ms: u32,
    /// The frequency that a pot was heated at last, in hertz.
    heated_hz: u32,
    last: Summary,
    /// The fault that was taken note of.
    seen_fault: Fault,
}

impl Default for Control {
    fn default() -> Self {
        Self {
            state: State::Idle,
            pot: Pot::Unknown,
            limit: Limit::None,
            request: Request::default(),
            restart: Restart::default(),
            plausibility: Plausibility::default(),
            temperatures: Temperatures::default(),
            power: PowerControl::default(),
            burst: Burst::default(),
            bursting: false,
            at_floor: 0,
            bursts_for_w: 0,
            half_cycles_on: 0,
            without_pot: 0,
            good_half_cycles: 0,
            judged_ms: 0,
            waiting_since_ms: 0,
            next_look_ms: 0,
            may_return: false,
            dark_looks: 0,
            give_up_ms: GIVE_UP_MS,
            heated_hz: pwm::HIGHEST_HZ,
            last: Summary::default(),
            seen_fault: Fault::NONE,
        }
    }
}

/// What panel, host and telemetry may ask.
impl Control {
    /// What the controller is doing.
    pub fn state(&self) -> State {
        self.state
    }

    /// What stands on the coil.
    pub fn pot(&self) -> Pot {
        self.pot
    }

    /// Power asked for, in watt.
    pub fn asked_w(&self) -> u16 {
        self.request.power_w()
    }

    /// What holds the power below what was asked for.
    pub fn limit(&self) -> Limit {
        if self.state != State::Heating {
            return Limit::None;
        }
        match self.limit {
            Limit::None if self.request.is_held_by_panel() => Limit::Panel,
            Limit::None => self.power.limit(),
            limit => limit,
        }
    }

    /// Panel and host.
    pub fn request(&self) -> &Request {
        &self.request
    }

    /// Tries and pauses.
    pub fn restart(&self) -> &Restart {
        &self.restart
    }

    /// Heat sink, glass, coil and fan.
    pub fn temperatures(&self) -> &Temperatures {
        &self.temperatures
    }

    /// How long a pot is waited for, in seconds.
    pub fn set_give_up_s(&mut self, give_up_s: u16) {
        self.give_up_ms = u32::from(give_up_s) * 1_000;
    }

    /// Takes the codes of the temperature sensors.
    pub fn set_temperatures(&mut self, codes: TemperatureCodes) {
        self.temperatures.update(codes);
    }

    /// Takes a touch of the panel.
    pub fn panel(&mut self, event: PanelEvent) -> Action {
        match self.request.panel(event) {
            Touched::SwitchedOn if self.restart.is_locked_out() => {
                self.restart.forgive();
                self.plausibility.reset();
                self.leave_fault()
            }
            _ => self.follow_request(),
        }
    }

    /// Takes what the host asks for, at most [`ihd_shared::hob::RATED_POWER_W`]; `None` when the panel is off.
    pub fn host(&mut self, power_w: u16) -> Option<Action> {
        let accepted = self.request.host(power_w);
        accepted.then(|| self.follow_request())
    }

    /// What the host asked for lapses.
    pub fn host_lost(&mut self) -> Action {
        self.request.host_lost();
        self.follow_request()
    }

    /// Off, for a reason of the hob's own.
    pub fn switch_off(&mut self) -> Action {
        self.request.switch_off();
        self.follow_request()
    }

    /// The host wants to hear no more of a fault: power must be asked for again. A lock-out stays, and
    /// no pause becomes shorter.
    pub fn clear_fault(&mut self) -> Action {
        let off = self.switch_off();
        if self.state == State::Pausing {
            self.leave_fault()
        } else {
            off
        }
    }

    fn leave_fault(&mut self) -> Action {
        self.enter(State::Idle);
        // One that stands, or comes again at once, counts anew.
        self.seen_fault = Fault::NONE;
        Action::ClearFault
    }

    fn follow_request(&mut self) -> Action {
        let asked_w = self.request.power_w();
        match (asked_w, self.state) {
            (0, State::Probing | State::Heating | State::WaitingForPot) => {
                self.enter(State::Idle);
                Action::Drive(Drive::OFF)
            }
            (1.., State::Heating) if !self.bursting && !self.power.is_searching() => {
                // The last half-cycle is as good as the next: 10 ms sooner.
                if self.last.f_sw_hz > 0 && !self.last.disturbed {
                    let granted_w = self.granted_w();
                    self.power.begin(&self.last, u64::from(granted_w) * 1_000);
                }
                Action::Keep
            }
            _ => Action::Keep,
        }
    }
}

/// What each half-cycle and each block lead to.
impl Control {
    fn enter(&mut self, state: State) {
        if state != State::Heating {
            self.restart.stopped();
        }
        if matches!(state, State::Idle) {
            self.pot = Pot::Unknown;
        }
        self.state = state;
        self.limit = Limit::None;
        self.power.cancel();
        self.bursting = false;
        self.without_pot = 0;
        self.at_floor = 0;
        self.bursts_for_w = 0;
    }

    /// Takes a half-cycle's summary.
    #[inline(never)]
    pub fn on_half_cycle(&mut self, summary: &Summary, now: &Now) -> Action {
        if summary.glance {
            return self.judge(summary, now);
        }
        self.last = *summary;
        let in_time = (HALF_CYCLE_MIN_NS..=HALF_CYCLE_MAX_NS).contains(&summary.duration_ns);
        let in_range = (BUS_MIN_DV..BUS_TRIP_DV).contains(&summary.bus_peak_dv);
        self.good_half_cycles = if in_time && in_range {
            self.good_half_cycles.saturating_add(1)
        } else {
            0
        };
        if now.replaying {
            // A recording has no mains and no bridge of its own.
            self.plausibility.reset();
            return Action::Keep;
        }
        let implausible = self.plausibility.on_half_cycle(summary);
        if let Some(fault) = implausible.filter(|_| now.fault == Fault::NONE) {
            return Action::Fault(fault);
        }
        if summary.f_sw_hz == 0 {
            self.half_cycles_on = 0;
        } else {
            self.half_cycles_on = self.half_cycles_on.wrapping_add(1);
        }
        self.power.note(summary, now.ms);
        match self.state {
            State::Idle
            | State::LockedOut
            | State::Pausing
            | State::Probing
            | State::WaitingForPot => Action::Keep,
            State::Heating => self.heat(summary, now),
        }
    }

    /// One step of the search for a frequency, after each block: at most
    /// [`crate::power::INSTRUCTIONS_PER_STEP`].
    #[inline(never)]
    pub fn advance(&mut self, lookup: &RlLookup, now: &Now) -> Action {
        match self.power.advance(lookup) {
            Some(f_sw_hz) if f_sw_hz != now.wanted.f_sw_hz && now.wanted.is_switching() => {
                Action::Drive(Drive::switching(f_sw_hz))
            }
            _ => Action::Keep,
        }
    }
}

#[cfg(test)]
mod tests;
