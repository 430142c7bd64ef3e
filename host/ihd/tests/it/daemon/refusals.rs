//! A daemon that cannot start says why, what to do, and with which exit code.

use std::net::TcpListener;
use std::path::Path;

use super::processes::{ihd, outcome};

/// Runs a daemon that must not start, and ends with `expected`: 2 for what the configuration says, 1 for what it met.
fn refused(dir: &Path, text: &str, expected: i32) -> String {
    let config = dir.join("ihd.toml");
    std::fs::write(&config, text).unwrap();
    let mut command = ihd();
    command
        .args(["trainer", "--daemon", "--config"])
        .arg(&config);
    let (code, stdout, stderr) = outcome(command.output().unwrap());
    assert_eq!(code, expected, "{text}: {stderr}");
    assert!(stdout.is_empty(), "{stdout}");
    stderr
}

#[test]
fn ports_keys_stores_and_addresses() {
    let dir = tempfile::tempdir().unwrap();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let file = dir.path().join("file");
    std::fs::write(&file, "x").unwrap();
    let store = format!("store = {:?}\n", dir.path().join("store"));
    for (expected, text, words) in [
        (
            1,
            format!("{store}listen = \"127.0.0.1:{port}\""),
            &["another process has", "`listen`"][..],
        ),
        (
            2,
            format!("{store}listn = \"127.0.0.1:0\""),
            &["listn", "listen"],
        ),
        (
            1,
            format!("store = {file:?}\nlisten = \"127.0.0.1:0\""),
            &["store"],
        ),
        (
            2,
            format!("{store}listen = \"0.0.0.0:0\""),
            &["token_file", "[tls]", "127.0.0.1:8731"],
        ),
        (
            2,
            format!(
                "{store}listen = \"127.0.0.1:0\"\n[[device]]\nname = \"a\"\naddress = \"sim\"\nsim = {{ pots = \"x\" }}"
            ),
            &["\"a\"", "pots"],
        ),
    ] {
        let stderr = refused(dir.path(), &text, expected);
        for word in words {
            assert!(stderr.contains(word), "{text}: {stderr}");
        }
    }
}

#[cfg(unix)]
#[test]
fn a_token_file_that_others_read() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    let tokens = dir.path().join("tokens");
    std::fs::write(&tokens, format!("read {}\n", "a".repeat(64))).unwrap();
    std::fs::set_permissions(&tokens, std::fs::Permissions::from_mode(0o644)).unwrap();
    let text = format!(
        "store = {:?}\nlisten = \"127.0.0.1:0\"\ntoken_file = {tokens:?}\n",
        dir.path().join("store")
    );
    let stderr = refused(dir.path(), &text, 1);
    assert!(
        stderr.contains("chmod 600") && !stderr.contains("aaaa"),
        "{stderr}"
    );
}

#[test]
fn options_that_say_nothing_to_a_daemon_are_wrong_usage() {
    for args in [
        &["trainer", "--daemon", "--power", "500"][..],
        &["trainer", "--daemon", "--follow"],
        &["trainer", "--daemon", "--device", "usb"],
        &["trainer", "--config", "ihd.toml"],
        &["trainer", "--daemon", "--log-format", "xml"],
    ] {
        let (code, _, stderr) = outcome(ihd().args(args).output().unwrap());
        assert_eq!(code, 2, "{args:?}: {stderr}");
    }
}
