//! The panel: four buttons to ground with the chip's own pull-ups, three lights on by a high level.

use embassy_stm32::gpio::{Input, Output, Pull};
use ihd_firmware::control::panel::{PanelButtons, PanelLines};
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::sampling::path::SamplingLock;
use ihd_shared::board::{self, Pin};

use super::pins::{low_output, of_board};

/// Lines and lights.
pub struct Panel {
    on_off: Input<'static>,
    plus: Input<'static>,
    minus: Input<'static>,
    timer: Input<'static>,
    on: Output<'static>,
    fault: Output<'static>,
    hot: Output<'static>,
    buttons: PanelButtons,
}

impl Panel {
    /// Lights off; a button that is closed by now counts once it has been released.
    pub fn new() -> Self {
        Self {
            on_off: button(board::BUTTON_ON_OFF_PIN),
            plus: button(board::BUTTON_PLUS_PIN),
            minus: button(board::BUTTON_MINUS_PIN),
            timer: button(board::BUTTON_TIMER_PIN),
            on: low_output(board::LIGHT_POWER_PIN),
            fault: low_output(board::LIGHT_FAULT_PIN),
            hot: low_output(board::LIGHT_HOT_GLASS_PIN),
            buttons: PanelButtons::default(),
        }
    }

    /// Hands touches to the hob and shows its state; called every millisecond.
    pub fn exchange(&mut self, housekeeping: &mut Housekeeping, path: &mut impl SamplingLock) {
        let now_ms = path.with(|path| path.now_ms());
        let lines = PanelLines {
            on_off: self.on_off.is_low(),
            plus: self.plus.is_low(),
            minus: self.minus.is_low(),
            timer: self.timer.is_low(),
        };
        let shown = housekeeping.control().panel_state();
        if let Some(event) = self.buttons.update(lines, &shown, now_ms) {
            housekeeping.panel(path, event);
        }
        let shown = housekeeping.control().panel_state();
        let lights = self.buttons.lights(&shown, now_ms);
        self.on.set_level(lights.on.into());
        self.fault.set_level(lights.fault.into());
        self.hot.set_level(lights.hot.into());
    }
}

fn button(pin: Pin) -> Input<'static> {
    Input::new(of_board(pin), Pull::Up)
}
