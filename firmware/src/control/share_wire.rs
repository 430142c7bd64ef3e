//! Wire between two zones that share a supply, and the search for it.
//!
//! A resistor on one of the two boards pulls the wire up. A board looks for the wire by pulling its own end weakly up and down in
//! turn: a free wire stays high, one that the other zone pulls stays low, a pin without a wire follows. So a zone that is reset
//! while the other one heats knows of it in some 40 ms.

/// Excess of equal or of unequal readings, one a millisecond, that decides about the wire: the weak pull changes from each to the next,
/// and a wire that is there stays as it is but for the other zone's checks.
const DRIVEN_READINGS: i8 = 20;
const ABSENT_READINGS: i8 = -DRIVEN_READINGS;

/// Drive of this end of the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WireDrive {
    /// Pulled low: the zone has the supply.
    Low,
    /// Weakly down.
    #[default]
    WeaklyDown,
    /// Weakly up.
    WeaklyUp,
}

/// Knowledge of the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WireState {
    /// Never read: a board without a pin for it.
    #[default]
    Unread,
    /// Not known yet.
    Sought,
    /// There is none: the zone has its supply alone.
    Absent,
    /// Found.
    Present,
}

/// Search for a wire that does not follow the weak pull.
#[derive(Clone, Debug, Default)]
pub struct WireSearch {
    state: WireState,
    /// Level of the last reading.
    was_high: bool,
    /// Readings that were equal to the one before, less those that were not.
    equal: i8,
}

impl WireSearch {
    /// Knowledge of the wire.
    pub fn state(&self) -> WireState {
        self.state
    }

    /// Takes the level of an end with this drive; returns its next drive.
    pub fn seek(&mut self, is_high: bool, drive: WireDrive) -> WireDrive {
        let is_equal = is_high == core::mem::replace(&mut self.was_high, is_high);
        let equal = match self.state {
            WireState::Unread => 0,
            _ if is_equal => self.equal + 1,
            _ => self.equal - 1,
        };
        self.equal = equal.clamp(ABSENT_READINGS, DRIVEN_READINGS);
        self.state = match (self.equal, self.state) {
            (DRIVEN_READINGS.., _) => WireState::Present,
            (..=ABSENT_READINGS, _) => WireState::Absent,
            (_, WireState::Unread) => WireState::Sought,
            (_, wire) => wire,
        };
        match (self.state, drive) {
            (WireState::Present, _) | (_, WireDrive::WeaklyUp) => WireDrive::WeaklyDown,
            _ => WireDrive::WeaklyUp,
        }
    }
}
