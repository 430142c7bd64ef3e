//! The controller's state machine.
//!
//! | state | entered by | left when |
//! |---|---|---|
//! | Idle | start, 0 W, `ClearFault` | power is asked for: Probing |
//! | Probing | power asked for in Idle | third half-cycle: Heating with a pot, else LockedOut |
//! | Heating | Probing that found a pot | two half-cycles in a row without one: LockedOut |
//! | LockedOut | any fault: pot, protection, hardware | `ClearFault`: Idle |
//!
//! Power comes from `SetPower`; 0 W also from a host that is not heard for 10 s and from replay mode.
//! 0 W leads from Probing and Heating to Idle at once, a fault from any state to LockedOut, and
//! `ClearFault` from any state to Idle, with the power that was asked for forgotten.
//!
//! It sees one summary per half-cycle and answers with a drive or a fault. The frequency of a new
//! drive is searched in steps, one after each block ([`Control::advance`]), and found within the
//! half-cycle. It takes effect at the next zero crossing, so the summary after that one still shows
//! the old one and is passed over.

use ihd_shared::fault::Fault;
use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::{Pot, State};

use crate::half_cycle::Summary;
use crate::pot::classify;
use crate::power::PowerControl;
use crate::pwm;
use crate::realtime::Drive;

/// Half-cycles with the bridge on before the pot is judged; the first one only builds the current
/// up, the second lets the estimator settle.
const PROBE_HALF_CYCLES: u8 = 3;

/// Half-cycles in a row that must say the same before heating stops because of the pot.
const POT_GONE_HALF_CYCLES: u8 = 2;

/// What the half-cycle asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Nothing changes.
    Keep,
    /// Drive the bridge so.
    Drive(Drive),
    /// Enter the safe state.
    Fault(Fault),
}

/// State, pot and power request.
#[derive(Clone, Debug, Default)]
pub struct Control {
    state: State,
    pot: Pot,
    asked_w: u16,
    half_cycles_in_state: u8,
    /// In a row, while heating.
    half_cycles_without_pot: u8,
    /// Frequency of the last drive asked for, of the grid; summaries of another one are of the past.
    requested_hz: u32,
    power: PowerControl,
}

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
        self.asked_w
    }

    /// Asks for power, 0 to switch off. At most [`RATED_POWER_W`]; the caller has checked.
    pub fn set_power(&mut self, power_w: u16) -> Action {
        self.asked_w = power_w;
        match (power_w, self.state) {
            (_, State::LockedOut) => Action::Keep,
            (0, _) => {
                self.enter(State::Idle);
                self.pot = Pot::Unknown;
                Action::Drive(Drive::OFF)
            }
            (_, State::Idle) => {
                self.enter(State::Probing);
                self.pot = Pot::Unknown;
                self.power.restart();
                self.drive_at(pwm::HIGHEST_HZ)
            }
            (_, State::Probing | State::Heating | State::WaitingForPot | State::Pausing) => {
                Action::Keep
            }
        }
    }

    /// A fault was cleared: idle until power is asked for again.
    pub fn clear_fault(&mut self) {
        self.enter(State::Idle);
        self.asked_w = 0;
        self.pot = Pot::Unknown;
    }

    /// A fault tripped somewhere.
    pub fn faulted(&mut self) {
        self.enter(State::LockedOut);
        self.asked_w = 0;
    }

    fn enter(&mut self, state: State) {
        self.state = state;
        self.power.cancel();
        self.half_cycles_in_state = 0;
        self.half_cycles_without_pot = 0;
    }

    /// Takes a half-cycle's summary.
    pub fn on_half_cycle(&mut self, summary: &Summary, lookup: &RlLookup) -> Action {
        match self.state {
            State::Idle | State::LockedOut | State::WaitingForPot | State::Pausing => Action::Keep,
            // The drive asked for has not taken effect yet.
            _ if summary.f_sw_hz != self.requested_hz => Action::Keep,
            State::Probing => self.probe(summary, lookup),
            State::Heating => self.heat(summary, lookup),
        }
    }

    fn probe(&mut self, summary: &Summary, lookup: &RlLookup) -> Action {
        self.half_cycles_in_state += 1;
        if self.half_cycles_in_state < PROBE_HALF_CYCLES {
            return Action::Keep;
        }
        self.pot = classify(summary, lookup);
        match self.pot {
            Pot::Ferromagnetic | Pot::Small => {
                self.enter(State::Heating);
                self.heat(summary, lookup)
            }
            Pot::Unsuitable => Action::Fault(Fault::UNSUITABLE_POT),
            // A coil through which no current flows heats nothing either.
            Pot::Absent | Pot::Unknown => Action::Fault(Fault::NO_POT),
        }
    }

    fn heat(&mut self, summary: &Summary, lookup: &RlLookup) -> Action {
        let seen = classify(summary, lookup);
        if matches!(seen, Pot::Ferromagnetic | Pot::Small) {
            self.half_cycles_without_pot = 0;
            self.pot = seen;
        } else {
            self.half_cycles_without_pot += 1;
            if self.half_cycles_without_pot >= POT_GONE_HALF_CYCLES {
                self.pot = seen;
                return Action::Fault(if seen == Pot::Unsuitable {
                    Fault::UNSUITABLE_POT
                } else {
                    Fault::POT_REMOVED
                });
            }
            return Action::Keep;
        }
        // A small pot takes the whole flux on a small base: half of the rating.
        let limit_w = if self.pot == Pot::Small {
            RATED_POWER_W / 2
        } else {
            RATED_POWER_W
        };
        let asked_mw = u64::from(self.asked_w.min(limit_w)) * 1_000;
        // A thread too slow for one search a half-cycle ends the old one first.
        if !self.power.is_searching() {
            self.power.begin(summary, asked_mw);
        }
        Action::Keep
    }

    /// One step of the search for a frequency, after each block: at most
    /// [`crate::power::INSTRUCTIONS_PER_STEP`].
    pub fn advance(&mut self, lookup: &RlLookup) -> Action {
        match self.power.advance(lookup) {
            Some(f_sw_hz) if f_sw_hz != self.requested_hz => self.drive_at(f_sw_hz),
            _ => Action::Keep,
        }
    }

    fn drive_at(&mut self, f_sw_hz: u32) -> Action {
        self.requested_hz = f_sw_hz;
        Action::Drive(Drive::switching(f_sw_hz))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ihd_shared::lookup::prior::prior;
    use ihd_shared::units::{MicroOhm, PicoHenry};

    fn summary(r_ohm: f64, l_uh: f64, i_a: f64) -> Summary {
        Summary {
            f_sw_hz: pwm::HIGHEST_HZ,
            r: MicroOhm((r_ohm * 1e6) as i32),
            l: PicoHenry((l_uh * 1e6) as i32),
            i_crest_ma: (i_a * 1e3) as u32,
            power_mw: 400_000,
            bus_peak_dv: 3_253,
            ..Summary::default()
        }
    }

    /// Loads at 80 kHz: R carries √(80/45) = 1.33.
    const POT: (f64, f64, f64) = (5.9, 22.0, 16.0);
    const AIR: (f64, f64, f64) = (0.13, 70.0, 6.0);
    const ALUMINIUM: (f64, f64, f64) = (0.3, 17.0, 30.0);

    fn run(control: &mut Control, load: (f64, f64, f64), half_cycles: usize) -> Action {
        let mut action = Action::Keep;
        for _ in 0..half_cycles {
            let seen = Summary {
                f_sw_hz: control.requested_hz,
                ..summary(load.0, load.1, load.2)
            };
            action = control.on_half_cycle(&seen, &prior());
            for _ in 0..crate::power::STEPS_PER_SEARCH {
                if let drive @ Action::Drive(_) = control.advance(&prior()) {
                    action = drive;
                }
            }
        }
        action
    }

    fn probing() -> Control {
        let mut c = Control::default();
        let probe = Drive::switching(pwm::HIGHEST_HZ);
        assert_eq!(c.set_power(1_500), Action::Drive(probe));
        c
    }

    #[test]
    fn a_pot_is_probed_then_heated() {
        let mut c = probing();
        assert_eq!(run(&mut c, POT, 2), Action::Keep);
        let action = run(&mut c, POT, 1);
        assert_eq!((c.state(), c.pot()), (State::Heating, Pot::Ferromagnetic));
        assert!(
            matches!(action, Action::Drive(d) if d.is_switching() && d.f_sw_hz < pwm::HIGHEST_HZ)
        );
    }

    /// A board answers with what its timers make of the frequency that was asked for.
    #[test]
    fn a_summary_at_the_frequency_of_the_timers_is_of_the_drive_asked_for() {
        let mut c = Control::default();
        let Action::Drive(probe) = c.set_power(1_500) else {
            panic!("it must probe");
        };
        let seen = Summary {
            f_sw_hz: pwm::nearest_hz(probe.f_sw_hz),
            ..summary(POT.0, POT.1, POT.2)
        };
        for _ in 0..PROBE_HALF_CYCLES {
            c.on_half_cycle(&seen, &prior());
        }
        assert_eq!(c.state(), State::Heating);
    }

    #[test]
    fn what_cannot_be_heated_is_a_numbered_fault() {
        assert_eq!(run(&mut probing(), AIR, 3), Action::Fault(Fault::NO_POT));
        let aluminium = run(&mut probing(), ALUMINIUM, 3);
        assert_eq!(aluminium, Action::Fault(Fault::UNSUITABLE_POT));
        assert_eq!(
            run(&mut probing(), (5.0, 22.0, 0.1), 3),
            Action::Fault(Fault::NO_POT)
        );
    }

    #[test]
    fn a_pot_taken_away_stops_the_heating() {
        let mut c = probing();
        run(&mut c, POT, 5);
        assert_eq!(run(&mut c, AIR, 1), Action::Keep, "one half-cycle may err");
        assert_eq!(run(&mut c, AIR, 1), Action::Fault(Fault::POT_REMOVED));
        let mut c = probing();
        run(&mut c, POT, 5);
        assert_eq!(
            run(&mut c, ALUMINIUM, 2),
            Action::Fault(Fault::UNSUITABLE_POT)
        );
    }

    #[test]
    fn switched_off_means_off() {
        let mut c = probing();
        run(&mut c, POT, 5);
        assert_eq!(c.set_power(0), Action::Drive(Drive::OFF));
        assert_eq!(c.state(), State::Idle);
        assert_eq!(run(&mut c, POT, 3), Action::Keep);
    }

    /// Switched off or faulted in the middle of a search, no drive comes out of it.
    #[test]
    fn a_search_under_way_ends_with_the_heating() {
        for switched_off in [true, false] {
            let mut c = probing();
            run(&mut c, POT, 2);
            let probed = Summary {
                f_sw_hz: c.requested_hz,
                power_mw: 1_300_000,
                ..summary(POT.0, POT.1, POT.2)
            };
            c.on_half_cycle(&probed, &prior());
            assert_eq!(c.advance(&prior()), Action::Keep);
            if switched_off {
                assert_eq!(c.set_power(0), Action::Drive(Drive::OFF));
            } else {
                c.faulted();
            }
            for _ in 0..10 {
                assert_eq!(c.advance(&prior()), Action::Keep);
            }
        }
    }

    /// A thread that is away for half-cycles does not begin its search anew each time.
    #[test]
    fn a_search_that_lasts_longer_than_a_half_cycle_still_ends() {
        let mut c = probing();
        run(&mut c, POT, 2);
        let seen = Summary {
            f_sw_hz: c.requested_hz,
            power_mw: 1_300_000,
            ..summary(POT.0, POT.1, POT.2)
        };
        let found = (0..10).any(|_| {
            c.on_half_cycle(&seen, &prior());
            matches!(c.advance(&prior()), Action::Drive(_))
        });
        assert!(found);
    }

    #[test]
    fn a_fault_stays_until_cleared() {
        let mut c = probing();
        c.faulted();
        assert_eq!(c.set_power(1_000), Action::Keep);
        assert_eq!(run(&mut c, POT, 3), Action::Keep);
        c.clear_fault();
        assert!(matches!(c.set_power(1_000), Action::Drive(_)));
    }
}
