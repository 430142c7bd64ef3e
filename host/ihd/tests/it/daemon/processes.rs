//! A hob, a daemon and commands, each a process; they end with the test.

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

/// Longest wait for an event; it only ends a hang.
pub const PATIENCE: Duration = Duration::from_secs(300);

pub fn ihd() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
    command
        .env_remove("RUST_BACKTRACE")
        .env_remove("RUST_LOG")
        .env_remove("IHD_TOKEN")
        .env_remove("NOTIFY_SOCKET");
    command
}

/// A process whose lines are read as they come; killed at the end.
pub struct Process {
    child: Child,
    lines: Receiver<String>,
    /// Everything that was read so far.
    pub said: String,
}

impl Process {
    /// Starts it; its standard output is read, or its standard error.
    pub fn start(command: &mut Command, stderr: bool) -> Self {
        match stderr {
            true => command.stderr(Stdio::piped()).stdout(Stdio::null()),
            false => command.stdout(Stdio::piped()).stderr(Stdio::inherit()),
        };
        let mut child = command.spawn().expect("it starts");
        let (tx, lines) = channel();
        let from: Box<dyn std::io::Read + Send> = match stderr {
            true => Box::new(child.stderr.take().unwrap()),
            false => Box::new(child.stdout.take().unwrap()),
        };
        std::thread::spawn(move || {
            for line in BufReader::new(from).lines().map_while(Result::ok) {
                if tx.send(line).is_err() {
                    return;
                }
            }
        });
        Self {
            child,
            lines,
            said: String::new(),
        }
    }

    /// The first line from now on that holds `word`.
    pub fn line_with(&mut self, word: &str) -> String {
        let until = Instant::now() + PATIENCE;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left) {
                Ok(line) => {
                    self.said += &format!("{line}\n");
                    if line.contains(word) {
                        return line;
                    }
                }
                Err(e) => panic!("{word:?} was never said ({e}):\n{}", self.said),
            }
        }
    }

    #[cfg(unix)]
    pub fn signal(&self, name: &str) {
        let sent = Command::new("kill")
            .args([&format!("-{name}"), &self.child.id().to_string()])
            .status();
        assert!(sent.unwrap().success());
    }

    /// Its exit code, once it has ended.
    pub fn code(&mut self) -> i32 {
        let until = Instant::now() + PATIENCE;
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code().unwrap_or(-1);
            }
            assert!(Instant::now() < until, "it does not end:\n{}", self.said);
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// One kitchen at a time: a hob follows the wall's clock, and several on a busy machine lag.
pub fn alone() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A simulated hob behind a port, and its address.
pub fn hob() -> (Process, String) {
    let mut command = ihd();
    command.args(["hob", "--listen", "127.0.0.1:0"]);
    let mut hob = Process::start(&mut command, false);
    let line = hob.line_with("tcp:");
    let (_, rest) = line.split_once("tcp:").unwrap();
    let address = rest.split(';').next().unwrap().trim().to_owned();
    (hob, address)
}

/// A port that is free now.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().port()
}

/// A daemon of one hob behind a port, its folder and its configuration.
pub struct Kitchen {
    pub daemon: Process,
    pub hob: Process,
    pub dir: TempDir,
    pub hob_address: String,
    _alone: MutexGuard<'static, ()>,
}

impl Kitchen {
    pub fn start() -> Self {
        let alone = alone();
        let dir = tempfile::tempdir().unwrap();
        let (hob, hob_address) = hob();
        let port = free_port();
        let text = format!(
            "store = {:?}\nlisten = \"127.0.0.1:{port}\"\n\
             [[device]]\nname = \"bench\"\naddress = \"tcp:{hob_address}\"\n",
            dir.path().join("store")
        );
        std::fs::write(dir.path().join("ihd.toml"), text).unwrap();
        let daemon = daemon(&dir.path().join("ihd.toml"));
        let kitchen = Self {
            daemon,
            hob,
            dir,
            hob_address,
            _alone: alone,
        };
        kitchen.until("it is connected", |report| report["state"] == "idle");
        kitchen
    }

    /// Another daemon on the same port and the same store, at once.
    pub fn start_daemon_again(&mut self) {
        self.daemon = daemon(&self.dir.path().join("ihd.toml"));
    }

    /// `ihd device …` with this configuration.
    pub fn device(&self, args: &[&str]) -> (i32, String, String) {
        let config = self.dir.path().join("ihd.toml");
        device(&config, args)
    }

    /// The state of the device as the daemon tells it.
    pub fn report(&self) -> Value {
        let (code, stdout, stderr) = self.device(&["bench", "status", "--json"]);
        assert_eq!(code, 0, "{stderr}");
        serde_json::from_str(&stdout).unwrap()
    }

    /// Waits until the device is as it should be.
    pub fn until(&self, what: &str, is: impl Fn(&Value) -> bool) -> Value {
        let until = Instant::now() + PATIENCE;
        loop {
            let report = self.report();
            if is(&report) {
                return report;
            }
            assert!(Instant::now() < until, "{what}: never; {report:#}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// `ihd device bench …`, which goes on meanwhile.
    pub fn in_the_background(&self, args: &[&str]) -> Process {
        let mut command = ihd();
        command
            .arg("device")
            .args(args)
            .arg("--config")
            .arg(self.dir.path().join("ihd.toml"));
        Process::start(&mut command, false)
    }
}

/// A daemon that listens.
pub fn daemon(config: &Path) -> Process {
    let mut command = ihd();
    command
        .args(["trainer", "--daemon", "--config"])
        .arg(config);
    let mut daemon = Process::start(&mut command, true);
    daemon.line_with("the daemon listens");
    daemon
}

/// `ihd device …`: exit code, standard output, standard error.
pub fn device(config: &Path, args: &[&str]) -> (i32, String, String) {
    let mut command = ihd();
    command.arg("device").args(args).arg("--config").arg(config);
    outcome(command.output().expect("ihd runs"))
}

/// `ihd device …` with a `--for` or a number of powers that grows until the hob has heated (exit code 4 is that it has not): it takes
/// time to begin, which on a busy machine is longer by the wall's clock.
pub fn heated(config: &Path, args: impl Fn(usize) -> Vec<String>) -> (String, usize) {
    let mut times = 1;
    loop {
        let args = args(times);
        let args: Vec<_> = args.iter().map(String::as_str).collect();
        let (code, stdout, stderr) = device(config, &args);
        if code == 0 {
            return (stdout, times);
        }
        assert!(code == 4 && times < 32, "{code}: {stderr}");
        times *= 2;
    }
}

pub fn outcome(output: Output) -> (i32, String, String) {
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    let stderr = text(output.stderr);
    assert!(!stderr.contains("panicked"), "{stderr}");
    let code = output.status.code().expect("an exit code");
    (code, text(output.stdout), stderr)
}

/// What the hob itself says it was asked for, in watt, over its one link; the daemon must be gone.
pub fn asked_w_directly(address: &str) -> u64 {
    let dir = tempfile::tempdir().unwrap();
    let config = dir.path().join("ihd.toml");
    let text = format!("listen = \"127.0.0.1:{}\"\n", free_port());
    std::fs::write(&config, text).unwrap();
    let place = format!("tcp:{address}");
    let until = Instant::now() + PATIENCE;
    let stdout = loop {
        let (code, stdout, stderr) = device(&config, &[&place, "status", "--json"]);
        if code == 0 {
            break stdout;
        }
        // The hob may not know yet that the host before is gone.
        assert!(code == 3 && Instant::now() < until, "{stderr}");
    };
    let report: Value = serde_json::from_str(&stdout).unwrap();
    report["live"]["asked_w"].as_u64().unwrap()
}
