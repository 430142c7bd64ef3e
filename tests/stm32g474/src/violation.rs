//! Violations of the reference manual by the program.

use std::fmt;

use crate::time::{Ticks, seconds};

/// Broken rule of the chip.
#[derive(Clone, Debug, PartialEq)]
pub struct Violation {
    /// Time of the violation.
    pub at: Ticks,
    /// Program counter, as far as known: the beginning of the block of code.
    pub pc: u32,
    /// Broken rule, with its section of RM0440 or its erratum.
    pub rule: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at_ms = seconds(self.at) * 1e3;
        write!(f, "at {at_ms:.4} ms, pc {:#010x}: {}", self.pc, self.rule)
    }
}

/// Log of the violations in a run. Each rule is kept once, so that a loop does not fill the memory.
#[derive(Clone, Debug, Default)]
pub struct Log {
    /// Violations in the order of their times.
    pub violations: Vec<Violation>,
    /// Present time, set by the machine.
    pub now: Ticks,
    /// Program counter, set by the machine.
    pub pc: u32,
}

impl Log {
    /// Logs a violation at the present time.
    pub fn broken(&mut self, rule: impl Into<String>) {
        let rule = rule.into();
        if self.violations.iter().all(|known| known.rule != rule) {
            let (at, pc) = (self.now, self.pc);
            self.violations.push(Violation { at, pc, rule });
        }
    }
}
