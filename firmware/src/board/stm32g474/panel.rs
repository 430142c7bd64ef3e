//! The panel: four buttons to ground with the chip's own pull-ups, three lights on by a high level.

use embassy_stm32::Peri;
use embassy_stm32::gpio::{Input, Level, Output, Pin, Pull, Speed};
use embassy_stm32::peripherals::{PC6, PC7, PC8, PC9, PC10, PC11, PC12};
use ihd_firmware::control::panel::{PanelButtons, PanelLines};
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::sampling::path::SamplingLock;

/// Pins of the buttons: on/off, plus, minus, timer.
type Buttons = (
    Peri<'static, PC6>,
    Peri<'static, PC8>,
    Peri<'static, PC9>,
    Peri<'static, PC7>,
);

/// Pins of the lights of power, fault and hot glass.
type Lights = (
    Peri<'static, PC10>,
    Peri<'static, PC11>,
    Peri<'static, PC12>,
);

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
    pub fn new(buttons: Buttons, (on, fault, hot): Lights) -> Self {
        let (on_off, plus, minus, timer) = buttons;
        Self {
            on_off: Input::new(on_off, Pull::Up),
            plus: Input::new(plus, Pull::Up),
            minus: Input::new(minus, Pull::Up),
            timer: Input::new(timer, Pull::Up),
            on: light(on),
            fault: light(fault),
            hot: light(hot),
            buttons: PanelButtons::default(),
        }
    }

    /// Hands touches to the hob and shows its state; called every millisecond.
    pub fn exchange(&mut self, housekeeping: &mut Housekeeping, path: &mut impl SamplingLock) {
        let now_ms = path.with(|rt| rt.now_ms());
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

/// Light that is off.
fn light(pin: Peri<'static, impl Pin>) -> Output<'static> {
    Output::new(pin, Level::Low, Speed::Low)
}
