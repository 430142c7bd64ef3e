//! Cost of flash accesses in cycles: wait states, prefetch and the two caches (RM0440, 3.3.4 and 3.3.5).

use std::collections::VecDeque;

/// Bytes of a flash read with two banks (RM0440, 3.3.1: 72 bits with its ECC).
const READ_BYTES: u32 = 8;

/// Cache lines hold four reads; 32 of them for instructions, 8 for data (RM0440, 3.3.5).
const LINE_BYTES: u32 = 32;
const INSTRUCTION_LINES: usize = 32;
const DATA_LINES: usize = 8;

/// Least-recently-used cache of lines whose reads are valid one by one.
#[derive(Clone, Debug)]
struct Cache {
    lines: VecDeque<(u32, u8)>,
    capacity: usize,
}

impl Cache {
    fn new(capacity: usize) -> Self {
        Self {
            lines: VecDeque::with_capacity(capacity),
            capacity,
        }
    }

    /// Looks up a read and stores it; returns `true` on a hit.
    fn hit(&mut self, address: u32) -> bool {
        let line = address / LINE_BYTES;
        let bit = 1 << (address % LINE_BYTES / READ_BYTES);
        if let Some(at) = self.lines.iter().position(|&(known, _)| known == line) {
            let mut entry = self.lines[at];
            let hit = entry.1 & bit != 0;
            entry.1 |= bit;
            if at != 0 {
                self.lines.remove(at);
                self.lines.push_front(entry);
            } else {
                self.lines[0] = entry;
            }
            return hit;
        }
        if self.lines.len() == self.capacity {
            self.lines.pop_back();
        }
        self.lines.push_front((line, bit));
        false
    }
}

/// Fields of FLASH_ACR that concern the accelerator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Access {
    /// LATENCY.
    pub wait_states: u32,
    /// PRFTEN.
    pub prefetch: bool,
    /// ICEN.
    pub instruction_cache: bool,
    /// DCEN.
    pub data_cache: bool,
}

/// Accelerator between processor and flash.
#[derive(Clone, Debug)]
pub struct FlashAccelerator {
    /// Settings by FLASH_ACR.
    pub access: Access,
    instructions: Cache,
    data: Cache,
    /// Address of the read that the prefetch has begun.
    prefetched: u32,
}

impl Default for FlashAccelerator {
    fn default() -> Self {
        // FLASH_ACR after reset is 0x0004_0601.
        let access = Access {
            wait_states: 1,
            prefetch: false,
            instruction_cache: true,
            data_cache: true,
        };
        Self {
            access,
            instructions: Cache::new(INSTRUCTION_LINES),
            data: Cache::new(DATA_LINES),
            prefetched: u32::MAX,
        }
    }
}

impl FlashAccelerator {
    /// Cycles lost in fetching the code from `start` to `end`, which takes `cycles` to execute.
    pub fn fetch(&mut self, start: u32, end: u32, cycles: u32) -> u32 {
        let first = start & !(READ_BYTES - 1);
        let reads = (end - first).div_ceil(READ_BYTES);
        // Cycles of execution during the next read.
        let overlap = cycles / reads.max(1);
        let mut lost = 0;
        for read in (0..reads).map(|k| first + k * READ_BYTES) {
            let hit = self.instructions.hit(read) && self.access.instruction_cache;
            if !hit {
                let hidden = if self.access.prefetch && read == self.prefetched {
                    overlap
                } else {
                    0
                };
                lost += self.access.wait_states.saturating_sub(hidden);
            }
            self.prefetched = read + READ_BYTES;
        }
        lost
    }

    /// Cycles lost in reading a word of data.
    pub fn read(&mut self, address: u32) -> u32 {
        let hit = self.data.hit(address & !(READ_BYTES - 1)) && self.access.data_cache;
        if hit { 0 } else { self.access.wait_states }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_170_mhz(prefetch: bool) -> FlashAccelerator {
        let mut flash = FlashAccelerator::default();
        flash.access = Access {
            wait_states: 4,
            prefetch,
            ..flash.access
        };
        flash
    }

    #[test]
    fn straight_code_waits_for_each_read_and_prefetch_hides_what_executes() {
        assert_eq!(at_170_mhz(false).fetch(0x0800_0000, 0x0800_0040, 32), 8 * 4);
        assert_eq!(
            at_170_mhz(true).fetch(0x0800_0000, 0x0800_0040, 16),
            4 + 7 * 2
        );
    }

    #[test]
    fn a_loop_is_cached_and_a_long_one_is_not() {
        let mut flash = at_170_mhz(true);
        flash.fetch(0x0800_0000, 0x0800_0100, 64);
        assert_eq!(flash.fetch(0x0800_0000, 0x0800_0100, 64), 0);
        // 1 KiB of cache: a loop of 2 KiB evicts itself.
        flash.fetch(0x0800_0000, 0x0800_0800, 512);
        assert!(flash.fetch(0x0800_0000, 0x0800_0800, 512) > 400);
    }
}
