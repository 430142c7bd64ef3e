//! The daemon killed at random moments, with three devices on bad cables: what it acknowledged is there, what a
//! device uses is known, and the next one goes on where it was.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use ihd_link::Client;
use ihd_link::tcp::TcpTransport;
use ihd_shared::wire::messages::State;
use ihd_shared::wire::timing::HOST_UNHEARD_MS;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::server::{HobServer, ServerEvent};
use ihd_store::{ResultFilter, StoreReader, WindowFilter};
use serde_json::Value;

use crate::chance::Chance;
use crate::daemon::{Daemon, configure, store};
use crate::http::Watch;
use crate::player::{Player, Tape};
use crate::process::{Hob, PATIENCE};
use crate::proxy::{Faults, Proxy};

/// Everything that goes wrong on these cables.
pub fn bad_cable(seed: u64) -> Faults {
    Faults {
        seed,
        flip: 1e-6,
        lose_byte: 1e-7,
        lose_frame: 1e-3,
        repeat_frame: 1e-3,
        swap_frames: 1e-3,
        stall_every_s: 10.0,
        stall_s: 1.0,
        cut_every_s: 30.0,
    }
}

/// A number from the environment.
pub fn setting(name: &str, usual: f64) -> f64 {
    std::env::var(name)
        .ok()
        .and_then(|v| v.parse().ok())
        .unwrap_or(usual)
}

/// A device of a test: a hob's process, or a player.
enum Device {
    Hob(Hob),
    Player(Player),
}

impl Device {
    fn address(&self) -> SocketAddr {
        match self {
            Self::Hob(hob) => hob.address,
            Self::Player(player) => player.address(),
        }
    }
}

/// Told to have been stored before a kill.
#[derive(Default)]
struct Acknowledged {
    windows: BTreeSet<(String, u32, u32)>,
    results: BTreeSet<(String, u32, u32)>,
    /// Lookups that were active: device, version, observed cells.
    lookups: BTreeMap<String, (u32, u64)>,
}

impl Acknowledged {
    fn take(&mut self, notices: &[Value]) {
        for notice in notices {
            let device = notice["device"].as_str().unwrap_or_default().to_owned();
            let number = |key: &str| notice[key].as_u64().unwrap_or_default();
            let window = (device.clone(), number("boot") as u32, number("seq") as u32);
            match notice["event"].as_str() {
                Some("window-stored") => drop(self.windows.insert(window)),
                Some("result-stored") => drop(self.results.insert(window)),
                Some("lookup-active") => {
                    let active = (number("version") as u32, number("observed_cells"));
                    self.lookups.insert(device, active);
                }
                _ => {}
            }
        }
    }

    /// Those that the store does not have.
    fn missing(&self, folder: &Path) -> io::Result<Vec<String>> {
        let reader = StoreReader::open(&folder.join("store")).map_err(io::Error::other)?;
        let windows = reader
            .windows(&WindowFilter::default())
            .map_err(io::Error::other)?;
        let windows: BTreeSet<_> = windows
            .into_iter()
            .map(|w| (w.device, w.boot, w.seq))
            .collect();
        let all = ResultFilter {
            limit: Some(u32::MAX),
            ..ResultFilter::default()
        };
        let results = reader.results(&all).map_err(io::Error::other)?;
        let results: BTreeSet<_> = results
            .into_iter()
            .map(|r| (r.device, r.boot, r.seq))
            .collect();
        let lost = |kind: &str, there: &BTreeSet<_>, told: &BTreeSet<_>| {
            told.difference(there)
                .map(|w| format!("{kind} {w:?}"))
                .collect::<Vec<_>>()
        };
        let mut missing = lost("window", &windows, &self.windows);
        missing.extend(lost("result", &results, &self.results));
        Ok(missing)
    }
}

/// Reads a device's state while no daemon runs, without the bad cable.
fn look(address: SocketAddr) -> Result<(State, u16, u32), String> {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let looked = TcpTransport::connect(&address.to_string())
            .and_then(|t| Client::connect(Box::new(t)))
            .and_then(|mut client| client.status());
        match looked {
            Ok(status) => return Ok((status.state, status.asked_w, status.lookup_version)),
            // The cable's end of the last connection may not have gone yet.
            Err(_) if Instant::now() < deadline => thread::sleep(Duration::from_millis(100)),
            Err(e) => return Err(e.to_string()),
        }
    }
}

/// The full tier kills more often (`IHD_KILLS`).
#[test]
fn kills_lose_nothing_that_was_acknowledged() {
    let kills = setting("IHD_KILLS", 2.0) as u32;
    let hobs = setting("IHD_HOBS", 1.0) as usize;
    let folder = tempfile::tempdir().unwrap();
    let tapes = Arc::new(vec![Tape::record(3, &[700, 1_200, 1_800], 2)]);
    let speed = setting("IHD_HOB_SPEED", 0.3).to_string();
    let devices: Vec<_> = (0..3)
        .map(|k| match k < hobs {
            true => {
                let sim = format!("warming,seed={}", k + 1);
                let options = ["--panel", "6", "--speed", &speed, "--sim", &sim];
                Device::Hob(Hob::start(folder.path(), &options).unwrap())
            }
            false => {
                Device::Player(Player::start(100 + k as u32, Arc::clone(&tapes), 1.0).unwrap())
            }
        })
        .collect();
    let cables: Vec<_> = devices
        .iter()
        .enumerate()
        .map(|(k, d)| Proxy::start(d.address(), bad_cable(k as u64 + 1)).unwrap())
        .collect();
    let named: Vec<_> = cables
        .iter()
        .enumerate()
        .map(|(k, cable)| (format!("hob-{k}"), cable.address()))
        .collect();
    let address = configure(folder.path(), "", &named).unwrap();

    let (mut acknowledged, mut chance) = (Acknowledged::default(), Chance::new(7));
    let (mut wrong, mut most_lookups) = (Vec::new(), 0);
    for kill in 1..=kills {
        let mut daemon = Daemon::start(folder.path(), address).unwrap();
        let watch = Watch::begin(address).unwrap();
        let rest = Duration::from_secs_f64(chance.between(0.3, 6.0));
        let until = Instant::now() + rest;
        let deadline = until + PATIENCE;
        // The last kill comes when something was learned and is used, however slow the machine is. A pot that is known well needs no
        // new lookup for long.
        let before = acknowledged.lookups.clone();
        let has_learned = || {
            let notices = watch.notices.lock().unwrap();
            let is = |event: &str| notices.iter().any(|n| n["event"] == event);
            is("result-stored") && (is("lookup-active") || !before.is_empty())
        };
        // What was learned is there as soon as the device is.
        let mut resumed = BTreeSet::new();
        while Instant::now() < until || (kill == kills && !has_learned()) {
            assert!(Instant::now() < deadline, "nothing is learned");
            for report in daemon.devices().unwrap_or_default() {
                let name = report["name"].as_str().unwrap_or_default().to_owned();
                if report["asked_by_daemon_w"] != 0 {
                    wrong.push(format!(
                        "kill {kill}: the daemon asked {name} for power by itself"
                    ));
                }
                let Some(&(version, cells)) = before.get(&name) else {
                    continue;
                };
                let lookup = &report["lookup"];
                if report["identity"].is_null()
                    || lookup["active"].is_null()
                    || !resumed.insert(name.clone())
                {
                    continue;
                }
                let now = (lookup["active"].as_u64(), lookup["observed_cells"].as_u64());
                if now.0 < Some(u64::from(version)) || now.1 < Some(cells) {
                    wrong.push(format!(
                        "kill {kill}: {name} had {version}, {cells} cells, and has {now:?}"
                    ));
                }
            }
            thread::sleep(Duration::from_millis(200));
        }
        daemon.process.kill();
        acknowledged.take(&watch.end());

        let check = store(folder.path(), &["check"]);
        match &check {
            Ok(check) if check["integrity"] == "ok" => {}
            Ok(check) => wrong.push(format!("kill {kill}: {}", check["integrity"])),
            Err(e) => wrong.push(format!("kill {kill}: {e}")),
        }
        wrong.extend(
            acknowledged
                .missing(folder.path())
                .unwrap()
                .into_iter()
                .map(|m| format!("kill {kill}: {m}")),
        );
        let known: BTreeSet<_> = check
            .iter()
            .flat_map(|check| check["lookups"].as_array().into_iter().flatten())
            .filter_map(|l| {
                Some((
                    l["device"].as_str()?.to_owned(),
                    l["version"].as_u64()? as u32,
                ))
            })
            .collect();
        most_lookups = most_lookups.max(known.len());
        for (device, (name, _)) in devices.iter().zip(&named) {
            match look(device.address()) {
                Ok((_, _, 0)) => {}
                Ok((_, _, version)) if known.contains(&(name.clone(), version)) => {}
                Ok((_, _, version)) => {
                    wrong.push(format!(
                        "kill {kill}: {name} uses lookup {version}, unknown to the store"
                    ));
                }
                Err(e) => wrong.push(format!("kill {kill}: {name} cannot be looked at: {e}")),
            }
            if let Device::Player(player) = device
                && player.truth().asked_by_host > 0
            {
                wrong.push(format!("kill {kill}: {name} was asked for power"));
            }
        }
        println!(
            "kill {kill} after {:.1} s: {} windows, {} results acknowledged so far, {} lookups known; {} wrong",
            rest.as_secs_f64(),
            acknowledged.windows.len(),
            acknowledged.results.len(),
            known.len(),
            wrong.len()
        );
    }
    for (cable, (name, _)) in cables.iter().zip(&named) {
        println!("{name}: {}", cable.counted());
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(
        acknowledged.windows.len() >= kills as usize,
        "hardly a window came"
    );
    assert!(
        !acknowledged.results.is_empty() && most_lookups > 0,
        "nothing was learned"
    );
}

/// A hob in this process, of whose time the test is the clock once the daemon is gone.
#[test]
fn a_hob_does_not_heat_for_a_dead_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let mut server = HobServer::bind("127.0.0.1:0", SimHob::new(&HobConfig::default())).unwrap();
    let address = configure(folder.path(), "", &[("hob".into(), server.address())]).unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    let (ended, is_left) = (Arc::clone(&stop), Arc::clone(&stop));
    let served = thread::spawn(move || {
        let watch = |event| {
            if matches!(event, ServerEvent::Disconnected { .. }) {
                ended.store(true, Ordering::Relaxed);
            }
        };
        server.run(1.0, &is_left, watch).unwrap();
        server
    });
    let mut daemon = Daemon::start(folder.path(), address).unwrap();
    let deadline = Instant::now() + PATIENCE;
    loop {
        // Again and again, as the lease lasts ten seconds and a slow machine needs longer.
        let heats = daemon.heat("hob", 1_000);
        let live = daemon.devices().unwrap()[0]["live"].clone();
        if live["power_w"].as_f64() > Some(800.0) {
            break;
        }
        assert!(Instant::now() < deadline, "{heats:?}, {live}");
        thread::sleep(Duration::from_millis(500));
    }
    daemon.process.kill();
    // The server ends when it sees that the daemon has left.
    let mut server = served.join().unwrap();
    assert!(stop.load(Ordering::Relaxed));
    let hob = server.hob();
    assert_eq!(hob.housekeeping().control().asked_w(), 1_000);
    let left_s = hob.t_s();
    while hob.housekeeping().control().asked_w() > 0 {
        assert!(hob.t_s() - left_s < 11.0, "it heats on");
        hob.step();
    }
    // What was heard last came at most a keep-alive's period before the daemon's end.
    let off_s = hob.t_s() - left_s;
    let limit_s = f64::from(HOST_UNHEARD_MS) / 1e3;
    println!("off {off_s:.2} s after the daemon's end");
    assert!(off_s > 0.5 * limit_s && off_s < 1.01 * limit_s, "{off_s} s");
    let until_s = hob.t_s() + 0.5;
    while hob.t_s() < until_s {
        hob.step();
    }
    assert_eq!(hob.housekeeping().control().state(), State::Idle);
}
