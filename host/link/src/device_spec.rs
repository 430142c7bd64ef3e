//! Value of `--device`.

use std::fmt;
use std::str::FromStr;

use super::serial::SerialTransport;
use super::tcp::TcpTransport;
use super::usb::UsbTransport;
use super::{LinkError, Transport};

/// Address of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeviceSpec {
    /// The simulated hob, in process.
    Sim,
    /// A hob behind a TCP port, as `HOST:PORT`.
    Tcp(String),
    /// A board on USB: the one that is plugged in, or the one with this serial number.
    Usb(Option<String>),
    /// A board behind a serial port, for instance the ST-LINK's, by its path.
    Serial(String),
}

/// Error for a text that names no device.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{text:?} is no device: {why}; there are: sim, tcp:HOST:PORT, usb, usb:SERIAL, serial:PATH"
)]
pub struct UnknownDevice {
    text: String,
    why: &'static str,
}

impl FromStr for DeviceSpec {
    type Err = UnknownDevice;

    fn from_str(text: &str) -> Result<Self, UnknownDevice> {
        let unknown = |why| UnknownDevice {
            text: text.to_owned(),
            why,
        };
        match text.split_once(':') {
            None if text == "sim" => Ok(Self::Sim),
            None if text == "usb" => Ok(Self::Usb(None)),
            Some(("usb", "")) => Err(unknown("the serial number is missing")),
            Some(("usb", serial)) => Ok(Self::Usb(Some(serial.to_owned()))),
            Some(("tcp", address)) => match address.rsplit_once(':') {
                Some(("", _)) => Err(unknown("the host is missing")),
                Some((_, port)) if !port.parse::<u16>().is_ok_and(|p| p > 0) => {
                    Err(unknown("the port must be 1 to 65535"))
                }
                Some(_) => Ok(Self::Tcp(address.to_owned())),
                None => Err(unknown("the port is missing")),
            },
            Some(("serial", "")) => Err(unknown("the path is missing")),
            Some(("serial", path)) => Ok(Self::Serial(path.to_owned())),
            _ => Err(unknown("no such kind")),
        }
    }
}

impl fmt::Display for DeviceSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sim => write!(f, "sim"),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
            Self::Usb(None) => write!(f, "usb"),
            Self::Usb(Some(serial)) => write!(f, "usb:{serial}"),
            Self::Serial(path) => write!(f, "serial:{path}"),
        }
    }
}

impl DeviceSpec {
    /// Opens a transport to the device. `sim` makes the one to the simulated hob, which this crate does not know.
    ///
    /// # Errors
    /// [`LinkError::Connect`] when nothing answers there.
    pub fn open(
        &self,
        sim: impl FnOnce() -> Box<dyn Transport>,
    ) -> Result<Box<dyn Transport>, LinkError> {
        match self {
            Self::Sim => Ok(sim()),
            Self::Tcp(address) => Ok(Box::new(TcpTransport::connect(address)?)),
            Self::Usb(serial) => Ok(Box::new(UsbTransport::open(serial.as_deref())?)),
            Self::Serial(path) => Ok(Box::new(SerialTransport::open(path)?)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_what_is_read() {
        for text in [
            "sim",
            "usb",
            "usb:123456789ABCDEF011223344",
            "tcp:[::1]:4711",
            "tcp:hob.lan:1",
            "serial:/dev/ttyACM0",
        ] {
            let spec: DeviceSpec = text.parse().unwrap();
            assert_eq!(spec.to_string(), text);
        }
    }

    #[test]
    fn what_is_no_device_says_so_and_lists_what_is() {
        for text in [
            "",
            "simm",
            "sim:1",
            "tcp",
            "tcp:",
            "tcp:host",
            "tcp::1",
            "tcp:h:0",
            "tcp:h:65536",
            "serial:",
            "usb:",
            "SIM",
        ] {
            let error = text.parse::<DeviceSpec>().unwrap_err().to_string();
            assert!(
                error.contains("tcp:HOST:PORT") && error.contains(text),
                "{error}"
            );
        }
    }

    #[test]
    fn a_device_that_is_not_there_is_named() {
        let no_sim = || -> Box<dyn Transport> { unreachable!("not asked for") };
        let spec = DeviceSpec::Serial("/dev/no-such-port".to_owned());
        let Err(error) = spec.open(no_sim) else {
            panic!("nothing is there");
        };
        assert!(
            error.to_string().contains("serial:/dev/no-such-port"),
            "{error}"
        );
    }
}
