//! What a host asks of a device besides heating: what it is, whether it is sound, what it has logged, and to
//! begin anew.

use std::time::Duration;

use ihd_shared::window::CHUNK_BYTES;
use ihd_shared::wire::link_test::fill;
use ihd_shared::wire::messages::{
    Board, Channels, Clocks, Comparators, GetBoard, LinkData, LinkTested, Program, Raw, Restart,
    StreamLog, TestChannels, TestClocks, TestComparators, TestLink,
};
use ihd_shared::wire::number::Number;

use super::{Client, LinkError};

/// How long the next of a test's bytes may stay away before the rest counts as lost.
const SILENCE: Duration = Duration::from_millis(500);

/// What the device is, as [`Board`] tells it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BoardFacts {
    /// DBGMCU_IDCODE; 0 where there is no chip.
    pub id_code: u32,
    /// Flash, in KiB, as the chip says.
    pub flash_kib: u16,
    /// FLASH_OPTR.
    pub option_bytes: u32,
    /// RCC_CSR as the program found it.
    pub reset_flags: u32,
    /// Starts since power came on; 255 for that many or more.
    pub starts: u8,
    /// Bytes of the program in flash before its CRC.
    pub image_bytes: u32,
    /// Their CRC-32 as worked out at start.
    pub image_crc: u32,
    /// The CRC-32 that the program was sealed with.
    pub sealed_crc: u32,
    /// GNU build id; empty where the program has none.
    pub build_id: Vec<u8>,
    /// The chip's unique number; empty where there is no chip.
    pub chip: Vec<u8>,
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

/// A test of the link in both directions, on the transport's clock.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkTest {
    /// What the device received of what was sent to it; frames lost behind the last that came count too.
    pub to_device: LinkTested,
    /// From the first frame sent until the device's count was here.
    pub to_device_took: Duration,
    /// What was received of what the device was asked for.
    pub from_device: LinkTested,
    /// From the request until the last of it was here.
    pub from_device_took: Duration,
}

impl Client {
    /// Ends the program that runs on the device, for `into`; the link ends with it, some 0.1 s later.
    ///
    /// # Errors
    /// [`LinkError::Refused`] while the inverter is on or power is asked for, or where the device has no such
    /// program; else as every command.
    pub fn restart(&mut self, into: Program) -> Result<(), LinkError> {
        self.order(&Restart { into })
    }

    /// What the device is.
    ///
    /// # Errors
    /// As every command.
    pub fn board(&mut self) -> Result<BoardFacts, LinkError> {
        Ok((&self.request(&GetBoard {})?).into())
    }

    /// Offset and noise of the measuring channels, and the supply, with the bridge open.
    ///
    /// # Errors
    /// [`LinkError::Refused`] while the inverter is on or power is asked for; else as every command.
    pub fn channels(&mut self) -> Result<Channels, LinkError> {
        self.request(&TestChannels {})
    }

    /// Trips both comparators by their thresholds, with the bridge open.
    ///
    /// # Errors
    /// As [`Client::channels`]; [`LinkError::Refused`] with `Unavailable` by a simulated hob, which has none.
    pub fn comparators(&mut self) -> Result<Comparators, LinkError> {
        self.request(&TestComparators {})
    }

    /// Counts the clocks against each other.
    ///
    /// # Errors
    /// As [`Client::comparators`].
    pub fn clocks(&mut self) -> Result<Clocks, LinkError> {
        self.request(&TestClocks {})
    }

    /// Sends `frames` frames with `bytes` bytes of data each to the device, then has it send as many.
    ///
    /// # Errors
    /// [`LinkError::Refused`] with `OutOfRange` for more than [`CHUNK_BYTES`] bytes; else as every command. Losses are
    /// no error.
    pub fn test_link(&mut self, frames: u16, bytes: u16) -> Result<LinkTest, LinkError> {
        // Both ends begin to count.
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

    /// From now on the device sends what it logs, from the oldest that it still keeps on, as
    /// [`super::Event::Log`]; or no more.
    ///
    /// # Errors
    /// [`LinkError::Refused`] with `Unavailable` by a device without a log; else as every command.
    pub fn stream_log(&mut self, on: bool) -> Result<(), LinkError> {
        self.order(&StreamLog { on })
    }

    /// What the device has received since it was asked last; then it sends.
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
            self.receive(SILENCE)?;
            let now = self.clock();
            if self.link_data() != before {
                last = now;
            } else if now.saturating_sub(last) >= SILENCE {
                break;
            }
        }
        let counts = with_the_last(self.link_data().counts(), frames);
        Ok((counts, last.saturating_sub(begin)))
    }
}

/// Of frames behind the last that came, no number tells that they are missing.
fn with_the_last(tested: LinkTested, sent: u16) -> LinkTested {
    let lost = u32::from(sent).saturating_sub(tested.frames);
    LinkTested {
        lost: tested.lost.max(lost),
        ..tested
    }
}

#[cfg(test)]
mod tests;
