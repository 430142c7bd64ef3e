//! Check `store`: reported by a running daemon, or a trial of the folder.

use std::path::Path;

use ihd_daemon::cause_of;
use ihd_daemon::config::DaemonConfig;
use ihd_doctor::{Check, Measurement};
use ihd_model::StoreFailure;
use ihd_store::{StoreError, clock, try_folder};

use crate::cli::configured;
use crate::cli::device::HEALTH_WITHIN;

const NAME: &str = "store";

/// Checks the store of a configuration.
pub(super) fn check(path: Option<&Path>) -> Check {
    let config = match configured::config(path) {
        Ok(config) => config,
        Err(error) => {
            let why = crate::cli::message(&error);
            return Check::fail(
                NAME,
                why,
                "Mend the configuration; docs/daemon.md has its keys",
            );
        }
    };
    let health = configured::daemon(&config).and_then(|daemon| match daemon {
        Some(client) => Ok(Some(client.health(HEALTH_WITHIN)?)),
        None => Ok(None),
    });
    match health {
        Ok(Some(health)) => of_daemon(&config, health.store, health.store_failure),
        Ok(None) => of_folder(&config.store),
        Err(error) => Check::fail(
            NAME,
            format!("the daemon does not say: {}", crate::cli::message(&error)),
            "Look into the daemon's log",
        ),
    }
}

/// Check from the running daemon's report.
fn of_daemon(config: &DaemonConfig, is_well: bool, failure: Option<StoreFailure>) -> Check {
    let at = format!("the daemon at {}", config.listen);
    let Some(failure) = failure else {
        return match is_well {
            true => Check::pass(NAME, format!("{at} stores everything")),
            false => Check::fail(
                NAME,
                format!("{at} does not store everything"),
                "Look into the daemon's log",
            ),
        };
    };
    let (since, lost) = (clock::rfc3339(failure.since_ms), &failure.dropped);
    let finding = format!(
        "{at} does not store everything since {since}: {}; lost so far: {}",
        failure.text,
        lost.text()
    );
    let evidence = [
        ("since_ms", failure.since_ms as f64, "ms"),
        ("lost_windows", lost.windows as f64, ""),
        ("lost_results", lost.results as f64, ""),
        ("lost_telemetry", lost.telemetry_s as f64, "s"),
        ("lost_events", lost.events as f64, ""),
        ("lost_audits", lost.audits as f64, ""),
    ];
    let numbers = evidence.map(|(name, value, unit)| Measurement::informative(name, value, unit));
    Check::fail(NAME, finding, failure.advice).with_evidence(numbers.into())
}

/// Checks a folder that no daemon of this configuration writes to.
fn of_folder(folder: &Path) -> Check {
    match try_folder(folder) {
        Ok(tried) => Check::pass(
            NAME,
            format!(
                "{}: opens, can be written, has room; no daemon uses it",
                folder.display()
            ),
        )
        .with_evidence(vec![
            Measurement::informative("databases", tried.databases as f64, ""),
            Measurement::informative("checked", tried.checked as f64, ""),
        ]),
        Err(StoreError::NoStore { folder }) => Check::not_tested(
            NAME,
            format!("{}: none yet; a daemon makes it", folder.display()),
        ),
        Err(error) => match cause_of(&error) {
            Some(cause) => Check::fail(NAME, format!("{}: {error}", cause.text()), cause.advice()),
            // Used by another process, or of a later version: the error has the remedy.
            None => Check::fail(
                NAME,
                error.to_string(),
                "ihd doctor --config FILE asks the daemon of another configuration",
            ),
        },
    }
}
