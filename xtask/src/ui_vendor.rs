//! Whether what the page brings along is what npm's package holds: the hashes beside it, and on demand the package itself.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, bail, ensure};
use serde::Deserialize;
use sha2::{Digest, Sha512};

use crate::workspace::{Workspace, first_line, run};

const VENDOR: &str = "host/ui/page/vendor";
/// In each folder of it.
const SOURCE: &str = "SOURCE.json";

/// Where a folder of the vendor's files is from.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Source {
    /// The package's name at npm.
    name: String,
    version: String,
    /// npm's hash of the package: `sha512-` and base64.
    integrity: String,
    /// SHA-512 in hexadecimal of each file, by its path in the package.
    files: BTreeMap<String, String>,
}

/// Fails where a file is not that of its list, or where none or another one is listed; with `fetch` where npm's package of that
/// version is another one.
pub fn check(workspace: &Workspace, fetch: bool) -> anyhow::Result<()> {
    let sources = sources(&workspace.root.join(VENDOR))?;
    for (folder, source) in &sources {
        let named = || format!("{} ({} {})", folder.display(), source.name, source.version);
        hold(folder, source).with_context(named)?;
        println!(
            "{} {}: {} files as listed",
            source.name,
            source.version,
            source.files.len()
        );
        if fetch {
            compare(&workspace.target, source).with_context(named)?;
            println!(
                "{} {}: npm's package has the same",
                source.name, source.version
            );
        }
    }
    Ok(())
}

/// Whether npm's registry is there; where it is not, the package cannot be looked at.
pub fn can_fetch() -> bool {
    let mut asked = npm();
    asked.args(["view", "uplot", "name"]);
    asked.args(["--fetch-retries=0", "--fetch-timeout=5000"]);
    first_line(&mut asked).is_some()
}

fn npm() -> Command {
    Command::new(if cfg!(windows) { "npm.cmd" } else { "npm" })
}

fn sources(vendor: &Path) -> anyhow::Result<Vec<(PathBuf, Source)>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(vendor).with_context(|| vendor.display().to_string())? {
        let folder = entry?.path();
        let path = folder.join(SOURCE);
        let text = fs::read_to_string(&path)
            .with_context(|| format!("{}: each folder says where it is from", path.display()))?;
        let source = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
        found.push((folder, source));
    }
    ensure!(!found.is_empty(), "{} is empty", vendor.display());
    Ok(found)
}

/// The folder's files against the list.
fn hold(folder: &Path, source: &Source) -> anyhow::Result<()> {
    let mut listed = BTreeSet::from([SOURCE.to_owned()]);
    for (path, sum) in &source.files {
        let name = path.rsplit('/').next().unwrap_or(path);
        ensure!(listed.insert(name.to_owned()), "{name} is listed twice");
        let bytes = fs::read(folder.join(name)).with_context(|| format!("{name} is missing"))?;
        ensure!(
            sha512(&bytes) == *sum,
            "{name} is not the file of the list: it was changed, or {SOURCE} was; `npm pack {}@{}` has the package",
            source.name,
            source.version
        );
    }
    for entry in fs::read_dir(folder)? {
        let name = entry?.file_name();
        let name = name.to_string_lossy();
        ensure!(
            listed.contains(&*name),
            "{name} stands there, and {SOURCE} does not list it"
        );
    }
    Ok(())
}

/// npm's package against the list. npm itself compares what it downloads with the hash that its registry names.
fn compare(target: &Path, source: &Source) -> anyhow::Result<()> {
    let folder = target.join("ui-vendor");
    if folder.exists() {
        fs::remove_dir_all(&folder)?;
    }
    fs::create_dir_all(&folder)?;
    let package = format!("{}@{}", source.name, source.version);
    let packed = npm()
        .current_dir(&folder)
        .args(["pack", "--json", &package])
        .stderr(Stdio::inherit())
        .output()
        .context("could not start npm")?;
    ensure!(
        packed.status.success(),
        "`npm pack {package}` failed; see above"
    );
    let packed: Vec<Packed> =
        serde_json::from_slice(&packed.stdout).context("`npm pack --json`")?;
    let [packed] = &packed[..] else {
        bail!("`npm pack {package}` made {} packages", packed.len());
    };
    ensure!(
        packed.integrity == source.integrity,
        "npm says {}, {SOURCE} says {}",
        packed.integrity,
        source.integrity
    );
    run(Command::new("tar")
        .current_dir(&folder)
        .args(["-xzf", &packed.filename]))?;
    for (path, sum) in &source.files {
        let bytes = fs::read(folder.join(path)).with_context(|| format!("{path} is not in it"))?;
        ensure!(
            sha512(&bytes) == *sum,
            "{path} is another one in the package"
        );
    }
    Ok(())
}

/// What `npm pack --json` says of a package.
#[derive(Deserialize)]
struct Packed {
    integrity: String,
    filename: String,
}

fn sha512(bytes: &[u8]) -> String {
    let sum = Sha512::digest(bytes);
    sum.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sum_is_that_of_the_standard() {
        // FIPS 180-4, example of one block.
        let expected = "ddaf35a193617abacc417349ae20413112e6fa4e89a97ea20a9eeee64b55d39a\
                        2192992a274fc1a836ba3c23a3feebbd454d4423643ce80e2a9ac94fa54ca49f";
        assert_eq!(sha512(b"abc"), expected);
    }

    #[test]
    fn a_file_that_was_changed_added_or_lost_is_seen() {
        let folder = std::env::temp_dir().join(format!("ihd-ui-vendor-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let source = Source {
            name: "x".into(),
            version: "1.0.0".into(),
            integrity: String::new(),
            files: BTreeMap::from([("package/dist/a.js".to_owned(), sha512(b"abc"))]),
        };
        let told = |source| hold(&folder, source).err().map(|why| why.to_string());
        assert!(told(&source).unwrap().contains("missing"));
        fs::write(folder.join("a.js"), b"abc").unwrap();
        assert_eq!(told(&source), None);
        fs::write(folder.join("a.js"), b"abd").unwrap();
        assert!(told(&source).unwrap().contains("not the file of the list"));
        fs::write(folder.join("a.js"), b"abc").unwrap();
        fs::write(folder.join("b.js"), b"").unwrap();
        assert!(told(&source).unwrap().contains("b.js"));
        fs::remove_dir_all(&folder).unwrap();
    }
}
