//! How `ihd trainer` ends: a signal, a hob that goes away, one that comes back.
#![cfg(unix)]

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use ihd_link::{Client, DeviceSpec};
use ihd_shared::wire::messages::State;
use serde_json::Value;

/// A process that ends with the test.
struct Process(Child);

impl Process {
    fn start(args: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
        command
            .args(args)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        Self(command.spawn().expect("ihd runs"))
    }

    fn signal(&self, name: &str) {
        let kill = Command::new("kill")
            .args([name, &self.0.id().to_string()])
            .status();
        assert!(kill.expect("kill runs").success());
    }

    /// What it printed in all, after its end within some seconds.
    fn ended(mut self, within: Duration) -> (Option<i32>, String, String) {
        let until = Instant::now() + within;
        let status: ExitStatus = loop {
            match self.0.try_wait().expect("a child") {
                Some(status) => break status,
                None if Instant::now() > until => panic!("it does not end"),
                None => std::thread::sleep(Duration::from_millis(20)),
            }
        };
        let mut texts = [String::new(), String::new()];
        if let Some(out) = &mut self.0.stdout {
            out.read_to_string(&mut texts[0]).expect("UTF-8");
        }
        if let Some(err) = &mut self.0.stderr {
            err.read_to_string(&mut texts[1]).expect("UTF-8");
        }
        let [out, err] = texts;
        assert!(!err.contains("panicked"), "{err}");
        (status.code(), out, err)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
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
        let mut stdout = BufReader::new(process.0.stdout.take().expect("piped"));
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
        let until = Instant::now() + Duration::from_secs(5);
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

fn trainer(device: &str, rest: &[&str]) -> Process {
    let mut args = vec!["trainer", "--no-store", "--json", "--device", device];
    args.extend(rest);
    Process::start(&args)
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
    for signal in ["-INT", "-TERM"] {
        let hob = Hob::start("127.0.0.1:0");
        let trainer = trainer(&hob.device(), &["--power", LONG]);
        std::thread::sleep(Duration::from_secs(6));
        trainer.signal(signal);
        let (code, out, err) = trainer.ended(Duration::from_secs(10));
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
    let trainer = trainer(&hob.device(), &["--power", LONG]);
    std::thread::sleep(Duration::from_secs(6));
    drop(hob);
    let (code, out, err) = trainer.ended(Duration::from_secs(30));
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
    let trainer = trainer(&hob.device(), &["--power", "1500", "--follow"]);
    std::thread::sleep(Duration::from_secs(6));
    drop(hob);
    std::thread::sleep(Duration::from_secs(1));
    let hob = Hob::start(&address);
    std::thread::sleep(Duration::from_secs(5));
    trainer.signal("-INT");
    let (code, out, err) = trainer.ended(Duration::from_secs(10));
    assert_eq!(code, Some(0), "{err}");
    assert!(err.contains("trying again for 60 s"), "{err}");
    assert!(
        err.contains("connected again; it has started anew"),
        "{err}"
    );
    let report = report(&out);
    assert!(
        points(&report) >= 1 && report["error"].is_null(),
        "{report:#}"
    );
    assert_eq!(hob.asked_w(), (State::Idle, 0));
}
