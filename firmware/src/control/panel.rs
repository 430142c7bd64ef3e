//! A panel of four buttons and three lights: debounced lines in, touches of the panel and what the lights show out.
//!
//! | press | does |
//! |---|---|
//! | on/off | switches off; from off it wakes the panel for 10 s, which heats nothing |
//! | plus | awake: level 1; on: one level more, to 9 |
//! | minus | one level less; below 1 off |
//! | timer | on: off after the next whole ten minutes and ten more, to 90; then none |
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

/// Step of the timer and the longest one, in minutes.
const TIMER_STEP_MIN: u8 = 10;
const TIMER_MOST_MIN: u8 = 90;

/// Time for which a press of the timer's button shows the timer, in milliseconds.
const TIMER_SHOWN_MS: u32 = 5_000;

/// Half of the time from one flash of the timer to the next, in milliseconds.
const TIMER_FLASH_MS: u32 = 120;

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
    /// Timer.
    pub timer: bool,
}

/// State of the hob that the panel acts on and shows.
#[derive(Clone, Copy, Debug)]
pub struct PanelState {
    /// State of the controller.
    pub state: State,
    /// The panel's level; `None` until it is touched.
    pub level: Option<u8>,
    /// Power is requested, by whomever.
    pub is_on: bool,
    /// Minutes left on the timer; 0 without one.
    pub timer_min: u8,
    /// The glass is hot.
    pub glass_hot: bool,
}

/// Lights of the panel, `true` if lit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PanelLights {
    /// Flashes the level; fast while the panel is awake; tens of minutes for 5 s after a press of the timer.
    pub on: bool,
    /// Lit when locked out, flashes during a pause.
    pub fault: bool,
    /// Lit while the glass is hot.
    pub hot: bool,
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
    timer: Button,
    awake_until_ms: Option<u32>,
    timer_shown_ms: Option<u32>,
}

impl Default for PanelButtons {
    fn default() -> Self {
        let button = Button::AT_START;
        Self {
            on_off: button,
            plus: button,
            minus: button,
            timer: button,
            awake_until_ms: None,
            timer_shown_ms: None,
        }
    }
}

impl PanelButtons {
    /// Takes the lines, at least every 10 ms; returns the touch that they are.
    pub fn update(
        &mut self,
        lines: PanelLines,
        shown: &PanelState,
        now_ms: u32,
    ) -> Option<PanelEvent> {
        let on_off = self.on_off.is_pressed(lines.on_off, now_ms);
        let plus = self.plus.is_pressed(lines.plus, now_ms);
        let minus = self.minus.is_pressed(lines.minus, now_ms);
        let timer = self.timer.is_pressed(lines.timer, now_ms);
        if self.awake_until_ms.is_some_and(|at| is_reached(now_ms, at)) {
            self.awake_until_ms = None;
        }
        let timer_over = |since| now_ms.wrapping_sub(since) >= TIMER_SHOWN_MS;
        if !shown.is_on || self.timer_shown_ms.is_some_and(timer_over) {
            self.timer_shown_ms = None;
        }
        let (level, is_awake) = (shown.level.unwrap_or(0), self.awake_until_ms.is_some());
        if on_off {
            let wakes = !shown.is_on && !is_awake;
            self.awake_until_ms = wakes.then(|| now_ms.wrapping_add(AWAKE_MS));
            return Some(PanelEvent::Level(0));
        }
        // Two at once mean nothing.
        match (plus, minus, timer) {
            (true, false, false) if level > 0 || is_awake => {
                self.awake_until_ms = None;
                Some(PanelEvent::Level(level.saturating_add(1).min(9)))
            }
            (false, true, false) if level > 0 => Some(PanelEvent::Level(level - 1)),
            (false, false, true) if shown.is_on => {
                self.timer_shown_ms = Some(now_ms);
                Some(PanelEvent::Timer(next_timer_min(shown.timer_min)))
            }
            _ => None,
        }
    }

    /// Lights for the hob's state.
    pub fn lights(&self, shown: &PanelState, now_ms: u32) -> PanelLights {
        let on = match (self.timer_shown_ms, shown.level) {
            _ if self.awake_until_ms.is_some() => now_ms % FLASH_MS < FLASH_MS / 2,
            (Some(since_ms), _) => {
                let tens = shown.timer_min.div_ceil(TIMER_STEP_MIN);
                is_flash(tens, TIMER_FLASH_MS, now_ms.wrapping_sub(since_ms))
            }
            (None, Some(level)) => is_flash(level, FLASH_MS, now_ms),
            (None, None) => false,
        };
        PanelLights {
            on,
            fault: match shown.state {
                State::LockedOut => true,
                State::Pausing => now_ms % (2 * FLASH_MS) < FLASH_MS,
                _ => false,
            },
            hot: shown.glass_hot,
        }
    }
}

/// Setting of the timer after a press, from the minutes that are left.
fn next_timer_min(left_min: u8) -> u8 {
    let next = (left_min.div_ceil(TIMER_STEP_MIN) + 1) * TIMER_STEP_MIN;
    if next <= TIMER_MOST_MIN { next } else { 0 }
}

/// Returns `true` during one of so many flashes, which a pause follows. `flash_ms` is half of the time from one to the next.
fn is_flash(count: u8, flash_ms: u32, at_ms: u32) -> bool {
    let flashing_ms = u32::from(count) * 2 * flash_ms;
    let at_ms = at_ms % (flashing_ms + PAUSE_MS);
    at_ms < flashing_ms && at_ms % (2 * flash_ms) < flash_ms
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
        timer: false,
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

    const TIMER: PanelLines = PanelLines {
        timer: true,
        ..NONE
    };

    fn shown(state: State, level: Option<u8>) -> PanelState {
        PanelState {
            state,
            level,
            is_on: level > Some(0),
            timer_min: 0,
            glass_hot: false,
        }
    }

    /// Buttons with the requests that they lead to, in simulated milliseconds.
    struct Person {
        buttons: PanelButtons,
        request: PowerRequest,
        timer_min: u8,
        now_ms: u32,
        results: Vec<PanelResult>,
    }

    impl Person {
        fn at_power_on() -> Self {
            Self {
                buttons: PanelButtons::default(),
                request: PowerRequest::default(),
                timer_min: 0,
                // The clock wraps on the way.
                now_ms: u32::MAX - 500,
                results: Vec::new(),
            }
        }

        fn hold(&mut self, lines: PanelLines, ms: u32) {
            for _ in 0..ms {
                self.now_ms = self.now_ms.wrapping_add(1);
                let shown = PanelState {
                    is_on: self.request.power_w() > 0,
                    timer_min: self.timer_min,
                    ..shown(State::Idle, self.request.level())
                };
                if let Some(event) = self.buttons.update(lines, &shown, self.now_ms) {
                    let result = self.request.panel(event);
                    if let PanelResult::Timer(minutes) = result {
                        self.timer_min = minutes;
                    }
                    self.results.push(result);
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
            timer: true,
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
    fn the_timer_is_set_in_tens_of_minutes_while_something_is_on() {
        let mut person = Person::at_power_on();
        person.press(TIMER);
        person.press(ON_OFF);
        person.press(TIMER);
        assert_eq!(person.timer_min, 0, "nothing is on");
        person.press(PLUS);
        person.press(TIMER);
        assert_eq!(person.timer_min, 10);
        person.timer_min = 3;
        let mut seen = Vec::new();
        for _ in 0..10 {
            person.press(TIMER);
            seen.push(person.timer_min);
        }
        assert_eq!(seen, [20, 30, 40, 50, 60, 70, 80, 90, 0, 10]);
        assert_eq!(person.request.level(), Some(1));
        assert!(person.request.panel(PanelEvent::KeyLock(true)) == PanelResult::Changed);
        person.press(TIMER);
        assert_eq!(person.timer_min, 10, "locked");
    }

    fn flashes(buttons: &PanelButtons, shown: &PanelState, from_ms: u32, ms: u32) -> usize {
        let lit = |ms: u32| buttons.lights(shown, from_ms.wrapping_add(ms)).on;
        (1..=ms).filter(|&ms| lit(ms - 1) && !lit(ms)).count()
    }

    #[test]
    fn a_press_of_the_timer_shows_it() {
        let mut person = Person::at_power_on();
        person.press(ON_OFF);
        person.press(PLUS);
        person.press(TIMER);
        person.press(TIMER);
        let shown = PanelState {
            timer_min: person.timer_min,
            ..shown(State::Heating, Some(9))
        };
        let since_ms = person.buttons.timer_shown_ms.expect("pressed");
        let cycle_ms = 4 * TIMER_FLASH_MS + PAUSE_MS;
        assert_eq!(flashes(&person.buttons, &shown, since_ms, cycle_ms), 2);
        person.hold(NONE, TIMER_SHOWN_MS);
        let cycle_ms = 18 * FLASH_MS + PAUSE_MS;
        assert_eq!(flashes(&person.buttons, &shown, 0, cycle_ms), 9);
    }

    #[test]
    fn the_lights_show_level_lock_out_and_hot_glass() {
        let buttons = PanelButtons::default();
        let count = |level: Option<u8>| {
            let cycle_ms = u32::from(level.unwrap_or(0)) * 2 * FLASH_MS + PAUSE_MS;
            flashes(&buttons, &shown(State::Heating, level), 0, cycle_ms)
        };
        assert_eq!([None, Some(0), Some(1), Some(9)].map(count), [0, 0, 1, 9]);
        let off = shown(State::Idle, None);
        assert!(buttons.lights(&shown(State::LockedOut, None), 0).fault);
        assert_eq!(buttons.lights(&off, 0), PanelLights::default());
        let hot = PanelState {
            glass_hot: true,
            ..off
        };
        assert!(buttons.lights(&hot, 0).hot);
    }
}
