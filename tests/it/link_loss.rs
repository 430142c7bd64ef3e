//! Windows lost on a faulty link, with and without retransmission.

use std::time::Duration;

use ihd_link::{Client, ClientCounters, DeviceEvent, Transport};
use ihd_shared::wire::messages::Status;
use ihd_tests::desk_hob::{DeskHob, DeskLink, desk_hello};
use ihd_tests::faulty_link::{Faults, FaultyLink};

/// A device on the desk whose link carries a frame a block, 15 MB/s.
fn desk(sends_again: bool) -> DeskLink {
    let mut hob = DeskHob::new(desk_hello());
    hob.sends_again = sends_again;
    hob.bytes_per_block = 1;
    DeskLink::new(hob)
}

/// Heats over the link until that many windows have ended one way or the other; what both ends counted.
fn watch(link: impl Transport + 'static, windows: u32) -> (ClientCounters, Status) {
    let mut client = Client::connect(Box::new(link)).unwrap();
    client.set_power(1_000).unwrap();
    client.stream(1, 2).unwrap();
    let (mut seqs, mut ended, mut last_kept) = (Vec::new(), 0, Duration::ZERO);
    while ended < windows {
        let event = client.next_event(Duration::from_secs(2)).unwrap();
        match event.expect("the hob must not fall silent") {
            DeviceEvent::Window(window) => {
                seqs.push(window.seq);
                ended += 1;
            }
            DeviceEvent::WindowRejected { .. } => ended += 1,
            _ => {}
        }
        if client.clock() > last_kept + Duration::from_secs(5) {
            client.set_power(1_000).unwrap();
            last_kept = client.clock();
        }
    }
    let once = seqs.windows(2).all(|pair| pair[0] < pair[1]);
    assert!(once, "windows twice, or in another order: {seqs:?}");
    // More windows come while the status is asked for.
    let status = client.status().unwrap();
    (client.counters(), status)
}

/// Share of the windows that the device recorded which arrived whole.
fn whole((counters, status): &(ClientCounters, Status)) -> f64 {
    f64::from(counters.windows.received) / f64::from(status.windows_recorded)
}

const CASES: [(&str, Faults, f64); 6] = [
    ("nothing", faults(0.0, 0.0, 0.0, 0.0), 0.99),
    ("flips of 1e-6 a bit", faults(1e-6, 0.0, 0.0, 0.0), 0.99),
    ("flips of 1e-5 a bit", faults(1e-5, 0.0, 0.0, 0.0), 0.9),
    ("1 % of frames lost", faults(0.0, 0.01, 0.0, 0.0), 0.98),
    ("1 % of frames repeated", faults(0.0, 0.0, 0.01, 0.0), 0.99),
    ("1 % of frames swapped", faults(0.0, 0.0, 0.0, 0.01), 0.98),
];

const fn faults(flips: f64, lost: f64, repeated: f64, swapped: f64) -> Faults {
    Faults {
        flips,
        lost,
        repeated,
        swapped,
    }
}

#[test]
fn a_faulty_link_costs_few_windows() {
    for (what, faults, at_least) in CASES {
        let seen = watch(FaultyLink::new(desk(true), faults, 1), 120);
        assert!(whole(&seen) >= at_least, "{what}: {:?}", seen.0);
    }
}

/// Run with `--no-capture` for the table.
#[test]
fn a_faulty_link_costs_few_windows_at_length() {
    for (what, faults, at_least) in CASES {
        let faulty = |sends_again| FaultyLink::new(desk(sends_again), faults, 1);
        let now = watch(faulty(true), 300);
        let before = watch(faulty(false), 100);
        let (share, pieces) = (whole(&now), now.0.pieces_asked);
        println!(
            "{what}: {:.1} % of {} windows whole, {pieces} pieces asked for again, {} dropped by the \
             device, rejected {:?}; {:.1} % where nothing is sent again",
            100.0 * share,
            now.1.windows_recorded,
            now.1.windows_dropped,
            now.0.windows_rejected,
            100.0 * whole(&before)
        );
        assert!(share >= at_least, "{what}: {share} of {:?}", now.0);
    }
}
