//! DMA1 with DMAMUX: a request of a peripheral moves one unit to memory (RM0440, 12 and 13).

use crate::registers::{dma1, dmamux};
use crate::violation::Log;

use super::register_file::RegisterFile;

const CHANNELS: u32 = 8;

/// Interrupt number of channel 1; the others follow (RM0440, 14.3, vector table).
pub const FIRST_INTERRUPT: usize = 11;

/// Write to memory that a request causes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transfer {
    /// Address in memory.
    pub address: u32,
    /// Value to write.
    pub value: u32,
    /// Size in bytes.
    pub bytes: usize,
}

/// DMA controller.
#[derive(Clone, Debug, Default)]
pub struct Dma {
    /// Value written to CNDTRx, for the reload of a circular channel.
    length: [u32; CHANNELS as usize],
}

const STRIDE: u32 = 0x14;

fn channel_register(first: u32, channel: u32) -> u32 {
    first + channel * STRIDE
}

impl Dma {
    /// Handles a request of a peripheral for a `value` at the address `from`; `request` is its DMAMUX input. Returns the write to
    /// memory, `None` if no channel serves it.
    pub fn request(
        &mut self,
        request: u32,
        from: u32,
        value: u32,
        file: &mut RegisterFile,
        log: &mut Log,
    ) -> Option<Transfer> {
        let channel = (0..CHANNELS).find(|k| {
            let id = file.word(dmamux::BASE + 4 * k) & 0x7F;
            let on = file.word(channel_register(dma1::ccr1::ADDRESS, *k)) & 1 == 1;
            id == request && on
        })?;
        let ccr = file.word(channel_register(dma1::ccr1::ADDRESS, channel));
        let left_at = channel_register(dma1::cndtr1::ADDRESS, channel);
        let left = file.word(left_at);
        if left == 0 {
            return None;
        }
        if file.word(channel_register(dma1::cpar1::ADDRESS, channel)) != from {
            log.broken(format!(
                "DMA: CPAR is not {from:#010x}, whose request it serves (RM0440 12.6.5)"
            ));
            return None;
        }
        let bytes = 1 << dma1::ccr1::MSIZE.extract(ccr);
        if dma1::ccr1::PSIZE.extract(ccr) != dma1::ccr1::MSIZE.extract(ccr)
            || dma1::ccr1::DIR.extract(ccr) != 0
        {
            log.broken("DMA: this emulator moves from a peripheral, unit by unit of the same size");
        }
        let length = self.length[channel as usize];
        let done = length - left;
        let step = if dma1::ccr1::MINC.extract(ccr) == 1 {
            done * bytes
        } else {
            0
        };
        let address = file.word(channel_register(dma1::cmar1::ADDRESS, channel)) + step;
        let mut flags = 0;
        let left = left - 1;
        if length - left == length / 2 {
            flags |= 0b0101;
        }
        let mut next = left;
        if left == 0 {
            flags |= 0b0011;
            if dma1::ccr1::CIRC.extract(ccr) == 1 {
                next = length;
            }
        }
        file.set_word(left_at, next);
        file.set_word(
            dma1::isr::ADDRESS,
            file.word(dma1::isr::ADDRESS) | flags << (4 * channel),
        );
        Some(Transfer {
            address,
            value,
            bytes: bytes as usize,
        })
    }

    /// Handles a write before it is stored; returns the word to store.
    pub fn write(
        &mut self,
        address: u32,
        value: u32,
        file: &mut RegisterFile,
        log: &mut Log,
    ) -> u32 {
        if address == dma1::ifcr::ADDRESS {
            let mut cleared = value;
            for channel in 0..CHANNELS {
                // CGIFx clears all four.
                if value >> (4 * channel) & 1 == 1 {
                    cleared |= 0xF << (4 * channel);
                }
            }
            let mut flags = file.word(dma1::isr::ADDRESS) & !cleared;
            for channel in 0..CHANNELS {
                let any = flags >> (4 * channel) & 0b1110 != 0;
                flags = flags & !(1 << (4 * channel)) | u32::from(any) << (4 * channel);
            }
            file.set_word(dma1::isr::ADDRESS, flags);
            return 0;
        }
        for channel in 0..CHANNELS {
            let enabled = file.word(channel_register(dma1::ccr1::ADDRESS, channel)) & 1 == 1;
            let locked = [
                dma1::cndtr1::ADDRESS,
                dma1::cpar1::ADDRESS,
                dma1::cmar1::ADDRESS,
            ];
            if locked
                .iter()
                .any(|first| channel_register(*first, channel) == address)
                && enabled
            {
                log.broken(
                    "DMA: CNDTR, CPAR or CMAR written while the channel is enabled (RM0440 12.6.4)",
                );
                return file.word(address);
            }
            if channel_register(dma1::cndtr1::ADDRESS, channel) == address {
                self.length[channel as usize] = value & 0xFFFF;
            }
        }
        value
    }

    /// Level of a channel's interrupt line.
    pub fn line(&self, channel: u32, file: &RegisterFile) -> bool {
        let flags = file.word(dma1::isr::ADDRESS) >> (4 * channel) & 0b1110;
        let enabled = file.word(channel_register(dma1::ccr1::ADDRESS, channel)) & 0b1110;
        flags & enabled != 0
    }
}
