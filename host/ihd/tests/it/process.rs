//! Processes of tests, which end with them; `ihd hob` among them.

use std::io::{BufRead, BufReader, PipeWriter, Read};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest wait for an event; it only ends a hang.
pub const PATIENCE: Duration = Duration::from_secs(300);

/// Polls until there is a value; the text of `late` tells of a hang.
#[cfg(all(feature = "pinn", unix))]
pub fn wait_for<T>(mut poll: impl FnMut() -> Option<T>, late: impl FnOnce() -> String) -> T {
    let until = Instant::now() + PATIENCE;
    loop {
        if let Some(value) = poll() {
            return value;
        }
        if Instant::now() >= until {
            panic!("{}", late());
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Standard output or error whose reader is gone.
pub fn closed_pipe() -> PipeWriter {
    let (_, writer) = std::io::pipe().expect("a pipe");
    writer
}

/// A process whose lines are read as they come; killed at the end.
pub struct Process {
    child: Child,
    lines: Receiver<String>,
    /// Everything that was read so far.
    pub said: String,
    /// Reads its standard output, where the lines are those of standard error.
    output: Option<JoinHandle<String>>,
}

impl Process {
    /// Starts it; the lines are those of its standard output, or of its standard error.
    pub fn start(command: &mut Command, stderr: bool) -> Self {
        command.stdout(Stdio::piped());
        if stderr {
            command.stderr(Stdio::piped());
        }
        let mut child = command.spawn().expect("it starts");
        let mut stdout = child.stdout.take().expect("piped");
        let (tx, lines) = channel();
        let (from, output): (Box<dyn Read + Send>, _) = match child.stderr.take() {
            None => (Box::new(stdout), None),
            Some(stderr) => {
                let read = std::thread::spawn(move || {
                    let mut text = String::new();
                    stdout.read_to_string(&mut text).expect("UTF-8");
                    text
                });
                (Box::new(stderr), Some(read))
            }
        };
        // To its end: with nobody to read, it would end at its next line.
        std::thread::spawn(move || {
            for line in BufReader::new(from).lines().map_while(Result::ok) {
                let _ = tx.send(line);
            }
        });
        Self {
            child,
            lines,
            said: String::new(),
            output,
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

    /// Kills it, which it cannot catch, and waits for its end.
    pub fn kill(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Exit code of a process, once it has ended; -1 where a signal ended it.
#[cfg(all(feature = "pinn", unix))]
pub fn exit_code(child: &mut Child, said: impl FnOnce() -> String) -> i32 {
    let status = wait_for(
        || child.try_wait().expect("a child"),
        || format!("it does not end:\n{}", said()),
    );
    status.code().unwrap_or(-1)
}

#[cfg(all(feature = "pinn", unix))]
impl Process {
    /// Sends a signal: `TERM`.
    pub fn signal(&self, name: &str) {
        let sent = Command::new("kill")
            .args([&format!("-{name}"), &self.child.id().to_string()])
            .status();
        assert!(sent.expect("kill runs").success());
    }

    /// Its exit code, once it has ended; -1 where a signal ended it.
    pub fn code(&mut self) -> i32 {
        exit_code(&mut self.child, || self.said.clone())
    }

    /// Exit code, standard output and standard error, after its end; of a process whose lines are those of standard error.
    pub fn ended(mut self) -> (i32, String, String) {
        let code = self.code();
        let output = self.output.take().expect("its errors are read");
        for line in &self.lines {
            self.said += &format!("{line}\n");
        }
        let said = std::mem::take(&mut self.said);
        assert!(!said.contains("panicked"), "{said}");
        (code, output.join().expect("it is read"), said)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// `ihd hob` behind a port.
pub struct Hob {
    /// It prints who comes and goes.
    pub process: Process,
    /// `127.0.0.1:4711`.
    pub address: String,
}

impl Hob {
    /// On a port that the system chooses.
    pub fn start() -> Self {
        Self::start_with(&["--listen", "127.0.0.1:0"])
    }

    /// With these arguments.
    pub fn start_with(args: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
        command.env_remove("RUST_BACKTRACE").arg("hob").args(args);
        let mut process = Process::start(&mut command, false);
        let line = process.line_with("tcp:");
        let address = line
            .split_once("tcp:")
            .and_then(|(_, rest)| rest.split_once(';'));
        let (address, _) = address.unwrap_or_else(|| panic!("{line:?}"));
        Self {
            address: address.to_owned(),
            process,
        }
    }

    /// Address, as `--device` takes it.
    pub fn place(&self) -> String {
        format!("tcp:{}", self.address)
    }

    /// Waits until the next host has left; returns the power in watt that it left asked for. Whoever connected to ask would end it.
    #[cfg(all(feature = "pinn", unix))]
    pub fn left_with_w(&mut self) -> u32 {
        let line = self.process.line_with("disconnected");
        let power = line
            .split_once("; ")
            .and_then(|(_, rest)| rest.split_once(" W"));
        power.map_or(0, |(power_w, _)| power_w.parse().expect("a number"))
    }
}
