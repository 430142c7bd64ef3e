//! Cycle counter of the processor, and the registers on which it depends (Armv7-M, C1.6.5 and C1.8). They keep their content in
//! a system reset.

const CTRL: u32 = 0x1000;
const CYCCNT: u32 = 0x1004;
const DEMCR: u32 = 0xEDFC;

const CYCCNTENA: u32 = 1;
const TRCENA: u32 = 1 << 24;

/// Cycle counter.
#[derive(Clone, Debug, Default)]
pub struct CycleCounter {
    control: u32,
    demcr: u32,
    count: u32,
    /// Fault injection: the counter keeps its value.
    pub broken: bool,
}

impl CycleCounter {
    /// Counts cycles of the processor's clock.
    #[inline]
    pub fn run(&mut self, cycles: u64) {
        let traces = self.demcr & TRCENA != 0;
        if traces && self.control & CYCCNTENA != 0 && !self.broken {
            self.count = self.count.wrapping_add(cycles as u32);
        }
    }

    /// Reads a register at an offset from 0xE000_0000; `None` if it is another's.
    pub fn read(&self, offset: u32) -> Option<u32> {
        match offset {
            CTRL => Some(self.control),
            CYCCNT => Some(self.count),
            DEMCR => Some(self.demcr),
            _ => None,
        }
    }

    /// Writes a register at an offset from 0xE000_0000; returns `false` if it is another's. Without TRCENA DWT takes nothing.
    pub fn write(&mut self, offset: u32, value: u32) -> bool {
        let traces = self.demcr & TRCENA != 0;
        match offset {
            CTRL if traces => self.control = value,
            CYCCNT if traces => self.count = value,
            CTRL | CYCCNT => {}
            DEMCR => self.demcr = value,
            _ => return false,
        }
        true
    }
}
