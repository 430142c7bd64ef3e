//! Addresses for servers that a test starts later.

use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::process;
use std::sync::atomic::{AtomicU16, Ordering};

/// First port, and the number of a process. All lie below those that a system gives to other sockets: 32768 and up.
const FIRST: u16 = 10_240;
const OF_A_PROCESS: u16 = 10;
const PROCESSES: u32 = 2_200;

/// Returns a loopback address whose port is free and stays so: no other socket gets it by chance, as one of port 0 might, nor another
/// test's process.
///
/// # Panics
/// If all ports of the process are in use.
pub fn free_address() -> SocketAddr {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    let first = FIRST + (process::id() % PROCESSES) as u16 * OF_A_PROCESS;
    let mut tries = (0..OF_A_PROCESS).map(|_| {
        let port = first + NEXT.fetch_add(1, Ordering::Relaxed) % OF_A_PROCESS;
        SocketAddr::from((Ipv4Addr::LOCALHOST, port))
    });
    let is_free = |address: &SocketAddr| TcpListener::bind(address).is_ok();
    tries.find(is_free).expect("a free port")
}
