//! A panel of four buttons and three lights: debounced lines in, touches of the panel and what the lights show out.
//!
//! | press | does |
//! |---|---|
//! | on/off | switches off; from off it wakes the panel for 10 s, which heats nothing |
//! | plus | awake: level 1; on: one level more, to 9 |
//! | minus | awake: keeps warm; on: one level less, below 1 off |
//! | timer | on: off after the next whole ten minutes and ten more, to 90; then none |
//!
//! A press is a line that was released for 30 ms and is closed for 30 ms. A button that is closed at power-on or stuck is pressed
//! once at most, and none repeats: to heat takes two buttons, one after the other. Only off, then on ends a lock-out.

use ihd_shared::wire::messages::State;

use crate::control::request::PanelEvent;
use crate::control::restart::is_reached;
use crate::limits::HIGHEST_LEVEL;

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

/// Half of the time from one flicker of the light to the next while the panel is awake, in milliseconds.
const FLICKER_MS: u32 = 100;

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
    /// The panel is set to keep warm.
    pub keeps_warm: bool,
    /// Minutes left on the timer; 0 without one.
    pub timer_min: u8,
    /// The glass is hot.
    pub glass_hot: bool,
}

/// Lights of the panel, `true` if lit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PanelLights {
    /// Flashes the level, lit while it keeps warm; fast while the panel is awake; tens of minutes for 5 s after a press of the timer.
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
        // Below level 1, and above off.
        let level = shown.level.filter(|_| !shown.keeps_warm).unwrap_or(0);
        let is_awake = self.awake_until_ms.is_some();
        if on_off {
            let wakes = !shown.is_on && !is_awake;
            self.awake_until_ms = wakes.then(|| now_ms.wrapping_add(AWAKE_MS));
            return Some(PanelEvent::Level(0));
        }
        // Two at once mean nothing.
        match (plus, minus, timer) {
            (true, false, false) if level > 0 || shown.keeps_warm || is_awake => {
                self.awake_until_ms = None;
                Some(PanelEvent::Level(
                    level.saturating_add(1).min(HIGHEST_LEVEL),
                ))
            }
            (false, true, false) if level > 0 || shown.keeps_warm => {
                Some(PanelEvent::Level(level.saturating_sub(1)))
            }
            (false, true, false) if is_awake => {
                self.awake_until_ms = None;
                Some(PanelEvent::KeepWarm)
            }
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
            _ if self.awake_until_ms.is_some() => now_ms % (2 * FLICKER_MS) < FLICKER_MS,
            (Some(since_ms), _) => {
                let tens = shown.timer_min.div_ceil(TIMER_STEP_MIN);
                is_flash(
                    tens.into(),
                    TIMER_FLASH_MS,
                    PAUSE_MS,
                    now_ms.wrapping_sub(since_ms),
                )
            }
            (None, _) if shown.keeps_warm => true,
            (None, Some(level)) => is_flash(level.into(), FLASH_MS, PAUSE_MS, now_ms),
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
pub fn is_flash(count: u32, flash_ms: u32, pause_ms: u32, at_ms: u32) -> bool {
    let flashing_ms = count * 2 * flash_ms;
    let at_ms = at_ms % (flashing_ms + pause_ms);
    at_ms < flashing_ms && at_ms % (2 * flash_ms) < flash_ms
}

#[cfg(test)]
mod tests;
