//! `ihd store` as a user calls it, beside a writer and on what a disk has left of it.

use std::fs;
use std::path::Path;
use std::process::Command;

use ihd_link::Window;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::{Pair, Scales};
use ihd_shared::wire::hello::{ROLE_DEVICE, ours};
use ihd_shared::wire::messages::FrontEnd;
use ihd_store::{NewResult, Store, StoreOptions};
use serde_json::Value;

/// Runs `ihd store` in a folder; gives exit code, stdout and stderr.
fn ihd(folder: &Path, args: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
    let output = command.current_dir(folder).arg("store").args(args).output();
    let output = output.expect("ihd runs");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    let stderr = text(output.stderr);
    assert!(!stderr.contains("panicked"), "{args:?}: {stderr}");
    let code = output.status.code().expect("a code");
    (code, text(output.stdout), stderr)
}

fn done(folder: &Path, args: &[&str]) -> String {
    let (code, stdout, stderr) = ihd(folder, args);
    assert_eq!(code, 0, "{args:?}: {stderr}{stdout}");
    stdout
}

fn json(folder: &Path, args: &[&str]) -> Value {
    serde_json::from_str(&done(folder, &[args, &["--json"]].concat())).expect("JSON")
}

fn window(seq: u32) -> Window {
    let pair = |k: i16| Pair {
        v: (k % 200) * 10 - 1_000,
        i: k % 700 - 350,
    };
    Window {
        seq,
        half_cycle: 20 * seq,
        f_sw_hz: 45_000,
        half_cycle_ns: 10_000_000,
        first_pair_ns: 500,
        pairs: (0..9_000).map(pair).collect(),
        first_trajectory_ns: 0,
        trajectory: Vec::new(),
        saturated: 0,
        lookup_version: 0,
        scales: Scales::OF_THIS_BUILD,
    }
}

/// A store in `FOLDER/kept` with three windows and their results of a device whose firmware has a name that
/// would clear the screen, and the configuration that names it.
fn filled(folder: &Path) -> Store {
    fs::write(
        folder.join("ihd.toml"),
        "store = \"kept\"\nlisten = \"127.0.0.1:8731\"\n",
    )
    .unwrap();
    let opened = Store::open(&folder.join("kept"), &StoreOptions::default()).unwrap();
    let mut store = opened.store;
    let device = store.device("bench", "tcp:127.0.0.1:4711").unwrap();
    let hello = ours(ROLE_DEVICE, 1, 77, "evil\u{1b}[2J", "sim");
    let front_end = FrontEnd {
        v_full_scale_mv: Scales::OF_THIS_BUILD.v_full_scale_mv,
        i_full_scale_ma: Scales::OF_THIS_BUILD.i_full_scale_ma,
        bus_full_scale_mv: 450_000,
        mains_full_scale_mv: 450_000,
        bits: 12,
    };
    let session = store.begin_session(device, &hello, &front_end).unwrap();
    for seq in 0..3 {
        store.keep_window(session, &window(seq)).unwrap();
        let pass = seq != 1;
        let result = NewResult {
            session,
            seq,
            half_cycle: 20 * seq,
            f_sw_hz: 45_000,
            i_crest_a: 30.0,
            power_w: None,
            r_ohm: if pass { 2.5 } else { f64::NAN },
            l_h: 8e-5,
            sigma_r_pct: 0.5,
            sigma_l_pct: 0.25,
            pass,
            why: if pass {
                String::new()
            } else {
                "R is not known to 5 %".to_owned()
            },
            changed_lookup: pass,
            iterations: 300,
        };
        store.record_result(&result, Some(b"{}")).unwrap();
    }
    let lookup = |version| RlLookup { version, ..prior() };
    store.pend_lookup(device, &lookup(1), "", None).unwrap();
    store.adopt_lookup(device, &lookup(1)).unwrap();
    store.pend_lookup(device, &lookup(2), "", None).unwrap();
    store
}

#[test]
fn results_windows_and_lookups_are_shown_beside_the_writer() {
    let folder = tempfile::tempdir().unwrap();
    let _writer = filled(folder.path());
    let rows = json(folder.path(), &["ls"]);
    let rows = rows.as_array().unwrap();
    assert_eq!(rows.len(), 3);
    let seqs: Vec<u64> = rows
        .iter()
        .map(|row| row["seq"].as_u64().unwrap())
        .collect();
    assert_eq!(seqs, [2, 1, 0]);
    let refused = &rows[1];
    assert_eq!(
        (&refused["device"], &refused["boot"]),
        (&"bench".into(), &77.into())
    );
    assert_eq!(
        (&refused["half_cycle"], &refused["verdict"]),
        (&20.into(), &"refused".into())
    );
    assert_eq!(
        (&refused["r_ohm"], &refused["why"]),
        (&Value::Null, &"R is not known to 5 %".into())
    );
    assert_eq!(rows[0]["verdict"], "pass");
    assert_eq!(
        json(folder.path(), &["ls", "--limit", "1"])
            .as_array()
            .unwrap()
            .len(),
        1
    );
    assert_eq!(
        json(folder.path(), &["ls", "--since", "2099-01-01"]),
        Value::Array(vec![])
    );
    let id = refused["id"].to_string();
    let shown = json(folder.path(), &["ls", &id]);
    assert_eq!(
        (&shown["window"]["pairs"], &shown["connection"]["boot"]),
        (&9_000.into(), &77.into())
    );
    let text = done(folder.path(), &["ls", &id]);
    assert!(
        text.contains("refused: R is not known to 5 %") && !text.contains('\u{1b}'),
        "{text}"
    );
    let report = json(folder.path(), &["check"]);
    assert_eq!(
        (&report["integrity"], &report["windows"], &report["results"]),
        (&"ok".into(), &3.into(), &3.into())
    );
    let states = report["lookups"].as_array().unwrap().iter();
    let states: Vec<_> = states
        .map(|l| {
            (
                l["device"].as_str(),
                l["version"].as_u64(),
                l["state"].as_str(),
            )
        })
        .collect();
    let bench = Some("bench");
    assert_eq!(
        states,
        [
            (bench, Some(1), Some("active")),
            (bench, Some(2), Some("pending"))
        ]
    );
    // The folder from the command line goes before that of the configuration.
    let (code, _, stderr) = ihd(folder.path(), &["ls", "--store", "elsewhere"]);
    assert!(
        code == 1 && stderr.contains("there is no store here"),
        "{code} {stderr}"
    );
    std::fs::create_dir_all(folder.path().join("runs/run-001")).unwrap();
    let (code, _, stderr) = ihd(folder.path(), &["ls", "--store", "runs"]);
    assert!(
        code == 1 && stderr.contains("run-001/session.mcap"),
        "{code} {stderr}"
    );
    // Only one may write.
    let (code, _, stderr) = ihd(folder.path(), &["check", "--collect"]);
    assert!(
        code == 1 && stderr.contains("another process"),
        "{code} {stderr}"
    );
}

#[test]
fn what_is_exported_and_backed_up_can_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let writer = filled(folder.path());
    let written = json(
        folder.path(),
        &["export", "--format", "mcap", "--out", "out"],
    );
    assert_eq!(
        (&written["windows"], &written["files"][0]),
        (&3.into(), &"out/bench-77.mcap".into())
    );
    let out = folder.path().join("out/bench-77.mcap");
    let capture = ihd_capture::open(&out, &ihd_capture::OpenOptions::default()).unwrap();
    let wanted: Vec<f32> = (0..3)
        .flat_map(|seq| window(seq).v_volt())
        .map(|v| v as f32)
        .collect();
    assert!(capture.v_v == wanted);
    let results = [
        "export",
        "--results",
        "--format",
        "csv",
        "--out",
        "results.csv",
    ];
    done(folder.path(), &results);
    let table = fs::read_to_string(folder.path().join("results.csv")).unwrap();
    assert!(
        table.starts_with("id,device,boot,seq") && table.lines().count() == 4,
        "{table}"
    );
    let (code, _, stderr) = ihd(folder.path(), &results);
    assert!(
        code == 1 && stderr.contains("nothing was written"),
        "{code} {stderr}"
    );
    let missing = ["export", "--format", "npz", "--seq", "4711", "--out", "x"];
    let (code, _, stderr) = ihd(folder.path(), &missing);
    assert!(code == 1 && stderr.contains("4711"), "{code} {stderr}");
    done(folder.path(), &["backup", "copy"]);
    drop(writer);
    let report = json(folder.path(), &["check", "--store", "copy"]);
    assert_eq!(
        (&report["integrity"], &report["windows"]),
        (&"ok".into(), &3.into())
    );
    let collected = json(folder.path(), &["check", "--collect", "--store", "copy"]);
    assert_eq!(collected["collected"]["deleted"], Value::Array(vec![]));
}

#[test]
fn damage_is_7_and_wrong_usage_2() {
    let folder = tempfile::tempdir().unwrap();
    drop(filled(folder.path()));
    for command in [&["ls"][..], &["export", "--format", "csv", "--out", "out"]] {
        let args = [command, &["--device", "nosuch"]].concat();
        let (code, _, stderr) = ihd(folder.path(), &args);
        assert!(code == 2 && stderr.contains("it has: bench"), "{stderr}");
    }
    let records = folder.path().join("kept/ihd.db");
    let mut bytes = fs::read(&records).unwrap();
    let page = 4_096;
    bytes[3 * page..8 * page].fill(0xA5);
    fs::write(&records, &bytes).unwrap();
    let (code, stdout, stderr) = ihd(folder.path(), &["check", "--json"]);
    assert_eq!(code, 7, "{stderr}");
    let report: Value = serde_json::from_str(&stdout).unwrap();
    assert_ne!(report["integrity"], "ok");
    fs::write(&records, "nothing of the kind").unwrap();
    let (code, stdout, _) = ihd(folder.path(), &["check", "--json"]);
    let report: Value = serde_json::from_str(&stdout).unwrap();
    assert!(
        code == 7 && report["integrity"].as_str().unwrap().contains("damaged"),
        "{report}"
    );
    for wrong in [
        &["export", "--format", "wav", "--out", "x"][..],
        &["export", "--results", "--format", "npz", "--out", "x"],
        &["ls", "--since", "yesterday"],
        &["check", "--collect", "--config", "broken.toml"],
    ] {
        fs::write(folder.path().join("broken.toml"), "store = 7\n").unwrap();
        let (code, _, stderr) = ihd(folder.path(), wrong);
        assert_eq!(code, 2, "{wrong:?}: {stderr}");
    }
}
