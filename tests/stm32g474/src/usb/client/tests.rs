use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use super::super::stand_in::{Echo, StandIn};
use super::*;
use ihd_link::{LinkError, Transport};

/// Machine with only the stand-in, on a thread of its own; it ends when this is dropped.
pub struct Machine {
    pub cable: Cable,
    stop: Arc<AtomicBool>,
}

impl Machine {
    pub fn start() -> Self {
        let (cable, mut controller) = Cable::new();
        let stop = Arc::<AtomicBool>::default();
        let stopped = Arc::clone(&stop);
        thread::spawn(move || {
            let mut device = StandIn::new("0123456789AB", Echo::default());
            let mut now_us = 0.0;
            while !stopped.load(Ordering::Relaxed) {
                now_us += 5.0;
                controller.poll(&mut device, now_us);
            }
        });
        Self { cable, stop }
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

#[test]
fn a_board_is_enumerated_and_carries_bytes() {
    let machine = Machine::start();
    let board = Board::enumerate(&machine.cable, 5).unwrap();
    let description = &board.description;
    assert_eq!(description.strings[2], "0123456789AB");
    assert_eq!(description.configuration.len(), 32);
    assert_eq!(description.bos.len(), 33);
    assert_eq!(description.microsoft[10..20], *b"\x14\0\x03\0WINUSB");
    assert!(!description.qualifier);
    let mut link = board.link();
    link.send(&[7; 100]).unwrap();
    let mut buf = [0; 256];
    let mut came = 0;
    while came < 100 {
        came += link.receive(&mut buf, Duration::from_millis(20)).unwrap();
    }
    assert_eq!(
        link.receive(&mut buf, Duration::from_millis(20)).unwrap(),
        0
    );
}

#[test]
fn a_link_that_is_dropped_leaves_what_comes_to_the_next() {
    let machine = Machine::start();
    let board = Board::enumerate(&machine.cable, 5).unwrap();
    drop(board.link());
    let mut link = board.link();
    link.send(b"for the second").unwrap();
    let mut buf = [0; 64];
    let length = link.receive(&mut buf, Duration::from_secs(1)).unwrap();
    assert_eq!(buf[..length], *b"for the second");
}

#[test]
fn a_pulled_cable_and_a_machine_that_ends_close_the_link() {
    let machine = Machine::start();
    let mut link = Board::enumerate(&machine.cable, 5).unwrap().link();
    machine.cable.unplug();
    let mut buf = [0; 64];
    let closed = link.receive(&mut buf, Duration::from_secs(1));
    assert!(
        matches!(closed, Err(LinkError::Closed { .. })),
        "{closed:?}"
    );
    let mut link = Board::enumerate(&machine.cable, 6).unwrap().link();
    drop(machine);
    let closed = link.receive(&mut buf, Duration::from_secs(1_000_000));
    assert!(
        matches!(closed, Err(LinkError::Closed { .. })),
        "{closed:?}"
    );
}
