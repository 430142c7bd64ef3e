//! The panel: three buttons to ground with the chip's own pull-ups, two lights on by a high level.

use embassy_stm32::Peri;
use embassy_stm32::gpio::{Input, Level, Output, Pull, Speed};
use embassy_stm32::peripherals::{PC6, PC8, PC9, PC10, PC11};
use ihd_firmware::control::panel::{PanelButtons, PanelLines};
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::sampling::path::SamplingLock;

/// Lines and lights.
pub struct Panel {
    on_off: Input<'static>,
    plus: Input<'static>,
    minus: Input<'static>,
    on: Output<'static>,
    fault: Output<'static>,
    buttons: PanelButtons,
}

impl Panel {
    /// Lights off; a button that is closed by now counts once it has been released.
    pub fn new(
        (on_off, plus, minus): (Peri<'static, PC6>, Peri<'static, PC8>, Peri<'static, PC9>),
        (on, fault): (Peri<'static, PC10>, Peri<'static, PC11>),
    ) -> Self {
        Self {
            on_off: Input::new(on_off, Pull::Up),
            plus: Input::new(plus, Pull::Up),
            minus: Input::new(minus, Pull::Up),
            on: Output::new(on, Level::Low, Speed::Low),
            fault: Output::new(fault, Level::Low, Speed::Low),
            buttons: PanelButtons::default(),
        }
    }

    /// Hands touches to the hob and shows its state; called every millisecond.
    pub fn exchange(&mut self, housekeeping: &mut Housekeeping, path: &mut impl SamplingLock) {
        let now_ms = path.with(|rt| rt.now_ms());
        let control = housekeeping.control();
        let (level, is_on) = (control.request().level(), control.asked_w() > 0);
        let lines = PanelLines {
            on_off: self.on_off.is_low(),
            plus: self.plus.is_low(),
            minus: self.minus.is_low(),
        };
        if let Some(event) = self.buttons.update(lines, level, is_on, now_ms) {
            housekeeping.panel(path, event);
        }
        let lights = self
            .buttons
            .lights(housekeeping.control().state(), level, now_ms);
        self.on.set_level(lights.on.into());
        self.fault.set_level(lights.fault.into());
    }
}
