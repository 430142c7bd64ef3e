//! Classification of a USB device by its ids and name.

use ihd_flash::dfu::{PRODUCT_ID as BOOTLOADER, VENDOR_ID as ST};
use ihd_shared::usb::{PRODUCT, PRODUCT_ID, VENDOR_ID};

use super::UsbDevice;

/// Kind of a USB device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UsbKind {
    /// An ihd controller on its own USB socket.
    Board,
    /// The bootloader in the chip's ROM, of this or any other STM32.
    Bootloader,
    /// ST's debug probe, as on a NUCLEO.
    StLink,
    /// A debug probe that speaks CMSIS-DAP.
    CmsisDap,
    /// SEGGER's debug probe.
    JLink,
}

impl UsbKind {
    /// Name of the kind.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Board => "ihd controller",
            Self::Bootloader => "STM32 bootloader",
            Self::StLink => "ST-LINK",
            Self::CmsisDap => "CMSIS-DAP probe",
            Self::JLink => "J-Link",
        }
    }

    /// Returns `true` for a debug probe.
    pub fn is_probe(self) -> bool {
        matches!(self, Self::StLink | Self::CmsisDap | Self::JLink)
    }
}

/// Vendor id of SEGGER.
const SEGGER: u16 = 0x1366;

/// Classifies a device; `None` for one of no interest.
pub fn kind(device: &UsbDevice) -> Option<UsbKind> {
    match (device.vendor, device.product) {
        // The id of pid.codes for prototypes is shared: the name decides if there is one.
        (VENDOR_ID, PRODUCT_ID) => {
            let ours = device.name.is_empty() || device.name.starts_with(PRODUCT);
            ours.then_some(UsbKind::Board)
        }
        (ST, BOOTLOADER) => Some(UsbKind::Bootloader),
        (ST, 0x3742..=0x375F) => Some(UsbKind::StLink),
        (SEGGER, 0x0101..=0x01FF | 0x1001..=0x10FF) => Some(UsbKind::JLink),
        _ if device.name.contains("CMSIS-DAP") => Some(UsbKind::CmsisDap),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device(vendor: u16, product: u16, name: &str) -> UsbDevice {
        UsbDevice {
            vendor,
            product,
            name: name.into(),
            ..UsbDevice::default()
        }
    }

    #[test]
    fn probes_boards_and_bootloaders_are_known() {
        for (vendor, product, name, expected) in [
            (
                0x1209,
                1,
                "ihd induction-hob controller",
                Some(UsbKind::Board),
            ),
            (0x1209, 1, "", Some(UsbKind::Board)),
            (0x1209, 1, "somebody else's prototype", None),
            (
                0x0483,
                0xDF11,
                "STM32  BOOTLOADER",
                Some(UsbKind::Bootloader),
            ),
            (0x0483, 0x3748, "STM32 STLink", Some(UsbKind::StLink)),
            (0x0483, 0x374B, "STM32 STLink", Some(UsbKind::StLink)),
            (0x0483, 0x374E, "STLINK-V3", Some(UsbKind::StLink)),
            (0x0483, 0x3752, "", Some(UsbKind::StLink)),
            (0x0483, 0x3754, "", Some(UsbKind::StLink)),
            (0x0483, 0x5740, "STM32 Virtual ComPort", None),
            (0x1366, 0x0105, "J-Link", Some(UsbKind::JLink)),
            (
                0x2E8A,
                0x000C,
                "Debug Probe (CMSIS-DAP)",
                Some(UsbKind::CmsisDap),
            ),
            (0x046D, 0xC52B, "USB Receiver", None),
        ] {
            assert_eq!(
                kind(&device(vendor, product, name)),
                expected,
                "{vendor:04x}:{product:04x}"
            );
        }
    }
}
