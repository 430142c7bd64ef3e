//! Runs a test runner with its output in sight, and collects the counts that it prints.

use std::env;
use std::io::{self, BufRead, BufReader, IsTerminal, Read, Write};
use std::process::{Command, ExitStatus, Stdio};
use std::thread;

use anyhow::Context;

use crate::count::{Counts, Runner};
use crate::workspace::spelled;

/// Runs `command`, passes on every line as it comes, and adds up all closing lines.
pub fn run_and_count(
    command: &mut Command,
    runner: Runner,
) -> anyhow::Result<(ExitStatus, Counts)> {
    if io::stderr().is_terminal() && env::var_os("NO_COLOR").is_none() {
        // The runner sees a pipe and would drop its colours.
        command.env("CARGO_TERM_COLOR", "always");
    }
    let mut child = command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .with_context(|| format!("could not start `{}`", spelled(command)))?;
    let (out, err) = (child.stdout.take(), child.stderr.take());
    let mut counts = Counts::default();
    // nextest closes on stderr, cargo test on stdout: both are read, at the same time so that neither pipe fills.
    thread::scope(|scope| {
        let errors = scope.spawn(|| {
            err.map(|err| pass_on(err, io::stderr(), runner))
                .transpose()
        });
        let output = out
            .map(|out| pass_on(out, io::stdout(), runner))
            .transpose();
        let errors = errors
            .join()
            .unwrap_or_else(|_| Err(io::Error::other("the reader of stderr panicked")));
        for part in [output, errors] {
            counts += part
                .context("lost the test runner's output")?
                .unwrap_or_default();
        }
        anyhow::Ok(())
    })?;
    let status = child.wait().context("could not wait for the test runner")?;
    Ok((status, counts))
}

fn pass_on(from: impl Read, mut to: impl Write, runner: Runner) -> io::Result<Counts> {
    let mut from = BufReader::new(from);
    let mut counts = Counts::default();
    let mut line = Vec::new();
    while from.read_until(b'\n', &mut line)? > 0 {
        to.write_all(&line)?;
        to.flush()?;
        counts += runner
            .closing_line(&String::from_utf8_lossy(&line))
            .unwrap_or_default();
        line.clear();
    }
    Ok(counts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_everything_on_and_adds_up() {
        let text = "test result: ok. 2 passed; 0 failed\nnoise \u{fffd}\r\n\
                    test result: FAILED. 1 passed; 1 failed; 1 ignored";
        let mut seen = Vec::new();
        let counts = pass_on(text.as_bytes(), &mut seen, Runner::Libtest).unwrap();
        assert_eq!(seen, text.as_bytes());
        assert_eq!((counts.passed, counts.failed, counts.skipped), (3, 1, 1));
    }
}
