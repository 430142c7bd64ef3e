//! Whether every dependency's licence is one that deny.toml allows. `cargo deny` would say the same; this needs
//! nothing installed.

use std::collections::BTreeSet;
use std::fs;

use anyhow::{Context, anyhow, bail};
use spdx::{Expression, Licensee, ParseMode};
use toml::Table;

use crate::workspace::Workspace;

const POLICY: &str = "deny.toml";

/// Fails with a list of the packages whose licence is not allowed.
pub fn check(workspace: &Workspace) -> anyhow::Result<()> {
    let path = workspace.root().join(POLICY);
    let text = fs::read_to_string(&path).with_context(|| format!("could not read {POLICY}"))?;
    let policy = Policy::parse(&text)?;
    let packages = packages(workspace)?;
    let refused: Vec<_> = packages
        .iter()
        .filter_map(|package| policy.refusal(package))
        .collect();
    if !refused.is_empty() {
        bail!(
            "{} of {} packages have a licence that {POLICY} does not allow; replace them, or allow the licence there \
             if it is permissive:\n  {}",
            refused.len(),
            packages.len(),
            refused.join("\n  ")
        );
    }
    println!(
        "{} packages, every licence allowed by {POLICY}",
        packages.len()
    );
    Ok(())
}

/// A dependency and its licence, empty where its manifest has none.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Package {
    name: String,
    version: String,
    licence: String,
}

impl Package {
    /// From `name v1.2.3 (where)|licence|`.
    fn parse(line: &str) -> Option<Self> {
        let (package, rest) = line.split_once('|')?;
        let (licence, _repeated) = rest.split_once('|')?;
        let mut words = package.split_whitespace();
        Some(Self {
            name: words.next()?.to_owned(),
            version: words.next()?.trim_start_matches('v').to_owned(),
            licence: licence.trim().to_owned(),
        })
    }
}

/// Every package that some build of the workspace uses, on any machine and with any feature.
///
/// From `cargo tree`, because `cargo metadata` also lists packages that no feature ever turns on.
fn packages(workspace: &Workspace) -> anyhow::Result<BTreeSet<Package>> {
    let mut tree = workspace.cargo(["tree", "--workspace", "--all-features", "--target", "all"]);
    tree.args([
        "--edges",
        "normal,build,dev",
        "--prefix",
        "none",
        "--format",
        "{p}|{l}|",
    ]);
    let output = tree.output().context("could not start `cargo tree`")?;
    if !output.status.success() {
        bail!(
            "`cargo tree` failed:\n{}",
            String::from_utf8_lossy(&output.stderr).trim()
        );
    }
    let text = String::from_utf8(output.stdout).context("`cargo tree` printed no UTF-8")?;
    let packages: BTreeSet<_> = text.lines().filter_map(Package::parse).collect();
    if packages.is_empty() {
        bail!("`cargo tree` listed no package in a form that xtask reads");
    }
    Ok(packages)
}

/// The `[licenses]` table of deny.toml.
struct Policy {
    allowed: Vec<Licensee>,
    /// Further licences for one crate, by its name.
    exceptions: Vec<(String, Vec<Licensee>)>,
}

impl Policy {
    fn parse(text: &str) -> anyhow::Result<Self> {
        let table: Table = text
            .parse()
            .with_context(|| format!("{POLICY} is no valid TOML"))?;
        let licences = table
            .get("licenses")
            .and_then(toml::Value::as_table)
            .with_context(|| format!("{POLICY} has no [licenses] table"))?;
        let mut exceptions = Vec::new();
        let listed = licences.get("exceptions").and_then(toml::Value::as_array);
        for exception in listed.into_iter().flatten() {
            let name = exception.get("crate").or_else(|| exception.get("name"));
            let name = name
                .and_then(toml::Value::as_str)
                .with_context(|| format!("an exception in {POLICY} names no crate"))?;
            exceptions.push((name.to_owned(), licensees(exception.get("allow"))?));
        }
        Ok(Self {
            allowed: licensees(licences.get("allow"))?,
            exceptions,
        })
    }

    /// Why `package` is not allowed, if it is not.
    fn refusal(&self, package: &Package) -> Option<String> {
        let Package {
            name,
            version,
            licence,
        } = package;
        if licence.is_empty() {
            return Some(format!(
                "{name} {version}: its manifest has no licence expression"
            ));
        }
        // Lax: older crates write MIT/Apache-2.0.
        match Expression::parse_mode(licence, ParseMode::LAX) {
            Err(error) => Some(format!(
                "{name} {version}: `{licence}` is no SPDX expression: {}",
                error.reason
            )),
            Ok(expression) => {
                let allowed = expression.evaluate(|wanted| {
                    self.licences_for(name)
                        .any(|licensee| licensee.satisfies(wanted))
                });
                (!allowed).then(|| format!("{name} {version}: {licence}"))
            }
        }
    }

    fn licences_for<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Licensee> {
        let own = self.exceptions.iter().filter(move |(of, _)| of == name);
        self.allowed.iter().chain(own.flat_map(|(_, more)| more))
    }
}

fn licensees(list: Option<&toml::Value>) -> anyhow::Result<Vec<Licensee>> {
    let list = list
        .and_then(toml::Value::as_array)
        .with_context(|| format!("{POLICY} lacks a list `allow` of licences"))?;
    list.iter()
        .map(|licence| {
            let name = licence
                .as_str()
                .with_context(|| format!("{POLICY}: `{licence}` is no licence's name"))?;
            Licensee::parse(name)
                .map_err(|error| anyhow!("{POLICY}: `{name}` is no SPDX licence: {}", error.reason))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: &str = r#"
        [licenses]
        allow = ["MIT", "Apache-2.0", "Apache-2.0 WITH LLVM-exception"]
        exceptions = [{ crate = "ring", allow = ["ISC"] }]
    "#;

    fn package(name: &str, licence: &str) -> Package {
        Package::parse(&format!("{name} v1.2.3|{licence}|")).unwrap()
    }

    fn refusal(name: &str, licence: &str) -> Option<String> {
        Policy::parse(SMALL)
            .unwrap()
            .refusal(&package(name, licence))
    }

    #[test]
    fn reads_cargo_tree() {
        let line = "ihd-pinn v0.1.0 (/work/host/pinn)|MIT OR Apache-2.0| (*)";
        let package = Package::parse(line).unwrap();
        assert_eq!(package.name, "ihd-pinn");
        assert_eq!(package.version, "0.1.0");
        assert_eq!(package.licence, "MIT OR Apache-2.0");
        assert_eq!(Package::parse(""), None);
    }

    #[test]
    fn one_allowed_alternative_is_enough() {
        assert_eq!(refusal("a", "MIT OR GPL-3.0-only"), None);
        assert_eq!(refusal("a", "MIT/Apache-2.0"), None);
        assert_eq!(refusal("a", "Apache-2.0 WITH LLVM-exception"), None);
    }

    #[test]
    fn every_required_licence_must_be_allowed() {
        assert!(refusal("a", "MIT AND GPL-3.0-only").is_some());
        assert_eq!(
            refusal("a", "GPL-3.0-only").as_deref(),
            Some("a 1.2.3: GPL-3.0-only")
        );
    }

    #[test]
    fn a_missing_or_odd_licence_is_refused() {
        assert!(refusal("a", "").unwrap().contains("no licence"));
        assert!(refusal("a", "as you like").unwrap().contains("no SPDX"));
    }

    #[test]
    fn an_exception_holds_for_its_crate_alone() {
        assert_eq!(refusal("ring", "MIT AND ISC"), None);
        assert!(refusal("rong", "MIT AND ISC").is_some());
    }

    #[test]
    fn a_wrong_policy_says_what_is_wrong() {
        let wrong = |text| Policy::parse(text).err().map(|error| error.to_string());
        assert!(wrong("[bans]").unwrap().contains("[licenses]"));
        assert!(
            wrong("[licenses]\nallow = [\"MTI\"]")
                .unwrap()
                .contains("MTI")
        );
    }

    #[test]
    fn the_projects_policy_allows_no_gpl() {
        let root = Workspace::find().unwrap().root().join(POLICY);
        let policy = Policy::parse(&fs::read_to_string(root).unwrap()).unwrap();
        for licence in ["GPL-3.0-only", "LGPL-2.1-or-later", "AGPL-3.0-only"] {
            assert!(
                policy.refusal(&package("a", licence)).is_some(),
                "{licence}"
            );
        }
    }
}
