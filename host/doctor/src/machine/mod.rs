//! What is plugged into this machine, and whether this person may use it.
//!
//! [`System`] is what is asked of a machine, [`Here`] this one, and [`checks`] what is made of the answers.

mod access;
mod here;
mod ids;
mod presence;
mod udev;

pub use here::Here;
pub use ids::{Kind, kind};
pub use udev::{FixError, RULE, RULE_NAME, install};

use std::io;
use std::path::PathBuf;

use crate::Check;

/// An operating system, as far as it matters here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Os {
    /// Device nodes, groups, udev.
    Linux,
    /// No set-up needed.
    Mac,
    /// A driver a device.
    Windows,
    /// Something else.
    Other,
}

/// A device on USB. Strings come from the device: escape them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct UsbDevice {
    /// Vendor id.
    pub vendor: u16,
    /// Product id.
    pub product: u16,
    /// What it calls itself; empty where it does not.
    pub name: String,
    /// Its serial number; empty where it has none.
    pub serial: String,
    /// Driver in use, where the system tells (Windows).
    pub driver: Option<String>,
    /// Its device node, where there are such.
    pub node: Option<PathBuf>,
}

/// A serial port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// As `serial:PATH` takes it.
    pub path: String,
    /// The USB device that it belongs to.
    pub usb: Option<UsbDevice>,
    /// The group that owns it, where there are such.
    pub group: Option<String>,
}

/// What is asked of a machine.
pub trait System {
    /// Which it is.
    fn os(&self) -> Os;

    /// The devices on USB.
    ///
    /// # Errors
    /// Where the system has none, or does not let us look.
    fn usb(&self) -> io::Result<Vec<UsbDevice>>;

    /// The serial ports that are on USB, or may be.
    ///
    /// # Errors
    /// As [`System::usb`].
    fn ports(&self) -> io::Result<Vec<Port>>;

    /// Opens a device on USB, and lets it go.
    ///
    /// # Errors
    /// Why it cannot be opened.
    fn open_usb(&self, device: &UsbDevice) -> io::Result<()>;

    /// Opens a serial port, and lets it go.
    ///
    /// # Errors
    /// Why it cannot be opened; `ResourceBusy` where another program has it.
    fn open_port(&self, port: &Port) -> io::Result<()>;

    /// Whether udev runs.
    fn has_udev(&self) -> bool;

    /// Rules of udev whose file name ends as ours: file name and content, in the order udev reads them.
    ///
    /// # Errors
    /// Where a file is there and cannot be read.
    fn rules(&self) -> io::Result<Vec<(String, String)>>;

    /// Whether a program of this name runs.
    fn runs(&self, program: &str) -> bool;

    /// Command line that repeats this one with more rights, to be shown to a person.
    fn as_root(&self) -> String;
}

/// Everything about the machine.
pub fn checks(system: &dyn System) -> Vec<Check> {
    let usb = system.usb().map_err(|e| e.to_string());
    let ports = system.ports().map_err(|e| e.to_string());
    let mut checks = presence::checks(&usb, &ports);
    checks.extend(access::checks(system, &usb, &ports));
    checks.push(udev::check(system));
    checks
}

/// Where the one board that is plugged in is reached: `usb:SERIAL` or `serial:PATH`; all of them where there are more.
/// A board on its own USB socket counts before an ST-LINK's serial port, which may be the same board's.
pub fn boards(system: &dyn System) -> Vec<String> {
    let usb = system.usb().unwrap_or_default();
    let boards = usb.iter().filter(|d| kind(d) == Some(Kind::Board));
    let address = |d: &UsbDevice| match d.serial.as_str() {
        "" => "usb".to_owned(),
        serial => format!("usb:{serial}"),
    };
    let mut found: Vec<String> = boards.map(address).collect();
    if found.is_empty() {
        let ports = system.ports().unwrap_or_default();
        let of_stlink = |p: &&Port| p.usb.as_ref().and_then(kind) == Some(Kind::StLink);
        let ports = ports.iter().filter(of_stlink);
        found.extend(ports.map(|p| format!("serial:{}", p.path)));
    }
    found
}

#[cfg(test)]
mod fake;
#[cfg(test)]
mod tests;
