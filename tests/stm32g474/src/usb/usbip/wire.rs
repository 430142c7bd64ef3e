//! Packets of USB/IP, version 1.1.1 (Linux: Documentation/usb/usbip_protocol.rst). Numbers are big-endian.

use std::io::{self, Read};

const VERSION: u16 = 0x0111;
const OP_REQ_DEVLIST: u16 = 0x8005;
const OP_REQ_IMPORT: u16 = 0x8003;
const OP_REP_DEVLIST: u16 = 0x0005;
const OP_REP_IMPORT: u16 = 0x0003;

const CMD_SUBMIT: u32 = 1;
const CMD_UNLINK: u32 = 2;
const RET_SUBMIT: u32 = 3;
const RET_UNLINK: u32 = 4;

/// Bytes of the header of a command or a response.
const HEADER: usize = 48;
const BUS_ID: usize = 32;
/// Linux's USB_SPEED_FULL.
const FULL_SPEED: u32 = 2;
/// Linux's URB_ZERO_PACKET.
const ZERO_PACKET: u32 = 0x40;
/// Longest transfer: more than the kernel requests at once.
const MAX_TRANSFER_BYTES: usize = 1 << 20;

/// Request of a client before it imports a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Operation {
    /// List of all devices.
    List,
    /// Import of a device, by its bus id.
    Import(String),
}

/// Request of the kernel to a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// Submission of a transfer.
    Submit {
        /// Sequence number of the command.
        sequence: u32,
        /// Number of the endpoint.
        endpoint: u8,
        /// Set if data come from the endpoint.
        input: bool,
        /// Set if an empty packet follows a full last one.
        ends_short: bool,
        /// Length of the data or of the room for them.
        length: usize,
        /// Setup packet of a control transfer.
        setup: [u8; 8],
        /// Data for the device.
        data: Vec<u8>,
    },
    /// Cancellation of a transfer.
    Unlink {
        /// Sequence number of the command.
        sequence: u32,
        /// Sequence number of the transfer.
        transfer: u32,
    },
}

/// Description of a device for a client that has not imported it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Bus id, such as "1-1".
    pub bus_id: String,
    /// Number on the bus.
    pub number: u32,
    /// Device descriptor, 18 bytes.
    pub device: Vec<u8>,
}

fn invalid(what: impl std::fmt::Display) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, format!("USB/IP: {what}"))
}

fn exactly<const N: usize>(from: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    from.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn word(bytes: &[u8], place: usize) -> u32 {
    let word = bytes[4 * place..4 * place + 4].try_into();
    u32::from_be_bytes(word.expect("four bytes"))
}

impl Operation {
    /// Reads an operation.
    pub fn read(from: &mut impl Read) -> io::Result<Self> {
        let [version, version_low, code, code_low, ..] = exactly::<8>(from)?;
        if u16::from_be_bytes([version, version_low]) != VERSION {
            return Err(invalid(format!("version {version:x}.{version_low:x}")));
        }
        match u16::from_be_bytes([code, code_low]) {
            OP_REQ_DEVLIST => Ok(Self::List),
            OP_REQ_IMPORT => {
                let id = exactly::<BUS_ID>(from)?;
                let id = id.split(|byte| *byte == 0).next().unwrap_or_default();
                Ok(Self::Import(String::from_utf8_lossy(id).into_owned()))
            }
            other => Err(invalid(format!("operation {other:#x}"))),
        }
    }
}

impl Command {
    /// Reads a command.
    pub fn read(from: &mut impl Read) -> io::Result<Self> {
        let header = exactly::<HEADER>(from)?;
        let word = |place| word(&header, place);
        match word(0) {
            CMD_UNLINK => Ok(Self::Unlink {
                sequence: word(1),
                transfer: word(5),
            }),
            CMD_SUBMIT => {
                let (input, length) = (word(3) == 1, word(6) as usize);
                let goes = if input { 0 } else { length };
                if length > MAX_TRANSFER_BYTES {
                    return Err(invalid(format!("a transfer of {length} bytes")));
                }
                let mut data = vec![0; goes];
                from.read_exact(&mut data)?;
                let setup = header[40..].try_into().map_err(invalid)?;
                let endpoint = u8::try_from(word(4)).map_err(invalid)?;
                let ends_short = word(5) & ZERO_PACKET != 0;
                let sequence = word(1);
                Ok(Self::Submit {
                    sequence,
                    endpoint,
                    input,
                    ends_short,
                    length,
                    setup,
                    data,
                })
            }
            other => Err(invalid(format!("command {other:#x}"))),
        }
    }
}

fn reply(code: u16, status: u32) -> Vec<u8> {
    let head = [VERSION.to_be_bytes(), code.to_be_bytes()].concat();
    [head, status.to_be_bytes().to_vec()].concat()
}

/// Response to [`Operation::List`].
pub fn device_list(devices: &[Identity]) -> Vec<u8> {
    let mut bytes = reply(OP_REP_DEVLIST, 0);
    bytes.extend((devices.len() as u32).to_be_bytes());
    for device in devices {
        bytes.extend(device.encode());
        // One interface of vendor-specific class.
        bytes.extend([0xFF, 0, 0, 0]);
    }
    bytes
}

/// Response to [`Operation::Import`]; `None` if the device does not exist or is in use.
pub fn imported(device: Option<&Identity>) -> Vec<u8> {
    let mut bytes = reply(OP_REP_IMPORT, u32::from(device.is_none()));
    bytes.extend(device.map(Identity::encode).unwrap_or_default());
    bytes
}

impl Identity {
    fn encode(&self) -> Vec<u8> {
        let mut bytes = format!("/emulated/{}", self.bus_id).into_bytes();
        bytes.resize(256, 0);
        bytes.extend(self.bus_id.as_bytes());
        bytes.resize(256 + BUS_ID, 0);
        for number in [1, self.number, FULL_SPEED] {
            bytes.extend(number.to_be_bytes());
        }
        let byte = |place: usize| self.device.get(place).copied().unwrap_or(0);
        // idVendor, idProduct, bcdDevice: big-endian here.
        bytes.extend([9, 8, 11, 10, 13, 12].map(byte));
        // Class, subclass, protocol; no configuration yet; configurations, interfaces.
        bytes.extend([byte(4), byte(5), byte(6), 0, byte(17), 1]);
        bytes
    }
}

fn header(command: u32, sequence: u32, status: i32, length: usize) -> Vec<u8> {
    let mut bytes: Vec<u8> = [command, sequence, 0, 0, 0]
        .into_iter()
        .flat_map(u32::to_be_bytes)
        .collect();
    bytes.extend(status.to_be_bytes());
    bytes.extend((length as u32).to_be_bytes());
    bytes.resize(HEADER, 0);
    bytes
}

/// Response at the end of a transfer.
pub fn submitted(sequence: u32, status: i32, length: usize, data: &[u8]) -> Vec<u8> {
    [&header(RET_SUBMIT, sequence, status, length)[..], data].concat()
}

/// Response to [`Command::Unlink`].
pub fn unlinked(sequence: u32, status: i32) -> Vec<u8> {
    header(RET_UNLINK, sequence, status, 0)
}
