//! Checks of the connected devices.

use super::{Port, UsbDevice, UsbKind, kind};
use crate::Check;

/// Describes a device; [`Check`] escapes the text.
pub(super) fn named(device: &UsbDevice) -> String {
    let kind = kind(device).map_or("device", UsbKind::as_str);
    let ids = format!("{:04x}:{:04x}", device.vendor, device.product);
    match device.serial.as_str() {
        "" => format!("{kind} {ids}"),
        serial => format!("{kind} {ids} ({serial})"),
    }
}

fn list<'a>(devices: impl Iterator<Item = &'a UsbDevice>) -> Vec<String> {
    devices.map(named).collect()
}

/// Checks for a board, a debug probe, a bootloader and serial ports.
pub(super) fn checks(
    usb: &Result<Vec<UsbDevice>, String>,
    ports: &Result<Vec<Port>, String>,
) -> Vec<Check> {
    let mut checks = match usb {
        Err(why) => {
            let why = format!("USB cannot be looked at: {why}");
            let names = ["board_on_usb", "debug_probe", "bootloader"];
            names.map(|name| Check::not_tested(name, &why)).into()
        }
        Ok(usb) => vec![board(usb), probe(usb), bootloader(usb)],
    };
    checks.push(serial_ports(ports));
    checks
}

fn board(usb: &[UsbDevice]) -> Check {
    let boards: Vec<_> = usb
        .iter()
        .filter(|d| kind(d) == Some(UsbKind::Board))
        .collect();
    match boards.as_slice() {
        [] => Check::not_tested(
            "board_on_usb",
            "no ihd controller on a USB socket of its own",
        )
        .with_remedy("A NUCLEO has none: it is reached by its ST-LINK's serial port, serial:PATH"),
        [one] => Check::pass("board_on_usb", named(one)),
        all => Check::pass("board_on_usb", list(all.iter().copied()).join(", "))
            .with_remedy("Name one of them: ihd doctor usb:SERIAL"),
    }
}

fn probe(usb: &[UsbDevice]) -> Check {
    let is_probe = |d: &&UsbDevice| kind(d).is_some_and(UsbKind::is_probe);
    let probes = list(usb.iter().filter(is_probe));
    match probes.is_empty() {
        true => Check::not_tested("debug_probe", "no ST-LINK, CMSIS-DAP or J-Link").with_remedy(
            "Flash over the chip's bootloader: ihd flash --dfu. Or plug the NUCLEO's own USB socket in; a cable that \
             only charges shows nothing here",
        ),
        false => Check::pass("debug_probe", probes.join(", ")),
    }
}

fn bootloader(usb: &[UsbDevice]) -> Check {
    let found = list(usb.iter().filter(|d| kind(d) == Some(UsbKind::Bootloader)));
    match found.is_empty() {
        true => Check::pass("bootloader", "no chip is in its bootloader"),
        false => Check::fail(
            "bootloader",
            format!("{}: no firmware runs there", found.join(", ")),
            "ihd flash --dfu puts the firmware on it; to leave without, take BOOT0 low and press reset",
        ),
    }
}

fn serial_ports(ports: &Result<Vec<Port>, String>) -> Check {
    let ports = match ports {
        Ok(ports) => ports,
        Err(why) => {
            let why = format!("serial ports cannot be listed: {why}");
            return Check::not_tested("serial_ports", why);
        }
    };
    let named = |p: &Port| match p.usb.as_ref() {
        Some(usb) => match kind(usb) {
            Some(kind) => format!("{} of the {}", p.path, kind.as_str()),
            None => format!("{} of {:04x}:{:04x}", p.path, usb.vendor, usb.product),
        },
        None => p.path.clone(),
    };
    let of_stlink = |p: &Port| p.usb.as_ref().and_then(kind) == Some(UsbKind::StLink);
    let texts: Vec<_> = ports.iter().map(named).collect();
    match (ports.is_empty(), ports.iter().any(of_stlink)) {
        (true, _) => Check::not_tested("serial_ports", "there is none"),
        (false, true) => Check::pass("serial_ports", texts.join(", ")),
        (false, false) => Check::not_tested(
            "serial_ports",
            format!("{}; none is an ST-LINK's", texts.join(", ")),
        ),
    }
}
