//! A pseudo-terminal with a command on it, as a person at the bench has it.

use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};

use nix::pty::{Winsize, openpty};
use nix::sys::termios::{LocalFlags, tcgetattr};

use crate::process::{exit_code, wait_for};

/// The parser's own size, too.
const ROWS: u16 = 24;
const COLUMNS: u16 = 80;

/// A terminal, and the command that draws on it.
pub struct Screen {
    child: Child,
    keys: std::fs::File,
    terminal: std::fs::File,
    shown: Arc<Mutex<vt100::Parser>>,
}

impl Screen {
    /// Starts the command on a terminal of 80 columns and 24 rows.
    pub fn start(command: &mut Command) -> Self {
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
            terminal: pty.slave.into(),
            shown,
        }
    }

    fn text(&self) -> String {
        text(&self.shown)
    }

    pub fn until(&self, what: &str, is: impl Fn(&str) -> bool) -> String {
        let poll = || Some(self.text()).filter(|text| is(text));
        wait_for(poll, || format!("{what}: never\n{}", self.text()))
    }

    pub fn press(&mut self, keys: &[u8]) {
        self.keys.write_all(keys).expect("it listens to keys");
    }

    pub fn terminate(&self) {
        let id = self.child.id().to_string();
        Command::new("kill").arg(id).status().expect("kill");
    }

    /// Its exit code; the terminal must be as it was: not raw, and on its first screen with a cursor.
    pub fn ended(self) -> i32 {
        self.ended_with().0
    }

    /// [`Screen::ended`], and the text that is left on the screen.
    pub fn ended_with(mut self) -> (i32, String) {
        let shown = Arc::clone(&self.shown);
        let code = exit_code(&mut self.child, || text(&shown));
        let settings = tcgetattr(&self.terminal).expect("a terminal");
        let cooked = LocalFlags::ICANON | LocalFlags::ECHO;
        assert!(settings.local_flags.contains(cooked), "it is raw");
        self.until("the first screen", |_| {
            let shown = self.shown.lock().unwrap();
            !shown.screen().alternate_screen() && !shown.screen().hide_cursor()
        });
        // What comes last is shown last: all that it wrote is shown then.
        let last = "(it has ended)";
        self.terminal
            .write_all(last.as_bytes())
            .expect("a terminal");
        let text = self.until(last, |text| text.contains(last));
        (code, text)
    }
}

fn text(shown: &Mutex<vt100::Parser>) -> String {
    shown.lock().unwrap().screen().contents()
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
