//! `ihd flash --dfu`: access through the chip's own bootloader.

use anyhow::Result;
use ihd_flash::Programmer;
use ihd_flash::dfu::reach;
use ihd_link::DeviceSpec;

/// Opens the only bootloader, or the one with the serial number. If there is none, the firmware of the board on USB is restarted
/// into it; the firmware behind `device` always is.
///
/// # Errors
/// [`ihd_flash::dfu::EnterError`].
pub fn programmer(
    serial: Option<&str>,
    device: Option<&DeviceSpec>,
) -> Result<Box<dyn Programmer>> {
    Ok(Box::new(reach(serial, device)?))
}
