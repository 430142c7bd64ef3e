//! What the program did that the reference manual forbids.

use std::fmt;

use crate::time::{Ticks, seconds};

/// A rule of the chip that was broken.
#[derive(Clone, Debug, PartialEq)]
pub struct Violation {
    /// When.
    pub at: Ticks,
    /// Program counter, as far as it is known: the beginning of the block of code.
    pub pc: u32,
    /// The rule, with the section of RM0440 or the erratum that it comes from.
    pub rule: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at_ms = seconds(self.at) * 1e3;
        write!(f, "at {at_ms:.4} ms, pc {:#010x}: {}", self.pc, self.rule)
    }
}

/// The violations of a run. Each rule is kept once, so that a loop does not fill the memory.
#[derive(Clone, Debug, Default)]
pub struct Log {
    /// What was found, in order.
    pub violations: Vec<Violation>,
    /// Time, kept by the machine.
    pub now: Ticks,
    /// Program counter, kept by the machine.
    pub pc: u32,
}

impl Log {
    /// Notes that a rule was broken now.
    pub fn broken(&mut self, rule: impl Into<String>) {
        let rule = rule.into();
        if self.violations.iter().all(|known| known.rule != rule) {
            let (at, pc) = (self.now, self.pc);
            self.violations.push(Violation { at, pc, rule });
        }
    }
}
