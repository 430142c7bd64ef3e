//! Requests, blocks and status. An operation begins when the host requests the status, and ends when the device reports so. A
//! device in an error state stays there until the host clears it.

use std::time::Duration;

use dfu_core::{DfuIo, State, Status};

/// Types of class requests to the interface: to the device, and from it.
const TO_DEVICE: u8 = 0x21;
const FROM_DEVICE: u8 = 0xA1;

const DNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const GETSTATUS: u8 = 3;
const CLRSTATUS: u8 = 4;
const ABORT: u8 = 6;

/// Commands in block 0 of DNLOAD.
const SET_ADDRESS: u8 = 0x21;
const ERASE: u8 = 0x41;

/// Number of the block at the address that was set.
const FIRST_BLOCK: u16 = 2;

/// Length of the answer to DFU_GETSTATUS.
const STATUS_BYTES: usize = 6;

/// Time limit of an operation of the flash: all 256 pages take less than 6 s one by one.
const FLASH_TIMEOUT: Duration = Duration::from_secs(15);
/// Shortest pause between two requests for the status.
const MIN_POLL_PAUSE: Duration = Duration::from_millis(1);
/// Limit of requests until a device must be idle, in whatever state it was.
const TRIES_TO_IDLE: u32 = 8;

/// Error of a transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TransferFailure {
    /// The device has left the bus.
    Gone(String),
    /// The device answered with STALL.
    Stalled,
    /// Any other error, time-outs included.
    Failed(String),
}

/// Bootloader: the transfers of dfu-core, and what they lack.
pub trait BootloaderIo: DfuIo<Read = usize, Write = usize> {
    /// Selects a memory by the number of its alternate setting.
    ///
    /// # Errors
    /// Any error of a transfer.
    fn select(&self, alternate: u8) -> Result<(), Self::Error>;

    /// Strings of the alternate settings, in order; untrusted.
    fn layouts(&self) -> &[String];

    /// Serial number of the device; untrusted.
    fn serial(&self) -> &str;

    /// Classifies an error of a transfer.
    fn transfer_failure(error: Self::Error) -> TransferFailure;

    /// Waits.
    fn wait(&self, time: Duration);
}

/// Error of an operation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DfuError {
    /// The device has left the bus.
    Gone(String),
    /// The device reports an error.
    Refused(Status),
    /// The device stays busy; with the time waited.
    Stuck(Duration),
    /// A transfer failed, or the answer violates the protocol.
    Strange(String),
}

impl From<TransferFailure> for DfuError {
    fn from(error: TransferFailure) -> Self {
        match error {
            TransferFailure::Gone(why) => Self::Gone(why),
            TransferFailure::Stalled => {
                Self::Strange("the bootloader refused the request".to_owned())
            }
            TransferFailure::Failed(why) => Self::Strange(format!("USB: {why}")),
        }
    }
}

/// Answer to GETSTATUS.
#[derive(Clone, Copy, Debug)]
struct DeviceStatus {
    status: Status,
    poll: Duration,
    state: State,
}

/// Protocol with one bootloader.
pub struct Protocol<IO> {
    io: IO,
}

impl<IO: BootloaderIo> Protocol<IO> {
    pub fn new(io: IO) -> Self {
        Self { io }
    }

    pub fn io(&self) -> &IO {
        &self.io
    }

    /// Size of a block in bytes; `None` if the device's number is not usable.
    pub fn block_bytes(&self) -> Option<usize> {
        let bytes = usize::from(self.io.functional_descriptor().transfer_size).min(2048);
        (bytes >= 64 && bytes.is_multiple_of(8)).then_some(bytes)
    }

    /// Selects a memory, and ends any operation under way.
    pub fn begin(&self, alternate: u8) -> Result<(), DfuError> {
        self.io.select(alternate).map_err(IO::transfer_failure)?;
        self.make_idle()
    }

    /// Sets the address of the next block.
    pub fn set_address(&self, address: u32) -> Result<(), DfuError> {
        self.command(SET_ADDRESS, Some(address))
    }

    /// Erases the page that begins at an address.
    pub fn erase_page(&self, address: u32) -> Result<(), DfuError> {
        self.command(ERASE, Some(address))
    }

    /// Erases all of the flash.
    pub fn erase_all(&self) -> Result<(), DfuError> {
        self.command(ERASE, None)
    }

    /// Writes the block `index` after the address that was set; all blocks have the same length.
    pub fn write_block(&self, index: u16, bytes: &[u8]) -> Result<(), DfuError> {
        self.send(DNLOAD, FIRST_BLOCK + index, bytes)?;
        self.finish()
    }

    /// Reads a block at the same place, and returns the number of bytes. A command must be followed by [`Self::make_idle`] first.
    pub fn read_block(&self, index: u16, out: &mut [u8]) -> Result<usize, DfuError> {
        let block = FIRST_BLOCK + index;
        let read = self.io.read_control(FROM_DEVICE, UPLOAD, block, out);
        read.map_err(|error| self.explain(error))
    }

    /// Runs the program at the address that was set. The device leaves the bus, which is not an error.
    pub fn leave(&self) -> Result<(), DfuError> {
        let gone = |result: Result<(), DfuError>| match result {
            Err(DfuError::Gone(_)) => Ok(()),
            other => other,
        };
        gone(self.send(DNLOAD, FIRST_BLOCK, &[]))?;
        gone(self.status().map(drop))
    }

    /// Returns to the state in which every operation can begin.
    pub fn make_idle(&self) -> Result<(), DfuError> {
        let mut waited = Duration::ZERO;
        let mut tries = 0;
        loop {
            let status = self.status()?;
            match status.state {
                State::DfuIdle => return Ok(()),
                State::DfuDnbusy => self.wait(status.poll, &mut waited)?,
                // It waits for GETSTATUS.
                State::DfuDnloadSync | State::DfuManifestSync => {}
                State::DfuError => self.send(CLRSTATUS, 0, &[])?,
                State::DfuDnloadIdle | State::DfuUploadIdle => self.send(ABORT, 0, &[])?,
                state => {
                    return Err(DfuError::Strange(format!(
                        "the bootloader is in the state {state:?}"
                    )));
                }
            }
            tries += u32::from(status.state != State::DfuDnbusy);
            if tries == TRIES_TO_IDLE {
                let state = status.state;
                return Err(DfuError::Strange(format!(
                    "the bootloader stays in the state {state:?}"
                )));
            }
        }
    }

    fn command(&self, command: u8, address: Option<u32>) -> Result<(), DfuError> {
        let mut bytes = vec![command];
        bytes.extend(address.map(u32::to_le_bytes).into_iter().flatten());
        self.send(DNLOAD, 0, &bytes)?;
        self.finish()
    }

    fn send(&self, request: u8, value: u16, bytes: &[u8]) -> Result<(), DfuError> {
        let sent = self.io.write_control(TO_DEVICE, request, value, bytes);
        sent.map(drop).map_err(|error| self.explain(error))
    }

    /// Polls the status until the operation is over, with the pauses that the device requests.
    fn finish(&self) -> Result<(), DfuError> {
        let mut waited = Duration::ZERO;
        loop {
            let status = self.status()?;
            match status.state {
                State::DfuDnloadIdle => return Ok(()),
                State::DfuDnbusy | State::DfuDnloadSync => self.wait(status.poll, &mut waited)?,
                State::DfuError => {
                    self.clear()?;
                    return Err(DfuError::Refused(status.status));
                }
                state => {
                    return Err(DfuError::Strange(format!(
                        "the bootloader is in the state {state:?}"
                    )));
                }
            }
        }
    }

    fn wait(&self, poll: Duration, waited: &mut Duration) -> Result<(), DfuError> {
        let poll = poll.max(MIN_POLL_PAUSE);
        *waited += poll;
        if *waited > FLASH_TIMEOUT {
            return Err(DfuError::Stuck(*waited));
        }
        self.io.wait(poll);
        Ok(())
    }

    fn status(&self) -> Result<DeviceStatus, DfuError> {
        let mut bytes = [0; STATUS_BYTES];
        let read = self.io.read_control(FROM_DEVICE, GETSTATUS, 0, &mut bytes);
        let length = read.map_err(IO::transfer_failure)?;
        if length < STATUS_BYTES {
            return Err(DfuError::Strange(format!(
                "the bootloader gave {length} bytes of status"
            )));
        }
        let [status, low, middle, high, state, _] = bytes;
        let poll = u32::from_le_bytes([low, middle, high, 0]);
        Ok(DeviceStatus {
            status: status.into(),
            poll: Duration::from_millis(poll.into()),
            state: state.into(),
        })
    }

    /// Clears the device's error, so that it accepts the next request.
    fn clear(&self) -> Result<(), DfuError> {
        let sent = self.io.write_control(TO_DEVICE, CLRSTATUS, 0, &[]);
        Ok(sent.map(drop).map_err(IO::transfer_failure)?)
    }

    /// Finds the reason of an error: after a STALL the device's status has it.
    fn explain(&self, error: IO::Error) -> DfuError {
        let error = IO::transfer_failure(error);
        if error != TransferFailure::Stalled {
            return error.into();
        }
        let status = match self.status() {
            Ok(status) => status,
            Err(trouble) => return trouble,
        };
        match self.clear() {
            Ok(()) if status.state == State::DfuError => DfuError::Refused(status.status),
            Ok(()) => error.into(),
            Err(trouble) => trouble,
        }
    }
}
