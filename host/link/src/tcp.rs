//! A device behind a TCP port: `ihd hob --listen`, or a board behind a serial-to-network bridge.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use super::transport::{SEND_TIMEOUT, send_within};
use super::{LinkError, Transport};

/// Time limit for a connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);

/// A TCP connection.
pub struct TcpTransport {
    stream: TcpStream,
    device: String,
}

impl TcpTransport {
    /// Connects to `HOST:PORT`; every address of the host is tried in turn.
    ///
    /// # Errors
    /// [`LinkError::Connect`] with what the operating system reported last.
    pub fn connect(address: &str) -> Result<Self, LinkError> {
        let failed = |source: io::Error| LinkError::Connect {
            device: format!("tcp:{address}"),
            hint: match source.kind() {
                ErrorKind::ConnectionRefused => {
                    format!("; nothing listens there: start `ihd hob --listen {address}` first")
                }
                ErrorKind::TimedOut => "; check address, cable and firewall".into(),
                _ => String::new(),
            },
            source,
        };
        let mut last = io::Error::new(ErrorKind::NotFound, "the host name has no address");
        for candidate in address.to_socket_addrs().map_err(failed)? {
            match TcpStream::connect_timeout(&candidate, CONNECT_TIMEOUT) {
                Ok(stream) => return Self::new(stream, address).map_err(failed),
                Err(e) => last = e,
            }
        }
        Err(failed(last))
    }

    fn new(stream: TcpStream, address: &str) -> io::Result<Self> {
        // Commands are small and wait for their answer.
        stream.set_nodelay(true)?;
        Ok(Self {
            stream,
            device: format!("tcp:{address}"),
        })
    }

    fn failed(&self, doing: &'static str, source: io::Error) -> LinkError {
        let device = self.device.clone();
        match source.kind() {
            ErrorKind::ConnectionReset | ErrorKind::ConnectionAborted | ErrorKind::BrokenPipe => {
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

impl Transport for TcpTransport {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let sent = send_within(SEND_TIMEOUT, bytes, |rest, left| {
            self.stream.set_write_timeout(Some(left))?;
            self.stream.write(rest)
        });
        sent.map_err(|e| self.failed("send", e))
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        // Zero would mean "for ever" to the socket.
        let timeout = timeout.max(Duration::from_micros(1));
        let read = self.stream.set_read_timeout(Some(timeout)).and_then(|()| {
            loop {
                match self.stream.read(buf) {
                    Err(e) if e.kind() == ErrorKind::Interrupted => {}
                    read => return read,
                }
            }
        });
        match read {
            Ok(0) if !buf.is_empty() => Err(LinkError::Closed {
                device: self.device.clone(),
            }),
            Ok(n) => Ok(n),
            Err(e) => match e.kind() {
                ErrorKind::WouldBlock | ErrorKind::TimedOut => Ok(0),
                _ => Err(self.failed("receive", e)),
            },
        }
    }

    fn describe(&self) -> String {
        self.device.clone()
    }
}
