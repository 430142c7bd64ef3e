//! Latch of the active fault: the first one stays until it is cleared; one of the board itself takes its place and stays for good.

use ihd_shared::fault::Fault;

/// The active fault and when it tripped.
#[derive(Clone, Debug)]
pub struct FaultLatch {
    active: Fault,
    /// Half-cycle in which the active fault tripped.
    half_cycle: u32,
    /// Fault of the board itself, which clearing does not end.
    standing: Fault,
}

impl FaultLatch {
    /// No fault; all bits zero.
    pub const fn new() -> Self {
        Self {
            active: Fault::NONE,
            half_cycle: 0,
            standing: Fault::NONE,
        }
    }

    /// Trips, unless a fault is active.
    pub fn trip(&mut self, fault: Fault, half_cycle: u32) {
        if self.active == Fault::NONE {
            self.active = fault;
            self.half_cycle = half_cycle;
        }
    }

    /// Trips for good, in place of a fault that may pass: control, telemetry and the record for the next start know the active one alone.
    pub fn latch(&mut self, fault: Fault, half_cycle: u32) {
        if self.standing == Fault::NONE {
            *self = Self {
                active: fault,
                half_cycle,
                standing: fault,
            };
        }
    }

    /// Clears the active fault, but for a standing one.
    pub fn clear(&mut self) {
        self.active = self.standing;
    }

    /// The active fault; [`Fault::NONE`] if there is none.
    pub fn active(&self) -> Fault {
        self.active
    }

    /// Returns `true` if a fault is active.
    pub fn is_active(&self) -> bool {
        self.active != Fault::NONE
    }

    /// Half-cycle in which the active fault tripped; `None` if none is active.
    pub fn half_cycle(&self) -> Option<u32> {
        self.is_active().then_some(self.half_cycle)
    }
}

impl Default for FaultLatch {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_fault_stays_until_it_is_cleared() {
        let mut latch = FaultLatch::new();
        assert_eq!((latch.active(), latch.half_cycle()), (Fault::NONE, None));
        latch.trip(Fault::OVER_CURRENT, 7);
        latch.trip(Fault::MAINS_LOST, 8);
        assert_eq!(latch.active(), Fault::OVER_CURRENT);
        assert_eq!(latch.half_cycle(), Some(7));
        latch.clear();
        assert!(!latch.is_active());
    }

    #[test]
    fn a_fault_of_the_board_stays_for_good() {
        let mut latch = FaultLatch::new();
        latch.trip(Fault::MAINS_LOST, 1);
        latch.latch(Fault::FLASH_ECC, 2);
        latch.latch(Fault::COMPARATOR_TEST, 3);
        latch.clear();
        assert_eq!(latch.active(), Fault::FLASH_ECC);
        assert_eq!(latch.half_cycle(), Some(2));
    }
}
