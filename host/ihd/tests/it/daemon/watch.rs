//! `ihd watch` on a pseudo-terminal, as a person at the bench has it.

use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use nix::pty::{Winsize, openpty};
use nix::sys::termios::{LocalFlags, tcgetattr};

use super::processes::{Kitchen, free_port, ihd, outcome};
use crate::process::PATIENCE;

/// The parser's own size, too.
const ROWS: u16 = 24;
const COLUMNS: u16 = 80;

/// A terminal, and the command that draws on it.
struct Screen {
    child: Child,
    keys: std::fs::File,
    terminal: OwnedFd,
    shown: Arc<Mutex<vt100::Parser>>,
}

impl Screen {
    /// Starts the command on a terminal of 80 columns and 24 rows.
    fn start(command: &mut Command) -> Self {
        let size = Winsize {
            ws_row: ROWS,
            ws_col: COLUMNS,
            ws_xpixel: 0,
            ws_ypixel: 0,
        };
        let pty = openpty(Some(&size), None).expect("a pseudo-terminal");
        let end = || Stdio::from(pty.slave.try_clone().expect("its end"));
        command.stdin(end()).stdout(end()).stderr(end());
        let child = command.env("TERM", "xterm-256color").spawn();
        let shown = Arc::new(Mutex::new(vt100::Parser::default()));
        let (screen, master) = (Arc::clone(&shown), pty.master.try_clone());
        let mut master = std::fs::File::from(master.expect("the person's end"));
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(n) = master.read(&mut bytes)
                && n > 0
            {
                screen.lock().unwrap().process(&bytes[..n]);
            }
        });
        Self {
            child: child.expect("it starts"),
            keys: pty.master.into(),
            terminal: pty.slave,
            shown,
        }
    }

    fn text(&self) -> String {
        self.shown.lock().unwrap().screen().contents()
    }

    fn until(&self, what: &str, is: impl Fn(&str) -> bool) -> String {
        let until = Instant::now() + PATIENCE;
        loop {
            let text = self.text();
            if is(&text) {
                return text;
            }
            assert!(Instant::now() < until, "{what}: never\n{text}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    fn press(&mut self, keys: &[u8]) {
        self.keys.write_all(keys).expect("it listens to keys");
    }

    /// Its exit code; the terminal must be as it was: not raw, and on its first screen with a cursor.
    fn ended(mut self) -> i32 {
        let until = Instant::now() + PATIENCE;
        let code = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status.code().unwrap_or(-1);
            }
            assert!(Instant::now() < until, "it does not end\n{}", self.text());
            std::thread::sleep(Duration::from_millis(20));
        };
        let settings = tcgetattr(&self.terminal).expect("a terminal");
        let cooked = LocalFlags::ICANON | LocalFlags::ECHO;
        assert!(settings.local_flags.contains(cooked), "it is raw");
        self.until("the first screen", |_| {
            let shown = self.shown.lock().unwrap();
            !shown.screen().alternate_screen() && !shown.screen().hide_cursor()
        });
        code
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn watch(kitchen: &Kitchen, more: &[&str]) -> Screen {
    let config = kitchen.dir.path().join("ihd.toml");
    let mut command = ihd();
    command.arg("watch").args(more).arg("--config").arg(config);
    Screen::start(&mut command)
}

/// The number before `unit` in the line of the chosen device.
fn number_before(text: &str, unit: &str) -> Option<f64> {
    let (before, _) = text.split_once(unit)?;
    before.split_whitespace().last()?.parse().ok()
}

#[test]
fn a_person_sees_it_heat_and_switches_it_off() {
    let kitchen = Kitchen::start();
    let heating = kitchen.in_the_background(&["bench", "power", "1200"]);
    let mut screen = watch(&kitchen, &[]);
    let text = screen.until("it heats", |text| {
        text.contains("learning") && number_before(text, " Ω,").is_some()
    });
    assert!(text.contains("of 1200 W asked"), "{text}");
    assert!(text.contains("Ferromagnetic"), "{text}");
    assert!(text.contains("commands it"), "{text}");
    // Of the default pot: R and L are within what it can have at 20 to 80 kHz.
    let r_ohm = number_before(&text, " Ω,").unwrap();
    let (_, after_r) = text.split_once(" Ω,").unwrap();
    let l_uh = number_before(after_r, " µH").unwrap();
    assert!((1.0..6.0).contains(&r_ohm), "{r_ohm}\n{text}");
    assert!((10.0..40.0).contains(&l_uh), "{l_uh}\n{text}");
    screen.until("a window is learned from", |text| text.contains("window "));
    // The lease is another's; off needs none.
    screen.press(b"o");
    screen.until("it is off", |text| text.contains("of 0 W asked"));
    kitchen.until("the device itself is off", |report| {
        report["live"]["f_sw_hz"] == 0 && report["asked_by_daemon_w"] == 0
    });
    screen.press(b"q");
    assert_eq!(screen.ended(), 0);
    drop(heating);
}

#[test]
fn a_daemon_that_ends_is_told_and_comes_back_by_itself() {
    let mut kitchen = Kitchen::start();
    let screen = watch(&kitchen, &["bench"]);
    screen.until("it is seen", |text| text.contains("bench: idle"));
    kitchen.daemon.signal("KILL");
    screen.until("it is gone", |text| text.contains("NO DAEMON"));
    kitchen.start_daemon_again();
    let back = screen.until("it is back", |text| {
        !text.contains("NO DAEMON") && text.contains("the daemon is back")
    });
    assert!(back.contains("bench: "), "{back}");
    // Ended from outside, too, it leaves the terminal as it was.
    let id = screen.child.id().to_string();
    Command::new("kill").arg(id).status().expect("kill");
    assert_eq!(screen.ended(), 0);
}

#[test]
fn without_a_terminal_a_device_or_a_daemon_it_says_what_to_do() {
    let kitchen = Kitchen::start();
    let config = kitchen.dir.path().join("ihd.toml");
    let mut command = ihd();
    command.args(["watch", "bench", "--config"]).arg(&config);
    let (code, _, stderr) = outcome(command.output().unwrap());
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("ihd watch bench --lines"), "{stderr}");

    let screen = watch(&kitchen, &["nobody"]);
    let text = screen.until("it says so", |text| text.contains("nobody"));
    assert!(text.contains("ihd device status"), "{text}");
    assert_eq!(screen.ended(), 1);

    let other = kitchen.dir.path().join("other.toml");
    std::fs::write(&other, format!("listen = \"127.0.0.1:{}\"\n", free_port())).unwrap();
    let mut command = ihd();
    command.arg("watch").arg("--config").arg(other);
    let screen = Screen::start(&mut command);
    screen.until("it says so", |text| text.contains("start one with"));
    assert_eq!(screen.ended(), 3);
}
