use std::sync::mpsc;

use super::super::Usb;
use super::super::cable::Cable;
use super::super::stand_in::{Echo, StandIn};
use super::super::transfer::Outcome;
use super::*;

/// Controller, cable and device; time passes on request.
struct Bench {
    cable: Cable,
    controller: HostController,
    device: StandIn,
    now_us: f64,
}

const GET_DEVICE: [u8; 8] = [0x80, 6, 0, 1, 0, 0, 18, 0];
const SET_ADDRESS: [u8; 8] = [0, 5, 9, 0, 0, 0, 0, 0];
const CONFIGURE: [u8; 8] = [0, 9, 1, 0, 0, 0, 0, 0];

impl Bench {
    fn new() -> Self {
        let (cable, controller) = Cable::new();
        let device = StandIn::new("0123", Echo::default());
        Self {
            cable,
            controller,
            device,
            now_us: 0.0,
        }
    }

    fn pass(&mut self, milliseconds: u32) {
        for _ in 0..milliseconds * 100 {
            self.now_us += 10.0;
            self.controller.poll(&mut self.device, self.now_us);
        }
    }

    fn ask(&self, request: Request) -> Receiver<Outcome> {
        let (sender, receiver) = mpsc::channel();
        self.cable.submit(request, move |outcome| {
            let _ = sender.send(outcome);
        });
        receiver
    }

    fn control(&mut self, setup: [u8; 8]) -> Outcome {
        let outcome = self.ask(Request::Control {
            setup,
            data: Vec::new(),
        });
        self.pass(30);
        outcome.try_recv().expect("30 ms are enough")
    }

    /// Bench with a device that is plugged in, addressed and configured.
    fn configured() -> Self {
        let mut bench = Self::new();
        bench.cable.plug();
        let reset = bench.ask(Request::Reset);
        bench.pass(1);
        assert_eq!(reset.try_recv().unwrap().status, Status::Done);
        assert_eq!(bench.control(SET_ADDRESS).status, Status::Done);
        assert_eq!(bench.control(CONFIGURE).status, Status::Done);
        bench
    }

    fn out(&self, data: Vec<u8>) -> Receiver<Outcome> {
        self.ask(Request::Out {
            endpoint: 1,
            data,
            ends_short: false,
        })
    }

    fn input(&self, length: usize) -> Receiver<Outcome> {
        self.ask(Request::In {
            endpoint: 1,
            length,
        })
    }
}

#[test]
fn a_reset_waits_for_the_device_and_a_transfer_does_not() {
    let mut bench = Bench::new();
    let reset = bench.ask(Request::Reset);
    let early = bench.ask(Request::Control {
        setup: GET_DEVICE,
        data: Vec::new(),
    });
    bench.pass(5);
    assert!(reset.try_recv().is_err());
    assert_eq!(early.try_recv().unwrap().status, Status::Gone);
    bench.cable.plug();
    bench.pass(1);
    assert_eq!(reset.try_recv().unwrap().status, Status::Done);
    let device = bench.control(GET_DEVICE);
    assert_eq!((device.status, device.length), (Status::Done, 18));
    assert_eq!(device.data[..4], [18, 1, 0x10, 2]);
    assert!(bench.cable.attached());
    assert!(bench.cable.now() > Duration::from_millis(30));
}

#[test]
fn a_refused_request_ends_with_stall() {
    let mut bench = Bench::configured();
    assert_eq!(
        bench.control([0x80, 6, 0, 6, 0, 0, 10, 0]).status,
        Status::Stalled
    );
    assert_eq!(bench.control(GET_DEVICE).status, Status::Done);
}

#[test]
fn bulk_bytes_come_back_in_order() {
    let mut bench = Bench::configured();
    let bytes: Vec<u8> = (0..200).collect();
    let sent = bench.out(bytes.clone());
    let waits = bench.input(1000);
    bench.pass(2);
    assert_eq!(sent.try_recv().unwrap().length, 200);
    let mut came = waits.try_recv().unwrap().data;
    for _ in 0..6 {
        let more = bench.input(1000);
        bench.pass(1);
        came.extend(
            more.try_recv()
                .map(|outcome| outcome.data)
                .unwrap_or_default(),
        );
    }
    assert_eq!(came, bytes);
}

#[test]
fn nak_waits_until_it_is_cancelled_or_the_cable_is_pulled() {
    let mut bench = Bench::configured();
    let (sender, first) = mpsc::channel();
    let id = bench.cable.submit(
        Request::In {
            endpoint: 1,
            length: 64,
        },
        move |outcome| {
            let _ = sender.send(outcome.status);
        },
    );
    let second = bench.input(64);
    bench.pass(10);
    assert!(first.try_recv().is_err());
    bench.cable.cancel(id);
    bench.pass(1);
    assert_eq!(first.try_recv(), Ok(Status::Cancelled));
    assert!(second.try_recv().is_err());
    bench.cable.unplug();
    bench.pass(1);
    assert_eq!(second.try_recv().unwrap().status, Status::Gone);
    assert!(!bench.cable.attached());
}

#[test]
fn time_waits_for_a_reader_that_is_behind() {
    let mut bench = Bench::configured();
    bench.cable.be_patient();
    let sent = bench.out(vec![1; 63]);
    let first = bench.input(64);
    let cable = bench.cable.clone();
    let later = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(50));
        let before = cable.now();
        let (sender, receiver) = mpsc::channel();
        cable.submit(
            Request::In {
                endpoint: 1,
                length: 64,
            },
            move |outcome| {
                let _ = sender.send(outcome.status);
            },
        );
        (before, receiver)
    });
    bench.pass(1);
    assert_eq!(sent.try_recv().unwrap().status, Status::Done);
    assert_eq!(first.try_recv().unwrap().length, 63);
    let (before, _second) = later.join().unwrap();
    assert!(bench.cable.now() - before < Duration::from_millis(2));
}

#[test]
fn nineteen_packets_fit_into_a_frame() {
    let mut bench = Bench::configured();
    let (sender, sent) = mpsc::channel();
    let request = Request::Out {
        endpoint: 1,
        data: vec![0; 1_000_000],
        ends_short: false,
    };
    let id = bench
        .cable
        .submit(request, move |outcome| drop(sender.send(outcome)));
    bench.pass(100);
    assert!(sent.try_recv().is_err());
    bench.cable.cancel(id);
    bench.pass(1);
    let packets = sent.try_recv().unwrap().length / 64;
    assert!((1850..=1920).contains(&packets), "{packets}");
}

#[test]
fn a_cable_pulled_and_put_back_at_once_ends_all_the_same() {
    let mut bench = Bench::configured();
    let waits = bench.input(64);
    bench.pass(1);
    bench.cable.unplug();
    bench.cable.plug();
    bench.pass(1);
    assert_eq!(waits.try_recv().unwrap().status, Status::Gone);
    assert_eq!(bench.control(GET_DEVICE).status, Status::Gone);
}

#[test]
fn a_device_that_leaves_by_itself_ends_all_and_comes_back_without_an_address() {
    let mut bench = Bench::configured();
    let waits = bench.input(64);
    bench.pass(1);
    bench.device.set_present(false);
    bench.pass(1);
    assert_eq!(waits.try_recv().unwrap().status, Status::Gone);
    bench.device.set_present(true);
    assert_eq!(bench.control(GET_DEVICE).status, Status::Gone);
    bench.ask(Request::Reset);
    bench.pass(1);
    assert_eq!(bench.control(GET_DEVICE).status, Status::Done);
}

#[test]
fn a_device_that_never_answers_fails_at_the_third_try() {
    let mut bench = Bench::configured();
    bench.ask(Request::Reset);
    // The program of this device never acknowledges the reset.
    let mut usb = Usb::new();
    usb.write(0x40, 0);
    usb.write(0x58, 0x8000);
    let lost = bench.ask(Request::Control {
        setup: GET_DEVICE,
        data: Vec::new(),
    });
    let mut now_us = bench.now_us;
    for _ in 0..30_000 {
        now_us += 10.0;
        bench.controller.poll(&mut usb, now_us);
    }
    assert_eq!(lost.try_recv().unwrap().status, Status::Failed);
}

#[test]
fn whoever_waits_hears_when_the_machine_is_gone() {
    let bench = Bench::new();
    let waits = bench.ask(Request::Reset);
    drop(bench);
    assert!(waits.recv().is_err());
}
