//! Fake machine for tests.

use std::io::{self, ErrorKind};

use super::{Os, Port, System, UsbDevice};

/// Machine with the given devices and files.
pub(crate) struct FakeSystem {
    pub(crate) os: Os,
    pub(crate) usb: Vec<UsbDevice>,
    pub(crate) usb_hidden: bool,
    pub(crate) ports: Vec<Port>,
    pub(crate) usb_refuses: Option<ErrorKind>,
    pub(crate) port_refuses: Option<ErrorKind>,
    pub(crate) udev: bool,
    pub(crate) rules: Vec<(String, String)>,
    pub(crate) modem_manager: bool,
}

impl Default for FakeSystem {
    fn default() -> Self {
        Self {
            os: Os::Linux,
            usb: Vec::new(),
            usb_hidden: false,
            ports: Vec::new(),
            usb_refuses: None,
            port_refuses: None,
            udev: true,
            rules: Vec::new(),
            modem_manager: false,
        }
    }
}

/// Creates a device with ids and a serial number.
pub(crate) fn device(vendor: u16, product: u16, name: &str, serial: &str) -> UsbDevice {
    UsbDevice {
        vendor,
        product,
        name: name.into(),
        serial: serial.into(),
        ..UsbDevice::default()
    }
}

/// Creates a NUCLEO's ST-LINK.
pub(crate) fn stlink() -> UsbDevice {
    device(0x0483, 0x374E, "STLINK-V3", "0045")
}

/// Creates a serial port of a device.
pub(crate) fn port(path: &str, usb: UsbDevice) -> Port {
    Port {
        path: path.into(),
        usb: Some(usb),
        group: Some("dialout".into()),
    }
}

impl System for FakeSystem {
    fn os(&self) -> Os {
        self.os
    }

    fn usb(&self) -> io::Result<Vec<UsbDevice>> {
        match self.usb_hidden {
            true => Err(io::Error::new(ErrorKind::NotFound, "no /sys/bus/usb")),
            false => Ok(self.usb.clone()),
        }
    }

    fn ports(&self) -> io::Result<Vec<Port>> {
        Ok(self.ports.clone())
    }

    fn open_usb(&self, _: &UsbDevice) -> io::Result<()> {
        self.usb_refuses.map_or(Ok(()), |kind| Err(kind.into()))
    }

    fn open_port(&self, _: &Port) -> io::Result<()> {
        self.port_refuses.map_or(Ok(()), |kind| Err(kind.into()))
    }

    fn has_udev(&self) -> bool {
        self.udev
    }

    fn rules(&self) -> io::Result<Vec<(String, String)>> {
        Ok(self.rules.clone())
    }

    fn runs(&self, program: &str) -> bool {
        self.modem_manager && program == "ModemManager"
    }

    fn as_root(&self) -> String {
        "sudo ihd doctor --fix".into()
    }
}
