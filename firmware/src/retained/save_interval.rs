//! Limit of the flash's wear by lookups, of which a host may push any number.

/// Time from save to save, in milliseconds: ten thousand erasures of each of two pages last for two weeks of a host that pushes
/// without end.
const INTERVAL_MS: u32 = 60_000;

/// Lookups saved, at the most one every [`INTERVAL_MS`]. One that comes earlier is in use, and is saved later unless a newer one
/// replaces it; a loss of power before that costs a push.
#[derive(Debug)]
pub struct SaveInterval {
    /// Count of changes of the last save.
    saved_changes: u32,
    /// Time of the last save.
    saved_ms: u32,
}

impl SaveInterval {
    /// Returns `true` if the lookup in use is to be saved now; `changes` counts the lookups that became active since boot.
    pub fn begin(&mut self, changes: u32, now_ms: u32) -> bool {
        let begins =
            changes != self.saved_changes && now_ms.wrapping_sub(self.saved_ms) >= INTERVAL_MS;
        if begins {
            (self.saved_changes, self.saved_ms) = (changes, now_ms);
        }
        begins
    }
}

impl Default for SaveInterval {
    /// Permits the first save at once.
    fn default() -> Self {
        Self {
            saved_changes: 0,
            saved_ms: 0u32.wrapping_sub(INTERVAL_MS),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_host_that_pushes_without_end_gets_one_save_a_minute() {
        let mut saves = SaveInterval::default();
        // The clock wraps meanwhile.
        let begin_ms = u32::MAX - 90_000;
        assert!(!saves.begin(0, begin_ms));
        let count = (0..600_000u32).step_by(100).filter(|after_ms| {
            let changes = after_ms / 100 + 1;
            saves.begin(changes, begin_ms.wrapping_add(*after_ms))
        });
        assert_eq!(count.count(), 10);
    }

    #[test]
    fn the_newest_lookup_is_saved_once_when_the_minute_is_over() {
        let mut saves = SaveInterval::default();
        assert!(saves.begin(1, 5_000));
        assert!(!saves.begin(2, 6_000));
        assert!(!saves.begin(3, 64_999));
        assert!(saves.begin(3, 65_000));
        assert!(!saves.begin(3, 500_000));
        assert!(saves.begin(4, 500_001));
    }
}
