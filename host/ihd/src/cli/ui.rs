//! Opening of a daemon's page in a browser, if this machine has a screen.

use std::process::{Command, Stdio};

/// Opens the page without waiting; does nothing if there is no screen or no browser, since the address is printed in any case.
pub fn open(url: &str) {
    if !has_screen() {
        return;
    }
    let mut command = opener(url);
    command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    // Ctrl-C in this terminal must not reach the browser.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    if let Ok(mut child) = command.spawn() {
        // A thread collects its exit code; the browser may outlive this process.
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
    // The first text in quotes is the window's title.
    command.args(["/C", "start", "", url]);
    command
}

#[cfg(not(any(target_os = "macos", windows)))]
fn opener(url: &str) -> Command {
    let mut command = Command::new("xdg-open");
    command.arg(url);
    command
}

/// Returns `true` if there is a screen; without one xdg-open may start a browser in the terminal and block.
#[cfg(not(any(target_os = "macos", windows)))]
fn has_screen() -> bool {
    let set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    set("DISPLAY") || set("WAYLAND_DISPLAY")
}

#[cfg(any(target_os = "macos", windows))]
fn has_screen() -> bool {
    true
}
