//! `cargo xtask fuzz`: coverage-guided fuzzing of the targets in fuzz/, on stable Rust and without cargo-fuzz.
//!
//! Inputs that reach new code go to `fuzz-corpus/` in the target folder, so that the committed corpus in fuzz/corpus/ only grows by
//! a deliberate commit; inputs that fail go to `fuzz-artifacts/` beside it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{self, Command};

use anyhow::{Context, ensure};
use cargo_metadata::MetadataCommand;

use crate::workspace::{Workspace, first_line, run};

/// Compiler flags, as set by cargo-fuzz: counters at every edge for libFuzzer, and the operands of comparisons.
const RUSTFLAGS: &str = "--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
     -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
     -Cllvm-args=-sanitizer-coverage-trace-compares";

/// Limits of one input in seconds, MiB and bytes: more than any committed seed needs.
const LIMITS: [&str; 3] = ["-timeout=10", "-rss_limit_mb=2048", "-max_len=16384"];

/// Fuzzes one target, or all of them in turn; `seconds` each, 0 for no end.
pub fn fuzz(on: &Workspace, only: Option<&str>, seconds: u64) -> anyhow::Result<()> {
    let mut metadata = MetadataCommand::new();
    metadata.current_dir(on.root.join("fuzz")).no_deps();
    let package = metadata.exec()?.packages.pop();
    let package = package.context("fuzz/Cargo.toml has no package")?;
    let targets = package.targets.iter().filter(|target| target.is_bin());
    let mut targets: Vec<_> = targets.map(|target| target.name.as_str()).collect();
    if let Some(name) = only {
        let all = targets.join(", ");
        targets.retain(|target| *target == name);
        ensure!(!targets.is_empty(), "no target {name}; there are {all}");
    }
    let programs = build(on, &targets)?;
    let mut failed = Vec::new();
    for &target in &targets {
        let mut fuzzer = Command::new(programs.join(target));
        fuzzer
            .args(LIMITS)
            .arg(format!("-max_total_time={seconds}"));
        // libFuzzer writes into the first folder only.
        fuzzer.arg(on.target.join("fuzz-corpus").join(target));
        let seeds = package.metadata["seeds"][target].as_array();
        let seeds = seeds.into_iter().flatten();
        fuzzer.args(seeds.filter_map(|folder| folder.as_str()));
        let done = fuzz_one(on, target, &mut fuzzer);
        failed.extend(done.err().map(|why| format!("{why:#}")));
    }
    ensure!(failed.is_empty(), "{}", failed.join("\n"));
    println!("{} fuzz targets, none failed", targets.len());
    Ok(())
}

/// Builds the targets with coverage; returns the folder that they are in.
fn build(on: &Workspace, targets: &[&str]) -> anyhow::Result<PathBuf> {
    on.copy_lock(&on.root.join("fuzz"))?;
    let host = first_line(Command::new("rustc").args(["--print", "host-tuple"]));
    let host = host.context("`rustc --print host-tuple` failed")?;
    let folder = on.target.join("fuzz");
    let mut build = on.cargo(["build", "--release", "--manifest-path", "fuzz/Cargo.toml"]);
    // A target named, even this one, keeps the flags from build scripts and macros.
    build.args(["--target", &host, "--target-dir"]).arg(&folder);
    build.args(targets.iter().flat_map(|target| ["--bin", target]));
    build.env("RUSTFLAGS", RUSTFLAGS);
    run(build.env_remove("CARGO_ENCODED_RUSTFLAGS"))?;
    Ok(folder.join(host).join("release"))
}

fn fuzz_one(on: &Workspace, name: &str, fuzzer: &mut Command) -> anyhow::Result<()> {
    let artifacts = on.target.join("fuzz-artifacts");
    fs::create_dir_all(&artifacts)?;
    fs::create_dir_all(on.target.join("fuzz-corpus").join(name))?;
    let prefix = format!("{}/{name}-{}-", artifacts.display(), process::id());
    fuzzer.arg(format!("-artifact_prefix={prefix}"));
    let corpus = Path::new("fuzz/corpus").join(name);
    fuzzer.args(on.root.join(&corpus).is_dir().then_some(corpus));
    fuzzer.current_dir(&on.root);
    let done = run(fuzzer);
    let program = Path::new(fuzzer.get_program()).display();
    let rerun = format!("run it again with `{program} {prefix}*`");
    done.with_context(|| format!("fuzz target {name} failed; its input is {prefix}*; {rerun}"))
}
