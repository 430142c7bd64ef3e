//! Program of the guest: `usb-descriptors SERIAL` prints a board's descriptors as the host's USB library reads them, and
//! Microsoft's, as Windows reads them; a line each, in hexadecimal.

use std::process::ExitCode;
use std::time::Duration;

use nusb::MaybeFuture;
use nusb::transfer::{ControlIn, ControlType, Recipient};

const TIMEOUT: Duration = Duration::from_secs(5);
/// Types of descriptors.
const KINDS: [(&str, u8); 4] = [
    ("device", 1),
    ("configuration", 2),
    ("qualifier", 6),
    ("bos", 15),
];
/// bRequest by the BOS, and wIndex, of the request for Microsoft's descriptor set.
const MICROSOFT: (u8, u16) = (0x20, 7);

fn show(name: &str, bytes: Option<Vec<u8>>) {
    let digits: String = bytes
        .iter()
        .flatten()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    println!(
        "{name} {}",
        if bytes.is_some() { &digits } else { "refused" }
    );
}

fn print(serial: &str) -> Result<(), Box<dyn std::error::Error>> {
    let mut devices = nusb::list_devices().wait()?;
    let found = devices.find(|device| device.serial_number() == Some(serial));
    let device = found.ok_or("no such board")?.open().wait()?;
    for (name, kind) in KINDS {
        show(name, device.get_descriptor(kind, 0, 0, TIMEOUT).wait().ok());
    }
    let interface = device.claim_interface(0).wait()?;
    let (request, index) = MICROSOFT;
    let asked = ControlIn {
        control_type: ControlType::Vendor,
        recipient: Recipient::Device,
        request,
        value: 0,
        index,
        length: 4096,
    };
    show(
        "microsoft",
        interface.control_in(asked, TIMEOUT).wait().ok(),
    );
    Ok(())
}

fn main() -> ExitCode {
    let Some(serial) = std::env::args().nth(1) else {
        eprintln!("usb-descriptors SERIAL");
        return ExitCode::FAILURE;
    };
    match print(&serial) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("usb-descriptors: {error}");
            ExitCode::FAILURE
        }
    }
}
