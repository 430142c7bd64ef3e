//! A hob, a daemon and commands, each a process; they end with the test.

use std::path::Path;
use std::process::{Command, Output};
use std::sync::{Mutex, MutexGuard, PoisonError};

use ihd_fakes::free_address;
use serde_json::Value;
use tempfile::TempDir;

use crate::process::{Hob, Process, wait_for};

pub fn ihd() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
    command
        .env_remove("RUST_BACKTRACE")
        .env_remove("RUST_LOG")
        .env_remove("IHD_TOKEN")
        .env_remove("NOTIFY_SOCKET");
    command
}

/// One kitchen at a time: a hob follows the wall's clock, and several on a busy machine lag.
pub fn alone() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A daemon of one hob behind a port, its folder and its configuration.
pub struct Kitchen {
    pub daemon: Process,
    pub hob: Hob,
    pub dir: TempDir,
    _alone: MutexGuard<'static, ()>,
}

impl Kitchen {
    pub fn start() -> Self {
        let alone = alone();
        let dir = tempfile::tempdir().unwrap();
        let hob = Hob::start();
        let listen = free_address();
        let text = format!(
            "store = {:?}\nlisten = \"{listen}\"\n\
             [[device]]\nname = \"bench\"\naddress = \"{}\"\n",
            dir.path().join("store"),
            hob.place()
        );
        std::fs::write(dir.path().join("ihd.toml"), text).unwrap();
        let daemon = daemon(&dir.path().join("ihd.toml"));
        let kitchen = Self {
            daemon,
            hob,
            dir,
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
        let poll = || Some(self.report()).filter(|report| is(report));
        wait_for(poll, || format!("{what}: never; {:#}", self.report()))
    }

    /// Another command with this configuration.
    pub fn command(&self, args: &[&str]) -> (i32, String, String) {
        command(&self.dir.path().join("ihd.toml"), args)
    }

    /// `ihd device bench …`, which goes on meanwhile.
    pub fn in_the_background(&self, args: &[&str]) -> Process {
        self.command_in_the_background(&[&["device"], args].concat())
    }

    /// Another command, which goes on meanwhile.
    pub fn command_in_the_background(&self, args: &[&str]) -> Process {
        let mut command = ihd();
        command
            .args(args)
            .arg("--config")
            .arg(self.dir.path().join("ihd.toml"));
        Process::start(&mut command, false)
    }
}

/// A daemon that listens.
pub fn daemon(config: &Path) -> Process {
    let mut daemon = Process::start(&mut daemon_command(config), true);
    daemon.line_with("the daemon listens");
    daemon
}

pub fn daemon_command(config: &Path) -> Command {
    let mut command = ihd();
    command
        .args(["trainer", "--daemon", "--config"])
        .arg(config);
    command
}

/// `ihd device …`: exit code, standard output, standard error.
pub fn device(config: &Path, args: &[&str]) -> (i32, String, String) {
    command(config, &[&["device"], args].concat())
}

/// A command with a configuration: exit code, standard output, standard error.
pub fn command(config: &Path, args: &[&str]) -> (i32, String, String) {
    let mut command = ihd();
    command.args(args).arg("--config").arg(config);
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
