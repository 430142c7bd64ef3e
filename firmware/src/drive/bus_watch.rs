//! Bus voltage while the bridge switches: a mains that is away is seen here before its zero crossings are missed.

use crate::limits::{BUS_DOWN_DV, BUS_DOWN_NS, BUS_MIN_DV};

/// Duration of a bus that is down, and whether it was up before.
#[derive(Clone, Debug, Default)]
pub struct BusWatch {
    /// Time that the bus has been down while the bridge switches.
    down_ns: u32,
    /// The bus has had voltage in this half-cycle, and in the one before.
    was_up: (bool, bool),
}

impl BusWatch {
    /// All bits zero.
    pub const fn blank() -> Self {
        Self {
            down_ns: 0,
            was_up: (false, false),
        }
    }

    /// Takes the bus voltage of a block, in decivolt; `switching` as the bridge does.
    #[inline]
    pub fn on_block(&mut self, bus_dv: u16, at_crossing: bool, switching: bool, block_ns: u32) {
        if at_crossing {
            self.was_up = (false, self.was_up.0);
        }
        self.was_up.0 |= bus_dv >= BUS_MIN_DV;
        self.down_ns = if switching && bus_dv < BUS_DOWN_DV {
            self.down_ns.saturating_add(block_ns)
        } else {
            0
        };
    }

    /// Returns `true` if the mains is away: the bus was up and is down for longer than a zero crossing takes. A bus that never
    /// comes up is a sensor's fault, or a bench without power.
    #[inline]
    pub fn is_mains_away(&self) -> bool {
        let was_up = self.was_up.0 || self.was_up.1;
        was_up && self.down_ns > BUS_DOWN_NS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLOCK_NS: u32 = 40_000;

    #[test]
    fn a_bus_that_was_up_and_stays_down_is_a_mains_that_is_away() {
        let mut bus = BusWatch::blank();
        bus.on_block(BUS_MIN_DV, false, true, BLOCK_NS);
        for _ in 0..BUS_DOWN_NS / BLOCK_NS {
            bus.on_block(BUS_DOWN_DV - 1, false, true, BLOCK_NS);
            assert!(!bus.is_mains_away());
        }
        bus.on_block(BUS_DOWN_DV - 1, false, true, BLOCK_NS);
        assert!(bus.is_mains_away());
        bus.on_block(BUS_DOWN_DV, false, true, BLOCK_NS);
        assert!(!bus.is_mains_away());
    }

    #[test]
    fn a_bus_that_was_never_up_or_a_bridge_at_rest_says_nothing() {
        let mut bus = BusWatch::blank();
        for _ in 0..2 * BUS_DOWN_NS / BLOCK_NS {
            bus.on_block(0, false, true, BLOCK_NS);
            assert!(!bus.is_mains_away());
        }
        bus.on_block(BUS_MIN_DV, false, true, BLOCK_NS);
        for _ in 0..2 * BUS_DOWN_NS / BLOCK_NS {
            bus.on_block(0, false, false, BLOCK_NS);
            assert!(!bus.is_mains_away());
        }
    }
}
