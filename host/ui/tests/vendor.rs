//! Third-party files of the page are those of npm's packages: SOURCE.json in each folder has their hashes.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde_json::Value;
use sha2::{Digest, Sha512};

const SOURCE: &str = "SOURCE.json";

/// SHA-512 in hexadecimal of each file of a folder but its list, by name.
fn present(folder: &Path) -> BTreeMap<String, String> {
    let mut sums = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        if name != SOURCE {
            let sum = Sha512::digest(fs::read(entry.path()).unwrap());
            let hexadecimal = sum.iter().map(|byte| format!("{byte:02x}")).collect();
            sums.insert(name, hexadecimal);
        }
    }
    sums
}

/// Hashes that the folder's list has, by the name without the folders of the package.
fn listed(folder: &Path) -> BTreeMap<String, String> {
    let text = fs::read_to_string(folder.join(SOURCE)).unwrap();
    let source: Value = serde_json::from_str(&text).unwrap();
    let mut sums = BTreeMap::new();
    for (path, sum) in source["files"].as_object().unwrap() {
        let name = path.rsplit('/').next().unwrap().to_owned();
        let twice = sums.insert(name, sum.as_str().unwrap().to_owned());
        assert_eq!(twice, None, "{path} has a name that another file has");
    }
    sums
}

#[test]
fn no_file_was_changed_added_or_lost() {
    let vendor = Path::new(env!("CARGO_MANIFEST_DIR")).join("page/vendor");
    let folders: Vec<_> = fs::read_dir(&vendor)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    assert!(folders.contains(&vendor.join("uplot")), "{folders:?}");
    for folder in folders {
        assert_eq!(present(&folder), listed(&folder), "{}", folder.display());
    }
}
