//! How `ihd trainer` ends: a signal, a hob that goes away, one that comes back.
#![cfg(unix)]

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use ihd_link::{Client, DeviceSpec};
use ihd_shared::wire::messages::State;
use serde_json::Value;

/// Longest wait for an event; it only ends a hang.
const PATIENCE: Duration = Duration::from_secs(300);

/// A process that ends with the test, and what it says on standard error.
struct Process {
    child: Child,
    lines: Receiver<String>,
    said: String,
}

impl Process {
    fn start(args: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
        command
            .args(args)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = command.spawn().expect("ihd runs");
        let (tx, lines) = channel();
        let stderr = BufReader::new(child.stderr.take().expect("piped"));
        std::thread::spawn(move || {
            for line in stderr.lines().map_while(Result::ok) {
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

    /// Waits for a line on standard error that holds `word`.
    fn says(&mut self, word: &str) {
        let until = Instant::now() + PATIENCE;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left) {
                Ok(line) => {
                    self.said += &format!("{line}\n");
                    if line.contains(word) {
                        return;
                    }
                }
                Err(e) => panic!("{word:?} was never said ({e}):\n{}", self.said),
            }
        }
    }

    fn signal(&self, name: &str) {
        let kill = Command::new("kill")
            .args([name, &self.child.id().to_string()])
            .status();
        assert!(kill.expect("kill runs").success());
    }

    /// Exit code, standard output and standard error, after its end.
    fn ended(mut self) -> (Option<i32>, String, String) {
        let until = Instant::now() + PATIENCE;
        let status: ExitStatus = loop {
            match self.child.try_wait().expect("a child") {
                Some(status) => break status,
                None if Instant::now() > until => panic!("it does not end"),
                None => std::thread::sleep(Duration::from_millis(20)),
            }
        };
        let mut out = String::new();
        if let Some(stdout) = &mut self.child.stdout {
            stdout.read_to_string(&mut out).expect("UTF-8");
        }
        for line in &self.lines {
            self.said += &format!("{line}\n");
        }
        let err = std::mem::take(&mut self.said);
        assert!(!err.contains("panicked"), "{err}");
        (status.code(), out, err)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// `ihd hob` on a port, what it prints kept open.
struct Hob {
    _process: Process,
    _stdout: BufReader<ChildStdout>,
    address: String,
}

impl Hob {
    fn start(listen: &str) -> Self {
        let mut process = Process::start(&["hob", "--listen", listen]);
        let mut stdout = BufReader::new(process.child.stdout.take().expect("piped"));
        let mut line = String::new();
        stdout.read_line(&mut line).expect("UTF-8");
        let rest = line.split_once("tcp:").map(|(_, rest)| rest);
        let address = rest.and_then(|rest| rest.split_once(';'));
        let (address, _) = address.unwrap_or_else(|| panic!("{line:?}"));
        Self {
            _process: process,
            address: address.to_owned(),
            _stdout: stdout,
        }
    }

    fn device(&self) -> String {
        format!("tcp:{}", self.address)
    }

    /// What is asked of it; connects when the port is free.
    fn asked_w(&self) -> (State, u16) {
        let spec: DeviceSpec = self.device().parse().unwrap();
        let until = Instant::now() + PATIENCE;
        let mut client = loop {
            let open = spec.open(|| unreachable!("not asked for"));
            match open.and_then(Client::connect) {
                Ok(client) => break client,
                Err(why) if Instant::now() > until => panic!("{why}"),
                Err(_) => std::thread::sleep(Duration::from_millis(50)),
            }
        };
        let status = client.status().unwrap();
        (status.state, status.asked_w)
    }
}

/// `ihd trainer` with a store of its own.
fn trainer(device: &str, store: &Path, rest: &[&str]) -> Process {
    let store = store.to_str().expect("UTF-8");
    let mut args = vec!["trainer", "--json", "--device", device, "--store", store];
    args.extend(rest);
    Process::start(&args)
}

/// Waits until a point has been found and kept: the second lookup comes with the point after it.
fn until_a_point_is_found(store: &Path) {
    let until = Instant::now() + PATIENCE;
    let lookups = || {
        let files = std::fs::read_dir(store.join("run-001"));
        let names = files.into_iter().flatten().flatten();
        let names = names.map(|file| file.file_name().to_string_lossy().into_owned());
        let is_lookup = |name: &String| name.starts_with("lookup-v") && name.ends_with(".json");
        names.filter(is_lookup).count()
    };
    while lookups() < 2 {
        assert!(Instant::now() < until, "it finds nothing");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn report(out: &str) -> Value {
    serde_json::from_str(out).unwrap_or_else(|e| panic!("{e}: {out}"))
}

fn points(report: &Value) -> usize {
    report["points"].as_array().map_or(0, Vec::len)
}

/// Far more powers than there is time for.
const LONG: &str = "1500,2000,1000,700,1500,2000,1000,700,1500,2000,1000,700,1500,2000,1000,700,1500,2000,1000,700";

#[test]
fn a_signal_ends_a_plain_run_with_the_hob_off_and_what_was_found() {
    let hob = Hob::start("127.0.0.1:0");
    for signal in ["-INT", "-TERM"] {
        let store = tempfile::tempdir().unwrap();
        let trainer = trainer(&hob.device(), store.path(), &["--power", LONG]);
        until_a_point_is_found(store.path());
        trainer.signal(signal);
        let (code, out, err) = trainer.ended();
        assert_eq!(code, Some(1), "{err}");
        assert!(err.contains("interrupted"), "{err}");
        let report = report(&out);
        assert!(points(&report) >= 1, "{report:#}");
        assert_eq!(report["error"], "interrupted");
        assert_eq!(hob.asked_w(), (State::Idle, 0));
    }
}

#[test]
fn a_hob_that_goes_away_leaves_what_was_found_and_exits_with_3() {
    let hob = Hob::start("127.0.0.1:0");
    let store = tempfile::tempdir().unwrap();
    let trainer = trainer(&hob.device(), store.path(), &["--power", LONG]);
    until_a_point_is_found(store.path());
    drop(hob);
    let (code, out, err) = trainer.ended();
    assert_eq!(code, Some(3), "{err}");
    let report = report(&out);
    assert!(points(&report) >= 1, "{report:#}");
    let error = report["error"].as_str().unwrap_or_default();
    assert!(error.contains("could not be switched off"), "{report:#}");
}

/// A hob that was started anew is not switched on again: somebody has had a hand in it.
#[test]
fn following_survives_a_hob_that_comes_back_and_a_signal_is_its_ordinary_end() {
    let hob = Hob::start("127.0.0.1:0");
    let address = hob.address.clone();
    let store = tempfile::tempdir().unwrap();
    let follow = ["--power", "1500", "--follow"];
    let mut trainer = trainer(&hob.device(), store.path(), &follow);
    trainer.says("active on the device");
    drop(hob);
    trainer.says("trying again for 60 s");
    let hob = Hob::start(&address);
    trainer.says("connected again; it has started anew");
    trainer.signal("-INT");
    let (code, out, err) = trainer.ended();
    assert_eq!(code, Some(0), "{err}");
    let report = report(&out);
    assert!(
        points(&report) >= 1 && report["error"].is_null(),
        "{report:#}"
    );
    assert_eq!(hob.asked_w(), (State::Idle, 0));
}
