//! The link over USB: one vendor interface with a bulk endpoint each way, and the descriptors by
//! which Windows binds WinUSB to it without a driver.

use embassy_stm32::peripherals::USB;
use embassy_stm32::usb::{Driver, Endpoint, In, Out};
use embassy_usb::driver::{Endpoint as _, EndpointIn as _, EndpointOut as _};
use embassy_usb::msos::{self, windows_version};
use embassy_usb::{Builder, Config, UsbDevice};
use ihd_shared::usb::{PACKET, PRODUCT, PRODUCT_ID, VENDOR_ID};
use static_cell::StaticCell;

use crate::board::link::{Receive, Send};

/// By this GUID host programs find the interface on Windows.
const GUIDS: &[&str] = &["{5A7D8C5E-6C0B-4C57-9F5F-0E6B1C1D4B21}"];

/// bRequest by which Windows asks for its descriptors.
const VENDOR_CODE: u8 = 0x20;

/// The receiving half.
pub struct Receiver(Endpoint<'static, USB, Out>);

/// The sending half.
pub struct Sender {
    endpoint: Endpoint<'static, USB, In>,
}

struct Buffers {
    configuration: [u8; 128],
    bos: [u8; 64],
    msos: [u8; 256],
    control: [u8; 64],
}

/// The device, to be run by a task of its own, and the two halves of the link.
pub fn start(
    driver: Driver<'static, USB>,
    serial: &'static str,
) -> (UsbDevice<'static, Driver<'static, USB>>, Receiver, Sender) {
    static BUFFERS: StaticCell<Buffers> = StaticCell::new();
    let buffers = BUFFERS.init(Buffers {
        configuration: [0; 128],
        bos: [0; 64],
        msos: [0; 256],
        control: [0; 64],
    });
    let mut config = Config::new(VENDOR_ID, PRODUCT_ID);
    config.manufacturer = Some("ihd");
    config.product = Some(PRODUCT);
    config.serial_number = Some(serial);
    config.device_class = 0xFF;
    config.device_sub_class = 0;
    config.device_protocol = 0;
    config.composite_with_iads = false;
    let mut builder = Builder::new(
        driver,
        config,
        &mut buffers.configuration,
        &mut buffers.bos,
        &mut buffers.msos,
        &mut buffers.control,
    );
    builder.msos_descriptor(windows_version::WIN8_1, VENDOR_CODE);
    builder.msos_feature(msos::CompatibleIdFeatureDescriptor::new("WINUSB", ""));
    builder.msos_feature(msos::RegistryPropertyFeatureDescriptor::new(
        "DeviceInterfaceGUIDs",
        msos::PropertyData::RegMultiSz(GUIDS),
    ));
    let mut function = builder.function(0xFF, 0, 0);
    let mut interface = function.interface();
    let mut setting = interface.alt_setting(0xFF, 0, 0, None);
    let receiver = Receiver(setting.endpoint_bulk_out(None, PACKET as u16));
    let sender = Sender {
        endpoint: setting.endpoint_bulk_in(None, PACKET as u16),
    };
    drop(function);
    (builder.build(), receiver, sender)
}

impl Receive for Receiver {
    async fn receive(&mut self, buf: &mut [u8]) -> usize {
        self.0.wait_enabled().await;
        self.0.read(buf).await.unwrap_or(0)
    }
}

impl Send for Sender {
    /// Sends one packet. The last one of `bytes` is never full: a short packet ends the host's transfer, without a zero-length
    /// packet behind a full one.
    async fn send(&mut self, bytes: &[u8]) -> usize {
        self.endpoint.wait_enabled().await;
        let length = match bytes.len() {
            PACKET => PACKET - 1,
            length => length.min(PACKET),
        };
        let packet = bytes.get(..length).unwrap_or(bytes);
        match self.endpoint.write(packet).await {
            Ok(()) => packet.len(),
            Err(_) => 0,
        }
    }
}
