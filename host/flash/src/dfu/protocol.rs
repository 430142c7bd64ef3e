//! Requests, blocks and status. Every operation begins when the host asks for the status, and is over when the device
//! says so; a device that reports an error keeps it until it is cleared.

use std::time::Duration;

use dfu_core::{DfuIo, State, Status};

/// Class requests to the interface: to the device, and from it.
const TO_DEVICE: u8 = 0x21;
const FROM_DEVICE: u8 = 0xA1;

const DNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const GETSTATUS: u8 = 3;
const CLRSTATUS: u8 = 4;
const ABORT: u8 = 6;

/// Of DNLOAD's block 0.
const SET_ADDRESS: u8 = 0x21;
const ERASE: u8 = 0x41;

/// The block that lies at the address that was set.
const FIRST_BLOCK: u16 = 2;

/// What DFU_GETSTATUS answers with.
const STATUS_BYTES: usize = 6;

/// An operation of the flash that is not over by then never will be: all 256 pages take less than 6 s one by one.
const LONGEST: Duration = Duration::from_secs(15);
/// Between two questions to a device that says that it needs no time.
const SHORTEST: Duration = Duration::from_millis(1);
/// Requests until a device must be idle, whatever it did before.
const TRIES_TO_IDLE: u32 = 8;

/// How a transfer failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The device has left the bus.
    Gone(String),
    /// It answered with STALL.
    Stalled,
    /// Something else, with a time-out among it.
    Failed(String),
}

/// A bootloader: dfu-core's transfers, and what else it takes.
pub trait Rom: DfuIo<Read = usize, Write = usize> {
    /// Chooses a memory by the number of its alternate setting.
    ///
    /// # Errors
    /// As every transfer.
    fn select(&self, alternate: u8) -> Result<(), Self::Error>;

    /// The alternate settings' strings, in order; the device's own words.
    fn layouts(&self) -> &[String];

    /// The device's serial number, its own words.
    fn serial(&self) -> &str;

    /// What went wrong.
    fn refusal(error: Self::Error) -> Refusal;

    /// Lets time pass.
    fn wait(&self, time: Duration);
}

/// Why an operation did not succeed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// The device has left the bus.
    Gone(String),
    /// It says why not.
    Refused(Status),
    /// It is busy for ever.
    Stuck(Duration),
    /// A transfer failed, or what came is none of the protocol.
    Strange(String),
}

impl From<Refusal> for Trouble {
    fn from(refusal: Refusal) -> Self {
        match refusal {
            Refusal::Gone(why) => Self::Gone(why),
            Refusal::Stalled => Self::Strange("it refused the request".to_owned()),
            Refusal::Failed(why) => Self::Strange(why),
        }
    }
}

/// The device's answer to GETSTATUS.
#[derive(Clone, Copy, Debug)]
struct Told {
    status: Status,
    poll: Duration,
    state: State,
}

/// A bootloader that is spoken to.
pub struct Protocol<IO> {
    io: IO,
}

impl<IO: Rom> Protocol<IO> {
    pub fn new(io: IO) -> Self {
        Self { io }
    }

    pub fn io(&self) -> &IO {
        &self.io
    }

    /// Bytes of a block; none where the device does not name a number that can be used.
    pub fn block_bytes(&self) -> Option<usize> {
        let bytes = usize::from(self.io.functional_descriptor().transfer_size).min(2048);
        (bytes >= 64 && bytes.is_multiple_of(8)).then_some(bytes)
    }

    /// Chooses a memory, and ends whatever the device was at.
    pub fn begin(&self, alternate: u8) -> Result<(), Trouble> {
        self.io.select(alternate).map_err(IO::refusal)?;
        self.make_idle()
    }

    /// Where the next block lies.
    pub fn set_address(&self, address: u32) -> Result<(), Trouble> {
        self.command(SET_ADDRESS, Some(address))
    }

    /// Erases the page that begins at an address.
    pub fn erase_page(&self, address: u32) -> Result<(), Trouble> {
        self.command(ERASE, Some(address))
    }

    /// Erases all of the flash.
    pub fn erase_all(&self) -> Result<(), Trouble> {
        self.command(ERASE, None)
    }

    /// Writes a block that lies `index` blocks of the same length behind the address that was set.
    pub fn write_block(&self, index: u16, bytes: &[u8]) -> Result<(), Trouble> {
        self.send(DNLOAD, FIRST_BLOCK + index, bytes)?;
        self.finish()
    }

    /// Reads a block likewise, and gives how many bytes there were; not directly after a command, but after
    /// [`Self::make_idle`].
    pub fn read_block(&self, index: u16, out: &mut [u8]) -> Result<usize, Trouble> {
        let block = FIRST_BLOCK + index;
        let read = self.io.read_control(FROM_DEVICE, UPLOAD, block, out);
        read.map_err(|error| self.explain(error))
    }

    /// Runs the program at the address that was set. The device leaves the bus, which is no error.
    pub fn leave(&self) -> Result<(), Trouble> {
        let gone = |result: Result<(), Trouble>| match result {
            Err(Trouble::Gone(_)) => Ok(()),
            other => other,
        };
        gone(self.send(DNLOAD, FIRST_BLOCK, &[]))?;
        gone(self.status().map(drop))
    }

    /// Back to the state from which everything can begin.
    pub fn make_idle(&self) -> Result<(), Trouble> {
        let mut waited = Duration::ZERO;
        let mut tries = 0;
        loop {
            let told = self.status()?;
            match told.state {
                State::DfuIdle => return Ok(()),
                State::DfuDnbusy => self.wait(told.poll, &mut waited)?,
                // GETSTATUS is what it waits for.
                State::DfuDnloadSync | State::DfuManifestSync => {}
                State::DfuError => self.send(CLRSTATUS, 0, &[])?,
                State::DfuDnloadIdle | State::DfuUploadIdle => self.send(ABORT, 0, &[])?,
                state => return Err(Trouble::Strange(format!("it is in the state {state:?}"))),
            }
            tries += u32::from(told.state != State::DfuDnbusy);
            if tries == TRIES_TO_IDLE {
                let state = told.state;
                return Err(Trouble::Strange(format!("it stays in the state {state:?}")));
            }
        }
    }

    fn command(&self, command: u8, address: Option<u32>) -> Result<(), Trouble> {
        let mut bytes = vec![command];
        bytes.extend(address.map(u32::to_le_bytes).into_iter().flatten());
        self.send(DNLOAD, 0, &bytes)?;
        self.finish()
    }

    fn send(&self, request: u8, value: u16, bytes: &[u8]) -> Result<(), Trouble> {
        let sent = self.io.write_control(TO_DEVICE, request, value, bytes);
        sent.map(drop).map_err(|error| self.explain(error))
    }

    /// Asks until the operation is over, as seldom as the device wants.
    fn finish(&self) -> Result<(), Trouble> {
        let mut waited = Duration::ZERO;
        loop {
            let told = self.status()?;
            match told.state {
                State::DfuDnloadIdle => return Ok(()),
                State::DfuDnbusy | State::DfuDnloadSync => self.wait(told.poll, &mut waited)?,
                State::DfuError => {
                    self.clear()?;
                    return Err(Trouble::Refused(told.status));
                }
                state => return Err(Trouble::Strange(format!("it is in the state {state:?}"))),
            }
        }
    }

    fn wait(&self, poll: Duration, waited: &mut Duration) -> Result<(), Trouble> {
        let poll = poll.max(SHORTEST);
        *waited += poll;
        if *waited > LONGEST {
            return Err(Trouble::Stuck(*waited));
        }
        self.io.wait(poll);
        Ok(())
    }

    fn status(&self) -> Result<Told, Trouble> {
        let mut bytes = [0; STATUS_BYTES];
        let read = self.io.read_control(FROM_DEVICE, GETSTATUS, 0, &mut bytes);
        let length = read.map_err(IO::refusal)?;
        if length < STATUS_BYTES {
            return Err(Trouble::Strange(format!("{length} bytes of status")));
        }
        let [status, low, middle, high, state, _] = bytes;
        let poll = u32::from_le_bytes([low, middle, high, 0]);
        Ok(Told {
            status: status.into(),
            poll: Duration::from_millis(poll.into()),
            state: state.into(),
        })
    }

    /// Tells the device that its error was heard, so that it takes the next request.
    fn clear(&self) -> Result<(), Trouble> {
        let sent = self.io.write_control(TO_DEVICE, CLRSTATUS, 0, &[]);
        Ok(sent.map(drop).map_err(IO::refusal)?)
    }

    /// What an error means: after a STALL the device says why.
    fn explain(&self, error: IO::Error) -> Trouble {
        let refusal = IO::refusal(error);
        if refusal != Refusal::Stalled {
            return refusal.into();
        }
        let told = match self.status() {
            Ok(told) => told,
            Err(trouble) => return trouble,
        };
        match self.clear() {
            Ok(()) if told.state == State::DfuError => Trouble::Refused(told.status),
            Ok(()) => refusal.into(),
            Err(trouble) => trouble,
        }
    }
}
