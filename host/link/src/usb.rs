//! A board on USB: the vendor interface with a bulk endpoint each way.

use std::io::{self, ErrorKind, Read, Write};
use std::time::Duration;

use ihd_shared::usb::{PRODUCT, PRODUCT_ID, VENDOR_ID};
use nusb::MaybeFuture;
use nusb::descriptors::TransferType;
use nusb::io::{EndpointRead, EndpointWrite};
use nusb::transfer::{Bulk, Direction, In, Out};

use super::{LinkError, Transport};

/// The device sends packets of less than 64 bytes, each of which ends a transfer: many in flight.
const TRANSFER: usize = 64;
const IN_FLIGHT: usize = 64;

/// How long a device may leave what we send unread.
const SEND_TIMEOUT: Duration = Duration::from_secs(5);

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

impl UsbTransport {
    /// Opens the one controller that is plugged in.
    ///
    /// # Errors
    /// [`LinkError::Connect`] when there is none, more than one, or it may not be opened.
    pub fn open() -> Result<Self, LinkError> {
        let devices = nusb::list_devices().wait();
        let devices = devices.map_err(|e| failed("; is USB available here?", e.into()))?;
        let ours = |d: &nusb::DeviceInfo| {
            (d.vendor_id(), d.product_id()) == (VENDOR_ID, PRODUCT_ID)
                && d.product_string().is_none_or(|p| p.starts_with(PRODUCT))
        };
        let mut found: Vec<_> = devices.filter(ours).collect();
        let Some(info) = found.pop() else {
            let none = io::Error::new(ErrorKind::NotFound, "no ihd controller is plugged in");
            let hint = "; a NUCLEO without a USB socket of its own is reached by serial:PATH";
            return Err(failed(hint, none));
        };
        if !found.is_empty() {
            let many = io::Error::other("more than one ihd controller is plugged in");
            return Err(failed("; unplug all but one", many));
        }
        let serial = info.serial_number().unwrap_or("?");
        let device = format!("usb ({serial})");
        let hint = "; on Linux, does the udev rule of docs/99-ihd.rules apply?";
        let opened = info.open().wait();
        let opened = opened.and_then(|device| device.claim_interface(0).wait());
        let interface = opened.map_err(|e| failed(hint, e.into()))?;
        let address = |direction| {
            let descriptor = interface.descriptor()?;
            let mut endpoints = descriptor.endpoints();
            let wanted = endpoints
                .find(|e| e.transfer_type() == TransferType::Bulk && e.direction() == direction);
            wanted.map(|e| e.address())
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
            writer: writer.writer(TRANSFER).with_write_timeout(SEND_TIMEOUT),
            device,
        })
    }

    fn failed(&self, doing: &'static str, source: io::Error) -> LinkError {
        let device = self.device.clone();
        match source.kind() {
            ErrorKind::NotConnected | ErrorKind::BrokenPipe => LinkError::Closed { device },
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
