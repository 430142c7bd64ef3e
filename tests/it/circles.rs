//! Files of a crate use each other in one direction, so that each crate can be read from one end.
//!
//! Textual: a use is a path from `crate`, `super`, `self` or a child module, outside tests. A `pub use` is a surface and no
//! use; what is reached through it is not seen. A folder's files may use what its mod.rs defines.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// Text of each file by module.
type Files = BTreeMap<String, String>;

fn read(folder: &Path, module: &str, files: &mut Files) {
    for entry in fs::read_dir(folder).expect("sources").flatten() {
        let path = entry.path();
        let stem = path.file_stem().and_then(|stem| stem.to_str());
        let child = format!("{module}::{}", stem.unwrap_or_default());
        let child = child.trim_end_matches("::mod");
        let is_source = path.extension().is_some_and(|end| end == "rs");
        if path.is_dir() {
            read(&path, child, files);
        } else if is_source && !matches!(child, "::lib" | "::main") && !child.ends_with("::tests") {
            files.insert(child.to_owned(), fs::read_to_string(&path).expect("UTF-8"));
        }
    }
}

/// Files that a file uses. `a::{b, c}` is read as `a::b` and `a::c`; groups within groups are not.
fn uses(module: &str, files: &Files) -> BTreeSet<String> {
    let text = files[module].split("#[cfg(test)]\nmod ").next();
    let lines = text.unwrap_or_default().lines();
    let code = lines.filter(|line| !line.trim_start().starts_with("//"));
    let code = code.collect::<Vec<_>>().join(" ").replace("::{", "::{ ");
    let (mut used, mut group, mut before) = (BTreeSet::new(), String::new(), ["", ""]);
    let is_path = |c: char| c.is_alphanumeric() || "_:{}".contains(c);
    for word in code.split(|c| !is_path(c)).filter(|word| !word.is_empty()) {
        let path = format!("{group}{}", word.trim_end_matches('}'));
        if let Some(prefix) = path.strip_suffix('{').filter(|path| path.ends_with("::")) {
            prefix.clone_into(&mut group);
        } else if !(before[1] == "use" && matches!(before[0], "pub" | "crate" | "super")) {
            let inside = |to: &String| format!("{module}::").starts_with(&format!("{to}::"));
            used.extend(target(module, &path, files).filter(|to| !inside(to)));
        }
        if word.ends_with('}') {
            group.clear();
        }
        before = [before[1], word];
    }
    used
}

/// The file of a path as written in a module; `None` outside the crate's files.
fn target(module: &str, path: &str, files: &Files) -> Option<String> {
    let mut from = module.to_owned();
    for part in path.split("::") {
        match part {
            "crate" => from.clear(),
            "super" => from.truncate(from.rfind("::")?),
            "self" => {}
            part if files.contains_key(&format!("{from}::{part}")) => from += &format!("::{part}"),
            _ => break,
        }
    }
    files.contains_key(&from).then_some(from)
}

/// Files that reach themselves.
fn circle(files: &Files) -> Vec<&String> {
    let uses: BTreeMap<_, _> = files
        .keys()
        .map(|module| (module, uses(module, files)))
        .collect();
    let reaches_itself = |module: &&String| {
        let (mut seen, mut next) = (BTreeSet::new(), uses[module].clone());
        while let Some(one) = next.pop_first() {
            next.extend(uses[&one].difference(&seen).cloned());
            seen.insert(one);
        }
        seen.contains(*module)
    };
    files.keys().filter(reaches_itself).collect()
}

#[test]
fn no_two_files_of_a_crate_use_each_other() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let hosts = fs::read_dir(root.join("host")).expect("host").flatten();
    let others = ["firmware", "python", "shared", "xtask"].map(|room| root.join(room));
    for room in hosts.map(|room| room.path()).chain(others) {
        let mut files = Files::new();
        read(&room.join("src"), "", &mut files);
        let found = circle(&files);
        assert!(found.is_empty(), "{}: {found:?}", room.display());
    }
}
