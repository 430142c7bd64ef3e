//! The arrows between the crates: shared ← firmware ← host ← tests, and nothing of a machine below the host.

use anyhow::Context;
use serde_json::Value;

use crate::workspace::Workspace;

/// The workspace's folders, each of which may lean on those before it.
const ORDER: [&str; 4] = ["shared", "firmware", "host", "tests"];
/// Where no standard library, HAL or executor is known.
const BARE: [&str; 2] = ["shared", "firmware"];
/// Crates that know a board or schedule tasks on one.
const BOARD_CRATES: [&str; 8] = [
    "embassy-",
    "stm32",
    "cortex-m",
    "embedded-hal",
    "embedded-io",
    "defmt",
    "panic-",
    "rtic",
];
/// Crates that need an operating system.
const STD_CRATES: [&str; 12] = [
    "anyhow",
    "axum",
    "burn",
    "clap",
    "indicatif",
    "nusb",
    "plotters",
    "rayon",
    "serde_json",
    "serialport",
    "tokio",
    "toml",
];
/// Features that bring in an operating system or a heap.
const STD_FEATURES: [&str; 3] = ["std", "use-std", "alloc"];

/// Every dependency that points the wrong way.
pub fn check(workspace: &Workspace) -> anyhow::Result<Vec<String>> {
    let metadata = workspace.metadata(&["--no-deps"])?;
    breaches(&metadata)
}

fn breaches(metadata: &Value) -> anyhow::Result<Vec<String>> {
    let root = metadata["workspace_root"]
        .as_str()
        .context("`cargo metadata` names no workspace_root")?;
    let mut broken = Vec::new();
    for package in list(&metadata["packages"]) {
        let manifest = text(&package["manifest_path"]);
        let path = manifest.strip_prefix(root).unwrap_or(manifest);
        let path = path.trim_start_matches(['/', '\\']);
        let Some(folder) = folder(path) else {
            broken.push(format!(
                "{path}: xtask/src/arrows.rs does not say where this folder stands"
            ));
            continue;
        };
        for dependency in list(&package["dependencies"]) {
            let why = wrong_way(folder, root, dependency).or_else(|| not_bare(folder, dependency));
            broken.extend(why.map(|why| format!("{path}: {} {why}", text(&dependency["name"]))));
        }
    }
    Ok(broken)
}

/// The top folder of a manifest's path.
fn folder(path: &str) -> Option<&str> {
    let top = path.split(['/', '\\']).next()?;
    (ORDER.contains(&top) || top == "xtask").then_some(top)
}

/// Why the crate in `folder` may not have this dependency inside the workspace.
fn wrong_way(folder: &str, root: &str, dependency: &Value) -> Option<String> {
    let path = dependency["path"].as_str()?.strip_prefix(root)?;
    let other = path
        .trim_start_matches(['/', '\\'])
        .split(['/', '\\'])
        .next()?;
    let rank = |folder: &str| ORDER.iter().position(|name| *name == folder);
    // xtask stands beside the order: it may use any crate, no crate may use it.
    let allowed = match (rank(folder), rank(other)) {
        (_, None) => false,
        (None, Some(_)) => true,
        (Some(own), Some(other)) => other <= own,
    };
    (!allowed).then(|| format!("points the wrong way: {} is the order", ORDER.join(" <- ")))
}

/// Why a crate that runs on the board may not have this dependency.
fn not_bare(folder: &str, dependency: &Value) -> Option<String> {
    // Tests and build scripts run on the host.
    if !BARE.contains(&folder) || !dependency["kind"].is_null() {
        return None;
    }
    let name = text(&dependency["name"]);
    let for_board = text(&dependency["target"]).contains("target_os = \"none\"");
    if BOARD_CRATES.iter().any(|board| name.starts_with(board))
        && !(for_board && folder == "firmware")
    {
        return Some(
            "knows a board: only the firmware may name it, under cfg(target_os = \"none\")".into(),
        );
    }
    if STD_CRATES.contains(&name) {
        return Some("needs an operating system".into());
    }
    let feature = list(&dependency["features"])
        .map(text)
        .find(|feature| STD_FEATURES.contains(feature))?;
    Some(format!(
        "has the feature `{feature}`, which the board cannot offer"
    ))
}

fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn one(folder: &str, dependency: Value) -> Vec<String> {
        breaches(&json!({
            "workspace_root": "/w",
            "packages": [{
                "manifest_path": format!("/w/{folder}/Cargo.toml"),
                "dependencies": [dependency],
            }],
        }))
        .unwrap()
    }

    fn inside(folder: &str, kind: Option<&str>) -> Value {
        json!({ "name": folder, "path": format!("/w/{folder}"), "kind": kind, "features": [] })
    }

    fn outside(name: &str, kind: Option<&str>, target: Option<&str>, features: &[&str]) -> Value {
        json!({ "name": name, "path": null, "kind": kind, "target": target, "features": features })
    }

    #[test]
    fn arrows_point_one_way() {
        assert!(one("firmware", inside("shared", None)).is_empty());
        assert!(one("host", inside("host/pinn", None)).is_empty());
        assert!(one("tests", inside("host", Some("dev"))).is_empty());
        assert!(one("xtask", inside("host", None)).is_empty());
        assert_eq!(one("shared", inside("firmware", None)).len(), 1);
        assert_eq!(one("firmware", inside("tests", Some("dev"))).len(), 1);
        assert_eq!(one("host", inside("xtask", None)).len(), 1);
        assert_eq!(one("playground", inside("host", None)).len(), 1);
    }

    #[test]
    fn no_board_below_the_host_but_the_firmwares_own() {
        let board = Some("cfg(target_os = \"none\")");
        assert!(one("firmware", outside("embassy-stm32", None, board, &[])).is_empty());
        assert_eq!(
            one("firmware", outside("embassy-stm32", None, None, &[])).len(),
            1
        );
        assert_eq!(
            one("shared", outside("cortex-m", None, board, &[])).len(),
            1
        );
    }

    #[test]
    fn no_standard_library_on_the_board() {
        assert_eq!(one("shared", outside("clap", None, None, &[])).len(), 1);
        assert_eq!(
            one("shared", outside("postcard", None, None, &["use-std"])).len(),
            1
        );
        assert!(one("shared", outside("proptest", Some("dev"), None, &["std"])).is_empty());
        assert!(one("host", outside("clap", None, None, &["std"])).is_empty());
    }
}
