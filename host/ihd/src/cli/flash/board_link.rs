//! Link to a board that is flashed; opened for each request, as the board is reset in between.

use std::fs;
use std::path::Path;
use std::time::Duration;

use ihd_flash::BuildId;
use ihd_flash::install::{BoardAccess, RunningBoard};
use ihd_link::{Client, DeviceSpec, LinkError};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{State, Status};

/// Folder in which Linux names serial ports by device.
const BY_ID: &str = "/dev/serial/by-id";

/// Time limit of a request: a board answers within milliseconds.
const TIMEOUT: Duration = Duration::from_millis(500);

/// Given link, or all links that this board may have.
#[derive(Debug)]
pub struct BoardLink {
    links: Vec<DeviceSpec>,
}

impl BoardLink {
    /// Creates one from `given`, or from USB and the serial port of the probe with that serial number.
    pub fn new(given: Option<DeviceSpec>, probe_serial: Option<&str>) -> Self {
        let links = match given {
            Some(given) => vec![given],
            None => {
                let port = probe_serial.and_then(|serial| port_of(Path::new(BY_ID), serial));
                let port = port.map(DeviceSpec::Serial);
                [DeviceSpec::Usb(None)].into_iter().chain(port).collect()
            }
        };
        Self { links }
    }
}

impl BoardAccess for BoardLink {
    fn ask(&mut self) -> Result<RunningBoard, String> {
        let mut silent = Vec::new();
        for spec in &self.links {
            match ask(spec) {
                Ok(heard) => return Ok(heard),
                Err(why) => silent.push(why.to_string()),
            }
        }
        Err(silent.join("; "))
    }
}

fn ask(spec: &DeviceSpec) -> Result<RunningBoard, LinkError> {
    // `ihd flash` rejects a simulated hob: none is opened here.
    let transport = spec.open(|| unreachable!("a simulated hob was refused"))?;
    let mut client = Client::connect(transport)?;
    client.set_timeout(TIMEOUT);
    let status = client.status()?;
    let facts = client.board()?;
    let hello = client.hello();
    Ok(RunningBoard {
        link: spec.to_string(),
        build: hello.build.to_string(),
        build_id: BuildId::from_bytes(&facts.build_id),
        protocol: (hello.protocol_major, hello.protocol_minor),
        chip: facts.chip.try_into().ok(),
        heats: heats(&status),
        fault: (status.fault != Fault::NONE).then(|| {
            let name = status.fault.name().unwrap_or("unknown");
            (status.fault.number(), name.to_owned())
        }),
    })
}

/// Returns `true` if power is on or requested, so that flashing would interrupt it.
fn heats(status: &Status) -> bool {
    status.asked_w > 0
        || matches!(
            status.state,
            State::Probing | State::Heating | State::Pausing
        )
}

/// Serial port of a USB device with this serial number.
fn port_of(folder: &Path, serial: &str) -> Option<String> {
    let names = fs::read_dir(folder).ok()?.flatten();
    let mut ports = names.filter(|entry| {
        let name = entry.file_name();
        !serial.is_empty() && name.to_string_lossy().contains(serial)
    });
    ports.next().map(|entry| entry.path().display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_probes_own_port_is_found() {
        let folder = tempfile::tempdir().unwrap();
        for name in [
            "usb-FTDI_FT232R_A1-if00-port0",
            "usb-STMicroelectronics_STLINK-V3_0042F-if02",
        ] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let port = port_of(folder.path(), "0042F").unwrap();
        assert!(port.ends_with("STLINK-V3_0042F-if02"), "{port}");
        assert_eq!(port_of(folder.path(), "0043"), None);
        assert_eq!(port_of(folder.path(), ""), None);
        assert_eq!(port_of(Path::new("/no/such"), "0042F"), None);
    }

    #[test]
    fn a_link_that_was_named_is_the_only_one() {
        let named = DeviceSpec::Serial("/dev/no-such-port".into());
        let mut link = BoardLink::new(Some(named), Some("0042F"));
        let why = link.ask().unwrap_err();
        assert!(
            why.contains("/dev/no-such-port") && !why.contains("usb"),
            "{why}"
        );
    }
}
