//! Frames of a host, and what else may come over its line, on the whole controller with a pot that heats.

mod desk;

use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::messages::{
    GetStatus, Outcome, Piece, ResendWindow, ResetLookup, SetPower, Stream,
};
use ihd_shared::wire::timing::HOST_UNHEARD_MS;

use desk::{Desk, HALF_CYCLE_NS};

/// Lines that are shorted give back telemetry, windows, and the answer to the last request with its number.
#[test]
fn the_echo_of_its_own_frames_keeps_no_power_up() {
    for echoes in [false, true] {
        let mut desk = Desk::new();
        desk.request(&Stream {
            telemetry_every: 10,
            windows_every: 50,
        });
        desk.heat();
        desk.echoes = echoes;
        // An answer is on its way as the host dies.
        let mut frame = [0; MAX_ENCODED];
        desk.number = desk.number.next();
        let length = encode_numbered(&GetStatus {}, desk.number, desk.sent, &mut frame).unwrap();
        desk.housekeeping.receive(&mut *desk.path, &frame[..length]);
        desk.run_ms(HOST_UNHEARD_MS - 100);
        assert_eq!(desk.asked_w(), 1_000, "echoes: {echoes}");
        desk.run_ms(200);
        assert_eq!(desk.asked_w(), 0, "echoes: {echoes}");
        assert!(!desk.path.drive().is_switching());
    }
}

/// A host sends requests for pieces of windows by itself; a request that comes again is of a host that had no answer.
#[test]
fn requests_keep_power_up_and_notices_do_not() {
    let mut desk = Desk::new();
    desk.heat();
    for _ in 0..3 {
        desk.run_ms(HOST_UNHEARD_MS - 2_500);
        desk.request(&GetStatus {});
        assert_eq!(desk.asked_w(), 1_000);
    }
    let mut again = [0; MAX_ENCODED];
    let length = encode_numbered(&GetStatus {}, desk.number, desk.sent, &mut again).unwrap();
    for _ in 0..2 {
        desk.run_ms(HOST_UNHEARD_MS - 2_500);
        desk.housekeeping.receive(&mut *desk.path, &again[..length]);
        assert_eq!(desk.asked_w(), 1_000);
    }
    let piece = ResendWindow {
        seq: 0,
        piece: Piece::Start,
        offset: 0,
    };
    for _ in 0..3 {
        desk.run_ms(HOST_UNHEARD_MS / 3 + 100);
        desk.notice(&piece);
    }
    assert_eq!(desk.asked_w(), 0);
}

/// Opened at the crest, the line's current would charge the DC link: a replay begins with the bridge open, or changes nothing.
#[test]
fn a_replay_that_is_refused_changes_nothing() {
    let mut desk = Desk::new();
    desk.heat();
    desk.run_to_crest();
    for (f_sw_hz, outcome) in [(1, Outcome::Malformed), (45_000, Outcome::NotIdle)] {
        assert_eq!(desk.start_replay(f_sw_hz), outcome);
        assert_eq!(desk.asked_w(), 1_000);
        let block = desk.block;
        while desk.block < block + 100 {
            desk.step();
            assert!(desk.path.drive().is_switching());
        }
        desk.run_to_crest();
    }
    // Off opens the bridge at the zero crossing, and no sooner for a replay's sake.
    desk.request(&SetPower { power_w: 0 });
    assert_eq!(desk.start_replay(45_000), Outcome::NotIdle);
    desk.step();
    assert!(desk.path.drive().is_switching());
    desk.run_ms(12);
    for _ in 0..2 {
        assert_eq!(desk.start_replay(45_000), Outcome::Ok);
        assert!(!desk.path.drive().is_switching());
    }
}

/// The bridge may be on at any moment, though it waits for the mains.
#[test]
fn power_that_is_requested_and_not_yet_given_refuses_a_replay() {
    let mut desk = Desk::new();
    desk.mains = false;
    desk.run_ms(20);
    desk.request(&SetPower { power_w: 1_000 });
    desk.run_ms(5);
    assert!(!desk.path.drive().is_switching());
    assert_eq!(desk.start_replay(45_000), Outcome::NotIdle);
    assert_eq!(desk.asked_w(), 1_000);
}

/// Without mains no half-cycle ends: a lookup is in use before the next request comes.
#[test]
fn a_lookup_becomes_active_without_mains() {
    let mut desk = Desk::new();
    desk.mains = false;
    desk.run_ms(500);
    for version in 1..4 {
        let changes = desk.housekeeping.lookup_changes();
        assert_eq!(desk.push(version), Outcome::Ok);
        desk.step();
        assert_eq!(desk.housekeeping.lookup().version, version);
        assert_eq!(desk.housekeeping.lookup_changes(), changes + 1);
    }
    assert_eq!(desk.outcome(&ResetLookup {}), Outcome::Ok);
    desk.step();
    assert_eq!(desk.housekeeping.lookup().version, 0);
}

/// One half-cycle sees one lookup while the bridge switches, also between the bursts of little power.
#[test]
fn while_it_heats_a_lookup_becomes_active_at_the_zero_crossing() {
    for power_w in [1_000, 200] {
        let mut desk = Desk::new();
        desk.heat();
        desk.request(&SetPower { power_w });
        for version in 1..50 {
            desk.run_to_crest();
            assert_eq!(desk.push(version), Outcome::Ok);
            while desk.since_crossing_ns >= HALF_CYCLE_NS / 2 {
                assert_eq!(desk.housekeeping.lookup().version, version - 1);
                assert_eq!(desk.push(version + 1), Outcome::Busy);
                desk.step();
            }
            desk.run_ms(2);
            assert_eq!(desk.housekeeping.lookup().version, version);
        }
    }
}
