//! Events on the command line: `3ms:fsw=60k`, `5ms:pot=none`, `5ms:load=0.6,1.35`, `7ms:off`.

use ihd_sim::recording::settings::{RecordingChange, RecordingEvent};

use super::quantity::{list, quantity};

/// Error for a text that is no event.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{text}` is no event: {why}; write TIME:fsw=60k, TIME:pot=none, TIME:load=0.6,1.35, TIME:off or TIME:on"
)]
pub struct NotAnEvent {
    text: String,
    why: String,
}

/// Parses one event.
pub fn event(text: &str) -> Result<RecordingEvent, NotAnEvent> {
    let wrong = |why: String| NotAnEvent {
        text: text.to_owned(),
        why,
    };
    let (time, what) = text
        .split_once(':')
        .ok_or_else(|| wrong("no `:`".to_owned()))?;
    let t_s = quantity(time).map_err(|e| wrong(e.to_string()))?;
    let change = match what.split_once('=') {
        None if what == "off" => RecordingChange::Off,
        None if what == "on" => RecordingChange::On,
        Some(("fsw", f)) => {
            RecordingChange::Frequency(quantity(f).map_err(|e| wrong(e.to_string()))?)
        }
        Some(("pot", pot)) => RecordingChange::Pot(
            pot.parse()
                .map_err(|e: ihd_sim::pot::UnknownPotName| wrong(e.to_string()))?,
        ),
        Some(("load", factors)) => {
            let [r_factor, l_factor] = list(factors).map_err(|e| wrong(e.to_string()))?;
            RecordingChange::Load { r_factor, l_factor }
        }
        _ => return Err(wrong(format!("unknown change `{what}`"))),
    };
    Ok(RecordingEvent { t_s, change })
}

#[cfg(test)]
mod tests {
    use ihd_sim::pot::SimulatedPot;

    use super::*;

    #[test]
    fn events_are_read() {
        assert_eq!(
            event("3ms:fsw=60k"),
            Ok(RecordingEvent {
                t_s: 3e-3,
                change: RecordingChange::Frequency(60e3)
            })
        );
        assert_eq!(
            event("0.5:pot=none"),
            Ok(RecordingEvent {
                t_s: 0.5,
                change: RecordingChange::Pot(SimulatedPot::NONE)
            })
        );
        assert_eq!(
            event("5ms:load=0.6,1.35").map(|e| e.change),
            Ok(RecordingChange::Load {
                r_factor: 0.6,
                l_factor: 1.35
            })
        );
        assert_eq!(event("1us:off").map(|e| e.change), Ok(RecordingChange::Off));
    }

    #[test]
    fn wrong_events_say_why() {
        assert!(event("3ms").unwrap_err().to_string().contains("no `:`"));
        assert!(
            event("3ms:pot=wood")
                .unwrap_err()
                .to_string()
                .contains("ferritic-D")
        );
        assert!(event("x:off").unwrap_err().to_string().contains("`x`"));
    }
}
