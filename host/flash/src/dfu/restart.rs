//! From the running firmware into the bootloader: asked over the link, and then waited for on USB.

use std::time::Duration;

use ihd_link::{Client, DeviceSpec, LinkError, Transport};
use ihd_shared::wire::messages::Program;

use super::chip::Dfu;
use super::usb::{self, Usb};
use crate::programmer::ProgramError;

/// From the answer until the bootloader is known to the system: it measures the clock by its first frames.
const PATIENCE: Duration = Duration::from_secs(10);

/// Why a chip is not in its bootloader.
#[derive(Debug, thiserror::Error)]
pub enum EnterError {
    /// USB, or what is there.
    #[error(transparent)]
    Program(#[from] ProgramError),
    /// The firmware does not do it.
    #[error(
        "the board was not sent into its bootloader: {0}; nothing was written. A board whose firmware does not do that is \
         put there by hand: hold BOOT0 high, press reset"
    )]
    Link(#[from] LinkError),
}

/// The bootloader that is meant: the one that is plugged in, or that with the serial number. Where there is none and none
/// was named, the firmware on USB is sent there. Where `device` is named and answers, always that is.
///
/// # Errors
/// [`EnterError`]; a board that heats refuses.
pub fn reach(serial: Option<&str>, device: Option<&DeviceSpec>) -> Result<Dfu<Usb>, EnterError> {
    let present = usb::found()?;
    match device {
        None if !present.is_empty() => Ok(usb::open(serial)?),
        // What there is not is told with what to do. A serial number is a bootloader's: no board is sent away for it.
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
    let before: Vec<_> = usb::found()?.into_iter().map(|one| one.serial).collect();
    let transport = device.open(|| unreachable!("a simulated hob was refused"))?;
    send_into_bootloader(transport)?;
    let fresh = usb::wait_for_other_than(&before, PATIENCE)?;
    fresh.ok_or_else(|| not_found(not_seen(device)))
}

fn not_found(what: String) -> EnterError {
    ProgramError::NotFound { what }.into()
}

fn not_seen(device: &DeviceSpec) -> String {
    let seconds = PATIENCE.as_secs();
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

/// Asks the firmware to make place for the bootloader.
///
/// # Errors
/// [`LinkError::Refused`] while it heats, and as every command.
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
