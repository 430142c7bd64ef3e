//! `ihd` as a process: started, watched, killed.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use std::{fs, io, thread};

/// Longest wait for an event; it only ends a hang.
pub const PATIENCE: Duration = Duration::from_secs(300);

/// The command under test, of this build or of `IHD_BIN`.
pub fn ihd(folder: &Path) -> Command {
    let built = env!("CARGO_BIN_EXE_ihd").into();
    let mut command = Command::new(std::env::var_os("IHD_BIN").unwrap_or(built));
    command.current_dir(folder).stdin(Stdio::null());
    command
}

/// The command of [`ihd`], to which a limit of its files' size is an error and no signal.
pub fn ihd_with_limits(folder: &Path) -> Command {
    let plain = ihd(folder);
    let mut command = Command::new("sh");
    command.args(["-c", "trap '' XFSZ; exec \"$0\" \"$@\""]);
    command.arg(plain.get_program());
    command.current_dir(folder).stdin(Stdio::null());
    command
}

/// A process that does not outlive its owner.
pub struct Process {
    /// The process.
    pub child: Child,
    /// Most memory that it was seen to have, in bytes.
    pub peak_rss: u64,
}

impl Process {
    pub fn spawn(command: &mut Command) -> io::Result<Self> {
        Ok(Self {
            child: command.spawn()?,
            peak_rss: 0,
        })
    }

    /// `kill -9`, and its end.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Asks it to end (SIGTERM).
    pub fn terminate(&self) {
        let _ = Command::new("kill")
            .arg(self.child.id().to_string())
            .status();
    }

    /// Limits the size of its files, in bytes; `None` for no limit.
    pub fn limit_files(&self, bytes: Option<u64>) {
        let soft = bytes.map_or_else(|| "unlimited".to_owned(), |bytes| bytes.to_string());
        let pid = self.child.id().to_string();
        let limit = format!("--fsize={soft}:unlimited");
        let status = Command::new("prlimit")
            .args(["--pid", &pid, &limit])
            .status();
        assert!(
            status.is_ok_and(|status| status.success()),
            "prlimit (util-linux)"
        );
    }

    /// Returns the exit status; `None` while it runs.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().ok().flatten()
    }

    /// Its end, watched for at most `within`; none where it goes on.
    pub fn wait(&mut self, within: Duration) -> Option<ExitStatus> {
        let deadline = Instant::now() + within;
        loop {
            self.rss();
            if let Some(status) = self.ended() {
                return Some(status);
            }
            if Instant::now() >= deadline {
                return None;
            }
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// Memory that it has now, in bytes; 0 once it has ended.
    pub fn rss(&mut self) -> u64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id()));
        let field = |name: &str| {
            let line = status
                .as_deref()
                .ok()?
                .lines()
                .find(|l| l.starts_with(name))?;
            line.split_whitespace().nth(1)?.parse::<u64>().ok()
        };
        self.peak_rss = self.peak_rss.max(1024 * field("VmHWM:").unwrap_or(0));
        1024 * field("VmRSS:").unwrap_or(0)
    }

    /// Processor time that it has taken, in seconds.
    pub fn processor_s(&self) -> f64 {
        processor_s(self.child.id())
    }
}

/// Processor time that a process has taken, in seconds; 0 once it has ended.
pub fn processor_s(pid: u32) -> f64 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    let fields: Vec<_> = stat
        .rsplit(')')
        .next()
        .unwrap_or("")
        .split_whitespace()
        .collect();
    let ticks = |k: usize| {
        fields
            .get(k)
            .and_then(|f| f.parse::<f64>().ok())
            .unwrap_or(0.0)
    };
    (ticks(11) + ticks(12)) / 100.0
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A simulated hob as a process of its own, and its port.
pub struct Hob {
    pub process: Process,
    pub address: SocketAddr,
}

impl Hob {
    /// `ihd hob --listen 127.0.0.1:0` with more options.
    pub fn start(folder: &Path, options: &[&str]) -> io::Result<Self> {
        let mut command = ihd(folder);
        command
            .args(["hob", "--listen", "127.0.0.1:0"])
            .args(options);
        let mut process = Process::spawn(command.stdout(Stdio::piped()))?;
        let mut lines = BufReader::new(process.child.stdout.take().expect("piped")).lines();
        let first = lines.next().transpose()?.unwrap_or_default();
        // Nobody reads the rest, and nothing may wait for it.
        thread::spawn(move || lines.for_each(drop));
        let address = first
            .split("tcp:")
            .nth(1)
            .and_then(|rest| rest.split(';').next())
            .and_then(|address| address.parse().ok());
        match address {
            Some(address) => Ok(Self { process, address }),
            None => Err(io::Error::other(format!("it says {first:?}"))),
        }
    }
}
