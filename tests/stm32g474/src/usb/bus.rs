//! What travels on the bus, and a device as the bus sees it.

/// Which of the two data packets follow each other in turn (USB 2.0, 8.6).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Toggle {
    /// DATA0.
    #[default]
    Data0,
    /// DATA1.
    Data1,
}

impl Toggle {
    /// The one that follows.
    #[must_use]
    pub fn next(self) -> Self {
        match self {
            Self::Data0 => Self::Data1,
            Self::Data1 => Self::Data0,
        }
    }
}

/// How a device answers a packet that it is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handshake {
    /// Taken.
    Ack,
    /// Not now.
    Nak,
    /// Never, until the host has cleared the condition.
    Stall,
    /// No answer: not addressed, not enabled, or the packet was lost.
    Nothing,
}

/// How a device answers when it is asked for a packet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// A packet; the host acknowledges it.
    Data(Toggle, Vec<u8>),
    /// Not now.
    Nak,
    /// Never, until the host has cleared the condition.
    Stall,
    /// No answer.
    Nothing,
}

/// A full-speed device as the bus sees it: the chip's peripheral, or a stand-in in a test.
pub trait Device {
    /// Whether its pull-up says that there is a device.
    fn attached(&self) -> bool;

    /// The host resets the bus.
    fn bus_reset(&mut self);

    /// The host starts a frame: each millisecond, with the number of the frame.
    fn start_of_frame(&mut self, number: u16);

    /// A millisecond passes without a frame: the bus sleeps, or nothing is plugged in.
    fn missing_frame(&mut self);

    /// SETUP and its eight bytes.
    fn setup(&mut self, address: u8, endpoint: u8, packet: [u8; 8]) -> Handshake;

    /// OUT and a data packet.
    fn out(&mut self, address: u8, endpoint: u8, toggle: Toggle, data: &[u8]) -> Handshake;

    /// IN; data that come are acknowledged.
    fn input(&mut self, address: u8, endpoint: u8) -> Answer;
}
