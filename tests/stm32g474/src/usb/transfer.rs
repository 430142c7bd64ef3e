//! Transfers: a driver's requests to the host controller, and their transactions (USB 2.0, 5.5 and 5.8).

use super::bus::{Answer, Device, Handshake, Toggle};

/// Bytes of a packet on endpoint 0 and on the bulk endpoints; the boards have no others.
pub const PACKET: usize = 64;

/// Number of transactions without a response after which the controller gives up.
const STRIKES: u8 = 3;

/// Duration of a byte at 12 Mbit/s, in microseconds.
const BYTE_US: f64 = 8.0 / 12.0;
/// Length of a transaction beside its data, in bytes (USB 2.0, table 5-9).
const OVERHEAD: usize = 13;
/// Length of a transaction with a handshake in place of data, in bytes.
const REFUSED: usize = 8;

/// Request of a driver.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Waits for a device, then resets the bus: the device has address 0.
    Reset,
    /// Control transfer, with the data for the device.
    Control {
        /// bmRequestType, bRequest, wValue, wIndex, wLength.
        setup: [u8; 8],
        /// Data for the device, of length wLength.
        data: Vec<u8>,
    },
    /// Read of at most `length` bytes from a bulk endpoint, ended by a short packet.
    In {
        /// Number of the endpoint, without the direction's bit.
        endpoint: u8,
        /// Maximum number of bytes.
        length: usize,
    },
    /// Write to a bulk endpoint.
    Out {
        /// Number of the endpoint.
        endpoint: u8,
        /// Bytes for the endpoint.
        data: Vec<u8>,
        /// Set if an empty packet marks the end after a full packet.
        ends_short: bool,
    },
}

/// Status at the end of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Completed as requested.
    Done,
    /// Refused by the device.
    Stalled,
    /// Cancelled by the driver.
    Cancelled,
    /// The device was unplugged, or detached itself.
    Gone,
    /// No response by the device, or not the expected one.
    Failed,
    /// More bytes than there was room for.
    Overrun,
}

/// End of a transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// Status at the end.
    pub status: Status,
    /// Bytes from the device.
    pub data: Vec<u8>,
    /// Number of bytes sent or received.
    pub length: usize,
}

/// Callback at the end of a transfer, on the machine's thread.
pub type Done = Box<dyn FnOnce(Outcome) + Send>;

/// Queue of a transfer: an endpoint, and `true` if data come from it. Endpoint 0 has one queue.
pub(super) type Pipe = (u8, bool);

impl Request {
    pub(super) fn pipe(&self) -> Pipe {
        match self {
            Self::Reset | Self::Control { .. } => (0, false),
            Self::In { endpoint, .. } => (*endpoint, true),
            Self::Out { endpoint, .. } => (*endpoint, false),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Setup,
    Data,
    Status,
}

/// Result of a transaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Progress {
    /// The transfer continues.
    More,
    /// The device has no data, or no room.
    Refused,
    /// No response; the transaction is repeated in the next frame.
    Silence,
    /// The transfer has ended.
    Over(Status),
}

/// Transfer in progress.
pub(super) struct Transfer {
    pub id: u64,
    pub request: Request,
    done: Done,
    stage: Stage,
    received: Vec<u8>,
    sent: usize,
    strikes: u8,
    /// Toggle in the data stage of a control transfer.
    toggle: Toggle,
}

impl Transfer {
    pub fn new(id: u64, request: Request, done: Done) -> Self {
        let (received, stage, toggle) = (Vec::new(), Stage::Setup, Toggle::Data1);
        Self {
            id,
            request,
            done,
            stage,
            received,
            sent: 0,
            strikes: 0,
            toggle,
        }
    }

    /// Ends the transfer and calls `done`.
    pub fn finish(self, status: Status) {
        let length = self.sent + self.received.len();
        (self.done)(Outcome {
            status,
            data: self.received,
            length,
        });
    }

    /// Runs one transaction; returns its duration in microseconds. `toggle` is the pipe's.
    pub fn step(
        &mut self,
        device: &mut dyn Device,
        address: u8,
        toggle: &mut Toggle,
    ) -> (f64, Progress) {
        let (bytes, progress) = match self.request {
            // The controller resets the bus itself.
            Request::Reset => (0, Progress::Over(Status::Done)),
            Request::Control { .. } => self.control(device, address),
            Request::In { endpoint, length } => {
                self.receive(device, address, endpoint, length, toggle)
            }
            Request::Out {
                endpoint,
                ends_short,
                ..
            } => self.send(device, address, endpoint, ends_short, toggle),
        };
        let progress = self.count_strikes(progress);
        (bytes as f64 * BYTE_US, progress)
    }

    fn count_strikes(&mut self, progress: Progress) -> Progress {
        if progress != Progress::Silence {
            self.strikes = 0;
            return progress;
        }
        self.strikes += 1;
        if self.strikes < STRIKES {
            progress
        } else {
            Progress::Over(Status::Failed)
        }
    }

    fn control(&mut self, device: &mut dyn Device, address: u8) -> (usize, Progress) {
        let Request::Control { setup, .. } = self.request else {
            return (0, Progress::Over(Status::Failed));
        };
        let length = usize::from(u16::from_le_bytes([setup[6], setup[7]]));
        let to_host = setup[0] & 0x80 != 0;
        match self.stage {
            Stage::Setup => {
                let handshake = device.setup(address, 0, setup);
                self.stage = if length == 0 {
                    Stage::Status
                } else {
                    Stage::Data
                };
                if handshake == Handshake::Ack {
                    return (OVERHEAD + 8, Progress::More);
                }
                // A device cannot refuse a SETUP: any other response counts as none.
                self.stage = Stage::Setup;
                (OVERHEAD + 8, Progress::Silence)
            }
            Stage::Data => {
                let mut toggle = self.toggle;
                let (bytes, progress) = if to_host {
                    self.receive(device, address, 0, length, &mut toggle)
                } else {
                    self.send(device, address, 0, false, &mut toggle)
                };
                self.toggle = toggle;
                if progress == Progress::Over(Status::Done) {
                    self.stage = Stage::Status;
                    return (bytes, Progress::More);
                }
                (bytes, progress)
            }
            // Direction opposite to the data's, always DATA1.
            Stage::Status if to_host && length > 0 => {
                let handshake = device.out(address, 0, Toggle::Data1, &[]);
                (OVERHEAD, after(handshake, Progress::Over(Status::Done)))
            }
            Stage::Status => match device.input(address, 0) {
                Answer::Data(Toggle::Data1, data) if data.is_empty() => {
                    (OVERHEAD, Progress::Over(Status::Done))
                }
                Answer::Data(..) => (OVERHEAD, Progress::Over(Status::Failed)),
                Answer::Nak => (REFUSED, Progress::Refused),
                Answer::Stall => (REFUSED, Progress::Over(Status::Stalled)),
                Answer::Nothing => (REFUSED, Progress::Silence),
            },
        }
    }

    fn receive(
        &mut self,
        device: &mut dyn Device,
        address: u8,
        endpoint: u8,
        length: usize,
        toggle: &mut Toggle,
    ) -> (usize, Progress) {
        let (came, data) = match device.input(address, endpoint) {
            Answer::Data(toggle, data) => (toggle, data),
            Answer::Nak => return (REFUSED, Progress::Refused),
            Answer::Stall => return (REFUSED, Progress::Over(Status::Stalled)),
            Answer::Nothing => return (REFUSED, Progress::Silence),
        };
        let bytes = OVERHEAD + data.len();
        // Repeated packet: the host's acknowledgement was lost.
        if came != *toggle {
            return (bytes, Progress::More);
        }
        *toggle = came.next();
        let room = length - self.received.len();
        let short = data.len() < PACKET;
        self.received.extend(data.iter().take(room));
        let progress = if data.len() > room.min(PACKET) {
            Progress::Over(Status::Overrun)
        } else if short || self.received.len() == length {
            Progress::Over(Status::Done)
        } else {
            Progress::More
        };
        (bytes, progress)
    }

    fn send(
        &mut self,
        device: &mut dyn Device,
        address: u8,
        endpoint: u8,
        ends_short: bool,
        toggle: &mut Toggle,
    ) -> (usize, Progress) {
        let (Request::Control { data, .. } | Request::Out { data, .. }) = &self.request else {
            return (0, Progress::Over(Status::Failed));
        };
        let packet = &data[self.sent..data.len().min(self.sent + PACKET)];
        let handshake = device.out(address, endpoint, *toggle, packet);
        let bytes = OVERHEAD + packet.len();
        let full = packet.len() == PACKET;
        if handshake == Handshake::Ack {
            self.sent += packet.len();
            *toggle = toggle.next();
        }
        let all = self.sent == data.len() && !(full && ends_short);
        let next = if all {
            Progress::Over(Status::Done)
        } else {
            Progress::More
        };
        (bytes, after(handshake, next))
    }
}

fn after(handshake: Handshake, taken: Progress) -> Progress {
    match handshake {
        Handshake::Ack => taken,
        Handshake::Nak => Progress::Refused,
        Handshake::Stall => Progress::Over(Status::Stalled),
        Handshake::Nothing => Progress::Silence,
    }
}
