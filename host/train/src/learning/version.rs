//! Version numbers of lookups.

use ihd_shared::lookup::LOOKUP_VERSION_STEP;
use serde::{Deserialize, Serialize};

/// Version numbers in use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Versions {
    /// Version of the lookup that the device uses.
    pub device: u32,
    /// Highest version that was built for it.
    pub offered: u32,
}

impl Versions {
    /// Returns the next lookup's version: newer than the device's by a step that it accepts, and if possible not that of a lookup built
    /// before. `None` after the last number.
    pub fn next(self) -> Option<u32> {
        let highest = self.device.saturating_add(LOOKUP_VERSION_STEP);
        if (self.device..highest).contains(&self.offered) {
            self.offered.checked_add(1)
        } else {
            self.device.checked_add(1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_version_is_newer_than_the_devices_and_within_its_step() {
        let next = |device, offered| Versions { device, offered }.next();
        assert_eq!(next(0, 0), Some(1));
        assert_eq!(next(7, 7), Some(8));
        // Offered and refused: not the same number again.
        assert_eq!(next(7, 9), Some(10));
        // Somebody else has pushed.
        assert_eq!(next(20, 9), Some(21));
        // The device was reset.
        assert_eq!(next(0, 12), Some(13));
        let far = LOOKUP_VERSION_STEP;
        assert_eq!(next(0, far - 1), Some(far));
        assert_eq!(next(0, far), Some(1));
        assert_eq!(next(0, u32::MAX), Some(1));
    }

    #[test]
    fn the_last_version_has_no_next() {
        let next = |device, offered| Versions { device, offered }.next();
        assert_eq!(next(u32::MAX, 0), None);
        assert_eq!(next(u32::MAX, u32::MAX), None);
        assert_eq!(next(u32::MAX - 1, 0), Some(u32::MAX));
        assert_eq!(next(u32::MAX - 1, u32::MAX), Some(u32::MAX));
        let near = u32::MAX - 1;
        assert_eq!(next(u32::MAX - 5, near), Some(u32::MAX));
    }
}
