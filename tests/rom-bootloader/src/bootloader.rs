//! The bootloader's state machine.

use std::time::Duration;

use crate::chip::{Chip, FLASH, FLASH_BYTES, OPTION_BYTES, OPTIONS, OTP, OTP_BYTES};
use crate::descriptors::{self, TRANSFER};
use crate::fault::Fault;

/// First bytes of the commands of DFU_DNLOAD with block 0, as listed by DFU_UPLOAD of block 0.
const COMMANDS: [u8; 4] = [0x00, SET_ADDRESS, ERASE, READ_UNPROTECT];
const SET_ADDRESS: u8 = 0x21;
const ERASE: u8 = 0x41;
const READ_UNPROTECT: u8 = 0x92;
/// The block that lies at the address pointer.
const FIRST_BLOCK: u16 = 2;

/// Time to erase a page.
const ERASE_TIME: Duration = Duration::from_millis(23);
/// Time to erase all pages.
const ERASE_ALL_TIME: Duration = Duration::from_millis(50);
/// Time to write eight bytes.
const WRITE_TIME: Duration = Duration::from_micros(90);
/// Time to write option bytes.
const OPTIONS_TIME: Duration = Duration::from_millis(30);

/// Longest wait that it requests of a host.
const MAX_POLL: Duration = Duration::from_millis(100);

/// bStatus (DFU 1.1, 6.1.2), those that are used here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Status {
    /// No error.
    Ok = 0,
    /// The address is none.
    ErrTarget = 1,
    /// Data that do not fit their place.
    ErrFile = 2,
    /// Writing is not possible there.
    ErrWrite = 3,
    /// Erasing failed.
    ErrErase = 4,
    /// Writing failed.
    ErrProg = 6,
    /// The address is out of range, or unaligned.
    ErrAddress = 8,
    /// Reading is protected.
    ErrVendor = 11,
    /// A request that the state does not allow.
    ErrStalledPkt = 15,
}

/// bState, without those of a running application.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum State {
    /// Waits for anything.
    Idle = 2,
    /// Has a block, and begins with GETSTATUS.
    DownloadSync = 3,
    /// At work.
    DownloadBusy = 4,
    /// Waits for the next block.
    DownloadIdle = 5,
    /// Has been told to leave, and does with GETSTATUS.
    ManifestSync = 6,
    /// Leaves.
    Manifest = 7,
    /// Waits for the next upload.
    UploadIdle = 9,
    /// Waits for CLRSTATUS.
    Error = 10,
}

/// Reason for a missing answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// STALL.
    Stall,
    /// The device has left the bus.
    Gone,
}

/// Way in which the device left the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Left {
    /// It was told to run the program at this address.
    Program(u32),
    /// Option bytes were loaded, which resets the chip.
    Reset,
    /// Unplugged, or without power.
    Lost,
}

/// Operation that GETSTATUS starts.
#[derive(Clone, Debug)]
enum Operation {
    SetAddress(u32),
    Erase(u32),
    EraseAll,
    Unprotect,
    Write { address: u32, data: Vec<u8> },
}

/// The device.
pub struct Bootloader {
    /// Its memories.
    pub chip: Chip,
    /// Replaces the first alternate setting's description of the flash by that of another chip.
    pub flash_layout: Option<String>,
    /// GETSTATUS before the time that the device had asked for.
    pub early: u32,
    /// Operations on the flash and option bytes.
    pub operations: u32,
    pub(crate) alternate: u8,
    pub(crate) configured: bool,
    state: State,
    status: Status,
    pointer: u32,
    pending: Option<Operation>,
    busy_until: Duration,
    faults: Vec<Fault>,
    left: Option<Left>,
    clock: Box<dyn Fn() -> Duration + Send>,
}

impl Bootloader {
    /// On a chip, with the time since whenever.
    pub fn new(chip: Chip, clock: impl Fn() -> Duration + Send + 'static) -> Self {
        Self {
            chip,
            flash_layout: None,
            early: 0,
            operations: 0,
            alternate: 0,
            configured: false,
            state: State::Idle,
            status: Status::Ok,
            pointer: FLASH,
            pending: None,
            busy_until: Duration::ZERO,
            faults: Vec::new(),
            left: None,
            clock: Box::new(clock),
        }
    }

    /// Its serial number.
    pub fn serial(&self) -> String {
        descriptors::serial(self.chip.unique)
    }

    /// From now on this may happen.
    pub fn expect(&mut self, fault: Fault) {
        self.faults.push(fault);
    }

    /// Returns the way in which it left the bus; `None` if it did not.
    pub fn left(&self) -> Option<Left> {
        self.left
    }

    /// Returns its state, without a request.
    pub fn state(&self) -> State {
        self.state
    }

    /// Reset with BOOT0 high: on the bus again, as from the beginning, but for the memories.
    pub fn restart(&mut self) {
        self.faults.clear();
        self.left = None;
        self.state = State::Idle;
        self.status = Status::Ok;
        self.pointer = FLASH;
        self.pending = None;
        self.alternate = 0;
        self.configured = false;
    }

    /// The bus is reset: the memories' state stays, the configuration does not.
    pub fn bus_reset(&mut self) {
        self.configured = false;
        self.alternate = 0;
    }

    /// A request of the class without data from the device.
    ///
    /// # Errors
    /// STALL, or gone.
    pub fn class_out(&mut self, request: u8, value: u16, data: &[u8]) -> Result<(), Refused> {
        self.request_arrives()?;
        match (request, self.state) {
            // DNLOAD.
            (1, State::Idle | State::DownloadIdle) if data.is_empty() => {
                self.state = State::ManifestSync;
                Ok(())
            }
            (1, State::Idle | State::DownloadIdle) => self.download(value, data),
            // CLRSTATUS.
            (4, State::Error) => {
                self.state = State::Idle;
                self.status = Status::Ok;
                Ok(())
            }
            (4, _) => Ok(()),
            // ABORT.
            (6, State::DownloadBusy | State::Manifest | State::Error) => self.refuse(),
            (6, _) => {
                self.state = State::Idle;
                self.pending = None;
                Ok(())
            }
            _ => self.refuse(),
        }
    }

    /// A request of the class with data from the device.
    ///
    /// # Errors
    /// STALL, or gone.
    pub fn class_in(&mut self, request: u8, value: u16, length: u16) -> Result<Vec<u8>, Refused> {
        self.request_arrives()?;
        match (request, self.state) {
            (2, State::Idle | State::UploadIdle) => self.upload(value, length),
            (3, _) => Ok(self.get_status()),
            (5, _) => Ok(vec![self.state as u8]),
            _ => self.refuse().map(|()| Vec::new()),
        }
    }

    fn request_arrives(&mut self) -> Result<(), Refused> {
        for fault in &mut self.faults {
            if let Fault::Unplugged { after_requests } = fault {
                match after_requests.checked_sub(1) {
                    Some(fewer) => *after_requests = fewer,
                    None => self.left = Some(Left::Lost),
                }
            }
        }
        self.left.map_or(Ok(()), |_| Err(Refused::Gone))
    }

    /// Refuses a request that the state does not allow: a STALL, and an error to be cleared.
    fn refuse(&mut self) -> Result<(), Refused> {
        self.fails(Status::ErrStalledPkt);
        Err(Refused::Stall)
    }

    fn fails(&mut self, status: Status) {
        self.state = State::Error;
        self.status = status;
        self.pending = None;
    }

    fn download(&mut self, block: u16, data: &[u8]) -> Result<(), Refused> {
        let address = |bytes: &[u8]| bytes.try_into().map(u32::from_le_bytes);
        let operation = match (block, data) {
            (0, [SET_ADDRESS, rest @ ..]) => address(rest).ok().map(Operation::SetAddress),
            (0, [ERASE]) => Some(Operation::EraseAll),
            (0, [ERASE, rest @ ..]) => address(rest).ok().map(Operation::Erase),
            (0, [READ_UNPROTECT]) => Some(Operation::Unprotect),
            (FIRST_BLOCK.., _) if data.len() <= TRANSFER.into() => Some(Operation::Write {
                address: self.address_of(block, data.len()),
                data: data.to_vec(),
            }),
            _ => None,
        };
        let Some(operation) = operation else {
            return self.refuse();
        };
        self.pending = Some(operation);
        self.state = State::DownloadSync;
        Ok(())
    }

    /// The block's address counts in lengths of the buffer, not in the largest transfer: a short last block lies elsewhere
    /// than a reader of the specification may think.
    fn address_of(&self, block: u16, length: usize) -> u32 {
        let offset = u32::from(block - FIRST_BLOCK).wrapping_mul(length as u32);
        self.pointer.wrapping_add(offset)
    }

    fn upload(&mut self, block: u16, length: u16) -> Result<Vec<u8>, Refused> {
        if block == 0 {
            return Ok(COMMANDS.to_vec());
        }
        if block < FIRST_BLOCK || length > TRANSFER {
            return self.refuse().map(|()| Vec::new());
        }
        let address = self.address_of(block, length.into());
        match self.chip.read(address, length.into()) {
            Ok(bytes) => {
                let whole = bytes.len() == usize::from(length);
                self.state = if whole {
                    State::UploadIdle
                } else {
                    State::Idle
                };
                Ok(bytes)
            }
            Err(status) => {
                self.fails(status);
                Err(Refused::Stall)
            }
        }
    }

    fn get_status(&mut self) -> Vec<u8> {
        let now = (self.clock)();
        let mut poll = Duration::ZERO;
        match self.state {
            State::DownloadSync => {
                self.state = State::DownloadBusy;
                if let Some(operation) = self.pending.take() {
                    poll = self.perform(operation);
                }
                self.busy_until = now.saturating_add(poll);
            }
            State::DownloadBusy if now < self.busy_until => {
                self.early += u32::from(self.busy_until != Duration::MAX);
                poll = self.busy_until.saturating_sub(now);
            }
            State::DownloadBusy if self.status == Status::Ok => self.state = State::DownloadIdle,
            State::DownloadBusy => self.state = State::Error,
            State::ManifestSync => {
                self.state = State::Manifest;
                self.left = Some(Left::Program(self.pointer));
            }
            _ => {}
        }
        // An operation's error is told when it is over.
        let told = if self.state == State::DownloadBusy {
            Status::Ok
        } else {
            self.status
        };
        let poll = (poll.min(MAX_POLL).as_micros().div_ceil(1000) as u32).to_le_bytes();
        vec![told as u8, poll[0], poll[1], poll[2], self.state as u8, 0]
    }

    /// Does it at once, and says how long it takes.
    fn perform(&mut self, operation: Operation) -> Duration {
        if let Operation::SetAddress(address) = operation {
            if self.memory_at(address) {
                self.pointer = address;
            } else {
                self.status = Status::ErrTarget;
            }
            return Duration::ZERO;
        }
        self.operations += 1;
        let mut whole = true;
        for fault in &mut self.faults {
            let (Fault::PowerLost { after_operations }
            | Fault::StuckBusy { after_operations }
            | Fault::Fails { after_operations }) = fault
            else {
                continue;
            };
            if let Some(fewer) = after_operations.checked_sub(1) {
                *after_operations = fewer;
                continue;
            }
            match fault {
                Fault::StuckBusy { .. } => return Duration::MAX,
                Fault::Fails { .. } => {
                    self.status = Status::ErrErase;
                    return ERASE_TIME;
                }
                _ => whole = false,
            }
        }
        let (result, takes) = self.operate(operation, whole);
        if let Err(status) = result {
            self.status = status;
        }
        if !whole {
            self.left = Some(Left::Lost);
        }
        takes
    }

    fn operate(&mut self, operation: Operation, whole: bool) -> (Result<(), Status>, Duration) {
        match operation {
            Operation::SetAddress(_) => (Ok(()), Duration::ZERO),
            Operation::Erase(address) => (self.chip.erase(address, whole), ERASE_TIME),
            Operation::EraseAll => (self.chip.erase_all(), ERASE_ALL_TIME),
            Operation::Unprotect => {
                self.chip.unprotect();
                self.left = Some(Left::Reset);
                (Ok(()), ERASE_ALL_TIME)
            }
            Operation::Write { address, data } if OPTIONS.contains(&address) => {
                let written = self.chip.set_options(address, &data);
                if written.is_ok() {
                    self.left = Some(Left::Reset);
                }
                (written, OPTIONS_TIME)
            }
            Operation::Write { address, data } => {
                let takes = WRITE_TIME * data.len().div_ceil(8) as u32;
                (self.write(address, data, whole), takes)
            }
        }
    }

    fn write(&mut self, address: u32, mut data: Vec<u8>, whole: bool) -> Result<(), Status> {
        for fault in &self.faults {
            match *fault {
                Fault::SilentlyDropped => return Ok(()),
                Fault::BadBits { address: bad, mask } => {
                    let place = bad.checked_sub(address).map(|place| place as usize);
                    if let Some(byte) = place.and_then(|place| data.get_mut(place)) {
                        *byte ^= mask;
                    }
                }
                _ => {}
            }
        }
        self.chip.program(address, &data, whole)
    }

    /// Returns `true` if the alternate setting has memory there.
    fn memory_at(&self, address: u32) -> bool {
        let within = |start: u32, length: usize| (start..start + length as u32).contains(&address);
        match self.alternate {
            0 => within(FLASH, FLASH_BYTES),
            1 => OPTIONS.iter().any(|start| within(*start, OPTION_BYTES)),
            _ => within(OTP, OTP_BYTES),
        }
    }
}
