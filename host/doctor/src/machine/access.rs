//! Checks that the user may access the connected devices.

use std::io::{self, ErrorKind};

use super::presence::named;
use super::{Os, Port, System, UsbDevice, UsbKind, kind};
use crate::Check;

/// Checks device nodes, serial ports, ModemManager and the driver of Windows.
pub(super) fn checks(
    system: &dyn System,
    usb: &Result<Vec<UsbDevice>, String>,
    ports: &Result<Vec<Port>, String>,
) -> Vec<Check> {
    let none = Vec::new();
    let usb: Vec<_> = usb.as_ref().unwrap_or(&none).iter().collect();
    let usb: Vec<_> = usb.into_iter().filter(|d| kind(d).is_some()).collect();
    let no_ports = Vec::new();
    let ports: Vec<_> = ports
        .as_ref()
        .unwrap_or(&no_ports)
        .iter()
        .filter(|p| p.usb.as_ref().and_then(kind).is_some())
        .collect();
    let mut checks = vec![usb_access(system, &usb), serial_access(system, &ports)];
    if system.os() == Os::Linux {
        checks.push(modem_manager(system, &ports));
    }
    if system.os() == Os::Windows {
        checks.push(driver(&usb));
    }
    checks
}

fn usb_access(system: &dyn System, usb: &[&UsbDevice]) -> Check {
    const NAME: &str = "usb_access";
    if usb.is_empty() {
        return Check::not_tested(NAME, "nothing to open is plugged in");
    }
    let tried = usb.iter().map(|d| (*d, system.open_usb(d)));
    let refused: Vec<(&UsbDevice, io::Error)> = tried
        .filter_map(|(d, opened)| Some((d, opened.err()?)))
        .collect();
    let Some((_, first)) = refused.first() else {
        let all: Vec<_> = usb.iter().map(|d| named(d)).collect();
        return Check::pass(NAME, format!("may be opened: {}", all.join(", ")));
    };
    let texts: Vec<_> = refused
        .iter()
        .map(|(d, why)| {
            let node = d.node.as_ref().map(|n| format!(", {}", n.display()));
            format!("{}{}: {why}", named(d), node.unwrap_or_default())
        })
        .collect();
    let remedy = match (first.kind(), system.os()) {
        (ErrorKind::PermissionDenied, Os::Linux) => format!(
            "{}, then unplug and plug in again. Over ssh nobody sits at the machine and the rule gives nothing: run as \
             root there, or add MODE=\"0660\", GROUP=\"dialout\" to it",
            system.as_root()
        ),
        (_, Os::Windows) => "Bind WinUSB to it with Zadig; a probe needs its maker's driver".into(),
        (ErrorKind::ResourceBusy, _) => {
            "Another program has it: end it (a daemon, a debugger, ihd log)".into()
        }
        _ => "Unplug and plug in again; another cable or socket".into(),
    };
    Check::fail(NAME, texts.join("; "), remedy)
}

fn serial_access(system: &dyn System, ports: &[&Port]) -> Check {
    const NAME: &str = "serial_access";
    if ports.is_empty() {
        return Check::not_tested(NAME, "no serial port of a probe or a board");
    }
    let tried = ports.iter().map(|p| (*p, system.open_port(p)));
    let refused: Vec<_> = tried
        .filter_map(|(p, opened)| Some((p, opened.err()?)))
        .collect();
    let Some((port, why)) = refused.first() else {
        let all: Vec<_> = ports.iter().map(|p| p.path.as_str()).collect();
        return Check::pass(NAME, format!("may be opened: {}", all.join(", ")));
    };
    let remedy = match why.kind() {
        ErrorKind::PermissionDenied => match &port.group {
            Some(group) => format!(
                "sudo usermod -aG {group} $USER, then log out and in; or {}",
                system.as_root()
            ),
            None => system.as_root(),
        },
        ErrorKind::ResourceBusy => {
            "Another program has it: the daemon, a terminal program, ihd record. End it, or ask it"
                .into()
        }
        _ => "Unplug and plug in again".into(),
    };
    Check::fail(NAME, format!("{}: {why}", port.path), remedy)
}

fn modem_manager(system: &dyn System, ports: &[&Port]) -> Check {
    const NAME: &str = "modem_manager";
    if !system.runs("ModemManager") {
        return Check::pass(NAME, "ModemManager does not run");
    }
    let acm = |p: &&&Port| p.path.contains("ttyACM");
    let Some(port) = ports.iter().find(acm) else {
        return Check::pass(
            NAME,
            "ModemManager runs, and there is no port that it would take",
        );
    };
    // The rule makes ModemManager ignore the board; the contents of foreign rules are unknown.
    match super::udev::is_current(system) {
        true => Check::pass(
            NAME,
            "ModemManager runs, and the udev rule keeps it off the ST-LINK's port",
        ),
        false => Check::fail(
            NAME,
            format!(
                "ModemManager runs, and may open {} for half a minute after it is plugged in",
                port.path
            ),
            format!("{}: the rule keeps it off", system.as_root()),
        ),
    }
}

fn driver(usb: &[&UsbDevice]) -> Check {
    const NAME: &str = "usb_driver";
    let own = |d: &&&UsbDevice| matches!(kind(d), Some(UsbKind::Board | UsbKind::Bootloader));
    let Some(device) = usb.iter().find(own) else {
        return Check::not_tested(NAME, "no board and no bootloader on USB");
    };
    match device.driver.as_deref() {
        Some(driver) if driver.eq_ignore_ascii_case("winusb") => {
            Check::pass(NAME, format!("{}: WinUSB", named(device)))
        }
        driver => Check::fail(
            NAME,
            format!("{}: driver {}", named(device), driver.unwrap_or("none")),
            "A board asks for WinUSB by itself: unplug it and plug it in again. The bootloader does not: bind WinUSB to \
             it with Zadig",
        ),
    }
}
