//! Recording session on the link of a simulated hob whose clock runs only while the test waits, so that every time is known.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use ihd_capture::mcap::reader::McapItem;
use ihd_capture::mcap::topics::{self, META_FREE, Topic};
use ihd_capture::mcap::{McapReader, SessionReader};
use ihd_capture::recording::{
    Quantity, RecordSettings, RecordingLimit, RecordingOptions, RecordingPhase, RecordingSession,
    RecordingStatus, StartedRecording, Trigger,
};
use ihd_link::{Client, DeviceEvent, FrameSink as _};
use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::messages::AnyMessage;
use ihd_sim::behavioural::PotKind;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::injection::{Injection, InjectionKind};
use ihd_sim::transport::SharedHob;

/// Longest wait for an event in simulated time.
const PATIENCE: Duration = Duration::from_secs(10);

/// Half a mains period.
const HALF_CYCLE_S: f64 = 0.01;

struct Bench {
    hob: SharedHob,
    client: Client,
    recorder: RecordingSession,
    statuses: Arc<Mutex<Vec<RecordingStatus>>>,
    dir: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let (folder, made) = (dir.path().to_owned(), AtomicU32::new(0));
        Self::with(dir, move |_| {
            let number = 1 + made.fetch_add(1, Ordering::Relaxed);
            folder.join(format!("file-{number}.mcap"))
        })
    }

    fn with(dir: tempfile::TempDir, name: impl Fn(u32) -> PathBuf + Send + Sync + 'static) -> Self {
        let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
        let statuses: Arc<Mutex<Vec<RecordingStatus>>> = Arc::default();
        let published = Arc::clone(&statuses);
        let recorder = RecordingSession::new(name, move |t| published.lock().unwrap().push(t));
        let client = connect(&hob, &recorder);
        Self {
            hob,
            client,
            recorder,
            statuses,
            dir,
        }
    }

    /// The link is cut and made anew.
    fn reconnect(&mut self) {
        self.recorder.disconnected();
        self.client = connect(&self.hob, &self.recorder);
    }

    fn start(&mut self, settings: RecordSettings) -> Result<StartedRecording, String> {
        let started = self.recorder.start(settings, self.client.clock())?;
        started.wait()?;
        Ok(started)
    }

    /// Lets simulated time pass. Returns the received faults.
    fn pass(&mut self, seconds: f64) -> Vec<u16> {
        let until = self.client.clock() + Duration::from_secs_f64(seconds);
        let mut faults = Vec::new();
        while self.client.clock() < until {
            let left = until - self.client.clock();
            if let Some(DeviceEvent::Fault(f)) = self.client.next_event(left).unwrap() {
                faults.push(f.fault.number());
            }
        }
        faults
    }

    /// The wire of a temperature sensor breaks, which trips fault 22.
    fn trip(&mut self) {
        let kind = InjectionKind::NtcOpen;
        let broken = Injection {
            kind,
            value: 0.0,
            channel: kind.default_channel(),
        };
        self.hob.lock().inject(|all| {
            all.start(broken);
        });
    }

    fn heat(&mut self, power_w: u16) {
        self.client.set_power(power_w).unwrap();
    }

    /// Heats until this power is reached.
    fn heats(&mut self, power_w: u16) {
        self.heat(power_w);
        let deadline = self.client.clock() + PATIENCE;
        loop {
            let left = deadline.saturating_sub(self.client.clock());
            assert!(!left.is_zero(), "it does not reach {power_w} W");
            if let Some(DeviceEvent::Telemetry(t)) = self.client.next_event(left).unwrap()
                && (f64::from(t.power_mw) * 1e-3 / f64::from(power_w) - 1.0).abs() < 0.1
            {
                return;
            }
        }
    }

    /// Lets simulated time pass until nothing is recorded any more.
    fn until_it_ends(&mut self) {
        let deadline = self.client.clock() + PATIENCE;
        while self.recorder.active().is_some() {
            assert!(self.client.clock() < deadline, "it does not end");
            self.pass(0.1);
        }
    }

    fn phases(&self) -> Vec<RecordingPhase> {
        self.statuses
            .lock()
            .unwrap()
            .iter()
            .map(|t| t.phase)
            .collect()
    }

    /// Waits, by the system clock, until a file has ended. Returns the last status.
    fn ended(&self) -> RecordingStatus {
        for _ in 0..60_000 {
            let last = self.statuses.lock().unwrap().last().cloned();
            if let Some(last) = last
                && matches!(last.phase, RecordingPhase::Ended | RecordingPhase::Failed)
            {
                return last;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        panic!("it has not ended: {:?}", self.statuses.lock().unwrap());
    }
}

fn connect(hob: &SharedHob, recorder: &RecordingSession) -> Client {
    let mut client = Client::connect(Box::new(hob.clone())).unwrap();
    let at = client.clock();
    let sink = recorder.connected(client.hello(), client.front_end(), at);
    client.record_to(sink);
    client.stream(1, 20).unwrap();
    client
}

/// Contents of a file.
#[derive(Debug, Default)]
struct Held {
    notes: BTreeMap<String, String>,
    telemetry_s: Vec<f64>,
    faults: Vec<(f64, u16)>,
    windows_s: Vec<f64>,
    from_host: usize,
    powers_w: Vec<u16>,
    damaged: u32,
    rejected: u32,
}

impl Held {
    fn read(path: &Path) -> Self {
        let mut held = Self::default();
        let mut outgoing = Deframer::new();
        let mut reader = McapReader::open(path).unwrap();
        while let Some(item) = reader.next_item().unwrap() {
            match item {
                McapItem::Metadata { name, entries } if name == META_FREE => held.notes = entries,
                McapItem::Metadata { .. } => {}
                McapItem::Message(m) => {
                    let t_s = m.log_time_ns as f64 * 1e-9;
                    match m.topic {
                        Topic::Telemetry => held.telemetry_s.push(t_s),
                        Topic::Fault => {
                            let note: topics::FaultNote = serde_json::from_slice(m.data).unwrap();
                            held.faults.push((t_s, note.number));
                        }
                        Topic::Window => held.windows_s.push(t_s),
                        Topic::ToDevice => {
                            held.from_host += 1;
                            held.powers_w.extend(m.data.iter().filter_map(|&byte| {
                                let frame = outgoing.push(byte)?.ok()?;
                                match AnyMessage::decode(frame.id, frame.split().1) {
                                    Ok(AnyMessage::SetPower(m)) => Some(m.power_w),
                                    _ => None,
                                }
                            }));
                        }
                        _ => {}
                    }
                }
            }
        }
        assert!(!reader.is_cut(), "its index is there");
        let mut session = SessionReader::open(path).unwrap();
        while session.next_event().unwrap().is_some() {}
        held.damaged = session.counters().frames_bad;
        held.rejected = session.counters().windows_rejected_total();
        held
    }

    fn trigger_s(&self) -> f64 {
        self.notes["trigger_s"].parse().unwrap()
    }
}

fn at_fault(pre_trigger_s: f64, duration_s: Option<f64>) -> RecordSettings {
    RecordSettings {
        trigger: Trigger::Fault,
        pre_trigger_s,
        duration_s,
        ..RecordSettings::default()
    }
}

fn near(a: f64, b: f64) -> bool {
    // A chunk of the link comes at once: some half-cycles.
    (a - b).abs() < 3.0 * HALF_CYCLE_S
}

#[test]
fn a_fault_is_recorded_with_the_seconds_before_and_after_it() {
    let mut bench = Bench::new();
    bench.heats(1_000);
    bench.start(at_fault(1.0, Some(0.5))).unwrap();
    assert_eq!(bench.pass(1.2), [0; 0]);
    assert!(bench.recorder.active().unwrap().file.is_none());
    let broken_s = bench.hob.lock().t_s();
    bench.trip();
    assert_eq!(bench.pass(0.3), [22]);
    assert!(bench.recorder.active().unwrap().file.is_some());
    bench.pass(0.3);
    assert_eq!(bench.recorder.active(), None);
    let ended = bench.ended();
    assert_eq!(ended.text, "0.5 s are over");
    use RecordingPhase::{Armed, Begun, Ended};
    assert_eq!(bench.phases(), [Armed, Begun, Ended]);
    let held = Held::read(&ended.file.unwrap());
    // Beginning and end may cut a window.
    assert!(held.damaged == 0 && held.rejected <= 1, "{held:?}");
    // The trigger lies a second after the beginning, and the fault at it.
    assert!(near(held.trigger_s(), 1.0), "{held:?}");
    let [(fault_s, 22), ..] = held.faults[..] else {
        panic!("{held:?}");
    };
    assert!(near(fault_s, held.trigger_s()), "{held:?}");
    assert!(held.notes["trigger"].starts_with("fault 22: "), "{held:?}");
    // Half-cycles from the beginning to the end, none missing.
    let (first, last) = (held.telemetry_s[0], *held.telemetry_s.last().unwrap());
    assert!(near(first, 0.0) && near(last, 1.5), "{first} to {last}");
    assert!(
        held.telemetry_s.len().abs_diff(150) < 5,
        "{}",
        held.telemetry_s.len()
    );
    // Windows come five times a second while it heats, and none after.
    assert!(
        held.windows_s.len().abs_diff(5) <= 2,
        "{:?}",
        held.windows_s
    );
    assert!(
        broken_s > 1.1 && held.notes["pre_trigger_s"] == "1",
        "{held:?}"
    );
}

#[test]
fn a_lifted_pot_is_recorded_by_its_power() {
    let mut bench = Bench::new();
    bench.heats(1_000);
    let trigger = Trigger::Level {
        quantity: Quantity::Power,
        level: 100.0,
        rising: false,
    };
    let settings = RecordSettings {
        trigger,
        pre_trigger_s: 0.5,
        duration_s: Some(0.3),
        ..RecordSettings::default()
    };
    bench.start(settings).unwrap();
    bench.pass(0.3);
    bench.hob.lock().set_pot(PotKind::None).unwrap();
    bench.until_it_ends();
    let held = Held::read(&bench.ended().file.unwrap());
    assert!(held.notes["trigger"].contains("below 100 W"), "{held:?}");
    assert!(near(held.trigger_s(), 0.5) && near(*held.telemetry_s.last().unwrap(), 0.8));
}

#[test]
fn what_was_before_the_command_is_recorded_too_and_in_step() {
    let mut bench = Bench::new();
    bench.heats(800);
    bench.pass(1.0);
    let settings = RecordSettings {
        pre_trigger_s: 0.8,
        duration_s: Some(0.3),
        ..RecordSettings::default()
    };
    bench.start(settings).unwrap();
    bench.heat(900);
    bench.until_it_ends();
    let held = Held::read(&bench.ended().file.unwrap());
    assert!(near(held.trigger_s(), 0.8), "{held:?}");
    assert!(near(*held.telemetry_s.last().unwrap(), 1.1), "{held:?}");
    // The windows that its beginning and its end cut.
    assert!(held.damaged == 0 && held.rejected <= 2, "{held:?}");
    assert!(held.from_host > 0, "what was asked of it is in it");
    assert_eq!(held.notes["trigger"], "by hand");
}

#[test]
fn more_before_than_there_was_is_what_there_was() {
    let mut bench = Bench::new();
    bench.pass(0.5);
    let settings = RecordSettings {
        pre_trigger_s: 60.0,
        ..RecordSettings::default()
    };
    bench.start(settings).unwrap();
    bench.pass(0.5);
    let stopped = bench.recorder.stop("of a test").unwrap();
    stopped.wait().unwrap();
    let held = Held::read(&stopped.file.unwrap());
    assert!(near(held.trigger_s(), 0.5) && near(*held.telemetry_s.last().unwrap(), 1.0));
}

#[test]
fn a_level_that_is_exceeded_at_the_start_must_be_crossed() {
    let mut bench = Bench::new();
    bench.heats(1_200);
    let trigger = Trigger::Level {
        quantity: Quantity::Power,
        level: 900.0,
        rising: true,
    };
    let settings = RecordSettings {
        trigger,
        pre_trigger_s: 0.2,
        duration_s: Some(0.2),
        ..RecordSettings::default()
    };
    bench.start(settings).unwrap();
    bench.pass(0.3);
    bench.heats(600);
    assert_eq!(bench.phases(), [RecordingPhase::Armed]);
    bench.heat(1_200);
    bench.until_it_ends();
    let ended = bench.ended();
    let held = Held::read(&ended.file.unwrap());
    assert!(held.notes["trigger"].contains("above 900 W"), "{held:?}");
    assert!(near(held.trigger_s(), 0.2) && near(*held.telemetry_s.last().unwrap(), 0.4));
}

#[test]
fn a_fault_that_is_there_at_the_start_does_not_begin_it() {
    let mut bench = Bench::new();
    bench.heats(1_000);
    bench.trip();
    assert_eq!(bench.pass(0.5), [22]);
    bench.start(at_fault(0.0, None)).unwrap();
    // The fault is not published again, and a new link that reports it begins nothing.
    bench.pass(0.3);
    bench.reconnect();
    bench.pass(0.3);
    assert_eq!(bench.phases(), [RecordingPhase::Armed]);
    // Stopped while armed, it leaves nothing behind.
    let stopped = bench.recorder.stop("of a test").unwrap();
    stopped.wait().unwrap();
    assert_eq!(stopped.file, None);
    assert_eq!(bench.recorder.active(), None);
    assert_eq!(bench.phases()[1..], [RecordingPhase::Disarmed]);
    assert_eq!(fs::read_dir(bench.dir.path()).unwrap().count(), 0);
    assert!(bench.recorder.stop("again").is_err());
}

#[test]
fn armed_it_survives_a_reconnect_and_sees_what_happened_meanwhile() {
    let mut bench = Bench::new();
    bench.heats(1_000);
    bench.start(at_fault(1.0, Some(0.3))).unwrap();
    bench.recorder.disconnected();
    // No recorder is attached while it trips.
    bench.trip();
    // The fault stands until the first try, a tenth of a second later.
    let until = bench.hob.lock().t_s() + 0.05;
    while bench.hob.lock().t_s() < until {
        bench.hob.lock().step();
    }
    assert!(bench.recorder.active().is_some(), "it stays armed");
    bench.reconnect();
    bench.until_it_ends();
    let held = Held::read(&bench.ended().file.unwrap());
    assert!(held.notes["trigger"].starts_with("fault 22"), "{held:?}");
    // What came over the link that is gone belongs to another file.
    assert!(held.trigger_s() < 0.2, "{held:?}");
    assert_eq!(held.damaged, 0);
}

#[test]
fn under_way_it_goes_on_in_a_second_file_for_the_rest_of_its_time() {
    let mut bench = Bench::new();
    bench.heats(1_000);
    let settings = RecordSettings {
        duration_s: Some(1.0),
        ..RecordSettings::default()
    };
    bench.start(settings).unwrap();
    bench.pass(0.4);
    bench.reconnect();
    bench.until_it_ends();
    assert_eq!(bench.ended().text, "1 s are over");
    assert_eq!(bench.recorder.active(), None);
    let parts = ["file-1.mcap", "file-2.mcap"].map(|name| Held::read(&bench.dir.path().join(name)));
    assert!(
        near(*parts[0].telemetry_s.last().unwrap(), 0.4),
        "{:?}",
        parts[0]
    );
    assert_eq!(parts[1].notes["part"], "2");
    // The second one counts on from the same trigger.
    let after_s = -parts[1].trigger_s();
    assert!((0.4..0.6).contains(&after_s), "{after_s}");
    assert!(
        near(after_s + parts[1].telemetry_s.last().unwrap(), 1.0),
        "{:?}",
        parts[1]
    );
    // Ended while the link is away, it does not come back.
    bench.start(RecordSettings::default()).unwrap();
    bench.recorder.disconnected();
    assert!(bench.recorder.active().is_some());
    bench.recorder.stop("of a test").unwrap().wait().unwrap();
    bench.reconnect();
    assert_eq!(bench.recorder.active(), None);
}

#[test]
fn by_the_walls_clock_a_link_that_is_away_ends_it_too() {
    let mut bench = Bench::new();
    let settings = RecordSettings {
        duration_s: Some(0.05),
        ..RecordSettings::default()
    };
    bench.start(settings).unwrap();
    bench.recorder.tick();
    bench.recorder.disconnected();
    std::thread::sleep(Duration::from_millis(60));
    bench.recorder.tick();
    assert_eq!(bench.recorder.active(), None);
}

#[test]
fn a_file_of_its_largest_size_ends_the_recording_and_can_be_read() {
    let mut bench = Bench::new();
    bench.heats(1_000);
    let settings = RecordSettings {
        max_bytes: Some(100_000),
        ..RecordSettings::default()
    };
    bench.start(settings).unwrap();
    bench.until_it_ends();
    let ended = bench.ended();
    assert_eq!(ended.phase, RecordingPhase::Ended);
    let path = ended.file.unwrap();
    let bytes = fs::metadata(&path).unwrap().len();
    // A chunk of the link, a window at most, and the index come on top.
    assert!((100_000..250_000).contains(&bytes), "{bytes}");
    assert_eq!(Held::read(&path).damaged, 0);
}

/// Records 0.2 s as a command does: the owner sets the device up, ends at the limit and leaves. Returns the file's bytes.
fn recorded_by_its_owner() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let named = path.clone();
    let options = RecordingOptions {
        simulated_clock: true,
        ends_by_owner: true,
        free_bytes: None,
    };
    let session = RecordingSession::with_options(options, move |_| named.clone(), |_| ());
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let mut client = Client::connect(Box::new(hob)).unwrap();
    let at = client.clock();
    client.record_to(session.connected(client.hello(), client.front_end(), at));
    let settings = RecordSettings {
        duration_s: Some(0.2),
        ..RecordSettings::default()
    };
    session.start(settings, at).unwrap().wait().unwrap();
    client.stream(1, 20).unwrap();
    client.set_power(1_000).unwrap();
    let set_up = client.clock();
    session.count_from(set_up);
    let progress = loop {
        client.next_event(Duration::from_millis(10)).unwrap();
        let progress = session.progress(client.clock()).unwrap();
        if progress.limit.is_some() {
            break progress;
        }
    };
    assert_eq!(progress.limit, Some(RecordingLimit::Duration));
    assert!((0.2..0.22).contains(&progress.elapsed_s), "{progress:?}");
    client.set_power(0).unwrap();
    session.stop("of a test").unwrap().wait().unwrap();
    let held = Held::read(&path);
    assert!(
        held.notes.keys().all(|key| !key.ends_with("_at")),
        "{held:?}"
    );
    // The limit ends nothing by itself: the power that is taken back is in the file.
    assert_eq!(held.powers_w, [1_000, 0]);
    fs::read(&path).unwrap()
}

#[test]
fn by_a_simulated_clock_the_same_session_is_the_same_file() {
    assert_eq!(recorded_by_its_owner(), recorded_by_its_owner());
}

#[test]
fn one_at_a_time_and_none_without_a_device() {
    let mut bench = Bench::new();
    bench.start(at_fault(0.0, None)).unwrap();
    let why = bench.start(RecordSettings::default()).err().unwrap();
    assert!(why.contains("waits for a fault"), "{why}");
    bench.recorder.stop("of a test").unwrap();
    bench.start(RecordSettings::default()).unwrap();
    let why = bench.start(at_fault(0.0, None)).err().unwrap();
    assert!(why.contains(".mcap is being recorded"), "{why}");
    bench.recorder.stop("of a test").unwrap();
    bench.recorder.disconnected();
    let why = bench.start(RecordSettings::default()).err().unwrap();
    assert!(why.contains("not connected"), "{why}");
    let wrong = at_fault(61.0, None);
    assert!(bench.start(wrong).err().unwrap().contains("60"));
}

#[test]
fn a_file_that_cannot_be_made_is_said_and_ends_it() {
    let dir = tempfile::tempdir().unwrap();
    let in_the_way = dir.path().join("folder");
    fs::write(&in_the_way, "a file").unwrap();
    let mut bench = Bench::with(dir, move |_| in_the_way.join("a.mcap"));
    let why = bench.start(RecordSettings::default()).err().unwrap();
    assert!(why.contains("a.mcap"), "{why}");
    assert_eq!(bench.ended().phase, RecordingPhase::Failed);
    assert_eq!(bench.recorder.active(), None);
}

#[test]
fn without_a_limit_it_ends_before_its_disk_is_full() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let statuses: Arc<Mutex<Vec<RecordingStatus>>> = Arc::default();
    let published = Arc::clone(&statuses);
    // Room for the first four megabytes, and then too little.
    static LOOKS: AtomicU32 = AtomicU32::new(0);
    let options = RecordingOptions {
        free_bytes: Some(|_| match LOOKS.fetch_add(1, Ordering::Relaxed) {
            0 => Some(500_000_000),
            _ => Some(499_999_999),
        }),
        ..RecordingOptions::default()
    };
    let recorder = RecordingSession::with_options(
        options,
        move |_| path.clone(),
        move |t| published.lock().unwrap().push(t),
    );
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let client = Client::connect(Box::new(hob.clone())).unwrap();
    let at = client.clock();
    let mut sink = recorder.connected(client.hello(), client.front_end(), at);
    let mut bench = Bench {
        hob,
        client,
        recorder,
        statuses,
        dir,
    };
    bench.start(RecordSettings::default()).unwrap();
    for _ in 0..64 {
        sink.received(at, &[0; 1 << 16]).unwrap();
    }
    let ended = bench.ended();
    assert_eq!(ended.phase, RecordingPhase::Ended);
    assert!(ended.text.contains("less than 500 MB"), "{ended:?}");
    assert_eq!(LOOKS.load(Ordering::Relaxed), 2);
    assert_eq!(bench.recorder.failure(), None);
}

/// A file system of its own, of a megabyte; none where this may not be had.
#[cfg(target_os = "linux")]
struct SmallDisk(tempfile::TempDir);

#[cfg(target_os = "linux")]
impl SmallDisk {
    fn mount() -> Option<Self> {
        let dir = tempfile::tempdir().unwrap();
        let mut mount = std::process::Command::new("mount");
        mount
            .args(["-t", "tmpfs", "-o", "size=1m", "tmpfs"])
            .arg(dir.path());
        let is_mounted = mount.status().is_ok_and(|status| status.success());
        is_mounted.then_some(Self(dir))
    }
}

#[cfg(target_os = "linux")]
impl Drop for SmallDisk {
    fn drop(&mut self) {
        let mut umount = std::process::Command::new("umount");
        let _ = umount.arg("-l").arg(self.0.path()).status();
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_ends_the_recording_and_not_the_link() {
    let Some(disk) = SmallDisk::mount() else {
        eprintln!("no file system may be mounted here: nothing is tested");
        return;
    };
    // What is left of it is full after some windows of 30 kB.
    let ballast = disk.0.path().join("ballast");
    fs::write(&ballast, vec![1; 600_000]).unwrap();
    let path = disk.0.path().join("a.mcap");
    let named = path.clone();
    let mut bench = Bench::with(tempfile::tempdir().unwrap(), move |_| named.clone());
    bench.heat(1_000);
    bench.start(RecordSettings::default()).unwrap();
    for _ in 0..300 {
        bench.pass(0.1);
        if bench.recorder.active().is_none() {
            break;
        }
        // The file's thread is not paced by simulated time.
        std::thread::sleep(Duration::from_millis(5));
    }
    let failed = bench.ended();
    assert_eq!(failed.phase, RecordingPhase::Failed);
    assert!(failed.text.contains("No space left"), "{failed:?}");
    assert_eq!(bench.recorder.failure(), Some(failed.text));
    assert_eq!(bench.recorder.active(), None);
    // What was written until then can be read, and the link goes on.
    let mut session = SessionReader::open(&path).unwrap();
    let mut windows = 0;
    while let Some(event) = session.next_event().unwrap() {
        windows += u32::from(matches!(event, DeviceEvent::Window(_)));
    }
    assert!(windows > 2 && session.is_cut(), "{windows} windows");
    assert!(bench.client.status().is_ok());
    // On a disk with no room at all none is begun, and no file is left.
    fs::remove_file(&path).unwrap();
    let filled = fs::write(&ballast, vec![1; 2 << 20]);
    assert!(filled.is_err(), "it fills the disk");
    let why = bench.start(RecordSettings::default()).err().unwrap();
    assert!(why.contains("No space left") && !path.exists(), "{why}");
}
