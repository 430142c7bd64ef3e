//! A panel of three buttons and two lights: debounced lines in, touches of the panel and what the lights show out.
//!
//! | press | does |
//! |---|---|
//! | on/off | switches off; from off it wakes the panel for 10 s, which heats nothing |
//! | plus | awake: level 1; on: one level more, to 9 |
//! | minus | one level less; below 1 off |
//!
//! A press is a line that was released for 30 ms and is closed for 30 ms. A button that is closed at power-on or stuck is pressed
//! once at most, and none repeats: to heat takes two buttons, one after the other. Only on/off, then on/off and plus ends a lock-out.

use ihd_shared::wire::messages::State;

use crate::control::request::PanelEvent;
use crate::control::restart::is_reached;

/// Time for which a line must stay as it is, in milliseconds: contacts bounce for less than 10.
const DEBOUNCE_MS: u32 = 30;

/// Time for which the panel is awake, in milliseconds.
const AWAKE_MS: u32 = 10_000;

/// Half of the time from one flash of a light to the next, and the pause after the last, in milliseconds.
const FLASH_MS: u32 = 200;
const PAUSE_MS: u32 = 1_000;

/// State of the lines, `true` if a button closes it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PanelLines {
    /// On/off.
    pub on_off: bool,
    /// More.
    pub plus: bool,
    /// Less.
    pub minus: bool,
}

/// Lights of the panel, `true` if lit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PanelLights {
    /// Flashes the level; fast while the panel is awake.
    pub on: bool,
    /// Lit when locked out, flashes during a pause.
    pub fault: bool,
}

/// A line with a button to ground.
#[derive(Clone, Copy, Debug)]
struct Button {
    is_closed: bool,
    changed_ms: Option<u32>,
}

impl Button {
    /// Closed until it has been seen released.
    const AT_START: Self = Self {
        is_closed: true,
        changed_ms: None,
    };

    /// Takes the line; returns `true` if the button has just been pressed.
    fn is_pressed(&mut self, is_closed: bool, now_ms: u32) -> bool {
        if is_closed == self.is_closed {
            self.changed_ms = None;
            return false;
        }
        let since_ms = *self.changed_ms.get_or_insert(now_ms);
        if now_ms.wrapping_sub(since_ms) < DEBOUNCE_MS {
            return false;
        }
        self.is_closed = is_closed;
        self.changed_ms = None;
        is_closed
    }
}

/// The panel's buttons.
#[derive(Clone, Copy, Debug)]
pub struct PanelButtons {
    on_off: Button,
    plus: Button,
    minus: Button,
    awake_until_ms: Option<u32>,
}

impl Default for PanelButtons {
    fn default() -> Self {
        let button = Button::AT_START;
        Self {
            on_off: button,
            plus: button,
            minus: button,
            awake_until_ms: None,
        }
    }
}

impl PanelButtons {
    /// Takes the lines, at least every 10 ms; returns the touch that they are. `level` is the panel's, `is_on` if power is
    /// requested, of whomever.
    pub fn update(
        &mut self,
        lines: PanelLines,
        level: Option<u8>,
        is_on: bool,
        now_ms: u32,
    ) -> Option<PanelEvent> {
        let on_off = self.on_off.is_pressed(lines.on_off, now_ms);
        let plus = self.plus.is_pressed(lines.plus, now_ms);
        let minus = self.minus.is_pressed(lines.minus, now_ms);
        if self.awake_until_ms.is_some_and(|at| is_reached(now_ms, at)) {
            self.awake_until_ms = None;
        }
        let (level, is_awake) = (level.unwrap_or(0), self.awake_until_ms.is_some());
        if on_off {
            let wakes = !is_on && !is_awake;
            self.awake_until_ms = wakes.then(|| now_ms.wrapping_add(AWAKE_MS));
            return Some(PanelEvent::Level(0));
        }
        // Both at once mean nothing.
        match (plus, minus) {
            (true, false) if level > 0 || is_awake => {
                self.awake_until_ms = None;
                Some(PanelEvent::Level(level.saturating_add(1).min(9)))
            }
            (false, true) if level > 0 => Some(PanelEvent::Level(level - 1)),
            _ => None,
        }
    }

    /// Lights for the hob's state and the panel's level.
    pub fn lights(&self, state: State, level: Option<u8>, now_ms: u32) -> PanelLights {
        PanelLights {
            on: match level {
                _ if self.awake_until_ms.is_some() => now_ms % FLASH_MS < FLASH_MS / 2,
                Some(level) => is_flash(level, now_ms),
                None => false,
            },
            fault: match state {
                State::LockedOut => true,
                State::Pausing => now_ms % (2 * FLASH_MS) < FLASH_MS,
                _ => false,
            },
        }
    }
}

/// Returns `true` during one of so many flashes, which a pause follows.
fn is_flash(count: u8, now_ms: u32) -> bool {
    let flashing_ms = u32::from(count) * 2 * FLASH_MS;
    let at_ms = now_ms % (flashing_ms + PAUSE_MS);
    at_ms < flashing_ms && at_ms % (2 * FLASH_MS) < FLASH_MS
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::request::{PanelResult, PowerRequest};
    use std::vec::Vec;

    const NONE: PanelLines = PanelLines {
        on_off: false,
        plus: false,
        minus: false,
    };
    const ON_OFF: PanelLines = PanelLines {
        on_off: true,
        ..NONE
    };
    const PLUS: PanelLines = PanelLines { plus: true, ..NONE };
    const MINUS: PanelLines = PanelLines {
        minus: true,
        ..NONE
    };

    /// Buttons with the requests that they lead to, in simulated milliseconds.
    struct Person {
        buttons: PanelButtons,
        request: PowerRequest,
        now_ms: u32,
        results: Vec<PanelResult>,
    }

    impl Person {
        fn at_power_on() -> Self {
            Self {
                buttons: PanelButtons::default(),
                request: PowerRequest::default(),
                // The clock wraps on the way.
                now_ms: u32::MAX - 500,
                results: Vec::new(),
            }
        }

        fn hold(&mut self, lines: PanelLines, ms: u32) {
            for _ in 0..ms {
                self.now_ms = self.now_ms.wrapping_add(1);
                let (level, is_on) = (self.request.level(), self.request.power_w() > 0);
                if let Some(event) = self.buttons.update(lines, level, is_on, self.now_ms) {
                    self.results.push(self.request.panel(event));
                }
            }
        }

        fn press(&mut self, lines: PanelLines) {
            self.hold(NONE, 60);
            self.hold(lines, 60);
            self.hold(NONE, 60);
        }
    }

    #[test]
    fn on_takes_two_buttons_and_off_takes_one() {
        let mut person = Person::at_power_on();
        person.press(PLUS);
        assert_eq!(person.request.power_w(), 0, "asleep");
        person.press(ON_OFF);
        assert_eq!(person.request.power_w(), 0, "awake");
        for level in 1..=9 {
            person.press(PLUS);
            assert_eq!(person.request.level(), Some(level));
        }
        person.press(PLUS);
        assert_eq!(person.request.level(), Some(9));
        person.press(MINUS);
        assert_eq!(person.request.level(), Some(8));
        person.press(ON_OFF);
        assert_eq!(person.request.power_w(), 0);
        // Off, not awake.
        person.press(PLUS);
        assert_eq!(person.request.power_w(), 0);
    }

    #[test]
    fn the_panel_falls_asleep() {
        let mut person = Person::at_power_on();
        person.press(ON_OFF);
        person.hold(NONE, AWAKE_MS);
        person.press(PLUS);
        assert_eq!(person.request.power_w(), 0);
    }

    /// A button that is closed at power-on or for good, or that chatters, heats nothing.
    #[test]
    fn a_button_that_is_stuck_is_harmless() {
        let all = PanelLines {
            on_off: true,
            plus: true,
            minus: true,
        };
        let mut person = Person::at_power_on();
        person.hold(all, 60_000);
        assert_eq!(person.results, []);
        person.hold(NONE, 60);
        person.hold(all, 60_000);
        assert_eq!(person.request.power_w(), 0);
        // Plus closes for ever: one level, and off still works.
        let mut person = Person::at_power_on();
        person.press(ON_OFF);
        person.hold(PLUS, 60_000);
        assert_eq!(person.request.level(), Some(1));
        let both = PanelLines {
            on_off: true,
            ..PLUS
        };
        person.hold(both, 100);
        person.hold(PLUS, 60_000);
        assert_eq!(person.request.power_w(), 0);
        // Bouncing contacts are one press.
        let mut person = Person::at_power_on();
        person.press(ON_OFF);
        for _ in 0..50 {
            person.hold(PLUS, 3);
            person.hold(NONE, 2);
        }
        assert_eq!(person.request.power_w(), 0, "never closed for 30 ms");
        person.hold(PLUS, 100);
        assert_eq!(person.request.level(), Some(1));
    }

    /// A host heats, the hob locks out: off, awake, plus is a person's way on.
    #[test]
    fn a_person_switches_off_and_on_whoever_asked_before() {
        for host_w in [0, 1_200] {
            let mut person = Person::at_power_on();
            assert!(person.request.host(host_w));
            person.press(ON_OFF);
            assert_eq!(person.request.power_w(), 0);
            if host_w > 0 {
                person.press(ON_OFF);
            }
            person.press(PLUS);
            assert_eq!(person.results.last(), Some(&PanelResult::SwitchedOn));
        }
    }

    #[test]
    fn the_lights_show_level_and_lock_out() {
        let buttons = PanelButtons::default();
        let flashes = |level| {
            let lit = |ms| buttons.lights(State::Heating, level, ms).on;
            let cycle_ms = u32::from(level.unwrap_or(0)) * 2 * FLASH_MS + PAUSE_MS;
            (1..=cycle_ms).filter(|&ms| lit(ms - 1) && !lit(ms)).count()
        };
        assert_eq!([None, Some(0), Some(1), Some(9)].map(flashes), [0, 0, 1, 9]);
        assert!(buttons.lights(State::LockedOut, None, 0).fault);
        assert!(!buttons.lights(State::Idle, None, 0).fault);
    }
}
