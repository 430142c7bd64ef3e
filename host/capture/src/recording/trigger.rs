//! Trigger of a recording, evaluated on every half-cycle of telemetry.

use ihd_model::{Quantity, Trigger};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{FaultEvent, Telemetry};

/// Returns the quantity in a half-cycle, in [`Quantity::unit`]; `None` for R, L and frequency if the inverter is off.
fn value_in(quantity: Quantity, t: &Telemetry) -> Option<f64> {
    let is_switching = t.f_sw_hz > 0;
    match quantity {
        Quantity::Power => Some(f64::from(t.power_mw) * 1e-3),
        Quantity::Current => Some(f64::from(t.i_crest_ma) * 1e-3),
        Quantity::Resistance => is_switching.then(|| t.r.ohm()),
        Quantity::Inductance => is_switching.then(|| t.l.henry() * 1e6),
        Quantity::Frequency => is_switching.then(|| f64::from(t.f_sw_hz) * 1e-3),
    }
}

/// Last state of the device, because a trigger is a change.
#[derive(Clone, Debug, Default)]
pub struct TriggerState {
    fault: Option<Fault>,
    last: Option<Telemetry>,
}

impl TriggerState {
    /// Processes a half-cycle. Returns the cause, as text, if this trigger has come.
    ///
    /// Neither a fault present at the first half-cycle is a trigger, nor a level exceeded from the start: the level must
    /// be crossed between two successive half-cycles that both have the quantity.
    pub fn telemetry(&mut self, t: Telemetry, trigger: Option<&Trigger>) -> Option<String> {
        let began = match trigger {
            Some(Trigger::Fault) => self.tripped(t.fault, false),
            Some(Trigger::Level {
                quantity,
                level,
                rising,
            }) => self.crossed(&t, *quantity, *level, *rising),
            Some(Trigger::Now) | None => None,
        };
        self.fault = Some(t.fault);
        self.last = Some(t);
        began
    }

    /// Processes a fault event: tripped or cleared. Returns the cause, as text, if this trigger has come.
    pub fn fault(&mut self, event: &FaultEvent, trigger: Option<&Trigger>) -> Option<String> {
        let began = match trigger {
            Some(Trigger::Fault) => self.tripped(event.fault, true),
            _ => None,
        };
        self.fault = Some(event.fault);
        began
    }

    fn tripped(&self, fault: Fault, is_event: bool) -> Option<String> {
        let was_present = match self.fault {
            Some(last) => last == fault,
            None => !is_event,
        };
        let has_tripped = fault != Fault::NONE && !was_present;
        has_tripped.then(|| format!("fault {}: {}", fault.number(), fault.text()))
    }

    fn crossed(
        &self,
        t: &Telemetry,
        quantity: Quantity,
        level: f64,
        rising: bool,
    ) -> Option<String> {
        let before = value_in(quantity, self.last.as_ref()?)?;
        let now = value_in(quantity, t)?;
        let crossed = match rising {
            true => before < level && now >= level,
            false => before > level && now <= level,
        };
        let way = if rising { "above" } else { "below" };
        crossed.then(|| {
            let (name, unit) = (quantity.as_str(), quantity.unit());
            format!("{name} {way} {level} {unit}: from {before:.4} to {now:.4} {unit}")
        })
    }
}

#[cfg(test)]
mod tests {
    use ihd_fakes::telemetry;
    use ihd_shared::units::{MicroOhm, PicoHenry};
    use ihd_shared::wire::messages::State;

    use super::*;

    fn heating(power_w: f64) -> Telemetry {
        let mut t = telemetry(State::Heating);
        t.power_mw = (power_w * 1e3) as u32;
        t.f_sw_hz = 40_000;
        t
    }

    fn level(quantity: Quantity, level: f64, rising: bool) -> Trigger {
        Trigger::Level {
            quantity,
            level,
            rising,
        }
    }

    /// Returns the indices of the half-cycles that begin a recording.
    fn begins(trigger: &Trigger, half_cycles: impl IntoIterator<Item = Telemetry>) -> Vec<usize> {
        let mut state = TriggerState::default();
        let taken = half_cycles.into_iter().enumerate();
        taken
            .filter_map(|(k, t)| state.telemetry(t, Some(trigger)).map(|_| k))
            .collect()
    }

    #[test]
    fn a_level_is_crossed_in_its_direction_and_not_just_exceeded() {
        let powers = [
            1_200.0, 1_100.0, 900.0, 999.9, 1_000.0, 1_100.0, 1_000.0, 999.0, 1_500.0,
        ];
        let all = || powers.map(heating);
        assert_eq!(begins(&level(Quantity::Power, 1e3, true), all()), [4, 8]);
        assert_eq!(begins(&level(Quantity::Power, 1e3, false), all()), [2, 6]);
    }

    #[test]
    fn off_has_no_resistance_that_could_fall_below_a_level() {
        let r = |ohm: Option<i32>| {
            let mut t = heating(500.0);
            t.r = MicroOhm(ohm.unwrap_or(0) * 1_000_000);
            t.f_sw_hz = ohm.map_or(0, |_| 40_000);
            t
        };
        let falls = level(Quantity::Resistance, 2.0, false);
        // Switched off, and on with another pot: neither is a crossing. Then one is.
        let all = [Some(3), None, Some(1), Some(3), Some(1)].map(r);
        assert_eq!(begins(&falls, all), [4]);
        let frequency = level(Quantity::Frequency, 30.0, false);
        assert_eq!(begins(&frequency, [Some(3), None].map(r)), [0; 0]);
    }

    #[test]
    fn units_are_those_that_are_said() {
        let mut low = heating(0.0);
        low.i_crest_ma = 9_000;
        let mut high = heating(0.0);
        (high.i_crest_ma, high.f_sw_hz) = (11_000, 60_000);
        high.l = PicoHenry(90_000_000);
        for (quantity, between) in [
            (Quantity::Current, 10.0),
            (Quantity::Frequency, 50.0),
            (Quantity::Inductance, 50.0),
        ] {
            let both = [low.clone(), high.clone()];
            assert_eq!(
                begins(&level(quantity, between, true), both),
                [1],
                "{quantity:?}"
            );
        }
    }

    #[test]
    fn a_fault_trips_and_one_that_is_there_does_not() {
        let with = |fault| {
            let mut t = telemetry(State::Idle);
            t.fault = fault;
            t
        };
        let (none, one, other) = (Fault::NONE, Fault::OVER_CURRENT, Fault::from_number(3));
        // There at the start, cleared, tripped, still there, another one.
        let all = [one, one, none, one, one, other].map(with);
        assert_eq!(begins(&Trigger::Fault, all), [3, 5]);
        // The event comes first; the telemetry after it is no second trigger.
        let event = |fault| FaultEvent {
            half_cycle: 1,
            fault,
        };
        let mut state = TriggerState::default();
        assert!(state.fault(&event(one), Some(&Trigger::Fault)).is_some());
        assert!(state.telemetry(with(one), Some(&Trigger::Fault)).is_none());
        assert!(state.fault(&event(none), Some(&Trigger::Fault)).is_none());
        assert!(state.telemetry(with(one), Some(&Trigger::Fault)).is_some());
        assert!(state.fault(&event(one), Some(&Trigger::Fault)).is_none());
    }
}
