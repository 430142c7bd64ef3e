//! Restart from the running firmware into the bootloader: requested over the link, then awaited on USB.

use std::time::Duration;

use ihd_link::{Client, DeviceSpec, LinkError, Transport};
use ihd_shared::wire::messages::Program;

use super::chip::Dfu;
use super::usb::{self, Usb};
use crate::programmer::ProgramError;

/// Time limit from the answer until the system lists the bootloader, which measures its clock by the first frames.
const LISTING_TIMEOUT: Duration = Duration::from_secs(10);

/// Error of starting a chip's bootloader.
#[derive(Debug, thiserror::Error)]
pub enum EnterError {
    /// Error of USB or of the devices on it.
    #[error(transparent)]
    Program(#[from] ProgramError),
    /// The firmware did not restart into the bootloader.
    #[error(
        "the board was not sent into its bootloader: {0}; nothing was written. A board whose firmware does not do that is \
         put there by hand: hold BOOT0 high, press reset"
    )]
    Link(#[from] LinkError),
}

/// Opens the only bootloader, or the one with the serial number. If there is none and none was named, restarts the firmware on USB
/// into its bootloader. If `device` is given and answers, always restarts that.
///
/// # Errors
/// [`EnterError`]; a board that heats refuses.
pub fn reach(serial: Option<&str>, device: Option<&DeviceSpec>) -> Result<Dfu<Usb>, EnterError> {
    let present = usb::bootloaders()?;
    match device {
        None if !present.is_empty() => Ok(usb::open(serial)?),
        // A serial number belongs to a bootloader: no board is restarted for it.
        None if serial.is_some() || ihd_link::usb::boards()?.is_empty() => Ok(usb::open(serial)?),
        None => enter(&DeviceSpec::Usb(None)),
        Some(device) => match enter(device) {
            // Nothing answers there: it may be in its bootloader already.
            Err(EnterError::Link(LinkError::Connect { .. })) if !present.is_empty() => {
                Ok(usb::open(serial)?)
            }
            entered => entered,
        },
    }
}

fn enter(device: &DeviceSpec) -> Result<Dfu<Usb>, EnterError> {
    if *device == DeviceSpec::Sim {
        return Err(not_found("a simulated hob has no bootloader".to_owned()));
    }
    let before: Vec<_> = usb::bootloaders()?
        .into_iter()
        .map(|one| one.serial)
        .collect();
    let transport = device.open(|| unreachable!("a simulated hob was refused"))?;
    send_into_bootloader(transport)?;
    let fresh = usb::wait_for_other_than(&before, LISTING_TIMEOUT)?;
    fresh.ok_or_else(|| not_found(not_seen(device)))
}

fn not_found(what: String) -> EnterError {
    ProgramError::NotFound { what }.into()
}

fn not_seen(device: &DeviceSpec) -> String {
    let seconds = LISTING_TIMEOUT.as_secs();
    let socket = match device {
        DeviceSpec::Usb(_) => {
            "Press reset, which starts the program again, and see whether another program takes USB devices away \
             (`ihd doctor`)"
        }
        _ => {
            "Its link is none over USB: is a cable at the chip's own USB pins (PA11, PA12)? The ST-LINK's socket of a \
             NUCLEO does not do; flash through it instead (`ihd flash` without --dfu). Reset starts the program again"
        }
    };
    format!(
        "{device} went for its bootloader, but no 0483:df11 was seen on USB within {seconds} s; nothing was written. {socket}"
    )
}

/// Requests the restart into the bootloader.
///
/// # Errors
/// [`LinkError::Refused`] while it heats, else any error of [`Client::request`].
pub fn send_into_bootloader(transport: Box<dyn Transport>) -> Result<(), LinkError> {
    let mut client = Client::connect(transport)?;
    client.restart(Program::Bootloader)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_to_do_depends_on_the_link() {
        let serial = not_seen(&DeviceSpec::Serial("/dev/ttyACM0".to_owned()));
        assert!(
            serial.contains("PA11") && serial.contains("without --dfu"),
            "{serial}"
        );
        let usb = not_seen(&DeviceSpec::Usb(None));
        assert!(usb.contains("Press reset"), "{usb}");
        for text in [serial, usb] {
            assert!(text.contains("nothing was written"), "{text}");
        }
    }

    #[test]
    fn a_simulated_hob_is_refused() {
        let error = enter(&DeviceSpec::Sim).err().unwrap().to_string();
        assert!(error.contains("no bootloader"), "{error}");
    }
}
