//! Program of the guest: `vhci-attach HOST:PORT BUS_ID PORT` imports a board over USB/IP and passes the connection to the
//! kernel's virtual host controller, which then needs no program.

use std::fs;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::os::fd::AsRawFd;
use std::process::ExitCode;

const ATTACH: &str = "/sys/devices/platform/vhci_hcd.0/attach";
/// Linux's USB_SPEED_FULL.
const FULL_SPEED: u32 = 2;
/// Version 1.1.1, OP_REQ_IMPORT, status 0.
const REQUEST: [u8; 8] = [0x01, 0x11, 0x80, 0x03, 0, 0, 0, 0];
const BUS_ID: usize = 32;
/// Bytes of the device in the response, after its head, and the offsets of the numbers of bus and device in it.
const DEVICE: usize = 312;
const BUS_NUMBER: usize = 288;
const DEVICE_NUMBER: usize = 292;

fn attach(server: &str, bus_id: &str, port: &str) -> io::Result<()> {
    let mut stream = TcpStream::connect(server)?;
    stream.set_nodelay(true)?;
    let mut request = REQUEST.to_vec();
    request.extend(bus_id.as_bytes());
    request.resize(REQUEST.len() + BUS_ID, 0);
    stream.write_all(&request)?;
    let mut head = [0; 8];
    stream.read_exact(&mut head)?;
    if head[4..] != [0; 4] {
        return Err(io::Error::other(format!("{bus_id} cannot be imported")));
    }
    let mut device = [0; DEVICE];
    stream.read_exact(&mut device)?;
    let number = |place: usize| {
        let bytes = [
            device[place],
            device[place + 1],
            device[place + 2],
            device[place + 3],
        ];
        u32::from_be_bytes(bytes)
    };
    let id = number(BUS_NUMBER) << 16 | number(DEVICE_NUMBER);
    let socket = stream.as_raw_fd();
    fs::write(ATTACH, format!("{port} {socket} {id} {FULL_SPEED}"))
}

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let [server, bus_id, port] = &arguments[..] else {
        eprintln!("vhci-attach HOST:PORT BUS_ID PORT");
        return ExitCode::FAILURE;
    };
    match attach(server, bus_id, port) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vhci-attach: {error}");
            ExitCode::FAILURE
        }
    }
}
