use std::io::Read;

use super::super::client::tests::Machine;
use super::*;

/// Client in place of the kernel.
struct Kernel(TcpStream);

impl Kernel {
    fn connect(server: &Server) -> Self {
        let stream = TcpStream::connect(server.address()).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        Self(stream)
    }

    fn read(&mut self, length: usize) -> Vec<u8> {
        let mut bytes = vec![0; length];
        self.0.read_exact(&mut bytes).unwrap();
        bytes
    }

    fn import(server: &Server, bus_id: &str) -> Option<Self> {
        let mut kernel = Self::connect(server);
        let mut bytes = vec![1, 0x11, 0x80, 3, 0, 0, 0, 0];
        bytes.extend(bus_id.as_bytes());
        bytes.resize(40, 0);
        kernel.0.write_all(&bytes).unwrap();
        let reply = kernel.read(8);
        (reply == [1, 0x11, 0, 3, 0, 0, 0, 0]).then(|| {
            let device = kernel.read(312);
            assert_eq!(device[296..304], [0, 0, 0, 2, 0x12, 0x09, 0x00, 0x01]);
            kernel
        })
    }

    fn send(&mut self, words: [u32; 10], setup: [u8; 8], data: &[u8]) {
        let mut bytes: Vec<u8> = words.into_iter().flat_map(u32::to_be_bytes).collect();
        bytes.extend(setup);
        bytes.extend(data);
        self.0.write_all(&bytes).unwrap();
    }

    fn control(&mut self, sequence: u32, setup: [u8; 8]) {
        let length = u32::from(setup[6]);
        self.send(
            [1, sequence, 0x1_0001, 1, 0, 0, length, 0, 0, 0],
            setup,
            &[],
        );
    }

    fn input(&mut self, sequence: u32) {
        self.send([1, sequence, 0x1_0001, 1, 1, 0, 64, 0, 0, 0], [0; 8], &[]);
    }

    fn unlink(&mut self, sequence: u32, transfer: u32) {
        self.send(
            [2, sequence, 0x1_0001, 0, 0, transfer, 0, 0, 0, 0],
            [0; 8],
            &[],
        );
    }

    /// Command, sequence number, status and data of the next response.
    fn answer(&mut self, has_data: bool) -> (u32, u32, i32, Vec<u8>) {
        let header = self.read(48);
        let word = |i: usize| u32::from_be_bytes(header[4 * i..4 * i + 4].try_into().unwrap());
        let data = if has_data {
            self.read(word(6) as usize)
        } else {
            Vec::new()
        };
        (word(0), word(1), word(5) as i32, data)
    }
}

#[test]
fn a_board_is_imported_once_at_a_time_and_answers_transfers() {
    let machine = Machine::start();
    let server = Server::start([machine.cable.clone()]).unwrap();
    assert!(Kernel::import(&server, "1-2").is_none());
    let mut kernel = Kernel::import(&server, "1-1").unwrap();
    assert!(Kernel::import(&server, "1-1").is_none());
    kernel.control(7, DEVICE);
    let (command, sequence, status, data) = kernel.answer(true);
    assert_eq!((command, sequence, status, data.len()), (3, 7, 0, 18));
    // Device qualifier, which a full-speed device does not have.
    kernel.control(8, [0x80, 6, 0, 6, 0, 0, 10, 0]);
    assert_eq!(kernel.answer(true), (3, 8, PIPE, Vec::new()));
}

#[test]
fn every_unlink_is_answered() {
    let machine = Machine::start();
    let server = Server::start([machine.cable.clone()]).unwrap();
    let mut kernel = Kernel::import(&server, "1-1").unwrap();
    kernel.control(1, [0, 9, 1, 0, 0, 0, 0, 0]);
    assert_eq!(kernel.answer(false).2, 0);
    kernel.input(2);
    kernel.unlink(3, 2);
    assert_eq!(kernel.answer(false), (4, 3, CONNECTION_RESET, Vec::new()));
    kernel.unlink(4, 1);
    assert_eq!(kernel.answer(false), (4, 4, 0, Vec::new()));
    kernel.send([1, 5, 0x1_0001, 0, 1, 0, 3, 0, 0, 0], [0; 8], b"abc");
    assert_eq!(kernel.answer(false), (3, 5, 0, Vec::new()));
    kernel.input(6);
    assert_eq!(kernel.answer(true), (3, 6, 0, b"abc".to_vec()));
}

#[test]
fn a_pulled_cable_ends_the_connection_and_the_board_can_be_imported_again() {
    let machine = Machine::start();
    let server = Server::start([machine.cable.clone()]).unwrap();
    let mut kernel = Kernel::import(&server, "1-1").unwrap();
    machine.cable.unplug();
    assert_eq!(kernel.0.read(&mut [0; 64]).unwrap(), 0);
    // The server detects the end of the connection a moment later.
    let again = (0..100).find_map(|_| {
        thread::sleep(Duration::from_millis(10));
        Kernel::import(&server, "1-1")
    });
    assert!(again.is_some());
}

#[test]
fn the_list_names_the_boards_that_are_free() {
    let machine = Machine::start();
    let server = Server::start([machine.cable.clone()]).unwrap();
    let mut kernel = Kernel::connect(&server);
    kernel.0.write_all(&[1, 0x11, 0x80, 5, 0, 0, 0, 0]).unwrap();
    assert_eq!(kernel.read(12)[8..], [0, 0, 0, 1]);
    assert_eq!(kernel.read(316)[256..260], *b"1-1\0");
    // The machine processes the unplugging a moment later.
    while machine.cable.attached() {
        thread::yield_now();
    }
}
