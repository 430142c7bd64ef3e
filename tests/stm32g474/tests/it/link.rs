//! Data over the link: windows equal the sampled pairs, and replays are equal bit for bit.

use std::time::Duration;

use ihd_firmware::sampling::path::{AdcBlock, SamplingPath};
use ihd_firmware::sense::bus::BusReading;
use ihd_link::{Client, DeviceEvent, Window};
use ihd_shared::board::MAINS_FREQUENCY_HZ;
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q, CODE_HALF_RANGE, Pair};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::usb::PRODUCT;
use ihd_shared::window::TrajectoryEntry;
use ihd_sim::behavioural::PotKind;
use ihd_stm32g474::usb::Board as UsbHost;

use crate::board::{Bench, assert_no_violations, connect, over, with_pot};

/// USB host without an operating system, and a client on it. Emulated time passes all the time from now on.
fn over_usb(bench: &Bench) -> (UsbHost, Client) {
    let cable = bench.with(|machine| machine.cable.clone());
    bench.run_s(0.03);
    bench.run_freely(true);
    let host = UsbHost::enumerate(&cable, 5).expect("the board enumerates");
    let client = over(host.link());
    (host, client)
}

fn windows(client: &mut Client, wanted: usize) -> Vec<Window> {
    let mut found = Vec::new();
    while found.len() < wanted {
        let event = client
            .next_event(Duration::from_secs(2))
            .expect("the link holds");
        if let DeviceEvent::Window(window) = event.expect("windows come") {
            found.push(*window);
        }
    }
    found
}

/// Bytes of the stack that were ever used: start-up paints it (cortex-m-rt), memory.x has its address.
fn stack_used(bench: &Bench) -> usize {
    const STACK: (u32, usize) = (0x2000_0000, 12 * 1024);
    const PAINT: [u8; 4] = 0xCCCC_CCCC_u32.to_le_bytes();
    let stack = bench.with(|machine| machine.memory(STACK.0, STACK.1));
    let untouched = stack.chunks(4).take_while(|word| **word == PAINT).count();
    STACK.1 - 4 * untouched
}

/// Bytes of the stack that the budget allows.
fn stack_budget() -> usize {
    let budget = include_str!("../../../../firmware/budget.toml");
    let line = budget
        .lines()
        .find_map(|line| line.strip_prefix("stack = "));
    line.and_then(|bytes| bytes.parse().ok())
        .expect("stack = BYTES")
}

/// Regression test: a frame above 256 bytes was retried for ever. A window has frames of up to a kilobyte.
#[test]
fn a_window_comes_over_the_serial_port_too() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    bench.with(|machine| machine.chip().pins.taken = Some(Vec::new()));
    client.set_power(1_200).unwrap();
    bench.run_s(0.3);
    client.stream(1, 50).unwrap();
    let window = windows(&mut client, 1).remove(0);
    let taken = bench.with(|machine| machine.chip().pins.taken.clone().expect("they are kept"));
    let mut stretches = taken.windows(window.pairs.len());
    assert!(
        stretches.any(|stretch| stretch == window.pairs),
        "not what was sampled"
    );
    assert_no_violations(&bench);
}

#[test]
fn windows_over_usb_are_pair_for_pair_what_the_converters_found() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let (host, mut client) = over_usb(&bench);
    assert_eq!(host.description.strings[1], PRODUCT);
    bench.with(|machine| machine.chip().pins.taken = Some(Vec::new()));
    client.set_power(1_200).unwrap();
    client.stream(0, 10).unwrap();
    for window in windows(&mut client, 3) {
        let taken = bench.with(|machine| machine.chip().pins.taken.clone().expect("they are kept"));
        let length = window.pairs.len();
        // Blocks of a half-cycle, with a tolerance of one at each end.
        let half_cycle_s = 0.5 / f64::from(MAINS_FREQUENCY_HZ);
        let blocks = f64::from(window.f_sw_hz) / f64::from(ADC_LOCK_Q) * half_cycle_s;
        let off = length as f64 / ADC_LOCK_P as f64 - blocks;
        assert!(off.abs() < 2.0, "{length} pairs at {} Hz", window.f_sw_hz);
        let same = taken
            .windows(length)
            .position(|stretch| stretch == window.pairs);
        assert!(
            same.is_some(),
            "window {} of {length} pairs is not what was sampled",
            window.seq
        );
    }
    let used = stack_used(&bench);
    println!("stack: {used} bytes of {}", stack_budget());
    assert!(used > 2_000 && used <= stack_budget(), "{used}");
    assert_no_violations(&bench);
}

/// Half-cycle at 50 kHz with a lagging current, computed without code of the firmware.
fn blocks() -> Vec<[Pair; ADC_LOCK_P]> {
    let sample = |n: usize| {
        let phase = std::f64::consts::TAU * 3.0 * n as f64 / ADC_LOCK_P as f64;
        let envelope = (std::f64::consts::PI * n as f64 / (166.0 * ADC_LOCK_P as f64)).sin();
        let code = |share: f64| (share * f64::from(CODE_HALF_RANGE)) as i16;
        Pair {
            v: code(0.5 * envelope * phase.sin()),
            i: code(0.4 * envelope * (phase - 1.1).sin()),
        }
    };
    (0..166)
        .map(|block| std::array::from_fn(|k| sample(block * ADC_LOCK_P + k)))
        .collect()
}

const F_SW_HZ: u32 = 50_000;
const BUS_DV: u16 = 3_000;
const START: (MicroOhm, PicoHenry) = (MicroOhm(4_000_000), PicoHenry(25_000_000));

#[test]
fn a_replay_gives_the_bits_that_the_library_gives_here() {
    let mut here = Box::new(SamplingPath::new(START.0, START.1));
    here.set_replay(true, F_SW_HZ, START.0, START.1);
    let expected: Vec<Option<TrajectoryEntry>> = blocks()
        .iter()
        .enumerate()
        .map(|(k, pairs)| {
            let zero_crossing = (k == 0).then_some(0);
            here.replay_block(&AdcBlock {
                pairs,
                zero_crossing,
                bus: BusReading::steady(BUS_DV),
                dc_link_ma: None,
                lost: 0,
            })
        })
        .collect();
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    let pairs = blocks().concat();
    let mut replay = client.start_replay(F_SW_HZ, START.0, START.1).unwrap();
    let there = replay.blocks(&pairs, Some(0), BUS_DV).unwrap();
    assert_eq!(there.len(), 166);
    assert_eq!(there, expected);
    assert!(there.iter().flatten().count() > 150, "it estimated");
    assert_no_violations(&bench);
}
