//! Every hostile device against the commands that talk to one.

use std::fs;
use std::io;
use std::os::unix::process::ExitStatusExt;
use std::process::Stdio;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::thread;
use std::time::Instant;

use crate::device::Port;
use crate::hostile;
use crate::process::{PATIENCE, Process, ihd};

/// Memory that a command may take, in bytes: ten times what it takes with a device that is well.
const MAX_RSS: u64 = 200_000_000;

/// Their windows are those of a load (two sines), only counted wrongly: who needs no numbers may be taught by them.
const SOUND_BUT_FOR_NUMBERS: [&str; 2] =
    ["windows numbered backwards", "windows whose numbers jump"];

/// Runs `ihd ARGUMENTS --device tcp:…` against each of these; `allowed` are its exit codes.
fn against_each(
    devices: &[(&'static str, hostile::Serve)],
    name: &str,
    arguments: &[&str],
    allowed: &[i32],
) {
    let next = AtomicUsize::new(0);
    let wrong = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                while let Some(&(scenario, serve)) = devices.get(next.fetch_add(1, Relaxed)) {
                    let verdict = against(scenario, serve, arguments, allowed);
                    let line = match &verdict {
                        Ok(line) | Err(line) => format!("{name} | {scenario}: {line}"),
                    };
                    println!("{line}");
                    if verdict.is_err() {
                        wrong.lock().unwrap().push(line);
                    }
                }
            });
        }
    });
    let wrong = wrong.into_inner().unwrap();
    assert!(
        wrong.is_empty(),
        "{} of {}:\n{}",
        wrong.len(),
        devices.len(),
        wrong.join("\n")
    );
}

fn against(
    scenario: &str,
    serve: hostile::Serve,
    arguments: &[&str],
    allowed: &[i32],
) -> Result<String, String> {
    let failed = |e: io::Error| format!("the test itself failed: {e}");
    let port = Port::open(serve).map_err(failed)?;
    let folder = tempfile::tempdir().map_err(failed)?;
    let (out, err) = (folder.path().join("out"), folder.path().join("err"));
    let mut command = ihd(folder.path());
    command
        .args(arguments)
        .arg("--device")
        .arg(format!("tcp:{}", port.address()))
        .stdout(Stdio::from(fs::File::create(&out).map_err(failed)?))
        .stderr(Stdio::from(fs::File::create(&err).map_err(failed)?));
    let began = Instant::now();
    let mut process = Process::spawn(&mut command).map_err(failed)?;
    let status = process.wait(PATIENCE);
    let took = format!(
        "{:.1} s, {:.0} MB",
        began.elapsed().as_secs_f64(),
        process.peak_rss as f64 * 1e-6
    );
    let said = fs::read(&err).unwrap_or_default();
    let last = String::from_utf8_lossy(&said)
        .lines()
        .last()
        .unwrap_or_default()
        .to_owned();
    let Some(status) = status else {
        return Err(format!("goes on after {took}: {last}"));
    };
    let code = status
        .code()
        .unwrap_or_else(|| -status.signal().unwrap_or(0));
    let has_taught = code == 0 && SOUND_BUT_FOR_NUMBERS.contains(&scenario);
    if !allowed.contains(&code) && !has_taught {
        return Err(format!("exit {code} after {took}: {last}"));
    }
    if process.peak_rss > MAX_RSS {
        return Err(format!("too much memory: exit {code} after {took}: {last}"));
    }
    for bytes in [said, fs::read(&out).unwrap_or_default()] {
        if let Some(c) = String::from_utf8_lossy(&bytes)
            .chars()
            .find(|c| c.is_control() && *c != '\n')
        {
            return Err(format!(
                "a control character {c:?} of {scenario} reached the terminal"
            ));
        }
    }
    Ok(format!("exit {code} after {took}: {last}"))
}

/// Exit codes of a recording: it has recorded, or the link is no good.
const RECORDED: [i32; 2] = [0, 3];

/// Exit codes of the trainer: the link, the hob or what it learned is no good.
const NOT_TAUGHT: [i32; 3] = [3, 4, 5];

/// These keep no command waiting until it gives up.
fn quick() -> Vec<(&'static str, hostile::Serve)> {
    let names = [
        "closes at once",
        "garbage flood",
        "other major",
        "flood of hellos",
        "closes after the hello",
    ];
    let all = hostile::ALL.iter().copied();
    let quick: Vec<_> = all.filter(|(name, _)| names.contains(name)).collect();
    assert_eq!(quick.len(), names.len());
    quick
}

#[test]
fn commands_end_by_themselves_with_some_hostile_devices() {
    let record = ["record", "--out", "x.mcap", "--duration", "0.5"];
    against_each(&quick(), "record", &record, &RECORDED);
    let trainer = ["trainer", "--power", "700", "--store", "none"];
    against_each(&quick(), "trainer", &trainer, &NOT_TAUGHT);
}

#[test]
#[ignore = "full tier: two minutes"]
fn a_recording_ends_by_itself_with_every_hostile_device() {
    let arguments = ["record", "--out", "x.mcap", "--duration", "2"];
    against_each(hostile::ALL, "record", &arguments, &RECORDED);
}

#[test]
#[ignore = "full tier: two minutes"]
fn the_trainer_ends_by_itself_with_every_hostile_device() {
    let arguments = ["trainer", "--power", "700", "--store", "none"];
    against_each(hostile::ALL, "trainer", &arguments, &NOT_TAUGHT);
}
