//! The firmware image on an emulated Cortex-M4F, over its own UART: QEMU's mps2-an386.
//!
//! `cargo xtask test --full` builds the image, names it in `IHD_EMULATED_IMAGE` and runs this; in the quick tier tests/stm32g474 shows
//! the same on the board that there is.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};
use std::{env, fs};

use ihd_capture::mcap;
use ihd_firmware::retained::reset::ResetReason;
use ihd_firmware::sampling::path::{AdcBlock, SamplingPath};
use ihd_firmware::sense::bus::BusReading;
use ihd_link::tcp::TcpTransport;
use ihd_link::{Client, DeviceEvent, LinkError, Window};
use ihd_map::{CurrentCurve, MeasuredPoint, PotMap};
use ihd_shared::fault::Fault;
use ihd_shared::hob::F_SW_MAX_HZ;
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::{ADC_LOCK_P, AMPERE_PER_CODE, Pair};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::TrajectoryEntry;
use ihd_shared::wire::hello::{CAP_REPLAYING, CAP_SIMULATED};
use ihd_shared::wire::messages::{Outcome, State};
use ihd_survey::{Hints, Survey};
use ihd_tests::half_cycle::{F_SW_HZ, HalfCycle};
use ihd_tests::regression_captures;
use ihd_train::lookup::BuiltLookup;
use ihd_train::replay;
use ihd_train::{NetworkConfig, RecordedHalfCycle, RunOptions, TrainingSource};

/// Bus voltage that the replays state, in decivolt.
const BUS_DV: u16 = 3_000;

/// Start values of the estimators.
const START: (MicroOhm, PicoHenry) = (MicroOhm(4_000_000), PicoHenry(25_000_000));

/// The stack of memory.x, and what start-up paints it with (cortex-m-rt).
const STACK: (u32, usize) = (0x2000_0000, 12 * 1024);
const PAINT: u32 = 0xCCCC_CCCC;

/// Ends a hang before the runner does, which shows no log: a busy machine emulates slowly.
const PATIENCE: Duration = Duration::from_secs(500);

/// Largest use of the stack in these tests: firmware/budget.toml.
static STACK_LIMIT: LazyLock<usize> = LazyLock::new(|| {
    let budget = include_str!("../../firmware/budget.toml");
    let line = budget
        .lines()
        .find_map(|line| line.strip_prefix("stack = "));
    line.and_then(|bytes| bytes.parse().ok())
        .expect("stack = BYTES")
});

static IMAGE: LazyLock<String> = LazyLock::new(|| {
    env::var("IHD_EMULATED_IMAGE").expect("`cargo xtask test --full --only tests` names the image")
});

/// The emulator: `cargo xtask test --full` names the one it found or unpacked.
static QEMU: LazyLock<String> =
    LazyLock::new(|| env::var("IHD_QEMU").unwrap_or_else(|_| "qemu-system-arm".to_owned()));

/// A running emulator; ends with the value.
struct Board {
    qemu: Child,
    link: String,
    monitor: String,
}

impl Drop for Board {
    fn drop(&mut self) {
        // Both fail only when it has ended by itself.
        let _ = self.qemu.kill();
        let _ = self.qemu.wait();
    }
}

fn free_address() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().to_string()
}

impl Board {
    /// Switches a board on; `inject` is what fault_injection.rs of the board understands.
    fn start(inject: &str) -> Self {
        // A port that was free may be another process's before the emulator has it.
        let mut boards = (0..10).map(|_| Self::spawn(inject));
        let board = boards.find_map(|mut board| board.listens().then_some(board));
        board.expect("QEMU ended ten times: its reasons stand above")
    }

    /// Waits until the emulator greets; `false` if it has ended instead.
    fn listens(&mut self) -> bool {
        while self.qemu.try_wait().unwrap().is_none() {
            let greeting = TcpStream::connect(&self.monitor).and_then(|mut monitor| {
                monitor.set_read_timeout(Some(Duration::from_secs(1)))?;
                let mut buf = [0; 4];
                monitor.read_exact(&mut buf).map(|()| buf)
            });
            if greeting.is_ok_and(|bytes| bytes == *b"QEMU") {
                return true;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        false
    }

    fn spawn(inject: &str) -> Self {
        let (link, monitor) = (free_address(), free_address());
        let port = |address: &str| format!("tcp:{address},server=on,wait=off");
        let qemu = Command::new(&*QEMU)
            .args(["-M", "mps2-an386", "-cpu", "cortex-m4", "-display", "none"])
            .args(["-serial", &port(&link), "-monitor", &port(&monitor)])
            .arg("-semihosting-config")
            .arg(format!("enable=on,target=native,arg={inject}"))
            .args(["-kernel", &IMAGE])
            .stdin(Stdio::null())
            .spawn()
            .expect("`cargo xtask test --only setup` installs qemu-system-arm");
        Self {
            qemu,
            link,
            monitor,
        }
    }

    /// A client, as soon as the emulator listens.
    fn connect(&self) -> Client {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let connected = TcpTransport::connect(&self.link)
                .and_then(|transport| Client::connect(Box::new(transport)));
            match connected {
                Ok(mut client) => {
                    client.set_timeout(PATIENCE);
                    return client;
                }
                Err(why) => assert!(Instant::now() < deadline, "{why}"),
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Bytes of stack ever used.
    fn stack_used(&self) -> usize {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("stack");
        let mut monitor = TcpStream::connect(&self.monitor).unwrap();
        let (at, length) = STACK;
        // `info status` answers when the dump before it is written.
        write!(
            monitor,
            "pmemsave {at:#x} {length:#x} \"{}\"\ninfo status\n",
            file.display()
        )
        .unwrap();
        let mut answer = String::new();
        let mut buf = [0; 1024];
        while !answer.contains("VM status") {
            let n = monitor.read(&mut buf).unwrap();
            answer += &String::from_utf8_lossy(&buf[..n]);
        }
        let bytes = fs::read(&file).unwrap();
        let untouched = bytes
            .chunks_exact(4)
            .take_while(|w| u32::from_le_bytes([w[0], w[1], w[2], w[3]]) == PAINT)
            .count();
        length - 4 * untouched
    }
}

/// The host-compiled library on the same blocks.
fn on_this_machine(h: &HalfCycle) -> Vec<Option<TrajectoryEntry>> {
    let mut sampling_path = Box::new(SamplingPath::new(START.0, START.1));
    sampling_path.set_replay(true, h.f_sw_hz, START.0, START.1);
    let blocks = h.blocks().enumerate();
    blocks
        .map(|(k, pairs)| {
            sampling_path.replay_block(&AdcBlock {
                pairs,
                zero_crossing: (k == 0).then_some(0),
                bus: BusReading::steady(BUS_DV),
                dc_link_ma: None,
                lost: 0,
            })
        })
        .collect()
}

fn replayed(client: &mut Client, h: &HalfCycle) -> Vec<Option<TrajectoryEntry>> {
    let mut replay = client.start_replay(h.f_sw_hz, START.0, START.1).unwrap();
    let estimates = replay.blocks(&h.pairs, Some(0), BUS_DV).unwrap();
    replay.end().unwrap();
    estimates
}

#[test]
fn estimates_equal_those_of_this_machine_bit_for_bit() {
    let board = Board::start("");
    let mut client = board.connect();
    assert_eq!(client.hello().capabilities, CAP_SIMULATED);
    for f in F_SW_HZ {
        for noise in ["noiseless", "snr30"] {
            let h = HalfCycle::load(f, noise).unwrap();
            let (here, there) = (on_this_machine(&h), replayed(&mut client, &h));
            assert_eq!(there, here, "{f} Hz {noise}");
            let made = there.iter().flatten().count();
            assert!(made > 100, "{f} Hz {noise}: {made} estimates");
            // And they are no constant: R and L follow the current.
            let (low, high) = spread(&there);
            assert!(high > 1.2 * low, "{f} Hz {noise}: R {low}..{high} ohm");
        }
    }
}

/// `ihd trainer` on the board: each recorded half-cycle goes through the board's sampling path, comes
/// back as a window, is identified by the network, and the lookup is active at the end.
#[test]
fn the_trainer_identifies_what_is_replayed_and_teaches_the_board() {
    let board = Board::start("");
    let half_cycles = F_SW_HZ.map(|f| HalfCycle::load(f, "noiseless").unwrap());
    let recorded = |h: &HalfCycle| RecordedHalfCycle {
        f_sw_hz: h.f_sw_hz,
        first_pair_ns: 0,
        half_cycle_ns: 10_000_000,
        pairs: h.pairs.clone(),
        bus_dv: BUS_DV,
        truth: None,
    };
    let settings = RunOptions::new(
        TrainingSource::Replay(half_cycles.iter().map(recorded).collect()),
        NetworkConfig::default(),
    );
    let report = ihd_train::run(board.connect(), None, &settings, &mut |_| ()).unwrap();
    for (point, h) in report.points.iter().zip(&half_cycles) {
        let (r_ohm, l_h) = h.at(5e-3);
        let (r, l) = (point.pinn.r_ohm / r_ohm, point.pinn.l_h / l_h);
        println!("{} Hz: R {:.4}, L {:.4} of the truth", point.f_sw_hz, r, l);
        assert_eq!((point.f_sw_hz, point.asked_w), (h.f_sw_hz, None));
        // The fixtures have no anti-alias filter: the edges' 121st and 123rd harmonics alias onto
        // the fundamental and cost up to 0.15 % of V, of which R feels four times as much.
        assert!((r - 1.0).abs() <= 1e-2 && (l - 1.0).abs() <= 5e-3);
    }
    let built = report.built.expect("four half-cycles teach something");
    assert_eq!(report.points.len(), half_cycles.len());
    let status = report.status.expect("the board is there at the end");
    assert_eq!(status.lookup_version, built.lookup.version);
    let mut client = board.connect();
    assert!(built.lookup.observed_cells() > 20);
    assert_eq!(client.hello().capabilities, CAP_SIMULATED, "not replaying");
    assert_eq!(client.read_lookup().unwrap(), built.lookup);
}

fn spread(estimates: &[Option<TrajectoryEntry>]) -> (f64, f64) {
    let settled = estimates.iter().flatten().skip(40);
    settled.fold((f64::MAX, 0.0f64), |(low, high), entry| {
        (low.min(entry.r.ohm()), high.max(entry.r.ohm()))
    })
}

/// Replays two half-cycles with windows streamed; the first window that comes.
fn window_back(client: &mut Client, h: &HalfCycle) -> Box<Window> {
    client.stream(0, 1).unwrap();
    let mut replay = client.start_replay(h.f_sw_hz, START.0, START.1).unwrap();
    for _ in 0..2 {
        replay.blocks(&h.pairs, Some(0), BUS_DV).unwrap();
    }
    let deadline = Instant::now() + PATIENCE;
    let window = loop {
        match replay.client().next_event(Duration::from_secs(1)).unwrap() {
            Some(DeviceEvent::Window(window)) => break window,
            Some(other) => panic!("{other:?} instead of a window"),
            None => assert!(Instant::now() < deadline, "no window came"),
        }
    };
    replay.end().unwrap();
    client.stream(0, 0).unwrap();
    window
}

/// R and L against the amplitude of the current, from a window's own track.
fn curve(window: &Window) -> CurrentCurve {
    /// Deviation of the firmware's filter, as a share (docs/accuracy.md).
    const SIGMA: f64 = 5e-3;
    let block = ADC_LOCK_P;
    let points = window
        .trajectory
        .iter()
        .enumerate()
        .filter_map(|(k, entry)| {
            let pairs = window.pairs.get(k * block..(k + 1) * block)?;
            let peak = pairs.iter().map(|p| p.i.unsigned_abs()).max()?;
            let (r_ohm, l_h) = (entry.r.ohm(), entry.l.henry());
            Some(MeasuredPoint {
                i_a: f64::from(peak) * AMPERE_PER_CODE,
                r_ohm,
                l_h,
                r_sigma_ohm: SIGMA * r_ohm,
                l_sigma_h: SIGMA * l_h,
            })
        });
    CurrentCurve::new(f64::from(window.f_sw_hz), 0.0, points)
}

#[test]
fn a_window_comes_back_and_the_lookup_built_from_it_becomes_active() {
    let board = Board::start("");
    let mut client = board.connect();
    let h = HalfCycle::load(45_000, "noiseless").unwrap();
    let window = window_back(&mut client, &h);
    assert_eq!(window.pairs, h.pairs[..window.pairs.len()]);
    assert!(window.pairs.len() + ADC_LOCK_P > h.pairs.len());
    let mut map = PotMap::default();
    map.observe(curve(&window));
    let cells = map.cells(0.0).expect("a whole half-cycle");
    let lookup = BuiltLookup::from_cells(cells, 7).unwrap().lookup;
    assert_ne!(lookup.r, prior().r, "the window must have taught something");
    client.push_lookup(&lookup).unwrap();
    let deadline = Instant::now() + PATIENCE;
    while client.status().unwrap().lookup_version != 7 {
        assert!(Instant::now() < deadline, "the lookup never became active");
    }
    assert_eq!(client.read_lookup().unwrap(), lookup);
    let refused = client.push_lookup(&lookup).unwrap_err();
    let stale = Outcome::LookupStale;
    assert!(matches!(refused, LinkError::Refused { outcome, .. } if outcome == stale));
    let used = board.stack_used();
    println!("stack: {used} of {} bytes", STACK.1);
    assert!(
        (*STACK_LIMIT / 2..=*STACK_LIMIT).contains(&used),
        "{used} bytes of stack"
    );
}

#[test]
fn replay_mode_says_so_and_locks_the_power_outputs() {
    let board = Board::start("");
    let mut client = board.connect();
    let replay = client.start_replay(F_SW_MAX_HZ, START.0, START.1).unwrap();
    let refused = replay_power(replay);
    let locked = Outcome::FaultActive;
    assert!(
        matches!(refused, LinkError::Refused { outcome, detail: 0, .. } if outcome == locked),
        "{refused}"
    );
    drop(client);
    let mut client = board.connect();
    assert_eq!(
        client.hello().capabilities,
        CAP_SIMULATED | CAP_REPLAYING,
        "whoever connects must see the replay in the hello"
    );
    let replay = client.start_replay(F_SW_MAX_HZ, START.0, START.1).unwrap();
    replay.end().unwrap();
    client.set_power(1_000).unwrap();
    // It looks for a pot, or pauses by then: this board has no mains.
    let state = client.status().unwrap().state;
    assert!(
        matches!(state, State::Probing | State::Pausing),
        "{state:?}"
    );
}

#[test]
fn a_capture_replays_with_the_same_bits_windows_and_states() {
    let board = Board::start("");
    let capture = mcap::read(&regression_captures::file("start-up")).unwrap();
    let survey = Survey::from_capture(&capture, &Hints::default()).unwrap();
    let segments = survey.segments(&capture);
    let settings = replay::ReplayOptions {
        patience: Some(PATIENCE),
        ..replay::ReplayOptions::default()
    };
    let outcome = replay::run(
        &segments,
        settings,
        &mut || Ok(board.connect()),
        &mut |_, _| (),
    );
    let outcome = outcome.unwrap();
    assert!(outcome.is_identical(), "{:?}", outcome.first);
    // 20 ms at 45 kHz, three periods a block; zero crossings at 0 and 10 ms, a window between them.
    assert_eq!((outcome.blocks, outcome.estimates), (300, 300));
    assert_eq!((outcome.windows.compared, outcome.windows.lost), (1, 0));
    assert_eq!((outcome.telemetry.compared, outcome.telemetry.lost), (2, 0));
}

fn replay_power(mut replay: ihd_link::replay::ReplayMode<'_>) -> LinkError {
    let status = replay.client().status().unwrap();
    assert_eq!((status.state, status.f_sw_hz), (State::Idle, 0));
    replay.client().set_power(1_000).unwrap_err()
}

#[test]
fn over_current_in_a_replay_ends_the_estimates_and_is_reported() {
    let board = Board::start("");
    let mut client = board.connect();
    let mut replay = client.start_replay(45_000, START.0, START.1).unwrap();
    let loud = [Pair { v: 0, i: 1_960 }; ADC_LOCK_P];
    replay.blocks(&loud, None, BUS_DV).unwrap();
    let status = replay.client().status().unwrap();
    assert_eq!(status.fault, Fault::OVER_CURRENT);
    let after = replay.blocks(&loud, None, BUS_DV).unwrap();
    assert_eq!(after, [None]);
}

#[test]
fn the_reason_of_a_reset_survives_it() {
    for (inject, reason, fault) in [
        ("", ResetReason::PowerOn, 0),
        ("panic", ResetReason::Panic, 4),
        ("stack-overflow", ResetReason::StackOverflow, 0),
        ("processor-fault", ResetReason::Panic, 0),
    ] {
        let board = Board::start(inject);
        let client = board.connect();
        let hello = client.hello();
        assert_eq!(
            (hello.reset_reason, hello.fault_before_reset),
            (reason as u8, fault),
            "{inject:?}"
        );
    }
}
