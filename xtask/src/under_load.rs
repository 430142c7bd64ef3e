//! Test run on a busy or small machine: a test that only passes on a quiet one depends on the wall clock.

use std::env;
use std::ffi::OsStr;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use crate::workspace;

/// Number of endless loops beside the tests.
const LOOPS: usize = 2;

/// Number of runs beside them.
const RUNS: usize = 3;

/// Runs `all` three times beside two endless loops, then this command once more on a single core.
///
/// # Errors
/// The error of the first run that fails.
pub fn run(all: impl Fn() -> anyhow::Result<()>) -> anyhow::Result<()> {
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        for _ in 0..LOOPS {
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            });
        }
        let runs = (1..=RUNS).try_for_each(|run| {
            println!("\n━━ beside {LOOPS} endless loops, run {run} of {RUNS}");
            all()
        });
        done.store(true, Ordering::Relaxed);
        runs
    })?;
    println!("\n━━ on one core");
    let mut again = Command::new("taskset");
    again.args(["-c", "0"]).arg(env::current_exe()?);
    again.args(
        env::args_os()
            .skip(1)
            .filter(|word| word != OsStr::new("--under-load")),
    );
    workspace::run(&mut again)
}
