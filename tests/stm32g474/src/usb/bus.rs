//! Packets on the bus, and the interface between a device and the bus.

/// Data toggle: DATA0 and DATA1 alternate (USB 2.0, 8.6).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Toggle {
    /// DATA0.
    #[default]
    Data0,
    /// DATA1.
    Data1,
}

impl Toggle {
    /// Toggle of the next packet.
    #[must_use]
    pub fn next(self) -> Self {
        match self {
            Self::Data0 => Self::Data1,
            Self::Data1 => Self::Data0,
        }
    }
}

/// Response of a device to a packet from the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handshake {
    /// Packet accepted.
    Ack,
    /// Not ready.
    Nak,
    /// Refused until the host has cleared the condition.
    Stall,
    /// No response: not addressed, not enabled, or the packet was lost.
    Nothing,
}

/// Response of a device to a request for a packet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// A packet; the host acknowledges it.
    Data(Toggle, Vec<u8>),
    /// Not ready.
    Nak,
    /// Refused until the host has cleared the condition.
    Stall,
    /// No response.
    Nothing,
}

/// Full-speed device on the bus: the chip's peripheral, or a stand-in in a test.
pub trait Device {
    /// Returns `true` if its pull-up signals a device.
    fn attached(&self) -> bool;

    /// Handles a reset of the bus.
    fn bus_reset(&mut self);

    /// Handles the start of a frame: each millisecond, with the number of the frame.
    fn start_of_frame(&mut self, number: u16);

    /// Handles a millisecond without a frame: the bus is suspended, or nothing is plugged in.
    fn missing_frame(&mut self);

    /// Handles SETUP with its eight bytes.
    fn setup(&mut self, address: u8, endpoint: u8, packet: [u8; 8]) -> Handshake;

    /// Handles OUT with a data packet.
    fn out(&mut self, address: u8, endpoint: u8, toggle: Toggle, data: &[u8]) -> Handshake;

    /// Handles IN; a data packet in the response is acknowledged.
    fn input(&mut self, address: u8, endpoint: u8) -> Answer;
}
