//! `ihd doctor` as a user calls it: reports, JSON, exit codes. The machine that runs the tests may have boards and probes,
//! or not: nothing here depends on it.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Output, Stdio};

use ihd_store::{Store, StoreOptions};
use serde_json::Value;

fn ihd(args: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
    command
        .env_remove("RUST_BACKTRACE")
        .stdin(Stdio::null())
        .args(args.split_whitespace());
    command
}

fn run(args: &str) -> (i32, String, String) {
    let Output {
        status,
        stdout,
        stderr,
    } = ihd(args).output().expect("ihd runs");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    let stderr = text(stderr);
    assert!(!stderr.contains("panicked"), "{args}: {stderr}");
    (status.code().expect("an exit code"), text(stdout), stderr)
}

fn json(args: &str) -> (i32, Value) {
    let (code, stdout, stderr) = run(args);
    let report = serde_json::from_str(&stdout);
    (
        code,
        report.unwrap_or_else(|e| panic!("{e}: {stdout} {stderr}")),
    )
}

/// Verdicts of a group, by check.
fn group<'a>(report: &'a Value, name: &str) -> Vec<(&'a str, &'a str)> {
    let groups = report["groups"].as_array().expect("groups");
    let group = groups.iter().find(|group| group["name"] == name);
    let checks = group.unwrap_or_else(|| panic!("no {name}"))["checks"].as_array();
    let text = |check: &'a Value, name: &str| check[name].as_str().expect("text");
    let checks = checks.expect("checks").iter();
    checks
        .map(|check| (text(check, "name"), text(check, "verdict")))
        .collect()
}

/// Failed checks besides those of the machine that the tests run on.
fn failed<'a>(report: &'a Value, groups: &[&str]) -> Vec<&'a str> {
    let all = groups.iter().flat_map(|name| group(report, name));
    all.filter(|(_, verdict)| *verdict == "fail")
        .map(|(name, _)| name)
        .collect()
}

#[test]
fn a_simulated_hob_of_a_configuration_is_checked_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let text = "[[device]]\nname = \"bench\"\naddress = \"sim\"\n";
    fs::write(folder.path().join("ihd.toml"), text).unwrap();
    let mut doctor = ihd("doctor bench --json");
    let output = doctor.current_dir(folder.path()).output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["device"], "bench");
    assert!(group(&report, "firmware").contains(&("connection", "pass")));
}

#[test]
fn the_simulated_hob_is_well() {
    let (_, report) = json("doctor sim --json");
    assert_eq!(report["format"], 1);
    assert_eq!(report["device"], "sim");
    assert_eq!(failed(&report, &["firmware", "board"]), [] as [&str; 0]);
    assert!(group(&report, "board").contains(&("link_from_device", "pass")));
    let machine = group(&report, "machine");
    assert!(
        machine.iter().any(|(name, _)| *name == "debug_probe"),
        "{machine:?}"
    );
    let counts = &report["counts"];
    let total: u64 = ["pass", "fail", "not_tested"]
        .iter()
        .filter_map(|k| counts[*k].as_u64())
        .sum();
    let groups = report["groups"].as_array().unwrap();
    let checks: usize = groups
        .iter()
        .map(|g| g["checks"].as_array().unwrap().len())
        .sum();
    assert_eq!(total as usize, checks);
}

#[test]
fn the_first_switching_asks_and_without_an_answer_nothing_is_switched() {
    for args in [
        "doctor sim --sim bench-supply=40 --first-switching",
        "doctor sim --first-switching --json",
        "doctor sim --yes",
        "doctor sim --reference r=7",
    ] {
        let (code, stdout, stderr) = run(args);
        assert_eq!((code, stdout.as_str()), (2, ""), "{args}: {stderr}");
    }
    let (_, report) = json("doctor sim --sim bench-supply=40 --first-switching --yes --json");
    assert_eq!(
        failed(&report, &["firmware", "board", "first_switching"]),
        [] as [&str; 0]
    );
    assert!(group(&report, "first_switching").contains(&("load", "pass")));
    assert!(group(&report, "first_switching").contains(&("power_off", "pass")));
}

#[test]
fn the_udev_rule_is_not_written_unasked() {
    let rule = Path::new("/etc/udev/rules.d/70-ihd.rules");
    let before = rule.exists();
    let (code, stdout, stderr) = run("doctor --fix");
    assert_eq!((code, stdout.as_str()), (2, ""), "{stderr}");
    assert!(stderr.contains("--yes"), "{stderr}");
    assert_eq!(rule.exists(), before);
    // Both questions may be answered in advance, and no other.
    let (code, _, stderr) = run("doctor --yes");
    assert!(code == 2 && stderr.contains("--fix"), "{code} {stderr}");
}

#[test]
fn a_supply_that_is_too_high_fails_and_exits_with_1() {
    let (code, report) = json("doctor sim --sim bench-supply=120 --first-switching --yes --json");
    assert_eq!(code, 1);
    assert_eq!(failed(&report, &["first_switching"]), ["bench_supply"]);
    let (code, stdout, _) = run("doctor sim --sim bench-supply=120 --first-switching --yes");
    assert_eq!(code, 1);
    assert!(stdout.contains("→ Nothing is switched"), "{stdout}");
}

#[test]
fn a_device_that_is_not_there_exits_with_3_and_a_whole_report() {
    let (code, report) = json("doctor tcp:127.0.0.1:9 --json");
    assert_eq!(code, 3);
    assert_eq!(failed(&report, &["firmware", "board"]), ["connection"]);
    assert!(
        group(&report, "board")
            .iter()
            .all(|(_, verdict)| *verdict == "not_tested")
    );
    for (args, code) in [
        ("doctor bluetooth", 2),
        ("doctor sim --image /nowhere.elf", 1),
    ] {
        assert_eq!(run(args).0, code, "{args}");
    }
}

/// A hob in a process of its own, ended with the test. Whoever reads its lines stays: without a reader it ends.
struct Hob {
    child: Child,
    _lines: BufReader<ChildStdout>,
}

impl Drop for Hob {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn hob(args: &str) -> (Hob, String) {
    let mut command = ihd(&format!("hob --listen 127.0.0.1:0 {args}"));
    let mut child = command.stdout(Stdio::piped()).spawn().expect("ihd runs");
    let stdout = child.stdout.take().expect("its output");
    let mut stdout = BufReader::new(stdout);
    let mut line = String::new();
    stdout.read_line(&mut line).expect("a line");
    let (_, address) = line.split_once("tcp:").expect("an address");
    let address = address.split(';').next().unwrap_or_default().to_owned();
    let _lines = stdout;
    (Hob { child, _lines }, address)
}

#[test]
fn a_hob_that_heats_is_left_alone() {
    let (_hob, address) = hob("--panel 5");
    std::thread::sleep(std::time::Duration::from_millis(1_500));
    let (code, report) = json(&format!("doctor tcp:{address} --json"));
    assert_eq!(code, 1);
    assert_eq!(failed(&report, &["firmware", "board"]), ["idle"]);
    assert!(group(&report, "board").contains(&("channels", "not_tested")));
}

/// Killed in the middle of it: a report, exit code 3, and no hang.
#[test]
fn a_hob_that_goes_away_leaves_a_report() {
    let (mut hob, address) = hob("--sim bench-supply=40");
    let doctor = ihd(&format!(
        "doctor tcp:{address} --first-switching --yes --json"
    ))
    .stdout(Stdio::piped())
    .stderr(Stdio::piped())
    .spawn()
    .expect("ihd runs");
    std::thread::sleep(std::time::Duration::from_millis(400));
    hob.child.kill().expect("it is killed");
    let output = doctor.wait_with_output().expect("it ends");
    let report: Value = serde_json::from_slice(&output.stdout).expect("a document");
    assert_eq!(output.status.code(), Some(3), "{report:#}");
    assert!(report["ended_by"].is_string() || failed(&report, &["firmware"]) == ["connection"]);
}

/// The check `store` of a folder's configuration, which no daemon answers for.
fn store_of(folder: &Path) -> Value {
    let config = folder.join("ihd.toml");
    let text = format!(
        "listen = \"127.0.0.1:1\"\nstore = {:?}\n",
        folder.join("store")
    );
    fs::write(&config, text).unwrap();
    let (_, report) = json(&format!(
        "doctor tcp:127.0.0.1:1 --json --config {}",
        config.display()
    ));
    let checks = report["groups"][0]["checks"].as_array().unwrap();
    let store = checks.iter().find(|check| check["name"] == "store");
    store.unwrap().clone()
}

#[test]
fn a_store_that_cannot_be_used_is_told_with_its_cause() {
    let folder = tempfile::tempdir().unwrap();
    let told = |verdict: &str, words: &str| {
        let check = store_of(folder.path());
        assert_eq!(check["verdict"], verdict, "{check}");
        let finding = check["finding"].as_str().unwrap().to_owned();
        assert!(finding.contains(words), "{words}: {finding}");
        check
    };
    told("not_tested", "none yet");
    let at = folder.path().join("store");
    let opened = Store::open(&at, &StoreOptions::default()).unwrap();
    told("fail", &format!("process {}", std::process::id()));
    drop(opened);
    let whole = told("pass", "has room");
    assert_eq!(whole["evidence"][0]["value"], 1.0);
    let records = at.join("ihd.db");
    let lock = rusqlite::Connection::open(&records).unwrap();
    lock.execute_batch("BEGIN IMMEDIATE").unwrap();
    let locked = told(
        "fail",
        "another program keeps a database of the store locked",
    );
    assert!(
        locked["remedy"]
            .as_str()
            .unwrap()
            .contains("End the program")
    );
    drop(lock);
    let bytes = fs::read(&records).unwrap();
    fs::write(&records, &bytes[..bytes.len() / 2]).unwrap();
    let damaged = told("fail", "a database of the store is damaged");
    assert!(
        damaged["remedy"]
            .as_str()
            .unwrap()
            .contains("Start the daemon again")
    );
    // It is left as it is, for whoever wants to rescue something.
    assert_eq!(fs::read(&records).unwrap().len(), bytes.len() / 2);
}
