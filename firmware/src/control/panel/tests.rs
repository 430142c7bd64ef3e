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
        keeps_warm: false,
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
                keeps_warm: self.request.keeps_warm(),
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

/// Minus is the other way from awake: less than level 1, and more than off.
#[test]
fn keeping_warm_is_below_level_1() {
    let mut person = Person::at_power_on();
    person.press(MINUS);
    assert_eq!(person.request.power_w(), 0, "asleep");
    for (next, power_w) in [(PLUS, 100), (MINUS, 0)] {
        person.press(ON_OFF);
        person.press(MINUS);
        assert!(person.request.keeps_warm());
        assert_eq!(person.request.power_w(), 350);
        person.press(next);
        assert!(!person.request.keeps_warm());
        assert_eq!(person.request.power_w(), power_w);
        person.press(ON_OFF);
    }
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
    let warm = PanelState {
        keeps_warm: true,
        ..shown(State::Heating, Some(3))
    };
    assert!((0..10_000).all(|now_ms| buttons.lights(&warm, now_ms).on));
    assert!(buttons.lights(&shown(State::LockedOut, None), 0).fault);
    assert_eq!(buttons.lights(&off, 0), PanelLights::default());
    let hot = PanelState {
        glass_hot: true,
        ..off
    };
    assert!(buttons.lights(&hot, 0).hot);
}
