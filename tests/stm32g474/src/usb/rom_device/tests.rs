use std::sync::mpsc;

use ihd_rom_bootloader::chip::{FLASH, PAGE};
use ihd_rom_bootloader::{Chip, Left};

use super::super::client::Board;
use super::super::transfer::{Outcome, Request, Status};
use super::*;

/// Configured bootloader on a cable.
struct Desk {
    rom: Arc<Mutex<Bootloader>>,
    board: Board,
    cable: Cable,
}

impl Desk {
    fn new() -> Self {
        let began = Instant::now();
        let rom = Bootloader::new(Chip::default(), move || began.elapsed());
        let rom = Arc::new(Mutex::new(rom));
        let cable = RomDevice::new(Arc::clone(&rom)).on_a_cable();
        let board = Board::enumerate(&cable, 7).unwrap();
        Self { rom, board, cable }
    }

    fn control(&self, setup: [u8; 8], data: &[u8]) -> Outcome {
        let (sender, receiver) = mpsc::channel();
        let request = Request::Control {
            setup,
            data: data.to_vec(),
        };
        self.cable
            .submit(request, move |outcome| drop(sender.send(outcome)));
        receiver.recv_timeout(Duration::from_secs(10)).unwrap()
    }

    fn send(&self, request: u8, value: u8, data: &[u8]) -> Status {
        let [length, length_high] = (data.len() as u16).to_le_bytes();
        let setup = [0x21, request, value, 0, 0, 0, length, length_high];
        self.control(setup, data).status
    }

    /// State after the operation.
    fn state(&self) -> u8 {
        loop {
            let told = self.control([0xA1, 3, 0, 0, 0, 0, 6, 0], &[]).data;
            if told[4] != 4 {
                return told[4];
            }
            thread::sleep(Duration::from_millis(told[1].into()));
        }
    }
}

#[test]
fn it_is_enumerated_and_a_page_is_written_and_read_back() {
    let desk = Desk::new();
    let description = &desk.board.description;
    assert_eq!(description.device[8..12], [0x83, 0x04, 0x11, 0xDF]);
    assert_eq!(description.strings[1], "DFU in FS Mode");
    assert_eq!(description.strings[2].len(), 12);
    assert_eq!(description.configuration.len(), 45);
    let page: Vec<_> = (0..PAGE).map(|i| (i / 8) as u8).collect();
    let erase = [&[0x41][..], &FLASH.to_le_bytes()].concat();
    for (block, data) in [(0, &erase), (2, &page)] {
        assert_eq!(desk.send(1, block, data), Status::Done);
        assert_eq!(desk.state(), 5);
    }
    assert_eq!(desk.send(6, 0, &[]), Status::Done);
    // 2048 bytes, a multiple of a packet.
    let read = desk.control([0xA1, 2, 2, 0, 0, 0, 0, 8], &[]);
    assert_eq!((read.status, read.data == page), (Status::Done, true));
    assert!(desk.rom.lock().unwrap().chip.flash[..PAGE] == page);
}

#[test]
fn what_it_refuses_stalls_and_it_goes_when_it_leaves() {
    let desk = Desk::new();
    assert_eq!(desk.send(1, 0, &[0x77]), Status::Stalled);
    assert_eq!(desk.state(), 10);
    assert_eq!(desk.send(4, 0, &[]), Status::Done);
    assert_eq!(desk.send(1, 2, &[]), Status::Done);
    desk.control([0xA1, 3, 0, 0, 0, 0, 6, 0], &[]);
    while desk.cable.attached() {
        thread::yield_now();
    }
    let left = desk.rom.lock().unwrap().left();
    assert_eq!(left, Some(Left::Program(FLASH)));
    assert_eq!(desk.send(4, 0, &[]), Status::Gone);
}
