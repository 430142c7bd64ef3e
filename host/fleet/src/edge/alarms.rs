//! Alarms of windows that stay in a state for longer than its limit.

use std::collections::BTreeSet;

use ihd_model::FleetStates;

/// Longest time in milliseconds that a window may be due before an alarm: longer than a restart of the server.
const DUE_FOR_MS: i64 = 10 * 60_000;

/// Longest time in milliseconds without an answer before an alarm.
const SENT_FOR_MS: i64 = 3_600_000;

/// Present alarms, which are logged already.
#[derive(Default)]
pub struct Alarms {
    logged: BTreeSet<&'static str>,
}

impl Alarms {
    /// Returns the texts of all alarms; logs the beginning and the end of each.
    pub fn update(&mut self, states: &FleetStates, now_ms: i64) -> Vec<String> {
        let now = alarms(states, now_ms);
        for (what, text) in &now {
            if self.logged.insert(what) {
                tracing::warn!("fleet: {text}");
            }
        }
        self.logged.retain(|what| {
            let stays = now.iter().any(|(other, _)| other == what);
            if !stays {
                tracing::info!("fleet: no windows are {what} for too long any more");
            }
            stays
        });
        now.into_iter().map(|(_, text)| text).collect()
    }
}

fn alarms(states: &FleetStates, now_ms: i64) -> Vec<(&'static str, String)> {
    let states = [
        (
            "due",
            states.due,
            states.due_since_ms,
            DUE_FOR_MS,
            "the fleet does not take them",
        ),
        (
            "sent",
            states.sent,
            states.sent_since_ms,
            SENT_FOR_MS,
            "the fleet does not answer: are there workers enough?",
        ),
    ];
    let late = states
        .into_iter()
        .filter_map(|(what, count, since_ms, bound_ms, why)| {
            let for_ms = now_ms - since_ms?;
            let text = || {
                format!(
                    "{count} windows are {what}, the first for {} min: {why}",
                    for_ms / 60_000
                )
            };
            (for_ms > bound_ms).then(|| (what, text()))
        });
    late.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_that_stays_too_long_is_an_alarm_until_it_goes_on() {
        let mut alarms = Alarms::default();
        let states = FleetStates {
            due: 3,
            due_since_ms: Some(1_000),
            sent: 2,
            sent_since_ms: Some(0),
            answered: 7,
            ..FleetStates::default()
        };
        assert_eq!(alarms.update(&states, 1_000 + DUE_FOR_MS), [""; 0]);
        let late = alarms.update(&states, 1_001 + DUE_FOR_MS);
        assert!(
            late.len() == 1 && late[0].starts_with("3 windows are due, the first for 10 min"),
            "{late:?}"
        );
        let both = alarms.update(&states, SENT_FOR_MS + 1);
        assert!(
            both.len() == 2 && both[1].contains("2 windows are sent, the first for 60 min"),
            "{both:?}"
        );
        assert_eq!(alarms.logged.len(), 2);
        let again = FleetStates {
            answered: 12,
            ..FleetStates::default()
        };
        assert_eq!(alarms.update(&again, i64::MAX), [""; 0]);
        assert!(alarms.logged.is_empty());
    }
}
