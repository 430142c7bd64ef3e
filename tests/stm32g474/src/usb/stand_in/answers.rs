//! Descriptors as the board's image returns them.

use ihd_shared::usb::{PRODUCT, PRODUCT_ID, VENDOR_ID};

/// Response to a request for a descriptor; `None` is a STALL.
pub fn descriptor(packet: [u8; 8], serial: &str) -> Option<Vec<u8>> {
    let [kind, request, index, which, ..] = packet;
    match (kind, request, which) {
        (0x80, 6, 1) => Some(device()),
        (0x80, 6, 2) => Some(configuration()),
        (0x80, 6, 3) => string(index, serial),
        (0x80, 6, 15) => Some(bos()),
        // A full-speed device has no qualifier (USB 2.0, 9.6.2).
        (0xC0, 0x20, _) if packet[4] == 7 => Some(microsoft()),
        _ => None,
    }
}

fn device() -> Vec<u8> {
    let ([vendor, vendor_high], [product, product_high]) =
        (VENDOR_ID.to_le_bytes(), PRODUCT_ID.to_le_bytes());
    let ids = [vendor, vendor_high, product, product_high];
    // USB 2.1, for the BOS; vendor-specific class; 64 bytes.
    let head = [18, 1, 0x10, 0x02, 0xFF, 0, 0, 64];
    let tail = [0x10, 0x00, 1, 2, 3, 1];
    [&head[..], &ids, &tail].concat()
}

fn configuration() -> Vec<u8> {
    let interface = [9, 4, 0, 0, 2, 0xFF, 0, 0, 0];
    let (out, input) = ([7, 5, 0x01, 2, 64, 0, 0], [7, 5, 0x81, 2, 64, 0, 0]);
    let configuration = [9, 2, 32, 0, 1, 1, 0, 0x80, 50];
    [&configuration[..], &interface, &out, &input].concat()
}

fn string(index: u8, serial: &str) -> Option<Vec<u8>> {
    let text = match index {
        // English.
        0 => return Some(vec![4, 3, 9, 4]),
        1 => "ihd",
        2 => PRODUCT,
        3 => serial,
        _ => return None,
    };
    let units: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let length = u8::try_from(units.len() + 2).ok()?;
    Some([&[length, 3], units.as_slice()].concat())
}

/// One capability: Microsoft's platform, whose descriptors are read with request 0x20.
fn bos() -> Vec<u8> {
    let uuid = [
        0xDF, 0x60, 0xDD, 0xD8, 0x89, 0x45, 0xC7, 0x4C, 0x9C, 0xD2, 0x65, 0x9D, 0x9E, 0x64, 0x8A,
        0x9F,
    ];
    let length = microsoft().len() as u8;
    let windows_8_1 = [0x00, 0x00, 0x03, 0x06, length, 0, 0x20, 0];
    [&[5, 15, 33, 0, 1, 28, 16, 5, 0][..], &uuid, &windows_8_1].concat()
}

/// WINUSB for the whole device.
fn microsoft() -> Vec<u8> {
    let header = [10, 0, 0, 0, 0x00, 0x00, 0x03, 0x06, 30, 0];
    let compatible = [20, 0, 3, 0];
    [&header[..], &compatible, b"WINUSB\0\0", &[0; 8]].concat()
}
