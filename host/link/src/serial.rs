//! A board behind a serial port: the ST-LINK of a NUCLEO-G474RE, or any adapter on its LPUART1.

use std::io::{self, ErrorKind, Read, Write};
use std::time::Duration;

use ihd_shared::wire::SERIAL_BAUD;
use serialport::SerialPort;

use super::transport::{SEND_TIMEOUT, send_within};
use super::{LinkError, Transport};

/// A serial port.
pub struct SerialTransport {
    port: Box<dyn SerialPort>,
    device: String,
}

impl SerialTransport {
    /// Opens a port by its path.
    ///
    /// # Errors
    /// [`LinkError::Connect`] with what the operating system reports.
    pub fn open(path: &str) -> Result<Self, LinkError> {
        let device = format!("serial:{path}");
        match serialport::new(path, SERIAL_BAUD).open() {
            Ok(port) => Ok(Self { port, device }),
            Err(why) => {
                let hint = match why.kind() {
                    serialport::ErrorKind::NoDevice => "; is the board plugged in?",
                    serialport::ErrorKind::Io(ErrorKind::PermissionDenied) => {
                        "; join the group that owns it (dialout on Debian)"
                    }
                    _ => "",
                };
                Err(LinkError::Connect {
                    device,
                    hint: hint.to_owned(),
                    source: why.into(),
                })
            }
        }
    }

    /// Wraps a port that is already open.
    pub fn over(port: Box<dyn SerialPort>, device: String) -> Self {
        Self { port, device }
    }

    fn failed(&self, doing: &'static str, source: io::Error) -> LinkError {
        let device = self.device.clone();
        match source.kind() {
            ErrorKind::BrokenPipe | ErrorKind::NotConnected => LinkError::Closed { device },
            _ => LinkError::Io {
                device,
                doing,
                source,
            },
        }
    }
}

impl Transport for SerialTransport {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let sent = send_within(SEND_TIMEOUT, bytes, |rest, left| {
            self.port.set_timeout(left)?;
            self.port.write(rest)
        });
        sent.map_err(|e| self.failed("send", e))
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        let read = self
            .port
            .set_timeout(timeout)
            .map_err(io::Error::from)
            .and_then(|()| self.port.read(buf));
        match read {
            Ok(n) => Ok(n),
            Err(e) if matches!(e.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => Ok(0),
            Err(e) => Err(self.failed("receive", e)),
        }
    }

    fn describe(&self) -> String {
        self.device.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_port_is_named() {
        let Err(error) = SerialTransport::open("/dev/no-such-port") else {
            panic!("nothing is there");
        };
        assert!(error.to_string().contains("/dev/no-such-port"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn bytes_pass_and_silence_is_a_time_out() {
        let (ours, theirs) = serialport::TTYPort::pair().unwrap();
        let mut ours = SerialTransport::over(Box::new(ours), "serial:ours".to_owned());
        let mut theirs = SerialTransport::over(Box::new(theirs), "serial:theirs".to_owned());
        let mut buf = [0; 16];
        let moment = Duration::from_millis(20);
        assert_eq!(theirs.receive(&mut buf, moment).unwrap(), 0);
        // Every byte value a terminal might want to interpret.
        ours.send(&[0, 3, 4, 10, 13, 17, 19, 0x7F, 0xFF]).unwrap();
        let n = theirs.receive(&mut buf, Duration::from_secs(2)).unwrap();
        assert_eq!(buf[..n], [0, 3, 4, 10, 13, 17, 19, 0x7F, 0xFF]);
        drop(theirs);
        assert!(matches!(
            ours.receive(&mut buf, moment),
            Ok(0) | Err(LinkError::Closed { .. } | LinkError::Io { .. })
        ));
    }
}
