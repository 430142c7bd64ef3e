//! The reader's desk: a folder with the reader's files, simulated hobs in place of boards, and a daemon in another terminal.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use ihd_fakes::SampleLog;
use tempfile::TempDir;

use super::files;
use super::special::{End, PLAIN, SPECIAL, STAND_INS, Special};
use ihd_fakes::free_address;

use crate::daemon::processes::{heated, ihd, outcome};
use crate::daemon::screen::Screen;
use crate::log;
use crate::process::{Hob, Process};

/// The checkout.
pub const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// Someone cooks at the panel, and the mains fails again and again: windows, results, levels that are crossed, faults.
const COOKING: &str = "duration_s = 4\nload = \"behavioural\"\n\
    [[event]]\nat_s = 0.1\npanel = 7\n\
    [[event]]\nat_s = 2.5\nmains = { v_rms = 0.0, for_s = 0.5 }\n";

pub struct Desk {
    folder: TempDir,
    /// Hobs, by the address that a document gives them.
    hobs: Vec<(String, Hob)>,
    daemon: Option<Process>,
}

impl Desk {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let desk = Self {
            folder,
            hobs: Vec::new(),
            daemon: None,
        };
        // Whatever runs at the usual address of this machine is left alone.
        desk.configure("");
        desk
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    fn configure(&self, devices: &str) {
        let listen = free_address();
        let text = format!("store = \"ihd-store\"\nlisten = \"{listen}\"\n{devices}");
        fs::write(self.folder().join("ihd.toml"), text).unwrap();
    }

    fn command(&self, words: &[impl AsRef<str>]) -> Command {
        let mut command = ihd();
        command
            .current_dir(self.folder())
            .env("XDG_DATA_HOME", self.folder().join("data"))
            .env_remove("DISPLAY")
            .env_remove("WAYLAND_DISPLAY")
            .args(words.iter().map(AsRef::as_ref))
            .stdin(Stdio::null());
        command
    }

    /// Runs what must work: exit code 0.
    pub fn must(&self, words: &[&str]) {
        let (code, _, stderr) = outcome(self.command(words).output().expect("ihd runs"));
        assert_eq!(code, 0, "{words:?}: {stderr}");
    }

    /// Runs a documented call to its end.
    ///
    /// # Errors
    /// Exit code and outputs of a call that ended otherwise.
    pub fn run(&mut self, call: &[String]) -> Result<(), String> {
        let special = special(call);
        if call[1] == "hob" {
            self.start_hob(&call[2..]);
            return Ok(());
        }
        if special.is_alone || serves(call) {
            self.end_daemon();
        } else if is_client(&call[1..]) {
            self.start_daemon();
        }
        let words = self.words(&call[1..], special);
        for word in words.iter().filter(|word| !word.starts_with('/')) {
            if !self.folder().join(word).exists() {
                files::make(self, word);
            }
        }
        self.end_of(&words, special)
    }

    /// Its words with what stands in for boards, the reader's files and the rest.
    fn words(&mut self, call: &[String], special: &Special) -> Vec<String> {
        let mut words = Vec::new();
        for word in call.iter().map(String::as_str) {
            let all = special.instead.iter().chain(&STAND_INS);
            let stand_in = all.copied().find(|(documented, _)| *documented == word);
            words.extend(stand_in.map_or(word, |(_, words)| words).split_whitespace());
        }
        words.extend(special.more.split_whitespace());
        words.into_iter().map(|word| self.address(word)).collect()
    }

    /// Address of the hob that stands for a documented one.
    fn address(&mut self, word: &str) -> String {
        if word == "{board}" {
            let said = SampleLog::frame(1, &60_000u32.to_le_bytes());
            return log::board(0xB1, vec![vec![(0, 0, said)]]).0;
        }
        if !word.starts_with("tcp:") && !word.starts_with("serial:/dev/tty") {
            return word.to_owned();
        }
        if !self.hobs.iter().any(|(documented, _)| documented == word) {
            self.hobs.push((word.to_owned(), Hob::start()));
        }
        let found = self.hobs.iter().find(|(documented, _)| documented == word);
        found.expect("it was started").1.place()
    }

    /// A documented hob, at a port that is free.
    fn start_hob(&mut self, options: &[String]) {
        let mut options: Vec<&str> = options.iter().map(String::as_str).collect();
        let mut documented = "127.0.0.1:4711";
        if let Some(at) = options.iter().position(|word| *word == "--listen") {
            documented = options[at + 1];
            options.drain(at..at + 2);
        }
        options.extend(["--listen", "127.0.0.1:0"]);
        let hob = Hob::start_with(&options);
        self.hobs.push((format!("tcp:{documented}"), hob));
    }

    fn start_daemon(&mut self) {
        if self.daemon.is_none() {
            self.serve(&["trainer", "--daemon"], "state=\"connected\"");
        }
    }

    /// Starts a daemon, for what follows.
    fn serve(&mut self, words: &[impl AsRef<str>], when: &str) {
        if !self.hobs.iter().any(|(name, _)| name == "bench") {
            let script = self.folder().join("cooking.toml");
            fs::write(&script, COOKING).unwrap();
            let script = script.to_str().expect("UTF-8");
            let hob = Hob::start_with(&["--script", script, "--listen", "127.0.0.1:0"]);
            self.configure(&format!(
                "[[device]]\nname = \"bench\"\naddress = \"{}\"\n",
                hob.place()
            ));
            self.hobs.push(("bench".to_owned(), hob));
        }
        let mut daemon = Process::start(&mut self.command(words), true);
        daemon.line_with(when);
        self.daemon = Some(daemon);
    }

    fn end_daemon(&mut self) {
        if let Some(daemon) = self.daemon.take() {
            daemon.signal("INT");
            let (code, _, stderr) = daemon.ended();
            assert_eq!(code, 0, "{stderr}");
        }
    }

    fn end_of(&mut self, words: &[String], special: &Special) -> Result<(), String> {
        let (codes, code, said) = match special.end {
            End::Codes(codes) => {
                let output = self.command(words).output().expect("ihd runs");
                let (code, stdout, stderr) = outcome(output);
                (codes, code, stdout + &stderr)
            }
            End::Shows(word) | End::Begins(word) => {
                let mut process = Process::start(&mut self.command(words), false);
                process.line_with(word);
                process.signal("INT");
                let codes: &[i32] = match special.end {
                    End::Begins(_) => &[-1],
                    _ => &[0],
                };
                (codes, process.code(), process.said.clone())
            }
            End::Serves(word) => {
                self.serve(words, word);
                return Ok(());
            }
            End::Draws(word) => self.on_a_screen(words, word, "q"),
            End::Asks(question, answer) => {
                self.on_a_screen(words, question, &format!("{answer}\n"))
            }
            End::Heats => {
                let config = self.folder().join("ihd.toml");
                let (before, _) = words[1..].split_at(words.len() - 2);
                let seconds = |times: usize| [before, &[times.to_string()]].concat();
                (&[0][..], 0, heated(&config, seconds).0)
            }
        };
        if codes.contains(&code) && said.contains(special.says) {
            return Ok(());
        }
        Err(format!("{}: exit code {code}\n{said}", words.join(" ")))
    }

    /// The exit code that is wanted and that of a call on a terminal, and what is shown there at its end.
    fn on_a_screen(
        &self,
        words: &[String],
        shown: &str,
        keys: &str,
    ) -> (&'static [i32], i32, String) {
        let mut screen = Screen::start(&mut self.command(words));
        screen.until(shown, |text| text.contains(shown));
        screen.press(keys.as_bytes());
        let (code, text) = screen.ended_with();
        assert!(!text.contains("panicked"), "{text}");
        (&[0], code, text)
    }

    /// Ends what no later call needs, as a simulated hob computes all the time.
    pub fn end_unused<'a>(&mut self, later: impl Iterator<Item = &'a [String]> + Clone) {
        let mut later_calls = later.clone();
        if !later_calls.any(|call| is_client(&call[1..]) || serves(call)) {
            self.end_daemon();
            self.end_hobs(|name| name == "bench");
        }
        self.end_hobs(|name| name != "bench" && !later.clone().flatten().any(|word| word == name));
    }

    /// Ends everything in order, as ^C in the other terminals does.
    pub fn close(mut self) {
        self.end_daemon();
        self.end_hobs(|_| true);
    }

    fn end_hobs(&mut self, ends: impl Fn(&str) -> bool) {
        for (name, mut hob) in self.hobs.extract_if(.., |(name, _)| ends(name)) {
            hob.process.signal("INT");
            assert_eq!(hob.process.code(), 0, "{name}");
        }
    }
}

/// Treatment of a call: its own, or that of a plain one.
fn special(call: &[String]) -> &'static Special {
    let text = call.join(" ");
    let special = SPECIAL.iter().find(|special| special.call == text);
    special.unwrap_or(&PLAIN)
}

/// Returns `true` for a daemon that serves what follows.
fn serves(call: &[String]) -> bool {
    matches!(special(call).end, End::Serves(_))
}

/// Returns `true` if a call goes through the daemon.
fn is_client(words: &[String]) -> bool {
    let names_it = words
        .iter()
        .any(|word| ["bench", "DEV"].contains(&word.as_str()));
    names_it || ["watch", "store"].contains(&words[0].as_str()) || words == ["device", "status"]
}
