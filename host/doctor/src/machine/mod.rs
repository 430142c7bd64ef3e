//! Devices connected to this machine, and the user's access to them.
//!
//! [`System`] is the interface to a machine, [`LocalSystem`] this one, and [`checks`] derives the checks.

mod access;
mod ids;
mod local_system;
mod presence;
mod udev;

pub use ids::{UsbKind, kind};
pub use local_system::LocalSystem;
pub use udev::{FixError, RULE, RULE_NAME, install};

use std::io;
use std::path::PathBuf;

use crate::Check;

/// Operating system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Os {
    /// With device nodes, groups and udev.
    Linux,
    /// Needs no set-up.
    Mac,
    /// Needs a driver for each device.
    Windows,
    /// Any other.
    Other,
}

/// Device on USB. Its strings are not trusted: escape them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct UsbDevice {
    /// Vendor id.
    pub vendor: u16,
    /// Product id.
    pub product: u16,
    /// Product name; empty if it has none.
    pub name: String,
    /// Serial number; empty if it has none.
    pub serial: String,
    /// Driver in use; `None` if the system does not report it (all but Windows).
    pub driver: Option<String>,
    /// Device node; `None` if the system has none.
    pub node: Option<PathBuf>,
}

/// Serial port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// Path as in `serial:PATH`.
    pub path: String,
    /// USB device that it belongs to; `None` if unknown.
    pub usb: Option<UsbDevice>,
    /// Group that owns it; `None` if the system has none.
    pub group: Option<String>,
}

/// Interface to a machine.
pub trait System {
    /// Returns the operating system.
    fn os(&self) -> Os;

    /// Lists the devices on USB.
    ///
    /// # Errors
    /// The system has no USB or denies access.
    fn usb(&self) -> io::Result<Vec<UsbDevice>>;

    /// Lists the serial ports that are or may be on USB.
    ///
    /// # Errors
    /// Any error of [`System::usb`].
    fn ports(&self) -> io::Result<Vec<Port>>;

    /// Opens a device on USB and closes it.
    ///
    /// # Errors
    /// The reason why it cannot be opened.
    fn open_usb(&self, device: &UsbDevice) -> io::Result<()>;

    /// Opens a serial port and closes it.
    ///
    /// # Errors
    /// The reason why it cannot be opened; `ResourceBusy` if another program has it.
    fn open_port(&self, port: &Port) -> io::Result<()>;

    /// Returns `true` if udev runs.
    fn has_udev(&self) -> bool;

    /// Returns file name and content of the udev rules whose file name ends like ours, in the order udev reads them.
    ///
    /// # Errors
    /// A file cannot be read.
    fn rules(&self) -> io::Result<Vec<(String, String)>>;

    /// Returns `true` if a program of this name runs.
    fn runs(&self, program: &str) -> bool;

    /// Command line that repeats this one with more rights, for display.
    fn as_root(&self) -> String;
}

/// Makes all checks of the machine.
pub fn checks(system: &dyn System) -> Vec<Check> {
    let usb = system.usb().map_err(|e| e.to_string());
    let ports = system.ports().map_err(|e| e.to_string());
    let mut checks = presence::checks(&usb, &ports);
    checks.extend(access::checks(system, &usb, &ports));
    checks.push(udev::check(system));
    checks
}

/// Addresses of the connected boards, `usb:SERIAL` or `serial:PATH`. Boards on their own USB socket exclude serial ports of
/// ST-LINKs, which may belong to the same boards.
pub fn boards(system: &dyn System) -> Vec<String> {
    let usb = system.usb().unwrap_or_default();
    let boards = usb.iter().filter(|d| kind(d) == Some(UsbKind::Board));
    let address = |d: &UsbDevice| match d.serial.as_str() {
        "" => "usb".to_owned(),
        serial => format!("usb:{serial}"),
    };
    let mut found: Vec<String> = boards.map(address).collect();
    if found.is_empty() {
        let ports = system.ports().unwrap_or_default();
        let of_stlink = |p: &&Port| p.usb.as_ref().and_then(kind) == Some(UsbKind::StLink);
        let ports = ports.iter().filter(of_stlink);
        found.extend(ports.map(|p| format!("serial:{}", p.path)));
    }
    found
}

#[cfg(test)]
mod fake;
#[cfg(test)]
mod tests;
