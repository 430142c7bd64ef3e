//! `ihd` as a user calls it: help, exit codes, the trainer in process and over TCP.
use std::net::TcpListener;
use std::process::{Command, Output};

use ihd_shared::wire::{PROTOCOL_MAJOR, PROTOCOL_MINOR};
use serde_json::Value;

use crate::process::Hob;

fn ihd() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
    command.env_remove("RUST_BACKTRACE");
    command
}

/// Runs a command line; gives its exit code, stdout and stderr.
fn run(args: &str) -> (i32, String, String) {
    let Output {
        status,
        stdout,
        stderr,
    } = ihd().args(args.split(' ')).output().expect("ihd runs");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    let stderr = text(stderr);
    assert!(!stderr.contains("panicked"), "{args}: {stderr}");
    (status.code().expect("an exit code"), text(stdout), stderr)
}

/// Runs what must fail; checks the exit code and what stderr holds.
fn refused(args: &str, code: i32, words: &[&str]) {
    let (got, stdout, stderr) = run(args);
    assert_eq!(got, code, "{args}: {stderr}");
    assert!(stdout.is_empty(), "{args}: {stdout}");
    // A cause that the message quotes is not repeated.
    assert!(stderr.matches("os error").count() <= 1, "{args}: {stderr}");
    for word in words {
        assert!(stderr.contains(word), "{args}: {word:?} not in {stderr}");
    }
}

/// A training run's report.
fn trained(args: &str) -> Value {
    let (code, stdout, stderr) = run(&format!("trainer --store none --json {args}"));
    assert_eq!(code, 0, "{stderr}");
    serde_json::from_str(&stdout).unwrap_or_else(|e| panic!("{e}: {stdout}"))
}

fn number(value: &Value, pointer: &str) -> f64 {
    let found = value.pointer(pointer).and_then(Value::as_f64);
    found.unwrap_or_else(|| panic!("no number at {pointer} in {value:#}"))
}

/// `ihd` in a folder, without a daemon at the address of its configuration; exit code, stdout and stderr.
fn alone(folder: &std::path::Path, arguments: &[&str]) -> (i32, String, String) {
    let nobody = "store = \"s\"\nlisten = \"127.0.0.1:1\"\n";
    std::fs::write(folder.join("ihd.toml"), nobody).unwrap();
    let output = ihd().current_dir(folder).args(arguments).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    let code = output.status.code().unwrap();
    (code, text(output.stdout), text(output.stderr))
}

#[test]
fn alone_it_shows_the_next_command_for_what_is_here() {
    let folder = tempfile::tempdir().unwrap();
    let (code, stdout, _) = alone(folder.path(), &[]);
    assert_eq!(code, 0);
    for command in ["ihd trainer", "ihd identify CAPTURE", "ihd --help"] {
        assert!(stdout.contains(command), "{stdout}");
    }
    std::fs::create_dir(folder.path().join("s")).unwrap();
    std::fs::write(folder.path().join("s/ihd.db"), "").unwrap();
    std::fs::write(folder.path().join("scope 1.csv"), "t,v,i\n").unwrap();
    let (code, stdout, _) = alone(folder.path(), &["--json"]);
    assert_eq!(code, 0);
    let steps: Value = serde_json::from_str(&stdout).unwrap();
    let commands: Vec<_> = steps
        .as_array()
        .unwrap()
        .iter()
        .map(|s| &s["command"])
        .collect();
    assert_eq!(commands, ["ihd store ls", "ihd inspect \"scope 1.csv\""]);
    // A configuration that cannot be read is named, and hides nothing else.
    let wrong = alone(folder.path(), &["--config", "none.toml"]);
    assert_eq!(wrong.0, 0);
    assert!(wrong.2.contains("none.toml"), "{}", wrong.2);
    assert!(wrong.1.contains("ihd inspect"), "{}", wrong.1);
}

#[test]
fn the_version_names_program_protocol_and_image() {
    let (code, text, _) = run("--version");
    let protocol = format!("protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}");
    let lines: Vec<&str> = text.lines().collect();
    let [program, second, image] = lines[..] else {
        panic!("{text}");
    };
    assert_eq!(code, 0);
    assert_eq!(program, concat!("ihd ", env!("CARGO_PKG_VERSION")));
    assert_eq!(second, protocol);
    assert!(image.starts_with("image "), "{image}");
}

#[test]
fn every_subcommand_shows_examples() {
    let (code, help, _) = run("--help");
    assert_eq!(code, 0);
    let commands: Vec<&str> = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .take_while(|line| !line.is_empty())
        // Deeper lines go on with the description of the one before.
        .filter(|line| !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .collect();
    assert!(commands.contains(&"trainer"), "{help}");
    for name in commands {
        let (code, help, _) = run(&format!("{name} --help"));
        assert_eq!(code, 0);
        let (_, examples) = help.split_once("Examples:").expect("an Examples section");
        assert!(examples.contains(&format!("ihd {name}")), "{name}: {help}");
    }
}

#[test]
fn a_device_that_is_not_there_exits_with_3() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    refused(
        &format!("hob --listen {address}"),
        3,
        &[&address, "another process has the port"],
    );
    drop(listener);
    let hint = format!("ihd hob --listen {address}");
    refused(
        &format!("trainer --device tcp:{address}"),
        3,
        &["cannot connect", &hint],
    );
}

/// The ten seconds for which the device looks for a pot are simulated, which takes as long. An absent one ends in the same way.
#[test]
fn a_pot_that_never_comes_exits_with_4_and_what_was_seen() {
    refused(
        "trainer --store none --pot aluminium",
        4,
        &["no pot", "Unsuitable"],
    );
}

#[test]
fn the_trainer_identifies_and_teaches() {
    let report = trained("--power 1500,1000");
    assert!(number(&report, "/lookup_version") >= 1.0);
    assert_eq!(number(&report, "/fault"), 0.0);
    assert_eq!(report["state"], "heating");
    for (k, asked_w) in [1_500.0, 1_000.0].into_iter().enumerate() {
        let of = |name: &str| number(&report, &format!("/points/{k}/{name}"));
        assert!(
            (of("delivered_w") / asked_w - 1.0).abs() <= 0.03,
            "{report:#}"
        );
        assert!(of("pinn_errors/r_whole_pct") <= 1.0, "{report:#}");
        assert!(of("pinn_errors/l_whole_pct") <= 1.0, "{report:#}");
        assert!(of("ekf_errors/r_middle_pct") <= 1.0, "{report:#}");
        assert!(of("ekf_errors/l_middle_pct") <= 0.5, "{report:#}");
    }
}

/// A capture of the behavioural reference load stands for the heating; what it is compared with is the capture's
/// own truth, and nothing of the simulated hob's load.
#[test]
fn the_trainer_teaches_from_a_capture() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("a.mcap");
    let made = format!(
        "simulate paper-50 --set load=behavioural --out {}",
        file.display()
    );
    assert_eq!(run(&made).0, 0);
    let report = trained(&format!("--replay {}", file.display()));
    assert_eq!(
        report["points"].as_array().map(Vec::len),
        Some(2),
        "{report:#}"
    );
    let i_a = number(&report, "/points/1/i_crest_a");
    let r_ohm = (2.2 + 3.5 / (1.0 + i_a / 15.0)) * (50.0f64 / 45.0).sqrt();
    let error = number(&report, "/points/1/pinn/r_ohm") / r_ohm - 1.0;
    assert!(error.abs() <= 0.01, "{report:#}");
    let truth = number(&report, "/points/1/truth/r_ohm") / r_ohm - 1.0;
    assert!(truth.abs() <= 2e-3, "{report:#}");
    for name in ["pinn_errors/r_whole_pct", "pinn_errors/l_whole_pct"] {
        let of = number(&report, &format!("/points/1/{name}"));
        assert!(of > 0.0 && of <= 1.0, "{report:#}");
    }
    assert_eq!(number(&report, "/lookup_version"), 2.0);
    assert_eq!(report["state"], "idle");
    refused(
        &format!("trainer --replay {} --power 900", file.display()),
        2,
        &["--power"],
    );
}

#[test]
fn a_store_keeps_every_session_in_a_folder_of_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let store = dir.path().join("new/store");
    for folder in ["run-001", "run-002"] {
        let (code, stdout, stderr) =
            run(&format!("trainer --power 1500 --store {}", store.display()));
        assert_eq!(code, 0, "{stderr}");
        assert!(stdout.contains("version 1 active"), "{stdout}");
        assert!(stdout.contains(folder), "{stdout}");
        for name in [
            "session.mcap",
            "lookup-v1.bin",
            "lookup-v1.json",
            "identified.svg",
        ] {
            let size = std::fs::metadata(store.join(folder).join(name))
                .unwrap()
                .len();
            assert!(size > 500, "{folder}/{name}: {size} bytes");
        }
    }
}

#[test]
fn the_trainer_works_over_tcp() {
    let hob = Hob::start();
    let address = &hob.address;
    let report = trained(&format!("--device tcp:{address} --power 1500"));
    assert_eq!(number(&report, "/lookup_version"), 1.0);
    assert_eq!(
        report["device"].as_str().map(|d| d.contains(address)),
        Some(true)
    );
    // No truth comes over a link.
    assert!(report["points"][0]["truth"].is_null(), "{report:#}");
    assert!(report["points"][0]["pinn_errors"].is_null(), "{report:#}");
    assert!(report["map_error"].is_null(), "{report:#}");
    assert!((number(&report, "/points/0/pinn/l_h") / 19e-6 - 1.0).abs() < 0.1);
    // What was taught outlives the link.
    let again = trained(&format!("--device tcp:{address} --power 1000"));
    assert_eq!(number(&again, "/lookup_version"), 2.0);
}
