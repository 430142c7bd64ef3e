//! A board on USB: the vendor interface with a bulk endpoint each way.

use std::io::{self, ErrorKind, Read, Write};
use std::time::Duration;

use ihd_shared::usb::{PRODUCT, PRODUCT_ID, TRANSFER, VENDOR_ID};
use ihd_signal::printable;
use nusb::MaybeFuture;
use nusb::descriptors::TransferType;
use nusb::io::{EndpointRead, EndpointWrite};
use nusb::transfer::{Bulk, Direction, In, Out};

use super::transport::SEND_TIMEOUT;
use super::{LinkError, Transport};

/// Number of transfers in flight, each with room for a frame.
const IN_FLIGHT: usize = 16;

/// A claimed interface.
pub struct UsbTransport {
    reader: EndpointRead<Bulk>,
    writer: EndpointWrite<Bulk>,
    device: String,
}

fn failed(hint: &str, source: io::Error) -> LinkError {
    LinkError::Connect {
        device: "usb".to_owned(),
        hint: hint.to_owned(),
        source,
    }
}

/// Lists the connected controllers.
fn controllers() -> Result<Vec<nusb::DeviceInfo>, LinkError> {
    let devices = nusb::list_devices().wait();
    let devices = devices.map_err(|e| failed("; is USB available here?", e.into()))?;
    let ours = |d: &nusb::DeviceInfo| {
        (d.vendor_id(), d.product_id()) == (VENDOR_ID, PRODUCT_ID)
            && d.product_string().is_none_or(|p| p.starts_with(PRODUCT))
    };
    Ok(devices.filter(ours).collect())
}

/// A connected controller.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct UsbBoard {
    /// Its serial number, which `usb:SERIAL` takes; empty where it has none.
    pub serial: String,
    /// Product string of the device.
    pub product: String,
}

/// Lists the connected controllers by serial number. Their strings are [`printable()`].
///
/// # Errors
/// [`LinkError::Connect`] if the system has no USB or denies access.
pub fn boards() -> Result<Vec<UsbBoard>, LinkError> {
    let board = |device: &nusb::DeviceInfo| UsbBoard {
        serial: printable(device.serial_number().unwrap_or_default()).to_string(),
        product: printable(device.product_string().unwrap_or_default()).to_string(),
    };
    let mut boards: Vec<UsbBoard> = controllers()?.iter().map(board).collect();
    boards.sort();
    Ok(boards)
}

/// Picks the device with the requested serial number, or the only device.
fn choose<T>(
    mut devices: Vec<T>,
    requested: Option<&str>,
    serial: impl Fn(&T) -> &str,
) -> Result<T, LinkError> {
    let list: Vec<_> = devices
        .iter()
        .map(|d| format!("usb:{}", serial(d)))
        .collect();
    let list = list.join(", ");
    devices.retain(|device| {
        requested.is_none_or(|requested| requested.eq_ignore_ascii_case(serial(device)))
    });
    let Some(device) = devices.pop() else {
        if list.is_empty() {
            let none = io::Error::new(ErrorKind::NotFound, "no ihd controller is plugged in");
            let hint = "; a NUCLEO without a USB socket of its own is reached by serial:PATH";
            return Err(failed(hint, none));
        }
        let none = io::Error::new(ErrorKind::NotFound, "none has this serial number");
        return Err(failed(&format!("; plugged in: {list}"), none));
    };
    if !devices.is_empty() {
        let many = io::Error::other("more than one ihd controller is plugged in");
        return Err(failed(&format!("; name one of them: {list}"), many));
    }
    Ok(device)
}

impl UsbTransport {
    /// Opens the controller with this serial number, or the only one that is plugged in.
    ///
    /// # Errors
    /// [`LinkError::Connect`] if no device fits, if several do, or if it cannot be opened.
    pub fn open(serial: Option<&str>) -> Result<Self, LinkError> {
        let known = |device: &nusb::DeviceInfo| device.serial_number().unwrap_or("?").to_owned();
        let devices = controllers()?
            .into_iter()
            .map(|device| (known(&device), device))
            .collect();
        let (serial, info) = choose(devices, serial, |(serial, _)| serial)?;
        let device = format!("usb ({serial})");
        let hint = "; on Linux, does the udev rule of docs/70-ihd.rules apply?";
        let opened = info.open().wait();
        let opened = opened.and_then(|device| device.claim_interface(0).wait());
        let interface = opened.map_err(|e| failed(hint, e.into()))?;
        let address = |direction| {
            let descriptor = interface.descriptor()?;
            let mut endpoints = descriptor.endpoints();
            let endpoint = endpoints
                .find(|e| e.transfer_type() == TransferType::Bulk && e.direction() == direction);
            endpoint.map(|e| e.address())
        };
        let (Some(receives), Some(sends)) = (address(Direction::In), address(Direction::Out))
        else {
            let strange = io::Error::other("its interface has no bulk endpoints");
            return Err(failed("", strange));
        };
        let reader = interface.endpoint::<Bulk, In>(receives);
        let writer = interface.endpoint::<Bulk, Out>(sends);
        let (reader, writer) = reader
            .and_then(|reader| Ok((reader, writer?)))
            .map_err(|e| failed("", e.into()))?;
        Ok(Self {
            reader: reader.reader(TRANSFER).with_num_transfers(IN_FLIGHT),
            // Per transfer, thus per frame.
            writer: writer.writer(TRANSFER).with_write_timeout(SEND_TIMEOUT),
            device,
        })
    }

    fn failed(&self, doing: &'static str, source: io::Error) -> LinkError {
        let device = self.device.clone();
        match source.kind() {
            // Kinds reported by nusb for an unplugged device, and by operating systems.
            ErrorKind::ConnectionAborted | ErrorKind::NotConnected | ErrorKind::BrokenPipe => {
                LinkError::Closed { device }
            }
            _ => LinkError::Io {
                device,
                doing,
                source,
            },
        }
    }
}

impl Transport for UsbTransport {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.writer
            .write_all(bytes)
            .and_then(|()| self.writer.flush())
            .map_err(|e| self.failed("send", e))
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        self.reader.set_read_timeout(timeout);
        match self.reader.read(buf) {
            Ok(n) => Ok(n),
            Err(e) if matches!(e.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => Ok(0),
            Err(e) => Err(self.failed("receive", e)),
        }
    }

    fn describe(&self) -> String {
        self.device.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(devices: &[&'static str], wanted: Option<&str>) -> Result<&'static str, String> {
        choose(devices.to_vec(), wanted, |serial| serial).map_err(|error| error.to_string())
    }

    #[test]
    fn the_only_controller_needs_no_serial_number() {
        assert_eq!(chosen(&["A1"], None), Ok("A1"));
        assert_eq!(chosen(&["A1", "B2"], Some("B2")), Ok("B2"));
        assert_eq!(chosen(&["A1", "B2"], Some("b2")), Ok("B2"));
    }

    #[test]
    fn where_it_is_not_clear_which_all_are_listed() {
        let many = chosen(&["A1", "B2"], None).unwrap_err();
        assert!(many.contains("name one of them: usb:A1, usb:B2"), "{many}");
        let other = chosen(&["A1", "B2"], Some("C3")).unwrap_err();
        assert!(other.contains("plugged in: usb:A1, usb:B2"), "{other}");
        let none = chosen(&[], Some("C3")).unwrap_err();
        assert!(none.contains("no ihd controller is plugged in"), "{none}");
    }
}
