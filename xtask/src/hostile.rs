//! What must not fool the identification: `ihd study hostile`, whose goals decide how it ends.

use std::process::Command;

use crate::workspace::{Workspace, run};

/// Where the tables go.
const DOCUMENT: &str = "docs/accuracy.md";

/// Runs the study; `short` is some twenty captures with one seed, and writes nothing.
pub fn test(on: &Workspace, short: bool) -> anyhow::Result<()> {
    // The build that the tests use: its program is the one under test.
    run(&mut on.whole("test", "--no-run --test it"))?;
    let mut study = Command::new(on.target.join("debug").join("ihd"));
    study.current_dir(&on.root).args(["study", "hostile"]);
    if short {
        study.arg("--short");
    } else {
        study.args(["--docs", DOCUMENT]);
    }
    run(&mut study)
}
