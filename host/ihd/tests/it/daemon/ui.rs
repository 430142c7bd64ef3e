//! `ihd trainer --ui`: the page, with a hob that heats by itself until somebody commands it.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use super::processes::{alone, ihd};
use crate::process::{Process, wait_for};

/// A demonstration, what it said, and where.
fn demonstration(dir: &Path, args: &[&str]) -> (Process, String) {
    let mut command = ihd();
    command
        .current_dir(dir)
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .args(["trainer", "--ui", "--power", "900,1500"])
        .args(args);
    let mut process = Process::start(&mut command, false);
    let line = process.line_with("http");
    (process, url(&line))
}

fn url(line: &str) -> String {
    let (_, rest) = line.split_once("http").expect("an address");
    format!("http{}", rest.split_whitespace().next().unwrap())
}

/// Answer of one of its routes.
fn get(url: &str, path: &str) -> Value {
    let mut answer = ureq::get(format!("{url}{path}")).call().expect(path);
    answer.body_mut().read_json().expect("JSON")
}

fn until(url: &str, what: &str, met: impl Fn(&Value) -> bool) -> Value {
    let device = || get(url, "api/v1/devices/simulated");
    let poll = || Some(device()).filter(|device| met(device));
    wait_for(poll, || format!("never: {what}; {:#}", device()))
}

#[test]
fn it_heats_and_learns_until_somebody_commands_and_ends_with_the_hob_off() {
    let _alone = alone();
    let dir = TempDir::new().unwrap();
    let pot = ["--pot", "cast-iron-21", "--store", "here"];
    let (mut process, url) = demonstration(dir.path(), &pot);
    let mut page = ureq::get(&url).call().unwrap();
    assert!(
        page.headers()["content-type"]
            .to_str()
            .unwrap()
            .starts_with("text/html")
    );
    let text = page.body_mut().read_to_string().unwrap();
    assert!(text.contains("page/js/main.js"), "{text}");
    let device = until(&url, "it heats", |d| {
        d["live"]["power_w"].as_f64() > Some(700.0)
    });
    assert_eq!(device["lease"]["holder"], "demonstration");
    until(&url, "it learns", |d| {
        d["lookup"]["observed_cells"].as_u64() > Some(0)
    });
    // Truth is known where the hob is in the process.
    let scope = get(&url, "api/v1/devices/simulated/window");
    assert!(scope["truth"].is_object(), "{scope:#}");
    assert!(dir.path().join("here").is_dir());
    let off = ureq::post(format!("{url}api/v1/devices/simulated/commands"))
        .header("ihd-holder", "Ada")
        .header("content-type", "application/json")
        .send(r#"{"command":"off"}"#);
    assert_eq!(off.unwrap().status(), 200);
    process.line_with("Ada commands the hob");
    let device = until(&url, "it is off", |d| d["live"]["asked_w"] == 0);
    assert_eq!(device["lease"], Value::Null);
    // It said so when it had stopped heating by itself: no sweep can follow.
    process.signal("INT");
    assert_eq!(process.code(), 0);
}

#[test]
fn a_browser_is_opened_where_there_is_a_screen() {
    let _alone = alone();
    let dir = TempDir::new().unwrap();
    let opened = dir.path().join("opened");
    let script = dir.path().join("xdg-open");
    let text = format!(
        "#!/bin/sh\necho \"$@\" > {0}.new && mv {0}.new {0}\n",
        opened.display()
    );
    std::fs::write(&script, text).unwrap();
    std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:/usr/bin:/bin", dir.path().display());
    let mut command = ihd();
    command
        .current_dir(dir.path())
        .env("PATH", path)
        .env("DISPLAY", ":99")
        .args(["trainer", "--ui"]);
    let mut process = Process::start(&mut command, false);
    let url = url(&process.line_with("http"));
    wait_for(
        || opened.exists().then_some(()),
        || "nothing was opened".to_owned(),
    );
    assert_eq!(std::fs::read_to_string(&opened).unwrap().trim(), url);
    process.signal("TERM");
    assert_eq!(process.code(), 0);
}

#[test]
fn what_has_no_page_is_refused() {
    for args in [
        &["--ui", "--store", "none"][..],
        &["--ui", "--follow"],
        &["--ui", "--json"],
        &["--ui", "--device", "tcp:127.0.0.1:9"],
        &["--ui", "--replay", "x.mcap"],
        &["--ui", "--power", "0"],
        &["--ui", "--pot", "copper"],
        &["--ui", "--sim", "mains=16.7"],
        &["--ui", "--sim", "bus-capacitance=5"],
    ] {
        let output = ihd().arg("trainer").args(args).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{args:?}");
    }
}
