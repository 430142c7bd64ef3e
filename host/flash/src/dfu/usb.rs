//! Bootloaders on USB, through dfu-nusb.

use std::thread;
use std::time::{Duration, Instant};

use dfu_core::functional_descriptor::FunctionalDescriptor;
use dfu_core::memory_layout::MemoryLayout;
use dfu_core::{DfuIo, DfuProtocol};
use dfu_nusb::{DfuNusb, Error};
use ihd_signal::printable;
use nusb::transfer::TransferError;
use nusb::{ErrorKind, MaybeFuture};

use super::chip::Dfu;
use super::protocol::{BootloaderIo, TransferFailure};
use crate::programmer::{FlashStep, ProgramError};

/// Vendor id of STMicroelectronics.
pub const VENDOR_ID: u16 = 0x0483;
/// Product id of the USB bootloader of every STM32.
pub const PRODUCT_ID: u16 = 0xDF11;

/// Number of its only interface.
const INTERFACE: u8 = 0;
/// Time limit for reading a descriptor.
const TIMEOUT: Duration = Duration::from_secs(3);
/// Period of polling the connected devices.
const POLL_PERIOD: Duration = Duration::from_millis(100);
/// Time from a reset until the system has noticed it.
const RESET_NOTICE_TIME: Duration = Duration::from_millis(500);
/// English, for a device that names no language.
const ENGLISH: u16 = 0x0409;

/// Option that chooses one of several.
const OPTION: &str = "--dfu=SERIAL";

/// Connected bootloader.
#[derive(Clone, Debug)]
pub struct BootloaderDevice {
    /// Serial number, untrusted; twelve digits derived from the chip's unique number.
    pub serial: String,
    info: nusb::DeviceInfo,
}

/// Opened bootloader.
pub struct Usb {
    dfu: DfuNusb,
    interface: nusb::Interface,
    layouts: Vec<String>,
    serial: String,
}

/// Lists the connected bootloaders by serial number.
///
/// # Errors
/// [`ProgramError::NotFound`] if the system does not list its devices.
pub fn bootloaders() -> Result<Vec<BootloaderDevice>, ProgramError> {
    let devices = nusb::list_devices().wait();
    let devices = devices.map_err(|why| ProgramError::NotFound {
        what: format!("cannot look for USB devices: {why}; is USB available here?"),
    })?;
    let ours = devices.filter(|d| (d.vendor_id(), d.product_id()) == (VENDOR_ID, PRODUCT_ID));
    let mut all: Vec<_> = ours
        .map(|info| BootloaderDevice {
            serial: info.serial_number().unwrap_or_default().to_owned(),
            info,
        })
        .collect();
    all.sort_by(|a, b| a.serial.cmp(&b.serial));
    Ok(all)
}

/// Picks the only one, or the one with the serial number; `None` if there is none at all.
fn choose<T>(
    mut all: Vec<T>,
    selected: Option<&str>,
    serial: impl Fn(&T) -> &str,
) -> Result<Option<T>, ProgramError> {
    let list = |all: &[T]| -> Vec<String> {
        let name = |one| printable(serial(one)).to_string();
        all.iter().map(name).collect()
    };
    let there = list(&all);
    all.retain(|one| selected.is_none_or(|selected| selected.eq_ignore_ascii_case(serial(one))));
    match (all.len(), selected) {
        (0, Some(selected)) if !there.is_empty() => Err(ProgramError::NotFound {
            what: format!(
                "no bootloader has the serial number {}; plugged in: {}",
                printable(selected),
                there.join(", ")
            ),
        }),
        (0 | 1, _) => Ok(all.pop()),
        _ => Err(ProgramError::Several {
            choices: list(&all),
            option: OPTION,
        }),
    }
}

/// Opens the bootloader with this serial number, or the only one.
///
/// # Errors
/// [`ProgramError::NotFound`], [`ProgramError::Several`], [`ProgramError::Open`] with the rights or the driver that lack.
pub fn open(serial: Option<&str>) -> Result<Dfu<Usb>, ProgramError> {
    match choose(bootloaders()?, serial, |one| &one.serial)? {
        Some(one) => Ok(one.open()?.into_programmer()),
        None => Err(ProgramError::NotFound {
            what: "no chip in its USB bootloader (0483:df11) is plugged in. It needs a cable to the chip's own USB pins \
                   (PA11, PA12; the ST-LINK's socket of a NUCLEO does not do): hold BOOT0 high, press reset, and run \
                   this again"
                .to_owned(),
        }),
    }
}

/// Opens a bootloader as soon as there is a new one; `None` if the time is over.
///
/// # Errors
/// Any error of [`open`].
pub(super) fn wait_for_other_than(
    before: &[String],
    patience: Duration,
) -> Result<Option<Dfu<Usb>>, ProgramError> {
    let fresh = |one: &BootloaderDevice| !before.contains(&one.serial);
    Ok(wait(&fresh, patience)?.map(Usb::into_programmer))
}

fn wait(
    matches: &dyn Fn(&BootloaderDevice) -> bool,
    patience: Duration,
) -> Result<Option<Usb>, ProgramError> {
    let deadline = Instant::now() + patience;
    loop {
        let late = Instant::now() >= deadline;
        let first = bootloaders()?.into_iter().find(matches);
        match first.map(|one| one.open()).transpose() {
            Ok(Some(usb)) => return Ok(Some(usb)),
            Ok(None) if late => return Ok(None),
            // Just connected: udev may not have set its rights yet, or it is about to disconnect.
            Err(error) if late => return Err(error),
            Ok(None) | Err(_) => thread::sleep(POLL_PERIOD),
        }
    }
}

impl BootloaderDevice {
    fn open(&self) -> Result<Usb, ProgramError> {
        let refused = |kind: ErrorKind, why: &dyn std::fmt::Display| ProgramError::Open {
            what: format!("the USB bootloader {}", printable(&self.serial)),
            why: format!("{why}{}", remedy(kind)),
        };
        let opened = self.info.open().wait();
        let claimed = opened.and_then(|device| {
            let interface = device.claim_interface(INTERFACE).wait()?;
            Ok((device, interface))
        });
        let (device, interface) = claimed.map_err(|error| refused(error.kind(), &error))?;
        let layouts = layouts(&device, &interface);
        let dfu =
            dfu(device, interface.clone()).map_err(|error| match Usb::transfer_failure(error) {
                TransferFailure::Gone(why) => ProgramError::Lost {
                    doing: FlashStep::Attaching,
                    why,
                },
                TransferFailure::Stalled => refused(ErrorKind::Other, &"it refuses a request"),
                TransferFailure::Failed(why) => refused(ErrorKind::Other, &why),
            })?;
        Ok(Usb {
            dfu,
            interface,
            layouts,
            serial: self.serial.clone(),
        })
    }
}

/// Remedy for an error of opening.
fn remedy(kind: ErrorKind) -> &'static str {
    match kind {
        ErrorKind::PermissionDenied if cfg!(target_os = "linux") => {
            " (the udev rule of docs/70-ihd.rules gives it to you: `ihd doctor --fix`, then plug it in again)"
        }
        ErrorKind::Unsupported | ErrorKind::NotFound if cfg!(windows) => {
            " (Windows needs the driver WinUSB for \"DFU in FS Mode\": Zadig binds it, and STM32CubeProgrammer brings one)"
        }
        ErrorKind::Busy => " (another program has it)",
        _ => "",
    }
}

/// Strings of the alternate settings; empty if there are none.
fn layouts(device: &nusb::Device, interface: &nusb::Interface) -> Vec<String> {
    let languages = device.get_string_descriptor_supported_languages(TIMEOUT);
    let language = languages.wait().ok().and_then(|mut all| all.next());
    let language = language.unwrap_or(ENGLISH);
    let mut settings: Vec<_> = interface.descriptors().collect();
    settings.sort_by_key(|setting| setting.alternate_setting());
    let text = |index| {
        let text = device.get_string_descriptor(index, language, TIMEOUT);
        text.wait().unwrap_or_default()
    };
    let texts = settings.iter().map(|setting| setting.string_index());
    texts
        .map(|index| index.map(text).unwrap_or_default())
        .collect()
}

/// Opens the interface through dfu-nusb, which needs the background of an async runtime; on a thread of its own, since the caller
/// may be within a runtime.
fn dfu(device: nusb::Device, interface: nusb::Interface) -> Result<DfuNusb, Error> {
    let open = || {
        let runtime = tokio::runtime::Builder::new_current_thread().build()?;
        runtime.block_on(DfuNusb::open(device, interface, 0))
    };
    let opened = thread::spawn(open).join();
    opened.unwrap_or_else(|_| Err(std::io::Error::other("dfu-nusb panicked").into()))
}

impl Usb {
    fn into_programmer(self) -> Dfu<Self> {
        let serial = self.serial.clone();
        let reopen = move |patience| {
            // The system still lists the disconnected device for a moment.
            thread::sleep(RESET_NOTICE_TIME);
            wait(&|one| one.serial == serial, patience)
        };
        Dfu::new(self, Box::new(reopen))
    }
}

impl DfuIo for Usb {
    type Read = usize;
    type Write = usize;
    type Reset = ();
    type Error = Error;
    type MemoryLayout = MemoryLayout;

    fn read_control(
        &self,
        request_type: u8,
        request: u8,
        value: u16,
        buffer: &mut [u8],
    ) -> Result<usize, Error> {
        DfuIo::read_control(&self.dfu, request_type, request, value, buffer)
    }

    fn write_control(
        &self,
        request_type: u8,
        request: u8,
        value: u16,
        buffer: &[u8],
    ) -> Result<usize, Error> {
        DfuIo::write_control(&self.dfu, request_type, request, value, buffer)
    }

    fn usb_reset(self) -> Result<(), Error> {
        drop(self.interface);
        DfuIo::usb_reset(self.dfu)
    }

    fn protocol(&self) -> &DfuProtocol<MemoryLayout> {
        DfuIo::protocol(&self.dfu)
    }

    fn functional_descriptor(&self) -> &FunctionalDescriptor {
        DfuIo::functional_descriptor(&self.dfu)
    }
}

impl BootloaderIo for Usb {
    fn select(&self, alternate: u8) -> Result<(), Error> {
        Ok(self.interface.set_alt_setting(alternate).wait()?)
    }

    fn layouts(&self) -> &[String] {
        &self.layouts
    }

    fn serial(&self) -> &str {
        &self.serial
    }

    fn transfer_failure(error: Error) -> TransferFailure {
        let why = error.to_string();
        match error {
            Error::Transfer(TransferError::Stall) => TransferFailure::Stalled,
            Error::Transfer(TransferError::Disconnected) => TransferFailure::Gone(why),
            Error::Nusb(error) if error.kind() == ErrorKind::Disconnected => {
                TransferFailure::Gone(why)
            }
            Error::DeviceNotFound => TransferFailure::Gone(why),
            Error::Transfer(TransferError::Cancelled) => {
                TransferFailure::Failed("no answer within 3 s".to_owned())
            }
            _ => TransferFailure::Failed(why),
        }
    }

    fn wait(&self, time: Duration) {
        thread::sleep(time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(
        present: &[&'static str],
        selected: Option<&str>,
    ) -> Result<Option<&'static str>, String> {
        choose(present.to_vec(), selected, |serial| serial).map_err(|error| error.to_string())
    }

    #[test]
    fn the_only_one_needs_no_serial_number() {
        assert_eq!(chosen(&[], None), Ok(None));
        assert_eq!(chosen(&[], Some("A1")), Ok(None));
        assert_eq!(chosen(&["A1"], None), Ok(Some("A1")));
        assert_eq!(chosen(&["A1", "B2"], Some("b2")), Ok(Some("B2")));
    }

    #[test]
    fn where_it_is_not_clear_which_all_are_listed() {
        let many = chosen(&["A1", "B2"], None).unwrap_err();
        assert!(many.contains("A1, B2") && many.contains(OPTION), "{many}");
        let other = chosen(&["A\u{1b}1"], Some("C3")).unwrap_err();
        assert!(other.contains("C3"), "{other}");
        assert!(!other.contains('\u{1b}'), "{other}");
    }
}
