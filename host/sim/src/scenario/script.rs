//! Events of a scenario applied to a hob with another host, repeatedly.

use super::ScenarioError;
use super::file::Scenario;
use super::surroundings::{ChangeableHob, Surroundings};
use super::timeline::{TimedChange, timeline};
use crate::hob::SimHob;

/// Changes of pot, mains and panel of a hob behind a link.
pub struct ScenarioScript {
    events: Vec<TimedChange>,
    duration_s: f64,
    /// Start of this repetition, in seconds of simulated time.
    began_s: f64,
    next: usize,
    surroundings: Surroundings,
}

impl ScenarioScript {
    /// Creates a script of a scenario's events for a hob, from its present time on; they repeat after the scenario's duration.
    ///
    /// # Errors
    /// [`ScenarioError::Event`] for invalid events, and for those of a host, which is whoever connects. [`ScenarioError::Plant`]
    /// for a pot without a model.
    pub fn new(scenario: &Scenario, hob: &mut SimHob) -> Result<Self, ScenarioError> {
        let events = timeline(scenario)?;
        if let Some(timed) = events.iter().find(|timed| timed.change.is_of_host()) {
            return Err(ScenarioError::Event {
                number: timed.event + 1,
                line: scenario.lines[timed.event],
                why: "the host is whoever connects: give pot, mains, panel, keep_warm, key_lock, timer_min, pass_min, \
                      inject, ambient_c, heat_sink_c or glass_c"
                    .to_owned(),
            });
        }
        Surroundings::prepare(hob.plant(), &events)?;
        Ok(Self {
            events,
            duration_s: scenario.file.duration_s,
            began_s: hob.t_s(),
            next: 0,
            surroundings: Surroundings::default(),
        })
    }

    /// Creates a script that runs once.
    ///
    /// # Errors
    /// Any error of [`ScenarioScript::new`].
    pub fn once(scenario: &Scenario, hob: &mut SimHob) -> Result<Self, ScenarioError> {
        Ok(Self {
            duration_s: f64::INFINITY,
            ..Self::new(scenario, hob)?
        })
    }

    /// Returns `true` if all events are over; always `false` for a repeating script.
    pub fn is_over(&self) -> bool {
        self.duration_s.is_infinite() && self.next == self.events.len()
    }

    /// Applies due events; called between any two steps.
    pub fn turn(&mut self, hob: &mut SimHob) {
        let mut at_s = hob.t_s() - self.began_s;
        if at_s >= self.duration_s && self.next == self.events.len() {
            self.began_s += self.duration_s;
            self.next = 0;
            at_s -= self.duration_s;
        }
        while let Some(timed) = self.events.get(self.next).filter(|e| e.at_s <= at_s) {
            self.next += 1;
            // Pots without a model were rejected when the script was made.
            let _ = self.surroundings.apply_to_hob(hob, timed);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::hob::HobConfig;

    fn script(text: &str, hob: &mut SimHob) -> Result<ScenarioScript, ScenarioError> {
        ScenarioScript::new(&Scenario::parse(text, PathBuf::new())?, hob)
    }

    #[test]
    fn events_come_at_their_time_and_again_in_the_next_round() {
        let mut hob = SimHob::new(&HobConfig::default());
        let text =
            "duration_s = 0.1\n[[event]]\nat_s = 0.02\npot = { name = \"none\", for_s = 0.03 }\n";
        let mut script = script(text, &mut hob).unwrap();
        let mut there = Vec::new();
        for at_s in [0.01, 0.03, 0.06, 0.11, 0.13, 0.16, 0.21, 0.23] {
            while hob.t_s() < at_s {
                script.turn(&mut hob);
                hob.step();
            }
            there.push(hob.pot().base.is_some());
        }
        assert_eq!(there, [true, false, true, true, false, true, true, false]);
    }

    #[test]
    fn once_is_over_when_all_has_happened() {
        let mut hob = SimHob::new(&HobConfig::default());
        let text =
            "duration_s = 0.01\n[[event]]\nat_s = 0\npot = { name = \"none\", for_s = 0.03 }\n";
        let scenario = Scenario::parse(text, PathBuf::new()).unwrap();
        let mut script = ScenarioScript::once(&scenario, &mut hob).unwrap();
        let mut seen = Vec::new();
        for at_s in [0.01, 0.05, 0.1] {
            while hob.t_s() < at_s {
                script.turn(&mut hob);
                hob.step();
            }
            seen.push((hob.pot().base.is_some(), script.is_over()));
        }
        assert_eq!(seen, [(false, false), (true, true), (true, true)]);
    }

    #[test]
    fn a_touch_of_the_panel_heats() {
        let mut hob = SimHob::new(&HobConfig::default());
        let mut script = script(
            "duration_s = 60\n[[event]]\nat_s = 0.05\npanel = 5\n",
            &mut hob,
        )
        .unwrap();
        while hob.t_s() < 1.5 {
            script.turn(&mut hob);
            hob.step();
        }
        assert!(hob.housekeeping().summary().power_mw > 200_000);
    }

    #[test]
    fn events_of_a_host_are_refused_by_line() {
        let mut hob = SimHob::new(&HobConfig::default());
        let text = "duration_s = 1\n[[event]]\nat_s = 0.1\npower_w = 500\n";
        let error = script(text, &mut hob).err().unwrap().to_string();
        assert!(
            error.contains("event 1 (line 2)") && error.contains("panel"),
            "{error}"
        );
    }
}
