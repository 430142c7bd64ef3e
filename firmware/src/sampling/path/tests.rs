use super::*;
use crate::drive::bridge::Bridge;
use crate::drive::sequencer::PotProbe;
use crate::estimate::tank::resonant_inductance;
use crate::limits::BOOTSTRAP_CHARGE_NS;
use crate::sampling::recorder::WindowHeader;
use core::f64::consts::TAU;
use ihd_shared::fault::Fault;
use ihd_shared::sampling::{ADC_LOCK_Q, AMPERE_PER_CODE, VOLT_PER_CODE};
use std::boxed::Box;
use std::vec::Vec;

/// 37.5 µs at 80 kHz: blocks of a half-cycle of 50 Hz.
const HALF_CYCLE: u32 = 266;

struct Board {
    sampling_path: Box<SamplingPath>,
    block: u32,
    /// Amplitude of the coil current while the bridge switches, in ampere, through [`COIL_OHM`] of reactance.
    i_a: f64,
}

/// Aluminium at 80 kHz.
const COIL_OHM: f64 = 5.7;

impl Board {
    fn new() -> Self {
        let (r, l) = (MicroOhm(4_000_000), PicoHenry(26_000_000));
        Self {
            sampling_path: Box::new(SamplingPath::new(r, l)),
            block: 0,
            i_a: 0.0,
        }
    }

    /// Pair `k` of a block; no two blocks are alike, or they would be frozen.
    fn pair(&self, k: usize) -> Pair {
        if self.i_a > 0.0 && self.sampling_path.drive().is_switching() {
            let turns = (self.block as usize * ADC_LOCK_P + k) as f64 * f64::from(ADC_LOCK_Q);
            let angle = TAU * turns / ADC_LOCK_P as f64;
            let code = |x: f64| x.round() as i16 + (self.block % 2) as i16;
            return Pair {
                v: code(self.i_a * COIL_OHM * angle.cos() / VOLT_PER_CODE),
                i: code(self.i_a * angle.sin() / AMPERE_PER_CODE),
            };
        }
        let i = if k == 0 { (self.block % 7) as i16 } else { 0 };
        Pair { v: 0, i }
    }

    /// The bridge after each of so many blocks.
    fn run(&mut self, blocks: u32) -> Vec<Bridge> {
        (0..blocks)
            .map(|_| {
                self.block += 1;
                let crossing = self.block.is_multiple_of(HALF_CYCLE);
                let block = AdcBlock {
                    pairs: &core::array::from_fn::<_, ADC_LOCK_P, _>(|k| self.pair(k)),
                    zero_crossing: crossing.then_some(0),
                    bus: BusReading::steady(300),
                    dc_link_ma: None,
                    lost: 0,
                };
                self.sampling_path.on_block(&block).bridge
            })
            .collect()
    }

    fn heat(&mut self) {
        self.sampling_path.request(Drive::switching(60_000));
    }
}

/// Whenever power is requested, the lower switch is closed for a millisecond before the upper
/// one may be, and switching begins at a zero crossing.
#[test]
fn the_bootstrap_capacitor_is_charged_before_the_bridge_switches() {
    for asked_at in [1, 30, HALF_CYCLE - 60, HALF_CYCLE - 28, HALF_CYCLE - 20] {
        let mut board = Board::new();
        assert!(board.run(asked_at).iter().all(|b| *b == Bridge::Open));
        board.heat();
        let seen = board.run(2 * HALF_CYCLE);
        let lower_on = seen.iter().take_while(|b| **b == Bridge::LowerOn).count() as u32;
        assert!(
            seen[lower_on as usize..]
                .iter()
                .all(|b| *b == Bridge::Switching)
        );
        // The first block's answer counts from the next one.
        assert!(lower_on * 37_500 >= BOOTSTRAP_CHARGE_NS, "{lower_on}");
        assert!(lower_on <= HALF_CYCLE + 27, "{lower_on}");
        assert_eq!((asked_at + lower_on + 1) % HALF_CYCLE, 0);
    }
}

/// A probe lasts 3.3 ms, or until the coil carries 55 A.
#[test]
fn a_pot_probe_ends_in_time_or_with_the_current_that_no_pot_takes() {
    let blocks = |i_a: f64| {
        let mut board = Board::new();
        board.i_a = i_a;
        board.sampling_path.request_pot_probe(PotProbe::FIRST);
        let seen = board.run(3 * HALF_CYCLE);
        seen.iter().filter(|b| **b == Bridge::Switching).count()
    };
    // Of 37.5 µs each.
    assert!((87..=88).contains(&blocks(50.0)), "{}", blocks(50.0));
    // As soon as the demodulator is filled.
    assert!((2..10).contains(&blocks(57.0)), "{}", blocks(57.0));
}

/// The first drive has the frequency of off, so that no change of it sets the resonant inductance.
#[test]
fn resonance_is_checked_from_the_first_start_on() {
    let mut board = Board::new();
    let l_min = board.sampling_path.protection.l_min();
    assert_eq!(l_min, resonant_inductance(Drive::OFF.f_sw_hz));
    board
        .sampling_path
        .request(Drive::switching(Drive::OFF.f_sw_hz));
    board.run(2 * HALF_CYCLE);
    assert_eq!(board.sampling_path.protection.l_min(), l_min);
}

#[test]
fn off_and_faults_open_both_switches_at_once_from_any_state() {
    for blocks in [5, 2 * HALF_CYCLE] {
        let mut board = Board::new();
        board.heat();
        assert_ne!(board.run(blocks).pop(), Some(Bridge::Open));
        board.sampling_path.request(Drive::OFF);
        assert_eq!(board.run(1), [Bridge::Open]);

        let mut board = Board::new();
        board.heat();
        board.run(blocks);
        board.sampling_path.raise(Fault::HARDWARE_OVER_CURRENT);
        assert_eq!(board.run(3), [Bridge::Open; 3]);
        // Cleared, it stays open until power is requested; then it charges again, once the mains has
        // passed its zero if it switched.
        board.sampling_path.clear_fault();
        assert_eq!(board.run(3), [Bridge::Open; 3]);
        board.heat();
        let switched = blocks > HALF_CYCLE;
        let to_crossing = if switched {
            HALF_CYCLE - board.block % HALF_CYCLE
        } else {
            1
        };
        let waited = board.run(to_crossing);
        let (last, before) = waited.split_last().expect("at least one");
        assert!(before.iter().all(|b| *b == Bridge::Open));
        assert_eq!(*last, Bridge::LowerOn);
    }
}

/// A replay may begin and end within a half-cycle in which the bridge switched.
#[test]
fn after_a_replay_no_switch_closes_before_the_mains_has_passed_its_zero() {
    let mut board = Board::new();
    board.heat();
    board.run(2 * HALF_CYCLE + HALF_CYCLE / 2);
    for replay in [true, false] {
        let (r, l) = (MicroOhm(4_000_000), PicoHenry(26_000_000));
        board.sampling_path.set_replay(replay, 60_000, r, l);
    }
    board.heat();
    let to_crossing = (HALF_CYCLE - board.block % HALF_CYCLE - 1) as usize;
    let seen = board.run(3 * HALF_CYCLE);
    assert!(seen[..to_crossing].iter().all(|b| *b == Bridge::Open));
    assert_eq!(seen.last(), Some(&Bridge::Switching));
}

/// Blocks of a recording at 34 kHz last 88 µs, but the ADC's go on as with an open bridge: pauses and times of cooking count those.
#[test]
fn a_recording_does_not_hasten_the_clock() {
    let mut board = Board::new();
    let (r, l) = (MicroOhm(4_000_000), PicoHenry(26_000_000));
    board.sampling_path.set_replay(true, 34_000, r, l);
    let from_ms = board.sampling_path.now_ms();
    // One second of 37.5 µs each.
    board.run(26_667);
    let passed_ms = board.sampling_path.now_ms() - from_ms;
    assert!((999..=1_001).contains(&passed_ms), "{passed_ms} ms");
}

/// Runs a board that records every half-cycle for a second. One or two blocks of so many half-cycles never come, as a late interrupt
/// loses them. Returns the windows' headers and the board.
fn run_with_losses(lost: u32, every: u32) -> (Vec<WindowHeader>, Board) {
    let mut board = Board::new();
    board.i_a = 20.0;
    board.sampling_path.recorder().set_period(1);
    board.heat();
    board.run(4 * HALF_CYCLE);
    // The bridge now switches at 60 kHz; blocks of 50 µs, 200 to a half-cycle.
    let (mut windows, mut missing) = (Vec::new(), 0);
    for real in 0..20_000_u32 {
        board.block += 1;
        if (real / 200).is_multiple_of(every) && (100..100 + lost).contains(&(real % 200)) {
            missing += 1;
            continue;
        }
        let pairs: [Pair; ADC_LOCK_P] = core::array::from_fn(|k| board.pair(k));
        board.sampling_path.on_block(&AdcBlock {
            pairs: &pairs,
            zero_crossing: real.is_multiple_of(200).then_some(0),
            bus: BusReading::steady(300),
            dc_link_ma: None,
            lost: core::mem::take(&mut missing),
        });
        let recorder = board.sampling_path.recorder();
        windows.extend(recorder.ready().copied());
        recorder.release();
    }
    (windows, board)
}

/// A window with a hole would join pairs that do not follow one another: it is dropped and counted, and time goes on.
#[test]
fn a_half_cycle_that_lost_blocks_is_no_window_and_lasts_as_long() {
    // The slot is taken until its trajectory is complete, some blocks into the next half-cycle: one in two is recorded.
    for (lost, every, whole) in [(0, 1, 49..=50), (1, 3, 32..=34), (2, 1, 0..=1)] {
        let (windows, mut board) = run_with_losses(lost, every);
        assert_eq!(board.sampling_path.fault(), Fault::NONE, "{lost} lost");
        assert!(whole.contains(&windows.len()), "{} windows", windows.len());
        for window in windows.iter().skip(1) {
            let lasts_ns = 200 * ihd_shared::sampling::block_ns(window.f_sw_hz);
            assert!(window.half_cycle_ns.abs_diff(lasts_ns) < 200, "{window:?}");
            assert_eq!(u32::from(window.pairs), 200 * ADC_LOCK_P as u32);
        }
        let counters = board.sampling_path.recorder().counters();
        let under_way = counters.due - counters.recorded - counters.dropped;
        assert!(under_way <= 1, "{counters:?}");
    }
}

#[test]
fn lost_blocks_take_no_time_from_the_clock() {
    let (_, without) = run_with_losses(0, 1);
    let (_, with) = run_with_losses(2, 1);
    let (without, with) = (without.sampling_path.now_ms(), with.sampling_path.now_ms());
    assert!(with.abs_diff(without) <= 1, "{with} of {without} ms");
}
