//! Descriptors of the device.

use crate::chip::Chip;

/// English.
const LANGUAGE: [u8; 4] = [4, 3, 9, 4];
/// Manufacturer, product, the alternate settings' strings; the serial number, 3, is the chip's.
const STRINGS: [(u8, &str); 5] = [
    (1, "STMicroelectronics"),
    (2, "DFU in FS Mode"),
    (4, "@Internal Flash   /0x08000000/256*02Kg"),
    (
        5,
        "@Option Bytes   /0x1FFF7800/01*048 e/0x1FFFF800/01*048 e",
    ),
    (6, "@OTP Memory   /0x1FFF7000/01*1024 e"),
];
/// Index of the first alternate setting's string.
const FIRST_ALTERNATE: u8 = 4;
/// Alternate settings.
pub const ALTERNATES: u8 = 3;
/// Bytes of a block.
pub const TRANSFER: u16 = 2048;

/// A descriptor by its kind and index; none is a STALL.
pub fn descriptor(kind: u8, index: u8, chip: &Chip, flash: Option<&str>) -> Option<Vec<u8>> {
    match kind {
        1 => Some(vec![
            18, 1, 0x00, 0x02, 0, 0, 0, 64, 0x83, 0x04, 0x11, 0xDF, 0x00, 0x02, 1, 2, 3, 1,
        ]),
        2 => Some(configuration()),
        3 if index == 0 => Some(LANGUAGE.to_vec()),
        3 if index == 3 => Some(string(&serial(chip.unique))),
        3 if index == FIRST_ALTERNATE && flash.is_some() => flash.map(string),
        3 => {
            let text = STRINGS.iter().find(|(number, _)| *number == index);
            text.map(|(_, text)| string(text))
        }
        _ => None,
    }
}

fn configuration() -> Vec<u8> {
    let [low, high] = TRANSFER.to_le_bytes();
    let interface = |n| [9, 4, 0, n, 0, 0xFE, 1, 2, FIRST_ALTERNATE + n];
    // Download, upload, detaches by itself; 255 ms; DfuSe 1.1a.
    let functional = [9, 0x21, 0x0B, 255, 0, low, high, 0x1A, 0x01];
    let mut bytes: Vec<u8> = (0..ALTERNATES).flat_map(interface).collect();
    bytes.extend(functional);
    let length = bytes.len() as u8 + 9;
    [&[9, 2, length, 0, 1, 1, 0, 0xC0, 50][..], &bytes].concat()
}

fn string(text: &str) -> Vec<u8> {
    let units: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    [&[units.len() as u8 + 2, 3][..], &units].concat()
}

/// The serial number: eight digits of the first and third word's sum, four of the second.
pub fn serial(unique: [u32; 3]) -> String {
    let sum = unique[0].wrapping_add(unique[2]);
    format!("{sum:08X}{:04X}", unique[1] >> 16)
}
