//! Device without a chip that responds as the board does, for tests of the other end of the cable.

use super::bus::{Answer, Device, Handshake, Toggle};
use super::transfer::PACKET;

mod answers;

/// Use of the bytes on a device's bulk endpoints.
pub trait Function: Send {
    /// Takes bytes from the host; returns `false` if there is no room.
    fn take(&mut self, bytes: &[u8]) -> bool;

    /// Next packet for the host, if there is one; a short one ends a transfer.
    fn give(&mut self) -> Option<Vec<u8>>;

    /// Handles the end of a millisecond.
    fn millisecond(&mut self) {}
}

/// Function that returns all bytes that it takes.
#[derive(Default)]
pub struct Echo(std::collections::VecDeque<Vec<u8>>);

impl Function for Echo {
    fn take(&mut self, bytes: &[u8]) -> bool {
        self.0.extend(bytes.chunks(PACKET - 1).map(<[u8]>::to_vec));
        true
    }

    fn give(&mut self) -> Option<Vec<u8>> {
        self.0.pop_front()
    }
}

/// Stand-in for the board.
pub struct StandIn {
    serial: String,
    function: Box<dyn Function>,
    present: bool,
    address: u8,
    /// Address by SET_ADDRESS, until its status stage.
    new_address: Option<u8>,
    configured: bool,
    /// Bytes still to be sent by endpoint 0; `None` if it stalls.
    control: Option<Vec<u8>>,
    /// Toggles of endpoint 0's data, of bulk in and of bulk out.
    toggles: [Toggle; 3],
}

impl StandIn {
    /// Plugged-in device with a serial number.
    pub fn new(serial: &str, function: impl Function + 'static) -> Self {
        Self {
            serial: serial.to_owned(),
            function: Box::new(function),
            present: true,
            address: 0,
            new_address: None,
            configured: false,
            control: None,
            toggles: [Toggle::Data0; 3],
        }
    }

    /// Switches the pull-up on or off.
    pub fn set_present(&mut self, present: bool) {
        self.present = present;
    }

    fn request(&mut self, packet: [u8; 8]) -> Option<Vec<u8>> {
        let [kind, request, value, index, ..] = packet;
        match (kind, request) {
            (0x00, 5) => self.new_address = Some(value),
            (0x00, 9) => {
                self.configured = value == 1;
                self.toggles = [Toggle::Data0; 3];
            }
            (0x00, 1 | 3) => {}
            (0x02, 1) => self.toggles[if index & 0x80 == 0 { 2 } else { 1 }] = Toggle::Data0,
            (0x01, 11) if value == 0 => {}
            (0x80..=0x82, 0) => return Some(vec![0, 0]),
            (0x80, 8) => return Some(vec![u8::from(self.configured)]),
            (0x81, 10) => return Some(vec![0]),
            _ => return answers::descriptor(packet, &self.serial),
        }
        Some(Vec::new())
    }
}

impl Device for StandIn {
    fn attached(&self) -> bool {
        self.present
    }

    fn bus_reset(&mut self) {
        self.address = 0;
        self.configured = false;
        self.toggles = [Toggle::Data0; 3];
    }

    fn start_of_frame(&mut self, _number: u16) {
        self.function.millisecond();
    }

    fn missing_frame(&mut self) {
        self.function.millisecond();
    }

    fn setup(&mut self, address: u8, endpoint: u8, packet: [u8; 8]) -> Handshake {
        if address != self.address || endpoint != 0 {
            return Handshake::Nothing;
        }
        let length = usize::from(u16::from_le_bytes([packet[6], packet[7]]));
        self.control = self.request(packet);
        if let Some(answer) = &mut self.control {
            answer.truncate(length);
        }
        self.toggles[0] = Toggle::Data1;
        Handshake::Ack
    }

    fn out(&mut self, address: u8, endpoint: u8, toggle: Toggle, data: &[u8]) -> Handshake {
        match endpoint {
            _ if address != self.address => Handshake::Nothing,
            0 if self.control.is_some() => Handshake::Ack,
            0 => Handshake::Stall,
            1 if !self.configured => Handshake::Nothing,
            // Repeated packet.
            1 if toggle != self.toggles[2] => Handshake::Ack,
            1 if self.function.take(data) => {
                self.toggles[2] = toggle.next();
                Handshake::Ack
            }
            1 => Handshake::Nak,
            _ => Handshake::Nothing,
        }
    }

    fn input(&mut self, address: u8, endpoint: u8) -> Answer {
        if address != self.address {
            return Answer::Nothing;
        }
        let (place, packet) = match endpoint {
            0 => {
                let Some(answer) = &mut self.control else {
                    return Answer::Stall;
                };
                let packet = answer.drain(..answer.len().min(PACKET)).collect();
                self.address = self.new_address.take().unwrap_or(self.address);
                (0, Some(packet))
            }
            1 if self.configured => (1, self.function.give()),
            _ => return Answer::Nothing,
        };
        let Some(packet) = packet else {
            return Answer::Nak;
        };
        let toggle = self.toggles[place];
        self.toggles[place] = toggle.next();
        Answer::Data(toggle, packet)
    }
}
