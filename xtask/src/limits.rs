//! firmware/budget.toml: what the firmware may take.

use std::collections::BTreeMap;
use std::fs;

use anyhow::Context;

use crate::workspace::Workspace;

/// The ceilings.
#[derive(Debug)]
pub struct Limits {
    /// Bytes: `flash`, `static_ram`, `stack`.
    pub memory: BTreeMap<String, f64>,
    /// Instructions by subject.
    pub instructions: BTreeMap<String, f64>,
}

impl Limits {
    /// Reads the file.
    pub fn read(workspace: &Workspace) -> anyhow::Result<Self> {
        let path = workspace.root().join("firmware/budget.toml");
        let text = fs::read_to_string(&path).with_context(|| format!("{}", path.display()))?;
        Self::parse(&text).with_context(|| format!("{}", path.display()))
    }

    fn parse(text: &str) -> anyhow::Result<Self> {
        let file: toml::Table = text.parse()?;
        let section = |name: &str| -> anyhow::Result<BTreeMap<String, f64>> {
            let table = file.get(name).and_then(toml::Value::as_table);
            let table = table.with_context(|| format!("no section [{name}]"))?;
            let number = |value: &toml::Value| {
                value
                    .as_float()
                    .or_else(|| value.as_integer().map(|n| n as f64))
            };
            table
                .iter()
                .map(|(key, value)| {
                    let value = number(value).with_context(|| format!("{key} is no number"))?;
                    Ok((key.clone(), value))
                })
                .collect()
        };
        Ok(Self {
            memory: section("memory")?,
            instructions: section("instructions")?,
        })
    }
}

/// What is wrong with a figure, if anything: above its ceiling, or so far below that the ceiling
/// no longer says anything.
pub fn verdict(what: &str, figure: f64, ceiling: f64) -> Option<String> {
    if figure > ceiling {
        Some(format!(
            "{what}: {figure}, more than the {ceiling} of firmware/budget.toml"
        ))
    } else if figure < ceiling / 2.0 {
        Some(format!(
            "{what}: {figure}, less than half of {ceiling}: lower the ceiling in firmware/budget.toml"
        ))
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ceilings_are_two_sided() {
        assert_eq!(verdict("x", 80.0, 100.0), None);
        assert_eq!(verdict("x", 50.0, 100.0), None);
        assert!(verdict("x", 100.1, 100.0).unwrap().contains("more than"));
        assert!(
            verdict("x", 49.0, 100.0)
                .unwrap()
                .contains("lower the ceiling")
        );
    }

    #[test]
    fn the_file_holds_numbers() {
        let limits = Limits::parse("[memory]\nflash = 3\n[instructions]\npair = 1.5\n").unwrap();
        assert_eq!(limits.memory["flash"], 3.0);
        assert_eq!(limits.instructions["pair"], 1.5);
        assert!(Limits::parse("[memory]\n").is_err());
        assert!(Limits::parse("[memory]\nflash = \"big\"\n[instructions]\n").is_err());
    }
}
