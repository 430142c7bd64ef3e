//! The number of the USB host's frame, which a crystal of the host counts every millisecond.

use embassy_stm32::pac;

/// USB, USB_FNR: it stands still without a host.
pub fn number() -> u16 {
    pac::USB.fnr().read().fn_()
}
