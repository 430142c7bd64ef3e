//! Every hostile device against the commands that talk to one.

use std::fs;
use std::io;
use std::os::unix::process::ExitStatusExt;
use std::process::Stdio;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use crate::device::Port;
use crate::hostile;
use crate::process::{Process, ihd};

/// Longest that a command may take that has nothing to do for more than 3 s.
const DEADLINE: Duration = Duration::from_secs(60);

/// Memory that a command may take, in bytes: ten times what it takes with a device that is well.
const MOST_RSS: u64 = 200_000_000;

/// Their windows are those of a load (two sines), only counted wrongly: who needs no numbers may be taught by them.
const SOUND_BUT_FOR_NUMBERS: [&str; 2] =
    ["windows numbered backwards", "windows whose numbers jump"];

/// Runs `ihd ARGUMENTS --device tcp:…` against each; `allowed` are its exit codes.
fn against_all(name: &str, arguments: &[&str], allowed: &[i32]) {
    let next = AtomicUsize::new(0);
    let wrong = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                while let Some(&(scenario, serve)) = hostile::ALL.get(next.fetch_add(1, Relaxed)) {
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
        hostile::ALL.len(),
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
    let status = process.wait(DEADLINE);
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
    if process.peak_rss > MOST_RSS {
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

#[test]
#[ignore = "two minutes: cargo xtask daemon runs it"]
fn a_recording_ends_in_time() {
    let arguments = ["record", "--out", "x.mcap", "--duration", "2"];
    against_all("record", &arguments, &[0, 3]);
}

#[test]
#[ignore = "two minutes: cargo xtask daemon runs it"]
fn the_trainer_ends_in_time() {
    let arguments = ["trainer", "--power", "700", "--no-store"];
    against_all("trainer", &arguments, &[3, 4, 5]);
}
