//! Serial port of the board behind a TCP port. Emulated time passes as fast as possible, but never faster than real time; the
//! ratio is printed.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::thread;
use std::time::{Duration, Instant};

use crate::machine::{Machine, MachineError};
use crate::time::{Ticks, seconds, us};

/// Emulated time between two polls of the socket.
const SLICE: Ticks = us(500);

/// Real time between two reports.
const REPORT: Duration = Duration::from_secs(10);

/// Error that ends the server.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The TCP port failed.
    #[error("the port: {0}")]
    Port(#[from] std::io::Error),
    /// The emulator failed.
    #[error(transparent)]
    Machine(#[from] MachineError),
}

/// Serves the board without end, to one host at a time.
///
/// # Errors
/// The TCP port or the emulator fails.
pub fn serve(mut machine: Machine, listener: &TcpListener) -> Result<(), ServerError> {
    listener.set_nonblocking(true)?;
    let mut host = None::<TcpStream>;
    let mut known = machine.violations().len();
    let (mut reported, mut emulated_at_report) = (Instant::now(), machine.now());
    loop {
        let began = Instant::now();
        machine.run_for(SLICE)?;
        if let Ok((stream, from)) = listener.accept() {
            println!("host connected: {from}");
            stream.set_nonblocking(true)?;
            stream.set_nodelay(true)?;
            host = Some(stream);
        }
        if host
            .as_mut()
            .is_some_and(|stream| exchange(&mut machine, stream).is_err())
        {
            println!("host disconnected");
            host = None;
        }
        let violations = machine.violations();
        for violation in violations.iter().skip(known) {
            println!("violation {violation}");
        }
        known = violations.len();
        if reported.elapsed() >= REPORT {
            let emulated_s = seconds(machine.now() - emulated_at_report);
            let slower = reported.elapsed().as_secs_f64() / emulated_s;
            let bridge = machine.chip().pins.bridge();
            println!(
                "{:.2} s emulated, {slower:.1} times slower than real time; bridge: {bridge:?}",
                seconds(machine.now())
            );
            (reported, emulated_at_report) = (Instant::now(), machine.now());
        }
        let left = Duration::from_secs_f64(seconds(SLICE)).saturating_sub(began.elapsed());
        thread::sleep(left);
    }
}

/// Moves available bytes in both directions; returns an error if the host is disconnected.
fn exchange(machine: &mut Machine, stream: &mut TcpStream) -> std::io::Result<()> {
    let mut bytes = [0; 1024];
    match stream.read(&mut bytes) {
        Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
        Ok(n) => machine.chip().serial.inbound.extend(&bytes[..n]),
        Err(error) if error.kind() == ErrorKind::WouldBlock => {}
        Err(error) => return Err(error),
    }
    let sent = &mut machine.chip().serial.sent;
    while !sent.is_empty() {
        let (front, _) = sent.as_slices();
        match stream.write(front) {
            Ok(n) => drop(sent.drain(..n)),
            Err(error) if error.kind() == ErrorKind::WouldBlock => break,
            Err(error) => return Err(error),
        }
    }
    Ok(())
}
