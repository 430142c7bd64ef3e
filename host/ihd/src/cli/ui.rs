//! The page of a daemon in a browser, where this machine has a screen to show one on.

use std::process::{Command, Stdio};

/// Opens the page; silently not where there is no screen or no browser, for its address is said anyway. Waits for nothing.
pub fn open(url: &str) {
    if !has_screen() {
        return;
    }
    let mut command = opener(url);
    command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    // ^C in this terminal is not meant for the browser.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    if let Ok(mut child) = command.spawn() {
        // Somebody has to take its exit code; the browser may be open for longer than this process.
        std::thread::spawn(move || drop(child.wait()));
    }
}

#[cfg(target_os = "macos")]
fn opener(url: &str) -> Command {
    let mut command = Command::new("open");
    command.arg(url);
    command
}

#[cfg(windows)]
fn opener(url: &str) -> Command {
    let mut command = Command::new("cmd");
    // What stands first in quotes is the window's title.
    command.args(["/C", "start", "", url]);
    command
}

#[cfg(not(any(target_os = "macos", windows)))]
fn opener(url: &str) -> Command {
    let mut command = Command::new("xdg-open");
    command.arg(url);
    command
}

/// Without one xdg-open may start a browser in the terminal, which waits there.
#[cfg(not(any(target_os = "macos", windows)))]
fn has_screen() -> bool {
    let set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    set("DISPLAY") || set("WAYLAND_DISPLAY")
}

#[cfg(any(target_os = "macos", windows))]
fn has_screen() -> bool {
    true
}
