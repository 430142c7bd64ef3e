//! Requests other than heating: identity, self tests, log and restart.

use std::time::Duration;

use ihd_shared::window::CHUNK_BYTES;
use ihd_shared::wire::link_test::fill;
use ihd_shared::wire::messages::{
    Board, Channels, Clocks, Comparators, GetBoard, LinkData, LinkTested, Program, Raw, Restart,
    StreamLog, TestChannels, TestClocks, TestComparators, TestLink,
};
use ihd_shared::wire::number::Number;

use super::{Client, LinkError};

/// Silence after which the rest of a test's bytes counts as lost.
const SILENCE_TIMEOUT: Duration = Duration::from_millis(500);

/// Identity of a board and its program, as in [`UsbBoard`](crate::usb::UsbBoard).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BoardFacts {
    /// DBGMCU_IDCODE; 0 if there is no chip.
    pub id_code: u32,
    /// Flash size in KiB, as the chip reports it.
    pub flash_kib: u16,
    /// FLASH_OPTR.
    pub option_bytes: u32,
    /// RCC_CSR at the start of the program.
    pub reset_flags: u32,
    /// Starts since power-on; 255 stands for 255 or more.
    pub starts: u8,
    /// Length of the program in flash before its CRC, in bytes.
    pub image_bytes: u32,
    /// CRC-32 of the program, computed at start.
    pub image_crc: u32,
    /// CRC-32 with which the program was sealed.
    pub sealed_crc: u32,
    /// GNU build id; empty if the program has none.
    pub build_id: Vec<u8>,
    /// Unique number of the chip; empty if there is no chip.
    pub chip: Vec<u8>,
}

impl BoardFacts {
    /// Returns the number of the chip in hexadecimal; empty if there is no chip.
    pub fn chip_number(&self) -> String {
        let digits = self.chip.iter().map(|byte| format!("{byte:02x}"));
        digits.collect()
    }
}

impl From<&Board<'_>> for BoardFacts {
    fn from(board: &Board<'_>) -> Self {
        Self {
            id_code: board.id_code,
            flash_kib: board.flash_kib,
            option_bytes: board.option_bytes,
            reset_flags: board.reset_flags,
            starts: board.starts,
            image_bytes: board.image_bytes,
            image_crc: board.image_crc,
            sealed_crc: board.sealed_crc,
            build_id: board.build_id.0.to_vec(),
            chip: board.chip.0.to_vec(),
        }
    }
}

/// Result of a link test in both directions, timed on the transport's clock.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkTest {
    /// Counts of the device for the host's data; frames lost after the last received one are included.
    pub to_device: LinkTested,
    /// Time from the first frame sent until the device's counts came.
    pub to_device_took: Duration,
    /// Counts of the host for the device's data.
    pub from_device: LinkTested,
    /// Time from the request until the last frame came.
    pub from_device_took: Duration,
}

impl Client {
    /// Restarts the device into program `into`; the link ends some 0.1 s later.
    ///
    /// # Errors
    /// [`LinkError::Refused`] while the inverter is on or power is requested, or if the device has no such program; else any error
    /// of [`Client::request`].
    pub fn restart(&mut self, into: Program) -> Result<(), LinkError> {
        self.order(&Restart { into })
    }

    /// Reads the identity of board and program.
    ///
    /// # Errors
    /// Any error of [`Client::request`].
    pub fn board(&mut self) -> Result<BoardFacts, LinkError> {
        Ok((&self.request(&GetBoard {})?).into())
    }

    /// Measures offset and noise of the measuring channels and the supply, with the bridge open.
    ///
    /// # Errors
    /// [`LinkError::Refused`] while the inverter is on or power is requested; else any error of [`Client::request`].
    pub fn channels(&mut self) -> Result<Channels, LinkError> {
        self.request(&TestChannels {})
    }

    /// Trips both comparators through their thresholds, with the bridge open.
    ///
    /// # Errors
    /// Any error of [`Client::channels`]; [`LinkError::Refused`] with `Unavailable` from a simulated hob, which has none.
    pub fn comparators(&mut self) -> Result<Comparators, LinkError> {
        self.request(&TestComparators {})
    }

    /// Counts the clocks against each other.
    ///
    /// # Errors
    /// Any error of [`Client::comparators`].
    pub fn clocks(&mut self) -> Result<Clocks, LinkError> {
        self.request(&TestClocks {})
    }

    /// Sends `frames` frames with `bytes` bytes of data each to the device, then receives as many from it.
    ///
    /// # Errors
    /// [`LinkError::Refused`] with `OutOfRange` for more than [`CHUNK_BYTES`] bytes; else any error of [`Client::request`]. Losses
    /// are counted, not errors.
    pub fn test_link(&mut self, frames: u16, bytes: u16) -> Result<LinkTest, LinkError> {
        // Resets the counts of both ends.
        self.end_link_test(0, bytes)?;
        let begin = self.clock();
        self.send_link_data(frames, bytes)?;
        let tested = self.end_link_test(frames, bytes)?;
        let to_device_took = self.clock().saturating_sub(begin);
        let to_device = with_the_last(tested, frames);
        let (from_device, from_device_took) = self.receive_link_data(frames)?;
        Ok(LinkTest {
            to_device,
            to_device_took,
            from_device,
            from_device_took,
        })
    }

    /// Starts or stops the log stream. It begins with the oldest entry that the device still keeps and comes as
    /// [`super::DeviceEvent::Log`].
    ///
    /// # Errors
    /// [`LinkError::Refused`] with `Unavailable` from a device without a log; else any error of [`Client::request`].
    pub fn stream_log(&mut self, on: bool) -> Result<(), LinkError> {
        self.order(&StreamLog { on })
    }

    /// Reads the device's counts since the last call; the device then sends its data.
    fn end_link_test(&mut self, frames: u16, bytes: u16) -> Result<LinkTested, LinkError> {
        self.forget_link_data();
        self.request(&TestLink { frames, bytes })
    }

    fn send_link_data(&mut self, frames: u16, bytes: u16) -> Result<(), LinkError> {
        let mut data = vec![0; usize::from(bytes).min(CHUNK_BYTES)];
        for seq in 0..u32::from(frames) {
            fill(seq, &mut data);
            let data = Raw(&data);
            self.send(&LinkData { seq, data }, Number::NONE)?;
        }
        Ok(())
    }

    fn receive_link_data(&mut self, frames: u16) -> Result<(LinkTested, Duration), LinkError> {
        let begin = self.clock();
        let mut last = begin;
        while self.link_data().seen() < u32::from(frames) {
            let before = self.link_data();
            self.receive(SILENCE_TIMEOUT)?;
            let now = self.clock();
            if self.link_data() != before {
                last = now;
            } else if now.saturating_sub(last) >= SILENCE_TIMEOUT {
                break;
            }
        }
        let counts = with_the_last(self.link_data().counts(), frames);
        Ok((counts, last.saturating_sub(begin)))
    }
}

/// Adds the frames lost after the last received one, which no sequence number reveals.
fn with_the_last(tested: LinkTested, sent: u16) -> LinkTested {
    let lost = u32::from(sent).saturating_sub(tested.frames);
    LinkTested {
        lost: tested.lost.max(lost),
        ..tested
    }
}

#[cfg(test)]
mod tests;
