//! Bootloader in the chip's ROM on the bus: packets for the model of `ihd-rom-bootloader`, which handles whole control
//! transfers.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use ihd_rom_bootloader::Bootloader;

use super::bus::{Answer, Device, Handshake, Toggle};
use super::cable::Cable;
use super::host::HostController;
use super::transfer::PACKET;

#[cfg(test)]
mod tests;

/// First two bytes of SET_ADDRESS.
const SET_ADDRESS: [u8; 2] = [0x00, 5];
/// Polling period of the bus: a frame has a millisecond.
const TURN: Duration = Duration::from_micros(200);

/// Control transfer in progress.
struct Control {
    setup: [u8; 8],
    /// Bytes received from the host.
    received: Vec<u8>,
    /// Bytes still to be sent to the host; `None` if the request was refused or not yet carried out.
    answer: Option<Vec<u8>>,
}

/// USB device of the bootloader.
pub struct RomDevice {
    rom: Arc<Mutex<Bootloader>>,
    address: u8,
    control: Option<Control>,
    toggle: Toggle,
}

impl RomDevice {
    /// Device of a model, to which the test keeps access.
    pub fn new(rom: Arc<Mutex<Bootloader>>) -> Self {
        Self {
            rom,
            address: 0,
            control: None,
            toggle: Toggle::Data0,
        }
    }

    /// Connects the device to a cable, on a thread of its own in real time, for the life of the process.
    pub fn on_a_cable(self) -> Cable {
        let (cable, controller) = Cable::new();
        thread::spawn(move || run(self, controller));
        cable
    }

    fn rom(&self) -> MutexGuard<'_, Bootloader> {
        self.rom.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Carries out the request in the model: at the beginning if data come from it, else at the end.
    fn perform(&mut self) {
        let Some(control) = self.control.take() else {
            return;
        };
        let Control {
            setup, received, ..
        } = &control;
        let answer = if setup[..2] == SET_ADDRESS {
            Ok(Vec::new())
        } else {
            self.rom().control(*setup, received)
        };
        // A device that has left does not respond: `attached` shows that.
        let answer = answer.ok();
        self.control = Some(Control { answer, ..control });
    }
}

fn run(mut device: RomDevice, mut controller: HostController) {
    let began = Instant::now();
    loop {
        controller.poll(&mut device, began.elapsed().as_secs_f64() * 1e6);
        thread::sleep(TURN);
    }
}

impl Device for RomDevice {
    fn attached(&self) -> bool {
        self.rom().left().is_none()
    }

    fn bus_reset(&mut self) {
        self.address = 0;
        self.control = None;
        self.rom().bus_reset();
    }

    fn start_of_frame(&mut self, _number: u16) {}

    fn missing_frame(&mut self) {}

    fn setup(&mut self, address: u8, endpoint: u8, packet: [u8; 8]) -> Handshake {
        if address != self.address || endpoint != 0 || !self.attached() {
            return Handshake::Nothing;
        }
        self.control = Some(Control {
            setup: packet,
            received: Vec::new(),
            answer: None,
        });
        self.toggle = Toggle::Data1;
        if packet[0] & 0x80 != 0 {
            self.perform();
        }
        Handshake::Ack
    }

    fn out(&mut self, address: u8, endpoint: u8, toggle: Toggle, data: &[u8]) -> Handshake {
        if address != self.address || endpoint != 0 {
            return Handshake::Nothing;
        }
        let Some(control) = &mut self.control else {
            return Handshake::Stall;
        };
        let to_host = control.setup[0] & 0x80 != 0;
        if to_host {
            // Status stage of a transfer to the host.
            return match control.answer {
                Some(_) => Handshake::Ack,
                None => Handshake::Stall,
            };
        }
        // A repeated packet is acknowledged and dropped.
        if toggle == self.toggle {
            control.received.extend(data);
            self.toggle = toggle.next();
        }
        Handshake::Ack
    }

    fn input(&mut self, address: u8, endpoint: u8) -> Answer {
        if address != self.address || endpoint != 0 {
            return Answer::Nothing;
        }
        let Some(setup) = self.control.as_ref().map(|control| control.setup) else {
            return Answer::Stall;
        };
        let to_host = setup[0] & 0x80 != 0;
        if !to_host {
            // Status stage: all data have been received.
            self.perform();
            self.toggle = Toggle::Data1;
        }
        let answer = self.control.as_mut().and_then(|c| c.answer.as_mut());
        let Some(answer) = answer else {
            return Answer::Stall;
        };
        let packet = answer.drain(..answer.len().min(PACKET)).collect();
        if setup[..2] == SET_ADDRESS {
            self.address = setup[2];
        }
        let toggle = self.toggle;
        self.toggle = toggle.next();
        Answer::Data(toggle, packet)
    }
}
