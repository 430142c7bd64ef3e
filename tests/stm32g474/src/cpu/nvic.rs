//! Interrupt controller: pending and active exceptions, and the next one to be taken (Armv7-M Architecture Reference Manual,
//! B1.5 and B3.4).

/// Exception number of the non-maskable interrupt.
pub const NMI: usize = 2;
/// Exception number of HardFault: every fault of the processor, as the image enables no other.
pub const HARD_FAULT: usize = 3;
/// Exception number of the first interrupt.
pub const FIRST_INTERRUPT: usize = 16;
const EXCEPTIONS: usize = FIRST_INTERRUPT + 102;

/// Priority below all others: no exception is active.
const THREAD: i32 = 256;

/// Interrupt controller.
#[derive(Clone, Debug)]
pub struct Nvic {
    enabled: [bool; EXCEPTIONS],
    pending: [bool; EXCEPTIONS],
    priority: [u8; EXCEPTIONS],
    /// Levels of the peripherals' lines.
    level: [bool; EXCEPTIONS],
    any_pending: bool,
    /// Active exceptions with the cycle at which each began, the running one last.
    active: Vec<(usize, u64)>,
    /// Number of entries of each exception since reset.
    pub entries: Vec<u64>,
}

impl Default for Nvic {
    fn default() -> Self {
        let mut enabled = [false; EXCEPTIONS];
        enabled[NMI] = true;
        enabled[HARD_FAULT] = true;
        Self {
            enabled,
            pending: [false; EXCEPTIONS],
            priority: [0; EXCEPTIONS],
            level: [false; EXCEPTIONS],
            any_pending: false,
            active: Vec::new(),
            entries: vec![0; EXCEPTIONS],
        }
    }
}

impl Nvic {
    /// Pends an exception.
    pub fn pend(&mut self, exception: usize) {
        if let Some(pending) = self.pending.get_mut(exception) {
            *pending = true;
            self.any_pending = true;
        }
    }

    /// Sets the level of a peripheral's line. A rising edge pends the interrupt, and so does the end of a handler with the line high.
    pub fn set_line(&mut self, interrupt: usize, high: bool) {
        let exception = FIRST_INTERRUPT + interrupt;
        if high && !self.level[exception] {
            self.pend(exception);
        }
        self.level[exception] = high;
    }

    /// Returns `false` if no exception is pending, enabled or not: a cheap check before [`Nvic::next`].
    pub fn any_pending(&self) -> bool {
        self.any_pending
    }

    fn priority_of(&self, exception: usize) -> i32 {
        match exception {
            NMI => -2,
            HARD_FAULT => -1,
            // Four bits are implemented (SVD: nvicPrioBits).
            _ => i32::from(self.priority[exception] >> 4),
        }
    }

    /// Priority of the running handler or of the thread.
    pub fn running_priority(&self) -> i32 {
        let active = self
            .active
            .iter()
            .map(|&(exception, _)| self.priority_of(exception));
        active.min().unwrap_or(THREAD)
    }

    /// Exception to be taken now, if any, at this PRIMASK and BASEPRI.
    pub fn next(&mut self, primask: bool, basepri: u8) -> Option<usize> {
        let mut limit = self.running_priority();
        if primask {
            limit = limit.min(0);
        }
        if basepri != 0 {
            limit = limit.min(i32::from(basepri >> 4));
        }
        let waiting = (0..EXCEPTIONS).filter(|&n| self.pending[n]);
        let mut best = None::<usize>;
        let mut any = false;
        for n in waiting {
            any = true;
            let better = best.is_none_or(|b| self.priority_of(n) < self.priority_of(b));
            if self.enabled[n] && better {
                best = Some(n);
            }
        }
        self.any_pending = any;
        best.filter(|&n| self.priority_of(n) < limit)
    }

    /// Returns `true` if a pending, enabled exception would wake the processor from WFE, regardless of PRIMASK.
    pub fn would_wake(&mut self) -> bool {
        self.next(false, 0).is_some()
    }

    /// Starts the handler of an exception, at a cycle.
    pub fn enter(&mut self, exception: usize, cycle: u64) {
        self.pending[exception] = false;
        self.active.push((exception, cycle));
        self.entries[exception] += 1;
    }

    /// Ends the running handler; returns its exception and the cycle at which it began.
    pub fn leave(&mut self) -> Option<(usize, u64)> {
        let ended = self.active.pop()?;
        if self.level[ended.0] {
            self.pend(ended.0);
        }
        Some(ended)
    }

    /// Returns `true` if the handler of an exception runs and none of higher priority has interrupted it.
    pub fn runs(&self, exception: usize) -> bool {
        self.active.last().is_some_and(|&(n, _)| n == exception)
    }

    /// Returns `true` if a handler runs.
    pub fn is_handler(&self) -> bool {
        !self.active.is_empty()
    }

    /// Reads a register at an offset from 0xE000E000.
    pub fn read(&self, offset: u32) -> Option<u32> {
        let bits = |source: &[bool], first: usize| {
            (0..32).fold(0, |word, k| {
                let set = source
                    .get(FIRST_INTERRUPT + first + k)
                    .copied()
                    .unwrap_or(false);
                word | (u32::from(set) << k)
            })
        };
        match offset {
            0x100..0x120 => Some(bits(&self.enabled, (offset as usize - 0x100) * 8)),
            0x180..0x1A0 => Some(bits(&self.enabled, (offset as usize - 0x180) * 8)),
            0x200..0x220 => Some(bits(&self.pending, (offset as usize - 0x200) * 8)),
            0x280..0x2A0 => Some(bits(&self.pending, (offset as usize - 0x280) * 8)),
            0x400..0x4F0 => {
                let first = FIRST_INTERRUPT + offset as usize - 0x400;
                let byte = |k: usize| u32::from(self.priority.get(first + k).copied().unwrap_or(0));
                Some((0..4).fold(0, |word, k| word | (byte(k) << (8 * k))))
            }
            _ => None,
        }
    }

    /// Writes a register at an offset from 0xE000E000; returns `true` if it belongs to the interrupt controller.
    pub fn write(&mut self, offset: u32, size: usize, value: u32) -> bool {
        let each = |first: usize| {
            (0..32)
                .filter(move |k| value >> k & 1 == 1)
                .map(move |k| FIRST_INTERRUPT + first + k)
        };
        let exists = |n: &usize| *n < EXCEPTIONS;
        match offset {
            0x100..0x120 => {
                each((offset as usize - 0x100) * 8)
                    .filter(exists)
                    .for_each(|n| self.enabled[n] = true);
                self.any_pending = true;
            }
            0x180..0x1A0 => each((offset as usize - 0x180) * 8)
                .filter(exists)
                .for_each(|n| self.enabled[n] = false),
            0x200..0x220 => each((offset as usize - 0x200) * 8)
                .filter(exists)
                .for_each(|n| self.pend(n)),
            0x280..0x2A0 => each((offset as usize - 0x280) * 8)
                .filter(exists)
                // A line that is still high keeps it pending (Cortex-M4 Devices Generic User Guide, 4.2.9).
                .for_each(|n| self.pending[n] = self.level[n]),
            0x400..0x4F0 => {
                for k in 0..size {
                    if let Some(priority) = self
                        .priority
                        .get_mut(FIRST_INTERRUPT + offset as usize - 0x400 + k)
                    {
                        *priority = (value >> (8 * k)) as u8 & 0xF0;
                    }
                }
            }
            // STIR: software triggers an interrupt.
            0xF00 => self.pend(FIRST_INTERRUPT + (value & 0x1FF) as usize),
            _ => return false,
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DMA: usize = 11;
    const USB: usize = 20;

    fn enabled(nvic: &mut Nvic, interrupt: usize, priority: u32) {
        nvic.write(
            0x100 + 4 * (interrupt as u32 / 32),
            4,
            1 << (interrupt % 32),
        );
        nvic.write(0x400 + interrupt as u32, 1, priority << 4);
    }

    #[test]
    fn the_more_urgent_comes_first_and_is_not_preempted_by_the_other() {
        let mut nvic = Nvic::default();
        enabled(&mut nvic, DMA, 1);
        enabled(&mut nvic, USB, 3);
        nvic.set_line(USB, true);
        nvic.set_line(DMA, true);
        assert_eq!(nvic.next(false, 0), Some(FIRST_INTERRUPT + DMA));
        assert_eq!(nvic.next(true, 0), None, "PRIMASK holds both");
        assert_eq!(
            nvic.next(false, 0x10),
            None,
            "BASEPRI 1 holds priorities 1 and below"
        );
        nvic.enter(FIRST_INTERRUPT + DMA, 0);
        assert_eq!(nvic.next(false, 0), None);
        nvic.set_line(DMA, false);
        assert_eq!(nvic.leave(), Some((FIRST_INTERRUPT + DMA, 0)));
        assert_eq!(nvic.next(false, 0), Some(FIRST_INTERRUPT + USB));
    }

    #[test]
    fn what_is_cleared_while_its_line_is_high_stays_pending() {
        let mut nvic = Nvic::default();
        nvic.set_line(USB, true);
        nvic.write(0x280, 4, 1 << USB);
        enabled(&mut nvic, USB, 3);
        assert_eq!(nvic.next(false, 0), Some(FIRST_INTERRUPT + USB));
        nvic.set_line(USB, false);
        nvic.write(0x280, 4, 1 << USB);
        assert_eq!(nvic.next(false, 0), None);
    }

    #[test]
    fn a_line_left_high_pends_again_and_stir_pends_from_inside() {
        let mut nvic = Nvic::default();
        enabled(&mut nvic, DMA, 1);
        nvic.set_line(DMA, true);
        nvic.enter(FIRST_INTERRUPT + DMA, 0);
        nvic.leave();
        assert_eq!(
            nvic.next(false, 0),
            Some(FIRST_INTERRUPT + DMA),
            "still high"
        );
        nvic.enter(FIRST_INTERRUPT + DMA, 0);
        nvic.set_line(DMA, false);
        nvic.write(0xF00, 4, DMA as u32);
        nvic.leave();
        assert_eq!(
            nvic.next(false, 0),
            Some(FIRST_INTERRUPT + DMA),
            "the livelock of 78153fe"
        );
    }
}
