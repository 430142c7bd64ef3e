//! Page: all its files, no others, and the security headers.

use std::fs;
use std::path::Path;

use crate::http::{ask, header, whole};
use crate::rig::Running;

fn read_below(folder: &Path, prefix: &str, files: &mut Vec<(String, Vec<u8>)>) {
    for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let path = format!("{prefix}{}", entry.file_name().to_str().unwrap());
        if entry.file_type().unwrap().is_dir() {
            read_below(&entry.path(), &format!("{path}/"), files);
        } else {
            files.push((path, fs::read(entry.path()).unwrap()));
        }
    }
}

/// Returns all files of host/ui/page.
fn files() -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../ui/page");
    read_below(&page, "", &mut files);
    assert!(!files.is_empty());
    files
}

#[test]
fn each_file_of_the_page_is_served_as_it_is() {
    // With tokens: the page needs none.
    let server = Running::with(|settings, dir| settings.token_file = Some(dir.join("tokens")));
    for (path, bytes) in files() {
        let (status, head, body) = whole(server.address, &format!("GET /page/{path}"), &[], "");
        assert_eq!(status, 200, "{path}");
        assert!(body == bytes, "{path} is another one");
        let mime = header(&head, "content-type").unwrap();
        let expected = match path.rsplit_once('.').map(|(_, ending)| ending) {
            Some("js") => "text/javascript; charset=utf-8",
            Some("css") => "text/css; charset=utf-8",
            Some("html") => "text/html; charset=utf-8",
            _ => mime,
        };
        assert_eq!(mime, expected, "{path}");
        assert_eq!(header(&head, "cache-control"), Some("no-cache"), "{path}");
    }
    let (status, head, body) = whole(server.address, "GET /", &[], "");
    assert_eq!(status, 200);
    assert!(
        header(&head, "content-type")
            .unwrap()
            .starts_with("text/html")
    );
    let index = files().into_iter().find(|(path, _)| path == "index.html");
    assert!(body == index.unwrap().1);
}

#[test]
fn nothing_beside_the_page_is_served() {
    let server = Running::start();
    for path in [
        "/page",
        "/page/",
        "/page/nowhere.js",
        "/page/../Cargo.toml",
        "/page/%2e%2e/Cargo.toml",
        "/page/..%2fCargo.toml",
        "/page/..%2f..%2f..%2f..%2fetc%2fpasswd",
        "/page/js/..%2f..%2fREADME.md",
        "/page/js%2f..%2findex.html",
        "/page//etc/passwd",
        "/page/%2fetc%2fpasswd",
        "/page/..%5cREADME.md",
        "/page/index.html%00",
        "/page/%ff",
        "/index.html",
        "/js/main.js",
    ] {
        let (status, body) = ask(server.address, &format!("GET {path}"), &[], "");
        assert!(status == 404 || status == 400, "{path}: {status} {body}");
        assert!(
            !body.contains("[package]") && !body.contains("root:"),
            "{path}: {body}"
        );
    }
}

#[test]
fn a_file_that_the_browser_has_is_not_sent_again() {
    let server = Running::start();
    for path in ["/", "/page/index.html"] {
        let line = format!("GET {path}");
        let (_, head, _) = whole(server.address, &line, &[], "");
        // The head is in lower case.
        let tag = header(&head, "etag").unwrap().replace("w/", "W/");
        for held in [tag.clone(), format!("\"x\", {tag}"), "*".to_owned()] {
            let held = format!("If-None-Match: {held}");
            let (status, head, body) = whole(server.address, &line, &[&held], "");
            assert_eq!((status, body.len()), (304, 0), "{held}");
            assert!(header(&head, "etag").is_some());
        }
        let other = "If-None-Match: W/\"0123456789abcdef\"";
        assert_eq!(whole(server.address, &line, &[other], "").0, 200);
    }
}

#[test]
fn a_browser_may_do_nothing_with_any_answer_but_what_the_page_needs() {
    let server = Running::start();
    for line in [
        "GET /",
        "GET /page/index.html",
        "GET /page/nowhere",
        "GET /api/v1/devices",
        "GET /api/v1/devices/x",
        "GET /metrics",
        "POST /",
    ] {
        let (_, head, _) = whole(server.address, line, &[], "");
        let policy = header(&head, "content-security-policy").unwrap();
        let parts: Vec<&str> = policy.split("; ").collect();
        for part in [
            "default-src 'none'",
            "script-src 'self'",
            "style-src 'self'",
            "connect-src 'self'",
            "img-src 'self' data: blob:",
            "worker-src 'self'",
            "base-uri 'none'",
            "form-action 'none'",
            "frame-ancestors 'none'",
        ] {
            assert!(parts.contains(&part), "{line}: {policy}");
        }
        assert!(!policy.contains("unsafe"), "{policy}");
        assert_eq!(header(&head, "x-content-type-options"), Some("nosniff"));
        assert_eq!(header(&head, "referrer-policy"), Some("no-referrer"));
        assert_eq!(header(&head, "access-control-allow-origin"), None);
        let cache = header(&head, "cache-control").unwrap();
        let page = line.ends_with('/') && line.starts_with("GET") || line.ends_with(".html");
        assert_eq!(cache, if page { "no-cache" } else { "no-store" }, "{line}");
    }
}

#[test]
fn text_is_compressed_where_it_is_asked_for() {
    let server = Running::start();
    let line = "GET /api/v1/openapi.json";
    let (_, head, plain) = whole(server.address, line, &[], "");
    assert_eq!(header(&head, "content-encoding"), None);
    let gzip = ["Accept-Encoding: gzip, br"];
    let (status, head, packed) = whole(server.address, line, &gzip, "");
    assert_eq!(status, 200);
    assert_eq!(header(&head, "content-encoding"), Some("gzip"), "{head}");
    assert!(
        packed.len() < plain.len() / 3,
        "{} of {}",
        packed.len(),
        plain.len()
    );
    // Small responses are not compressed.
    let (_, head, _) = whole(server.address, "GET /api/v1/devices", &gzip, "");
    assert_eq!(header(&head, "content-encoding"), None);
}
