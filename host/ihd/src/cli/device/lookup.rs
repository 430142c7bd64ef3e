//! `ihd device DEV lookup`: the one in use, and those that are offered.

use std::convert::Infallible;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result};
use ihd_model::Command;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::grid::{CURRENT_KNOTS_A, CURRENTS, FREQUENCIES, FREQUENCY_KNOTS_HZ};
use serde_json::{Value, json};

use super::hob::Hob;
use super::text::one_line;
use crate::cli::output;

/// Limit of a lookup file's size, in bytes.
const MAX_FILE: u64 = 4_096;

/// Lookup to be offered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Offer {
    /// The one that was active before.
    Previous,
    /// The built-in one.
    BuiltIn,
    /// A file of `ihd trainer`.
    File(PathBuf),
}

impl FromStr for Offer {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(match text {
            "previous" => Self::Previous,
            "builtin" => Self::BuiltIn,
            file => Self::File(file.into()),
        })
    }
}

impl Offer {
    /// Command that offers it.
    ///
    /// # Errors
    /// If the file cannot be read or is no lookup.
    pub(super) fn command(&self) -> Result<Command> {
        Ok(match self {
            Self::Previous => Command::LookupRollback { version: None },
            Self::BuiltIn => Command::LookupReset,
            Self::File(file) => Command::LookupPush { blob: read(file)? },
        })
    }
}

/// Reads a file's bytes; the device checks them.
///
/// # Errors
/// If the file cannot be read or is no lookup.
pub fn read(file: &Path) -> Result<Vec<u8>> {
    let cannot = || format!("cannot read {}", file.display());
    let opened = std::fs::File::open(file).with_context(cannot)?;
    let mut blob = Vec::new();
    opened
        .take(MAX_FILE)
        .read_to_end(&mut blob)
        .with_context(cannot)?;
    RlLookup::from_bytes(&blob).with_context(|| {
        format!(
            "{} is no lookup (lookup-vN.bin of `ihd trainer`)",
            file.display()
        )
    })?;
    Ok(blob)
}

/// Prints the active lookup, and the versions in the store.
pub(super) fn show(hob: &mut Hob, json: bool) -> Result<()> {
    let (lookup, stored) = match hob {
        Hob::Direct(direct) => (Some(direct.client().read_lookup()?), Vec::new()),
        Hob::Daemon { client, name } => {
            let stored = client.lookups(name)?;
            let active = stored.iter().find(|row| row.state == "active");
            let lookup = active
                .map(|row| RlLookup::from_bytes(&row.blob))
                .transpose()
                .context("the active lookup of the store")?;
            (lookup, stored)
        }
    };
    if json {
        let rows: Vec<Value> = stored
            .iter()
            .map(|row| json!({"version": row.version, "state": row.state, "at_ms": row.at_ms, "why": row.why}))
            .collect();
        return output::json(&json!({"active": lookup.as_ref().map(cells), "stored": rows}));
    }
    match &lookup {
        Some(lookup) => output::text(&table(lookup))?,
        None => say!("{}: the built-in lookup", hob.name())?,
    }
    for row in &stored {
        say!(
            "version {:<6} {:<11} {}",
            row.version,
            one_line(&row.state),
            one_line(&row.why)
        )?;
    }
    Ok(())
}

fn cells(lookup: &RlLookup) -> Value {
    let observed =
        |f: usize| -> Vec<bool> { (0..CURRENTS).map(|i| lookup.is_observed(f, i)).collect() };
    json!({
        "version": lookup.version,
        "observed_cells": lookup.observed_cells(),
        "frequency_hz": FREQUENCY_KNOTS_HZ,
        "current_a": CURRENT_KNOTS_A,
        "r_ohm": lookup.r_ohm(),
        "l_h": lookup.l_h(),
        "observed": (0..FREQUENCIES).map(observed).collect::<Vec<_>>(),
    })
}

/// Table of R and L over frequency (down) and current (across, every fourth); observed cells have a star.
fn table(lookup: &RlLookup) -> String {
    let shown: Vec<usize> = (0..CURRENTS).step_by(4).collect();
    let built_in = if lookup.version == 0 {
        " (the built-in one)"
    } else {
        ""
    };
    let mut text = format!(
        "version {}{built_in}, {} of {} cells known (*)\n",
        lookup.version,
        lookup.observed_cells(),
        FREQUENCIES * CURRENTS
    );
    let l_uh = lookup.l_h().map(|row| row.map(|l_h| l_h * 1e6));
    for (name, cells) in [("R in ohm", lookup.r_ohm()), ("L in µH", l_uh)] {
        text += &format!("{name:<10}");
        for &i in &shown {
            text += &format!("{:>8.1} A", CURRENT_KNOTS_A[i]);
        }
        text.push('\n');
        for (f, row) in cells.iter().enumerate() {
            text += &format!("{:>6.1} kHz", FREQUENCY_KNOTS_HZ[f] * 1e-3);
            for &i in &shown {
                let star = if lookup.is_observed(f, i) { '*' } else { ' ' };
                text += &format!("{:>9.3}{star}", row[i]);
            }
            text.push('\n');
        }
    }
    text
}
