//! `ihd flash --dfu`: the way through the chip's own bootloader.

use anyhow::Result;
use ihd_flash::Programmer;
use ihd_flash::dfu::reach;
use ihd_link::DeviceSpec;

/// The bootloader that is plugged in, or the one with the serial number; where there is none, the board's firmware is sent
/// there, behind `device` or on USB.
///
/// # Errors
/// [`ihd_flash::dfu::EnterError`].
pub fn programmer(
    serial: Option<&str>,
    device: Option<&DeviceSpec>,
) -> Result<Box<dyn Programmer>> {
    Ok(Box::new(reach(serial, device)?))
}
