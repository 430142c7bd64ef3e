//! A lookup in RAM that is known to be the one that was checked.

use core::ops::Deref;

use ihd_shared::lookup::RlLookup;

/// The active lookup with the CRC-32 of what it was when it became active. It is read like a lookup, and replaced as a
/// whole.
#[derive(Clone, Debug)]
pub struct GuardedLookup {
    lookup: RlLookup,
    crc: u32,
}

impl GuardedLookup {
    /// Guards a lookup as it is now.
    pub fn new(lookup: RlLookup) -> Self {
        let crc = crc(&lookup);
        Self { lookup, crc }
    }

    /// Returns `true` if it is unchanged. Some 10 000 cycles.
    pub fn is_intact(&self) -> bool {
        crc(&self.lookup) == self.crc
    }
}

/// The CRC at the end of a lookup's bytes. One of all bytes, that one included, would be the same for every lookup.
fn crc(lookup: &RlLookup) -> u32 {
    let [.., a, b, c, d] = lookup.to_bytes();
    u32::from_le_bytes([a, b, c, d])
}

impl Deref for GuardedLookup {
    type Target = RlLookup;

    fn deref(&self) -> &RlLookup {
        &self.lookup
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ihd_shared::lookup::prior::prior;
    use ihd_shared::wire::frame::CRC32;

    #[test]
    fn a_flipped_bit_is_found_wherever_it_is() {
        let whole = GuardedLookup::new(prior());
        assert!(whole.is_intact());
        let mut version = whole.clone();
        version.lookup.version ^= 1 << 31;
        assert!(!version.is_intact());
        let mut bytes = prior().to_bytes();
        let cell = bytes.len() / 2;
        bytes[cell] ^= 1;
        let end = bytes.len() - 4;
        let crc = CRC32.checksum(&bytes[..end]);
        bytes[end..].copy_from_slice(&crc.to_le_bytes());
        let changed = RlLookup::from_bytes(&bytes).expect("one unit of a cell is plausible");
        let mut cell = whole.clone();
        cell.lookup = changed;
        assert!(!cell.is_intact());
        let mut guard = whole;
        guard.crc ^= 1;
        assert!(!guard.is_intact());
    }
}
