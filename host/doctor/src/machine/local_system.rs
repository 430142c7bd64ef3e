//! Access to this machine.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use nusb::MaybeFuture;

use super::{Os, Port, System, UsbDevice};

/// Baud rate for opening a port; opening sends nothing.
const BAUD: u32 = 115_200;

/// Folders of udev's rules, in order of priority.
const RULES: [&str; 3] = [
    "etc/udev/rules.d",
    "run/udev/rules.d",
    "usr/lib/udev/rules.d",
];

/// This machine, or one whose files are below another root.
#[derive(Clone, Debug)]
pub struct LocalSystem {
    root: PathBuf,
    as_root: String,
}

impl LocalSystem {
    /// Creates one for this machine. `as_root` is the command that a user runs as root to install the rule.
    pub fn new(as_root: String) -> Self {
        Self::with_root(PathBuf::from("/"), as_root)
    }

    /// Uses the files below `root`; USB and serial ports are those of this machine in any case.
    pub fn with_root(root: PathBuf, as_root: String) -> Self {
        Self { root, as_root }
    }

    fn read(&self, path: &str) -> Option<String> {
        let text = fs::read_to_string(self.root.join(path)).ok()?;
        Some(text.trim().to_owned())
    }

    /// Lists the serial ports in sysfs.
    pub(super) fn ports_of_sysfs(&self) -> io::Result<Vec<Port>> {
        let mut ports = Vec::new();
        for entry in fs::read_dir(self.root.join("sys/class/tty"))? {
            let entry = entry?;
            let name = entry.file_name().to_string_lossy().into_owned();
            if !(name.starts_with("ttyACM") || name.starts_with("ttyUSB")) {
                continue;
            }
            ports.push(Port {
                path: format!("/dev/{name}"),
                usb: usb_of(&entry.path().join("device")),
                group: self.group_of(&self.root.join("dev").join(&name)),
            });
        }
        ports.sort_by(|a, b| a.path.cmp(&b.path));
        Ok(ports)
    }

    #[cfg(unix)]
    fn group_of(&self, node: &Path) -> Option<String> {
        use std::os::unix::fs::MetadataExt;
        let id = fs::metadata(node).ok()?.gid().to_string();
        let groups = self.read("etc/group")?;
        let of_id = |line: &&str| line.split(':').nth(2) == Some(&id);
        let name = groups.lines().find(of_id)?.split(':').next()?;
        Some(name.to_owned())
    }

    #[cfg(not(unix))]
    fn group_of(&self, _: &Path) -> Option<String> {
        None
    }
}

/// Returns the USB device above a node of sysfs: the first folder upwards with a vendor id.
fn usb_of(device: &Path) -> Option<UsbDevice> {
    let device = fs::canonicalize(device).ok()?;
    let mut above = device.ancestors();
    let folder = above.find(|folder| folder.join("idVendor").exists())?;
    let text = |name: &str| fs::read_to_string(folder.join(name)).ok();
    let id = |name: &str| u16::from_str_radix(text(name)?.trim(), 16).ok();
    let word = |name: &str| text(name).unwrap_or_default().trim().to_owned();
    Some(UsbDevice {
        vendor: id("idVendor")?,
        product: id("idProduct")?,
        name: word("product"),
        serial: word("serial"),
        driver: None,
        node: None,
    })
}

fn of_nusb(info: &nusb::DeviceInfo) -> UsbDevice {
    UsbDevice {
        vendor: info.vendor_id(),
        product: info.product_id(),
        name: info.product_string().unwrap_or_default().to_owned(),
        serial: info.serial_number().unwrap_or_default().to_owned(),
        #[cfg(target_os = "windows")]
        driver: info.driver().map(str::to_owned),
        #[cfg(not(target_os = "windows"))]
        driver: None,
        #[cfg(target_os = "linux")]
        node: Some(PathBuf::from(format!(
            "/dev/bus/usb/{:03}/{:03}",
            info.busnum(),
            info.device_address()
        ))),
        #[cfg(not(target_os = "linux"))]
        node: None,
    }
}

impl System for LocalSystem {
    fn os(&self) -> Os {
        match std::env::consts::OS {
            "linux" => Os::Linux,
            "macos" => Os::Mac,
            "windows" => Os::Windows,
            _ => Os::Other,
        }
    }

    fn usb(&self) -> io::Result<Vec<UsbDevice>> {
        let devices = nusb::list_devices().wait()?;
        Ok(devices.map(|info| of_nusb(&info)).collect())
    }

    fn ports(&self) -> io::Result<Vec<Port>> {
        if self.os() == Os::Linux {
            return self.ports_of_sysfs();
        }
        let ports = serialport::available_ports()?;
        let port = |p: serialport::SerialPortInfo| Port {
            path: p.port_name,
            usb: match p.port_type {
                serialport::SerialPortType::UsbPort(usb) => Some(UsbDevice {
                    vendor: usb.vid,
                    product: usb.pid,
                    name: usb.product.unwrap_or_default(),
                    serial: usb.serial_number.unwrap_or_default(),
                    driver: None,
                    node: None,
                }),
                _ => None,
            },
            group: None,
        };
        Ok(ports.into_iter().map(port).collect())
    }

    fn open_usb(&self, device: &UsbDevice) -> io::Result<()> {
        let same = |info: &nusb::DeviceInfo| of_nusb(info) == *device;
        let mut devices = nusb::list_devices().wait()?;
        let info = devices.find(same);
        let info = info.ok_or_else(|| io::Error::new(ErrorKind::NotFound, "it was unplugged"))?;
        info.open().wait()?;
        Ok(())
    }

    fn open_port(&self, port: &Port) -> io::Result<()> {
        match serialport::new(&port.path, BAUD).open() {
            Ok(_) => Ok(()),
            // Error kind reported if another program has locked the port.
            Err(e)
                if e.kind() == serialport::ErrorKind::NoDevice
                    && Path::new(&port.path).exists() =>
            {
                Err(io::Error::new(ErrorKind::ResourceBusy, e.to_string()))
            }
            Err(e) => Err(e.into()),
        }
    }

    fn has_udev(&self) -> bool {
        self.root.join("run/udev/control").exists()
    }

    fn rules(&self) -> io::Result<Vec<(String, String)>> {
        let mut found: Vec<(String, String)> = Vec::new();
        for folder in RULES {
            let entries = match fs::read_dir(self.root.join(folder)) {
                Ok(entries) => entries,
                Err(e) if e.kind() == ErrorKind::NotFound => continue,
                Err(e) => return Err(e),
            };
            for entry in entries {
                let entry = entry?;
                let name = entry.file_name().to_string_lossy().into_owned();
                // A file hides those of its name in later folders.
                if name.ends_with("ihd.rules") && !found.iter().any(|(known, _)| *known == name) {
                    let content = fs::read(entry.path())?;
                    found.push((name, String::from_utf8_lossy(&content).into_owned()));
                }
            }
        }
        found.sort();
        Ok(found)
    }

    fn runs(&self, program: &str) -> bool {
        let Ok(processes) = fs::read_dir(self.root.join("proc")) else {
            return false;
        };
        let mut processes = processes.flatten().map(|entry| entry.file_name());
        processes.any(|name| {
            let name = name.to_string_lossy();
            name.bytes().all(|b| b.is_ascii_digit())
                && self.read(&format!("proc/{name}/comm")).as_deref() == Some(program)
        })
    }

    fn as_root(&self) -> String {
        self.as_root.clone()
    }
}
