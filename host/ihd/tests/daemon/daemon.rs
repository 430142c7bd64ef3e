//! The daemon as a process, with a configuration and a store of its own.

use std::fs;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use ihd_fakes::free_address;
use serde_json::Value;

use crate::http;
use crate::process::{PATIENCE, Process, ihd};

/// A daemon that is running, or has been.
pub struct Daemon {
    pub process: Process,
    pub address: SocketAddr,
    pub folder: PathBuf,
}

/// Writes `ihd.toml` into a folder; returns the address that it listens on. `more` stands before the devices.
pub fn configure(
    folder: &Path,
    more: &str,
    devices: &[(String, SocketAddr)],
) -> io::Result<SocketAddr> {
    let address = free_address();
    let mut text = format!("store = \"store\"\nlisten = \"{address}\"\n{more}\n");
    for (name, at) in devices {
        text += &format!("[[device]]\nname = \"{name}\"\naddress = \"tcp:{at}\"\n");
    }
    fs::write(folder.join("ihd.toml"), text)?;
    Ok(address)
}

impl Daemon {
    /// Starts it on a configured folder, and waits until it answers. Its log goes to `daemon.log` there.
    pub fn start(folder: &Path, address: SocketAddr) -> io::Result<Self> {
        Self::start_as(ihd(folder), folder, address)
    }

    /// Starts it by this command: [`Daemon::start`].
    pub fn start_as(mut command: Command, folder: &Path, address: SocketAddr) -> io::Result<Self> {
        let log = fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(folder.join("daemon.log"))?;
        command
            .args(["trainer", "--daemon", "--config", "ihd.toml"])
            .stdout(Stdio::from(log.try_clone()?))
            .stderr(Stdio::from(log));
        let mut daemon = Self {
            process: Process::spawn(&mut command)?,
            address,
            folder: folder.to_owned(),
        };
        let began = Instant::now();
        while !daemon.is_healthy(Duration::from_secs(1)) {
            if let Some(status) = daemon.process.ended() {
                return Err(io::Error::other(format!("{status}: {}", daemon.log_tail())));
            }
            if began.elapsed() > PATIENCE {
                return Err(io::Error::other(format!(
                    "no answer: {}",
                    daemon.log_tail()
                )));
            }
            thread::sleep(Duration::from_millis(20));
        }
        Ok(daemon)
    }

    pub fn is_healthy(&self, timeout: Duration) -> bool {
        matches!(
            http::ask(self.address, "GET", "/healthz", "", timeout),
            Ok((200, _))
        )
    }

    /// The devices as the daemon sees them.
    pub fn devices(&self) -> io::Result<Vec<Value>> {
        match http::get(self.address, "/api/v1/devices")? {
            Value::Array(devices) => Ok(devices),
            other => Err(io::Error::other(format!("no list: {other}"))),
        }
    }

    /// Takes the lease of a device and asks for power.
    pub fn heat(&self, device: &str, power_w: u16) -> io::Result<()> {
        let at = format!("/api/v1/devices/{device}");
        let (status, said) = http::ask(
            self.address,
            "PUT",
            &format!("{at}/lease"),
            "{\"force\":true}",
            PATIENCE,
        )?;
        if status != 200 {
            return Err(io::Error::other(format!("lease: {status} {said}")));
        }
        let power = format!("{{\"command\":\"power\",\"power_w\":{power_w}}}");
        match http::ask(
            self.address,
            "POST",
            &format!("{at}/commands"),
            &power,
            PATIENCE,
        )? {
            (200, _) => Ok(()),
            (status, said) => Err(io::Error::other(format!("power: {status} {said}"))),
        }
    }

    /// All of `GET /metrics`.
    pub fn metrics(&self) -> String {
        http::ask(self.address, "GET", "/metrics", "", PATIENCE)
            .map_or_else(|e| e.to_string(), |(_, text)| text)
    }

    /// Ends it in order; whether it did, with exit code 0.
    pub fn stop(&mut self) -> bool {
        self.process.terminate();
        self.process
            .wait(PATIENCE)
            .is_some_and(|status| status.success())
    }

    /// Waits until the devices are as wanted; their reports then.
    pub fn until(&mut self, what: &str, wanted: impl Fn(&[Value]) -> bool) -> Vec<Value> {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let devices = self.devices();
            if let Ok(devices) = &devices
                && wanted(devices)
            {
                return devices.clone();
            }
            assert!(self.process.ended().is_none(), "{}", self.log_tail());
            assert!(Instant::now() < deadline, "never: {what}; {devices:#?}");
            self.process.rss();
            thread::sleep(Duration::from_millis(100));
        }
    }

    pub fn log_tail(&self) -> String {
        let text = fs::read_to_string(self.folder.join("daemon.log")).unwrap_or_default();
        let lines: Vec<_> = text.lines().collect();
        lines[lines.len().saturating_sub(15)..].join("\n")
    }
}

/// `ihd store ARGUMENTS --json` on the daemon's store.
pub fn store(folder: &Path, arguments: &[&str]) -> io::Result<Value> {
    let output = ihd(folder)
        .arg("store")
        .args(arguments)
        .args(["--config", "ihd.toml", "--json"])
        .output()?;
    serde_json::from_slice(&output.stdout).map_err(|e| {
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        io::Error::other(format!(
            "ihd store {arguments:?}: {e}; {} {said}",
            output.status
        ))
    })
}

/// Asks `/healthz` four times a second for as long as it lives.
pub struct Pulse {
    stop: Arc<AtomicBool>,
    worst_ms: Arc<AtomicU64>,
    missed: Arc<AtomicU64>,
}

impl Pulse {
    /// Starts to ask; answers that do not come are counted as missed.
    pub fn start(address: SocketAddr) -> Self {
        let pulse = Self {
            stop: Arc::default(),
            worst_ms: Arc::default(),
            missed: Arc::default(),
        };
        let own = (
            Arc::clone(&pulse.stop),
            Arc::clone(&pulse.worst_ms),
            Arc::clone(&pulse.missed),
        );
        thread::spawn(move || {
            while !own.0.load(Relaxed) {
                let began = Instant::now();
                let answer = http::ask(address, "GET", "/healthz", "", PATIENCE);
                let took = began.elapsed();
                own.1.fetch_max(took.as_millis() as u64, Relaxed);
                // One that says that the store is slow is an answer. The daemon may have ended meanwhile.
                if answer.is_err() && !own.0.load(Relaxed) {
                    own.2.fetch_add(1, Relaxed);
                }
                thread::sleep(Duration::from_millis(250));
            }
        });
        pulse
    }

    /// Longest answer in milliseconds, for whoever reads what a test prints, and how many were missed.
    pub fn seen(&self) -> (u64, u64) {
        (self.worst_ms.load(Relaxed), self.missed.load(Relaxed))
    }
}

impl Drop for Pulse {
    fn drop(&mut self) {
        self.stop.store(true, Relaxed);
    }
}
