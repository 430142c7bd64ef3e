//! The model behind dfu-core's trait, on a clock that goes on where somebody waits.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use dfu_core::functional_descriptor::FunctionalDescriptor;
use dfu_core::memory_layout::MemoryLayout;
use dfu_core::{DfuIo, DfuProtocol};
use ihd_flash::dfu::{BootloaderIo, Dfu, TransferFailure};
use ihd_rom_bootloader::{Bootloader, Chip, Refused};

/// Time never stands still where something is flashed.
pub const GIVEN_TIME: Duration = Duration::from_millis(1);

/// A bootloader that is plugged in, and what the desk knows of it.
#[derive(Clone)]
pub struct Desk {
    rom: Arc<Mutex<Bootloader>>,
    state: Arc<Mutex<State>>,
}

#[derive(Default)]
struct State {
    now: Duration,
    requests: u32,
    comes_back: bool,
}

/// Result of a transfer.
#[derive(Debug)]
pub enum Error {
    Refused(Refused),
    Core(dfu_core::Error),
}

impl From<dfu_core::Error> for Error {
    fn from(error: dfu_core::Error) -> Self {
        Self::Core(error)
    }
}

impl Default for Desk {
    fn default() -> Self {
        let state = Arc::<Mutex<State>>::default();
        let clock = Arc::clone(&state);
        let rom = Bootloader::new(Chip::default(), move || clock.lock().unwrap().now);
        Self {
            rom: Arc::new(Mutex::new(rom)),
            state,
        }
    }
}

impl Desk {
    /// Does something to the model.
    pub fn with<T>(&self, does: impl FnOnce(&mut Bootloader) -> T) -> T {
        does(&mut self.rom.lock().unwrap())
    }

    /// `true` if a chip that restarts is in its bootloader again: BOOT0 is held high.
    pub fn comes_back(&self, comes_back: bool) {
        self.state.lock().unwrap().comes_back = comes_back;
    }

    /// Requests of the class so far.
    pub fn requests(&self) -> u32 {
        self.state.lock().unwrap().requests
    }

    /// Time of the clock.
    pub fn now(&self) -> Duration {
        self.state.lock().unwrap().now
    }

    /// Opens it.
    pub fn programmer(&self) -> Dfu<Wire> {
        let desk = self.clone();
        let reopen = move |_| {
            let comes_back = desk.state.lock().unwrap().comes_back;
            Ok(comes_back.then(|| {
                desk.with(Bootloader::restart);
                desk.wire()
            }))
        };
        Dfu::new(self.wire(), Box::new(reopen))
    }

    fn wire(&self) -> Wire {
        let text = |index| {
            let answer = self.with(|rom| rom.control([0x80, 6, index, 3, 9, 4, 255, 0], &[]));
            let units: Vec<_> = answer.unwrap()[2..]
                .chunks(2)
                .map(|unit| u16::from_le_bytes([unit[0], unit[1]]))
                .collect();
            String::from_utf16(&units).unwrap()
        };
        let configuration = self.with(|rom| rom.control([0x80, 6, 0, 2, 0, 0, 255, 0], &[]));
        let configuration = configuration.unwrap();
        let functional = configuration.len() - 9;
        let descriptor = FunctionalDescriptor::from_bytes(&configuration[functional..]);
        Wire {
            desk: self.clone(),
            descriptor: descriptor.unwrap().unwrap(),
            protocol: DfuProtocol::Dfu,
            layouts: (4..7).map(text).collect(),
            serial: text(3),
        }
    }

    fn control(&self, setup: [u8; 8], data: &[u8]) -> Result<Vec<u8>, Error> {
        self.state.lock().unwrap().requests += u32::from(setup[0] & 0x60 == 0x20);
        self.with(|rom| rom.control(setup, data))
            .map_err(Error::Refused)
    }
}

/// The cable.
pub struct Wire {
    desk: Desk,
    descriptor: FunctionalDescriptor,
    protocol: DfuProtocol<MemoryLayout>,
    layouts: Vec<String>,
    serial: String,
}

fn setup(kind: u8, request: u8, value: u16, length: usize) -> [u8; 8] {
    let [value, value_high] = value.to_le_bytes();
    let [length, length_high] = (length as u16).to_le_bytes();
    [kind, request, value, value_high, 0, 0, length, length_high]
}

impl DfuIo for Wire {
    type Read = usize;
    type Write = usize;
    type Reset = ();
    type Error = Error;
    type MemoryLayout = MemoryLayout;

    fn read_control(
        &self,
        request_type: u8,
        request: u8,
        value: u16,
        buffer: &mut [u8],
    ) -> Result<usize, Error> {
        let setup = setup(request_type, request, value, buffer.len());
        let answer = self.desk.control(setup, &[])?;
        buffer[..answer.len()].copy_from_slice(&answer);
        Ok(answer.len())
    }

    fn write_control(
        &self,
        request_type: u8,
        request: u8,
        value: u16,
        buffer: &[u8],
    ) -> Result<usize, Error> {
        let setup = setup(request_type, request, value, buffer.len());
        self.desk.control(setup, buffer)?;
        Ok(buffer.len())
    }

    fn usb_reset(self) -> Result<(), Error> {
        Ok(())
    }

    fn protocol(&self) -> &DfuProtocol<MemoryLayout> {
        &self.protocol
    }

    fn functional_descriptor(&self) -> &FunctionalDescriptor {
        &self.descriptor
    }
}

impl BootloaderIo for Wire {
    fn select(&self, alternate: u8) -> Result<(), Error> {
        let setup = [1, 11, alternate, 0, 0, 0, 0, 0];
        self.desk.control(setup, &[]).map(drop)
    }

    fn layouts(&self) -> &[String] {
        &self.layouts
    }

    fn serial(&self) -> &str {
        &self.serial
    }

    fn transfer_failure(error: Error) -> TransferFailure {
        match error {
            Error::Refused(Refused::Gone) => TransferFailure::Gone("no device".to_owned()),
            Error::Refused(Refused::Stall) => TransferFailure::Stalled,
            Error::Core(error) => TransferFailure::Failed(error.to_string()),
        }
    }

    fn wait(&self, time: Duration) {
        self.desk.state.lock().unwrap().now += time;
    }
}
