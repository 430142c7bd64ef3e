//! Files of the page, with the metadata for a browser.

use std::borrow::Cow;
use std::hash::{DefaultHasher, Hasher};

use include_dir::{Dir, include_dir};

static PAGE: Dir<'static> = include_dir!("$CARGO_MANIFEST_DIR/page");

/// File of the page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct File {
    /// Contents.
    pub bytes: Cow<'static, [u8]>,
    /// Media type for the header `content-type`.
    pub mime: &'static str,
    /// Changes with `bytes`; in the form of the header `etag`. Weak, as the server may compress the file.
    pub etag: String,
}

/// Returns the file of this path below `page/`, such as `js/main.js`; `None` if there is none, or its type is unknown.
///
/// In the dev profile the file on disk is used while the checkout exists, otherwise the one of the build.
pub fn file(path: &str) -> Option<File> {
    let mime = mime(path)?;
    let bytes = on_disk(path).or_else(|| Some(embedded(path)?.into()))?;
    let mut hasher = DefaultHasher::new();
    hasher.write(&bytes);
    let etag = format!("W/\"{:016x}\"", hasher.finish());
    Some(File { bytes, mime, etag })
}

fn embedded(path: &str) -> Option<&'static [u8]> {
    Some(PAGE.get_file(path)?.contents())
}

/// Lets pages be edited without building.
#[cfg(debug_assertions)]
fn on_disk(path: &str) -> Option<Cow<'static, [u8]>> {
    let plain = |part: &str| {
        !part.is_empty() && !part.starts_with('.') && !part.contains(['\\', ':', '\0'])
    };
    if !path.split('/').all(plain) {
        return None;
    }
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/page");
    Some(std::fs::read(format!("{page}/{path}")).ok()?.into())
}

#[cfg(not(debug_assertions))]
fn on_disk(_: &str) -> Option<Cow<'static, [u8]>> {
    None
}

/// Type by the ending of the name. With `nosniff` a browser uses this type only.
fn mime(path: &str) -> Option<&'static str> {
    let name = path.rsplit('/').next()?;
    let Some((_, ending)) = name.rsplit_once('.') else {
        return (name == "LICENSE").then_some("text/plain; charset=utf-8");
    };
    Some(match ending {
        "html" => "text/html; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "js" | "mjs" => "text/javascript; charset=utf-8",
        "json" | "map" => "application/json",
        "webmanifest" => "application/manifest+json",
        "md" | "ts" | "txt" => "text/plain; charset=utf-8",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "ico" => "image/x-icon",
        "woff2" => "font/woff2",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::fs;
    use std::path::Path;

    use super::*;

    /// Every file below a folder, by its path from there.
    fn below(folder: &Path, prefix: &str, found: &mut BTreeMap<String, Vec<u8>>) {
        for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
            let path = format!("{prefix}{}", entry.file_name().to_str().unwrap());
            if entry.file_type().unwrap().is_dir() {
                below(&entry.path(), &format!("{path}/"), found);
            } else {
                found.insert(path, fs::read(entry.path()).unwrap());
            }
        }
    }

    fn on_disk_now() -> BTreeMap<String, Vec<u8>> {
        let mut found = BTreeMap::new();
        let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("page");
        below(&page, "", &mut found);
        found
    }

    fn all_embedded(folder: &'static Dir<'static>, found: &mut BTreeMap<String, Vec<u8>>) {
        for file in folder.files() {
            let path = file.path().to_str().unwrap().replace('\\', "/");
            found.insert(path, file.contents().to_vec());
        }
        for below in folder.dirs() {
            all_embedded(below, found);
        }
    }

    #[test]
    fn the_program_holds_the_files_of_the_folder_and_no_other() {
        let mut embedded = BTreeMap::new();
        all_embedded(&PAGE, &mut embedded);
        assert!(embedded.contains_key("index.html"));
        assert!(embedded == on_disk_now(), "they differ");
    }

    #[test]
    fn each_file_has_a_type_and_a_tag_of_its_own() {
        let mut tags = BTreeMap::new();
        for (path, bytes) in on_disk_now() {
            let file = file(&path).unwrap_or_else(|| panic!("{path} has no type"));
            assert_eq!(file.bytes, bytes, "{path}");
            assert_eq!(embedded(&path), Some(bytes.as_slice()), "{path}");
            let other = tags.insert(file.etag, bytes.clone());
            assert!(other.is_none_or(|other| other == bytes), "{path}");
        }
    }

    #[test]
    fn nothing_beside_the_folder_is_a_file_of_it() {
        for path in [
            "",
            ".",
            "..",
            "/",
            "js",
            "js/",
            "../Cargo.toml",
            "../src/lib.rs",
            "../README.md",
            "js/../../README.md",
            "js/../index.html",
            "./index.html",
            "/index.html",
            "//index.html",
            "..\\README.md",
            "index.html\0",
            "C:\\Windows\\win.ini",
            "/etc/passwd",
            "nowhere.html",
        ] {
            assert_eq!(file(path), None, "{path:?}");
        }
    }

    #[test]
    fn a_browser_is_told_types_that_it_runs() {
        assert_eq!(mime("js/main.js"), Some("text/javascript; charset=utf-8"));
        assert_eq!(mime("a.b/page.css"), Some("text/css; charset=utf-8"));
        assert_eq!(
            mime("vendor/uplot/LICENSE"),
            Some("text/plain; charset=utf-8")
        );
        for unknown in ["a.exe", "js.d/main", "js/.main", "x.php"] {
            assert_eq!(mime(unknown), None, "{unknown}");
        }
    }
}
