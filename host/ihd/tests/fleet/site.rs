//! An edge and its workers, as processes of `ihd`, with their results.

use std::collections::BTreeSet;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use ihd_fakes::free_address;
use ihd_link::{Client, DeviceEvent, Window};
use ihd_shared::wire::messages::{FrontEnd, Hello, State};
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;
use ihd_store::{ResultFilter, Store, StoreOptions, StoreReader, WindowFilter};
use serde_json::Value;
use tempfile::TempDir;

use super::process::{Process, ihd};

/// Hob, boot and number of a window.
pub type Key = (String, u32, u32);

/// Half-cycles between two windows of a device.
const WINDOWS_EVERY: u8 = 20;

/// Windows of a simulated hob that heats, with its identity.
pub struct Tape {
    pub hello: Hello,
    pub front_end: FrontEnd,
    pub windows: Vec<Window>,
}

/// Returns windows at three powers, settled or not, recorded once.
pub fn tape() -> &'static Tape {
    static TAPE: OnceLock<Tape> = OnceLock::new();
    TAPE.get_or_init(|| {
        let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
        let mut client = Client::connect(Box::new(hob)).expect("the simulated hob answers");
        client.stream(1, WINDOWS_EVERY).expect("it streams");
        let (mut windows, mut heats) = (Vec::new(), false);
        for power_w in [1_500, 2_000, 1_000] {
            client.set_power(power_w).expect("it heats");
            let until = windows.len() + 4;
            while windows.len() < until {
                match client.next_event(Duration::from_secs(1)).expect("a link") {
                    Some(DeviceEvent::Window(window)) if heats => windows.push(*window),
                    Some(DeviceEvent::Telemetry(t)) => heats = t.state == State::Heating,
                    Some(_) => {}
                    None => panic!("the hob is silent"),
                }
            }
        }
        Tape {
            hello: client.hello().clone(),
            front_end: client.front_end().clone(),
            windows,
        }
    })
}

/// A daemon that is an edge, whose store holds windows that are due.
pub struct Site {
    folder: TempDir,
    pub edge: String,
    pub hobs: Vec<String>,
    process: Option<Process>,
    /// Every window put into the store.
    pub windows: BTreeSet<Key>,
    /// More lines of `[fleet]`.
    pub fleet_lines: String,
    /// `true` if its hobs are simulated in the daemon; otherwise they do not answer.
    simulated: bool,
    /// Address of its API.
    listen: String,
}

impl Site {
    /// Creates a site with hobs `EDGE-0`, …, that do not answer.
    pub fn new(edge: &str, hobs: usize) -> Self {
        Self {
            folder: tempfile::tempdir().expect("a folder"),
            edge: edge.to_owned(),
            hobs: (0..hobs).map(|k| format!("{edge}-{k}")).collect(),
            process: None,
            windows: BTreeSet::new(),
            fleet_lines: String::new(),
            simulated: false,
            listen: free_address().to_string(),
        }
    }

    /// Creates a site whose hobs are simulated in the daemon.
    pub fn simulated(edge: &str, hobs: usize) -> Self {
        Self {
            simulated: true,
            ..Self::new(edge, hobs)
        }
    }

    /// Returns the folder of its store.
    pub fn store(&self) -> PathBuf {
        self.folder.path().join("store")
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Puts due windows into its store, in turn of its hobs, while the daemon does not run.
    pub fn fill(&mut self, count: usize) {
        let tape = tape();
        let opened = Store::open(&self.store(), &StoreOptions::default()).expect("a store");
        let mut store = opened.store;
        let first = self.windows.len();
        for (k, hob) in self.hobs.iter().enumerate() {
            let device = store.device(hob, "tcp:127.0.0.1:9").expect("a device");
            let hello = Hello {
                boot_id: 1_000 + k as u32,
                ..tape.hello.clone()
            };
            let session = store.begin_session(device, &hello, &tape.front_end);
            let session = session.expect("a session");
            let mine = (first..first + count).filter(|n| n % self.hobs.len() == k);
            for n in mine {
                let mut window = tape.windows[n % tape.windows.len()].clone();
                window.seq = n as u32;
                window.half_cycle = u32::from(WINDOWS_EVERY) * n as u32;
                let kept = store.keep_window_for(session, &window, true);
                assert!(kept.expect("kept").1);
                self.windows
                    .insert((hob.clone(), hello.boot_id, window.seq));
            }
        }
    }

    /// Starts the daemon; its devices do not answer.
    pub fn start(&mut self, url: &str) {
        let mut text = format!(
            "store = \"store\"\nlisten = {:?}\ndiscover_usb = false\n\
             [fleet]\nurl = {url:?}\nedge = {:?}\n{}",
            self.listen, self.edge, self.fleet_lines
        );
        for (k, hob) in self.hobs.iter().enumerate() {
            // No process listens there.
            let address = match self.simulated {
                true => "sim".to_owned(),
                false => format!("tcp:127.200.{}.{}:9", k / 250, k % 250 + 1),
            };
            text += &format!("[[device]]\nname = {hob:?}\naddress = {address:?}\n");
        }
        fs::write(self.path().join("ihd.toml"), text).expect("a configuration");
        let log = fs::File::options()
            .create(true)
            .append(true)
            .open(self.path().join("log"))
            .expect("a log");
        let mut command = ihd(self.path());
        command
            .args(["trainer", "--daemon"])
            .env("RUST_LOG", "info,ihd_daemon=warn")
            .stdout(Stdio::null())
            .stderr(log);
        self.process = Some(Process::spawn(&mut command).expect("the daemon starts"));
    }

    /// Runs `ihd device ARGUMENTS` with its daemon.
    pub fn device(&self, arguments: &[&str]) -> String {
        let mut command = ihd(self.path());
        command.arg("device").args(arguments);
        let out = command.output().expect("ihd device runs");
        assert!(out.status.success(), "{arguments:?}: {out:?}");
        String::from_utf8_lossy(&out.stdout).into_owned()
    }

    /// Moves its store to another folder, as to another machine, while the daemon does not run.
    pub fn move_away(&mut self) {
        let folder = tempfile::tempdir().expect("a folder");
        fs::rename(self.store(), folder.path().join("store")).expect("a store that moves");
        self.folder = folder;
    }

    /// Returns its daemon's report of the fleet; `None` while it does not answer.
    pub fn fleet(&self) -> Option<Value> {
        let mut stream = TcpStream::connect(&self.listen).ok()?;
        let head = "GET /api/v1/fleet HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
        stream.write_all(head.as_bytes()).ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        serde_json::from_str(answer.split_once("\r\n\r\n")?.1).ok()
    }

    /// Returns `true` if a hob of it is connected and does not heat.
    pub fn is_idle(&self, hob: &str) -> bool {
        let report = self.fleet().unwrap_or_default();
        let hobs = report["devices"].as_array().cloned().unwrap_or_default();
        hobs.iter()
            .any(|device| device["name"] == *hob && device["state"] == "idle")
    }

    /// Kills the daemon (`kill -9`).
    pub fn kill(&mut self) {
        if let Some(mut process) = self.process.take() {
            process.kill();
        }
    }

    /// Stops the daemon and waits for its end.
    pub fn stop(&mut self) {
        if let Some(mut process) = self.process.take() {
            process.terminate();
            let ended = process.wait(Duration::from_secs(40));
            assert!(ended.is_some_and(|status| status.success()), "{ended:?}");
        }
    }

    /// Asserts that the daemon runs.
    pub fn assert_runs(&mut self) {
        let ended = self.process.as_mut().and_then(Process::ended);
        assert!(ended.is_none(), "{ended:?}: {}", self.log());
    }

    /// Returns the processor time of the daemon in seconds.
    pub fn processor_s(&self) -> f64 {
        self.process.as_ref().map_or(0.0, Process::processor_s)
    }

    /// Returns the memory of the daemon in bytes.
    pub fn rss(&mut self) -> u64 {
        self.process.as_mut().map_or(0, Process::rss)
    }

    pub fn log(&self) -> String {
        fs::read_to_string(self.path().join("log")).unwrap_or_default()
    }

    /// Returns the number of windows in its store.
    pub fn stored(&self) -> u64 {
        let reader = StoreReader::open(&self.store()).expect("its store");
        let windows = reader.windows(&WindowFilter::default());
        windows.expect("its windows").len() as u64
    }

    /// Returns the results in its store.
    pub fn results(&self) -> BTreeSet<Key> {
        let filter = ResultFilter {
            limit: Some(u32::MAX),
            ..ResultFilter::default()
        };
        let read = StoreReader::open(&self.store()).and_then(|reader| reader.results(&filter));
        let rows = read.unwrap_or_default();
        rows.into_iter()
            .map(|r| (r.device, r.boot, r.seq))
            .collect()
    }
}

/// `ihd-fleet`, built beside the command under test (`cargo build -p ihd-fleet-cli`; a run of the whole workspace builds it).
pub fn ihd_fleet(folder: &Path) -> Command {
    let beside = Path::new(env!("CARGO_BIN_EXE_ihd")).with_file_name("ihd-fleet");
    let mut command = Command::new(beside);
    command.current_dir(folder).stdin(Stdio::null());
    command
}

/// `ihd-fleet worker`.
pub struct Worker {
    process: Process,
}

impl Worker {
    pub fn start(folder: &Path, url: &str, name: &str, options: &[&str]) -> Self {
        let log = fs::File::options()
            .create(true)
            .append(true)
            .open(folder.join(format!("{name}.log")))
            .expect("a log");
        let mut command = ihd_fleet(folder);
        command
            .args(["worker", "--url", url, "--name", name])
            .args(options)
            .stdout(Stdio::null())
            .stderr(log);
        Self {
            process: Process::spawn(&mut command).expect("a worker starts"),
        }
    }

    pub fn kill(&mut self) {
        self.process.kill();
    }

    pub fn pid(&self) -> u32 {
        self.process.child.id()
    }

    pub fn processor_s(&self) -> f64 {
        self.process.processor_s()
    }

    pub fn has_ended(&mut self) -> bool {
        self.process.ended().is_some()
    }
}

/// `ihd-fleet --url URL …`: what it prints, and its exit code.
pub fn fleet(url: &str, arguments: &[&str]) -> (String, i32) {
    let folder = std::env::temp_dir();
    let mut command = ihd_fleet(&folder);
    command.args(["--url", url]).args(arguments);
    let out = command.output().expect("ihd-fleet runs");
    let text =
        String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr);
    (text, out.status.code().unwrap_or(-1))
}

/// `ihd-fleet init`, with what is to be said beside.
pub fn init(url: &str, options: &[&str]) {
    // The reserved space must be available on any machine.
    let little = [
        "--windows-bytes",
        "500000000",
        "--results-bytes",
        "200000000",
        "--captures-bytes",
        "100000000",
    ];
    let little = match options.contains(&little[0]) {
        true => &little[2..],
        false => &little[..],
    };
    let arguments: Vec<&str> = [&["init"], little, options].concat();
    let (text, code) = fleet(url, &arguments);
    assert_eq!(code, 0, "{text}");
}

/// `ihd-fleet status --json`; none while the server is away.
pub fn status(url: &str) -> Option<Value> {
    let (text, code) = fleet(url, &["status", "--json"]);
    (code == 0).then(|| serde_json::from_str(&text).expect("JSON"))
}

/// Heats a hob of the daemon in `folder` once. Each attempt is twice as long as the one before: on a busy machine a simulated hob finds
/// no pot within seconds.
pub fn heat(folder: &Path, hob: &str, power_w: &str) {
    let mut for_s = 3;
    until("a hob that heats", PATIENCE, || {
        let mut command = ihd(folder);
        command.args(["device", hob, "power", power_w, "--for"]);
        let out = command.arg(for_s.to_string()).output();
        let out = out.expect("ihd device runs");
        println!("{out:?}");
        for_s = (2 * for_s).min(100);
        out.status.success()
    });
}

/// Time-out of a hang; no test measures it. Less than the runner's, which shows no log.
pub const PATIENCE: Duration = Duration::from_secs(500);

/// Waits until a condition holds; returns the time.
pub fn until(what: &str, within: Duration, mut holds: impl FnMut() -> bool) -> Duration {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < within, "{what}: not within {within:?}");
        std::thread::sleep(Duration::from_millis(100));
    }
    began.elapsed()
}
