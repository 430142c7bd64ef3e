//! The udev rule: check of its presence, content and order; and its installation.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use ihd_signal::atomic;

use super::{Os, System};
use crate::Check;

/// Content of the rule, kept in docs/.
pub const RULE: &str = include_str!("../../../../docs/70-ihd.rules");

/// Name of its file. Tags are processed by 73-seat-late.rules: a later rule has no effect.
pub const RULE_NAME: &str = "70-ihd.rules";

/// File name that a rule's must sort before to have an effect.
const TOO_LATE: &str = "73-seat-late.rules";

/// Folder of the rules of the machine's owner.
const RULES: &str = "etc/udev/rules.d";

/// Returns `true` if a rule equals ours apart from comments and blank lines.
fn equals_ours(content: &str) -> bool {
    let lines = |text: &str| -> Vec<String> {
        let lines = text.lines().map(str::trim);
        let lines = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
        lines.map(str::to_owned).collect()
    };
    lines(content) == lines(RULE)
}

/// Returns `true` if the rule is installed, up to date and effective.
pub(super) fn is_current(system: &dyn System) -> bool {
    system.rules().is_ok_and(|rules| {
        let mut rules = rules.iter();
        rules.any(|(name, content)| name.as_str() < TOO_LATE && equals_ours(content))
    })
}

/// Checks the rule.
pub(super) fn check(system: &dyn System) -> Check {
    const NAME: &str = "udev_rule";
    if system.os() != Os::Linux {
        return Check::not_tested(NAME, "only Linux has udev");
    }
    if !system.has_udev() {
        return Check::not_tested(NAME, "udev does not run here (a container?)");
    }
    let rules = match system.rules() {
        Ok(rules) => rules,
        Err(why) => return Check::fail(NAME, format!("cannot be read: {why}"), system.as_root()),
    };
    if is_current(system) {
        let names: Vec<_> = rules.iter().map(|(name, _)| name.as_str()).collect();
        return Check::pass(NAME, format!("installed and current: {}", names.join(", ")));
    }
    let finding = match rules.last() {
        None => "not installed".to_owned(),
        Some((name, _)) if name.as_str() >= TOO_LATE => {
            format!("{name} is read after {TOO_LATE}, which acts on its tag: it has no effect")
        }
        Some((name, _)) => format!("{name} is not that of this version"),
    };
    Check::fail(NAME, finding, system.as_root())
}

/// Error of installing the rule.
#[derive(Debug, thiserror::Error)]
pub enum FixError {
    /// A file could not be written or removed.
    #[error("cannot write {path}: {source}; run as root: {as_root}")]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
        /// Command line that has the rights.
        as_root: String,
    },
    /// The rule is written, but udev could not be notified.
    #[error(
        "the rule is written, but {command} failed: {source}; unplug the board and plug it in again"
    )]
    Reload {
        /// Command that failed.
        command: String,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Installs the rule under `root` (`/`), and calls `run` with the programs and arguments that notify udev. Our rules under an
/// ineffective name are removed. Returns the rule's path. If interrupted, either the old or the new rule is in place.
///
/// # Errors
/// [`FixError`] with what to do.
pub fn install(
    root: &Path,
    as_root: &str,
    run: &mut dyn FnMut(&str, &[&str]) -> io::Result<()>,
) -> Result<PathBuf, FixError> {
    let folder = root.join(RULES);
    let path = folder.join(RULE_NAME);
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |source| FixError::Write {
            path,
            source,
            as_root: as_root.to_owned(),
        }
    };
    // udev reads files ending in .rules only, which a temporary one does not.
    let written = fs::create_dir_all(&folder).and_then(|()| atomic::write(&path, RULE.as_bytes()));
    written.map_err(failed(&path))?;
    let old = folder.join("99-ihd.rules");
    match fs::remove_file(&old) {
        Ok(()) => {}
        Err(e) if e.kind() == ErrorKind::NotFound => {}
        Err(e) => return Err(failed(&old)(e)),
    }
    for arguments in [
        &["control", "--reload"][..],
        &["trigger", "--subsystem-match=usb", "--subsystem-match=tty"],
    ] {
        run("udevadm", arguments).map_err(|source| FixError::Reload {
            command: format!("udevadm {}", arguments.join(" ")),
            source,
        })?;
    }
    Ok(path)
}
