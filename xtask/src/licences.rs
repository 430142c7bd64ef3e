//! Whether every dependency's licence is one that deny.toml allows, with nothing installed. `cargo deny`, where it is
//! installed, checks advisories, bans and sources too.

use std::collections::BTreeSet;
use std::fs;
use std::process::Stdio;

use anyhow::{Context, anyhow, ensure};
use serde::Deserialize;
use spdx::{Expression, Licensee, ParseMode};

use crate::workspace::{Workspace, first_line, run};

const POLICY: &str = "deny.toml";
/// Every package that some build uses. `cargo metadata` also lists what no feature ever turns on.
const TREE: &str = "tree --workspace --all-features --target all --edges normal,build,dev \
                    --prefix none --format {p}|{l}";

/// Fails with a list of the packages whose licence is not allowed, or where `cargo deny` does.
pub fn check(workspace: &Workspace) -> anyhow::Result<()> {
    let policy = Licences::read(workspace)?;
    let mut tree = workspace.cargo(TREE.split(' '));
    tree.stderr(Stdio::inherit());
    let output = tree.output().context("could not start `cargo tree`")?;
    let text = String::from_utf8(output.stdout)?;
    // A package that stands in the tree before is marked with a star.
    let lines = text.lines().map(|line| line.trim_end_matches(" (*)"));
    let packages: BTreeSet<_> = lines.filter_map(|line| line.split_once('|')).collect();
    let listed = output.status.success() && !packages.is_empty();
    ensure!(listed, "`cargo tree` listed no package; see above");
    let mut refused = Vec::new();
    for (package, licence) in &packages {
        let name = package.split(' ').next().unwrap_or_default();
        if let Err(why) = policy.allow(name, licence) {
            refused.push(format!("{package}: {why}"));
        }
    }
    let (number, list) = (refused.len(), refused.join("\n  "));
    ensure!(
        refused.is_empty(),
        "{number} of {} packages have a licence that {POLICY} does not allow; replace them, or allow the licence there \
         if it is permissive:\n  {list}",
        packages.len()
    );
    println!("{} packages, every licence allowed", packages.len());
    if first_line(&mut workspace.cargo(["deny", "--version"])).is_some() {
        return run(&mut workspace.cargo(["deny", "check"]));
    }
    println!("cargo-deny is not installed: advisories, bans and sources were not checked");
    Ok(())
}

/// What this reads of deny.toml.
#[derive(Deserialize)]
struct Licences {
    allow: Vec<String>,
    #[serde(default)]
    exceptions: Vec<Exception>,
}

/// Further licences for one crate.
#[derive(Deserialize)]
struct Exception {
    #[serde(rename = "crate", alias = "name")]
    of: String,
    allow: Vec<String>,
}

impl Licences {
    fn read(workspace: &Workspace) -> anyhow::Result<Self> {
        let text = fs::read_to_string(workspace.root.join(POLICY)).context(POLICY)?;
        let file: toml::Table = text.parse().context(POLICY)?;
        let licences = file.get("licenses").cloned();
        let licences = licences.context("deny.toml has no [licenses]")?;
        licences.try_into().context(POLICY)
    }

    /// An error where the package `name` may not have this licence.
    fn allow(&self, name: &str, licence: &str) -> anyhow::Result<()> {
        let own = self.exceptions.iter().filter(|more| more.of == name);
        let names = self.allow.iter().chain(own.flat_map(|more| &more.allow));
        let allowed = names.map(|name| Licensee::parse(name).context(POLICY));
        let allowed = allowed.collect::<anyhow::Result<Vec<_>>>()?;
        // Lax: older crates write MIT/Apache-2.0.
        let licences = Expression::parse_mode(licence, ParseMode::LAX)
            .map_err(|why| anyhow!("`{licence}` is no SPDX expression: {}", why.reason))?;
        let met = licences.evaluate(|wanted| allowed.iter().any(|one| one.satisfies(wanted)));
        ensure!(met, "{licence}");
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(name: &str, licence: &str) -> Option<String> {
        let small = r#"
            allow = ["MIT", "Apache-2.0", "Apache-2.0 WITH LLVM-exception"]
            exceptions = [{ crate = "ring", allow = ["ISC"] }]
        "#;
        let policy: Licences = toml::from_str(small).unwrap();
        policy.allow(name, licence).err().map(|why| why.to_string())
    }

    #[test]
    fn one_alternative_is_enough_and_every_required_licence_must_be_allowed() {
        assert_eq!(refusal("a", "MIT OR GPL-3.0-only"), None);
        assert_eq!(refusal("a", "MIT/Apache-2.0"), None);
        assert_eq!(refusal("a", "Apache-2.0 WITH LLVM-exception"), None);
        assert!(refusal("a", "MIT AND GPL-3.0-only").is_some());
        assert!(refusal("a", "as you like").unwrap().contains("no SPDX"));
        assert!(refusal("a", "").is_some());

        // An exception holds for its crate alone.
        assert_eq!(refusal("ring", "MIT AND ISC"), None);
        assert!(refusal("rong", "MIT AND ISC").is_some());
    }

    #[test]
    fn the_projects_policy_allows_no_gpl() {
        let policy = Licences::read(&Workspace::find().unwrap()).unwrap();
        assert!(policy.allow("a", "MIT").is_ok());
        for licence in ["GPL-3.0-only", "LGPL-2.1-or-later", "AGPL-3.0-only"] {
            assert!(policy.allow("a", licence).is_err(), "{licence}");
        }
    }
}
