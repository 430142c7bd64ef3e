//! Time that `off` takes to reach a device, and to be answered, beside other work. A benchmark: it prints a table and
//! judges only that each `off` came through; docs/daemon.md has its last results.

use std::collections::VecDeque;
use std::fs;
use std::io::Write;
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use crate::daemon::{Daemon, configure};
use crate::http;
use crate::kills::setting;
use crate::player::{Player, Tape};
use crate::process::PATIENCE;
use crate::soak::Disk;

/// Power that is switched off, in watt.
const POWER_W: u16 = 900;

/// Sockets that a hostile process holds at a time.
const HELD: usize = 2_000;

/// Hostile sockets, before and while it is measured.
const HOSTILE: u64 = 10_000;

/// Speed of one player that fills its link: a hundred windows a second, and 2,000 half-cycles.
const FULL: f64 = 20.0;

/// Speed of many that flood together: twenty windows a second each, three times what a device may send.
const FLOOD: f64 = 4.0;

/// A daemon with players.
struct Bench {
    daemon: Daemon,
    players: Vec<Player>,
    _folder: tempfile::TempDir,
}

impl Bench {
    fn start(tapes: &Arc<Vec<Tape>>, count: usize, speed: f64, folder: tempfile::TempDir) -> Self {
        let players: Vec<_> = (0..count)
            .map(|k| Player::start(k as u32 + 1, Arc::clone(tapes), speed).unwrap())
            .collect();
        let named = |(k, player): (usize, &Player)| (format!("hob-{k}"), player.address());
        let devices: Vec<_> = players.iter().enumerate().map(named).collect();
        let address = configure(folder.path(), "", &devices).unwrap();
        let mut daemon = Daemon::start(folder.path(), address).unwrap();
        daemon.until("all are connected", |all| {
            all.iter().all(|report| report["live"].is_object())
        });
        Self {
            daemon,
            players,
            _folder: folder,
        }
    }

    /// Heats the first device and switches it off, so many times; prints a row.
    fn measure(&mut self, what: &str) {
        let offs = setting("IHD_OFFS", 20.0) as usize;
        let (mut reached, mut answered, mut again) = (Vec::new(), Vec::new(), 0);
        for _ in 0..offs {
            let heated = Instant::now();
            while self.players[0].truth().asked_w() == 0 {
                // It may have to wait for what is going on.
                let _ = self.daemon.heat("hob-0", POWER_W);
                assert!(
                    heated.elapsed() < PATIENCE,
                    "{what}: {}",
                    self.daemon.log_tail()
                );
            }
            // At any time within a half-cycle.
            thread::sleep(Duration::from_micros(50_000 + 3_700 * reached.len() as u64));
            self.players[0].truth().off_at = None;
            let began = Instant::now();
            while !self.is_off() {
                again += 1;
                assert!(
                    began.elapsed() < PATIENCE,
                    "{what}: {}",
                    self.daemon.log_tail()
                );
            }
            answered.push(began.elapsed());
            let at = self.players[0].truth().off_at;
            reached.push(at.expect("it was told").duration_since(began));
        }
        let [(median, worst), (answer, latest)] = [reached, answered].map(median_and_max_ms);
        println!(
            "| {what} | {offs} | {median:.1} | {worst:.1} | {answer:.1} | {latest:.1} | {again} | {} |",
            load()
        );
    }

    fn is_off(&self) -> bool {
        let body = "{\"command\":\"off\"}";
        let path = "/api/v1/devices/hob-0/commands";
        let asked = http::ask(self.daemon.address, "POST", path, body, PATIENCE);
        matches!(asked, Ok((200, _)))
    }
}

/// Median and largest, in milliseconds.
fn median_and_max_ms(mut times: Vec<Duration>) -> (f64, f64) {
    times.sort();
    let ms = |time: &Duration| 1e3 * time.as_secs_f64();
    (ms(&times[times.len() / 2]), ms(&times[times.len() - 1]))
}

/// Something that goes on in another thread until it is dropped.
struct Meanwhile {
    stop: Arc<AtomicBool>,
    rounds: Arc<AtomicU64>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Meanwhile {
    fn each(mut round: impl FnMut() + Send + 'static) -> Self {
        let (stop, rounds) = (
            Arc::new(AtomicBool::new(false)),
            Arc::new(AtomicU64::new(0)),
        );
        let (stopped, counted) = (Arc::clone(&stop), Arc::clone(&rounds));
        let thread = thread::spawn(move || {
            while !stopped.load(Relaxed) {
                round();
                counted.fetch_add(1, Relaxed);
            }
        });
        Self {
            stop,
            rounds,
            thread: Some(thread),
        }
    }

    /// Waits until it has gone on for so many rounds.
    fn until(&self, rounds: u64) {
        while self.rounds.load(Relaxed) < rounds {
            thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Meanwhile {
    fn drop(&mut self) {
        self.stop.store(true, Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Opens sockets without end: half of them say nothing, the others half a head.
fn hostile(to: SocketAddr) -> Meanwhile {
    let mut held = VecDeque::new();
    Meanwhile::each(move || {
        let Ok(mut stream) = TcpStream::connect(to) else {
            return;
        };
        if held.len() % 2 == 0 {
            let _ = stream.write_all(b"GET / HTTP/1.1\r\nHost:");
        }
        held.push_back(stream);
        if held.len() >= HELD {
            held.drain(..HELD / 2 + 1);
        }
    })
}

/// Returns `true` if a part of the table is requested: `IHD_OFF_WHILE` names parts by a word of theirs.
fn is_wanted(what: &str) -> bool {
    std::env::var("IHD_OFF_WHILE").map_or(true, |word| what.contains(&word))
}

/// Load of the machine in the last minute, as it says it itself.
fn load() -> String {
    let said = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    said.split(' ').next().unwrap_or_default().to_owned()
}

#[test]
#[ignore = "full tier: a benchmark of minutes, which judges nothing"]
fn off_reaches_a_device_whatever_goes_on() {
    let tapes = Arc::new(vec![Tape::record(3, &[700, 1_200, 1_800], 2)]);
    println!(
        "| while | offs | reached, median ms | worst | answered, median ms | worst | tried again | load |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    if is_wanted("one device") {
        with_one_device(&tapes);
    }
    if is_wanted("a full disk") {
        with_a_full_disk(&tapes);
    }
    let many = setting("IHD_MANY", 32.0) as usize;
    for (what, count, speed) in [
        ("its link full of windows", 1, FULL),
        ("32 devices as they are", many, 1.0),
        ("32 devices that flood", many, FLOOD),
    ] {
        if is_wanted(what) {
            let mut bench = Bench::start(&tapes, count, speed, tempfile::tempdir().unwrap());
            bench.measure(what);
            assert!(bench.daemon.stop(), "{}", bench.daemon.log_tail());
        }
    }
}

/// Rows of a device as it is, while something else is attacked.
fn with_one_device(tapes: &Arc<Vec<Tape>>) {
    let mut bench = Bench::start(tapes, 1, 1.0, tempfile::tempdir().unwrap());
    bench.measure("nothing else");
    let sockets = hostile(bench.daemon.address);
    sockets.until(HOSTILE);
    bench.measure("10,000 hostile sockets, and more all the time");
    drop(sockets);
    let (address, mut number) = (bench.daemon.address, 0);
    let backups = Meanwhile::each(move || {
        number += 1;
        let body = format!("{{\"to\":\"b{number}\"}}");
        let _ = http::ask(address, "POST", "/api/v1/store/backup", &body, PATIENCE);
    });
    backups.until(1);
    bench.measure("a backup after the other");
    drop(backups);
    let database = bench.daemon.folder.join("store/ihd.db");
    let lock = rusqlite::Connection::open(database).unwrap();
    lock.busy_timeout(PATIENCE).unwrap();
    lock.execute_batch("BEGIN IMMEDIATE").unwrap();
    bench.measure("the database locked");
    drop(lock);
    assert!(bench.daemon.stop(), "{}", bench.daemon.log_tail());
}

fn with_a_full_disk(tapes: &Arc<Vec<Tape>>) {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().join("store");
    fs::create_dir_all(&at).unwrap();
    let Some(disk) = Disk::mount(&at, 64) else {
        println!("| a full disk | not measured: no file system may be mounted here | | | | | | |");
        return;
    };
    let mut bench = Bench::start(tapes, 1, 1.0, folder);
    disk.fill(true);
    bench.measure("a full disk");
    disk.fill(false);
    assert!(bench.daemon.stop(), "{}", bench.daemon.log_tail());
}
