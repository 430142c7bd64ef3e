//! The handshake: what a `Hello` carries and when two of them fit.

use core::fmt;

use super::messages::{Hello, SCHEMA_HASH};
use super::messages::{PROTOCOL_MAJOR, PROTOCOL_MINOR};

/// "IHD1" read as a little-endian word.
pub const MAGIC: u32 = u32::from_le_bytes(*b"IHD1");

/// The samples come from a simulation.
pub const CAP_SIMULATED: u32 = 1 << 0;

/// The device is in replay mode: its samples come from a host, its power outputs are locked off.
pub const CAP_REPLAYING: u32 = 1 << 1;

/// Role of a host in [`Hello::role`].
pub const ROLE_HOST: u8 = 0;

/// Role of a device in [`Hello::role`].
pub const ROLE_DEVICE: u8 = 1;

/// Reason that two ends do not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mismatch {
    /// The peer's hello does not carry [`MAGIC`].
    NotIhd,
    /// Both ends have the same role.
    SameRole,
    /// Another major protocol version.
    Major {
        /// Our major version.
        ours: u16,
        /// The peer's.
        theirs: u16,
    },
    /// The same version number over different message tables (an unreleased build).
    Schema {
        /// Our hash.
        ours: u64,
        /// The peer's.
        theirs: u64,
    },
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotIhd => write!(f, "the peer does not speak the ihd protocol"),
            Self::SameRole => write!(f, "both ends are of the same kind (host or device)"),
            Self::Major { ours, theirs } => write!(
                f,
                "protocol major version {theirs} on the peer, {ours} here: flash the firmware \
                 that belongs to this host, or use the host that belongs to this firmware"
            ),
            Self::Schema { ours, theirs } => write!(
                f,
                "message tables differ ({theirs:016x} on the peer, {ours:016x} here) under one \
                 version number: build host and firmware from the same commit"
            ),
        }
    }
}

impl core::error::Error for Mismatch {}

/// Our own hello, for a role; strings longer than their field are cut.
pub fn ours(role: u8, capabilities: u32, boot_id: u32, build: &str, board: &str) -> Hello {
    Hello {
        magic: MAGIC,
        role,
        protocol_major: PROTOCOL_MAJOR,
        protocol_minor: PROTOCOL_MINOR,
        schema_hash: SCHEMA_HASH,
        capabilities,
        boot_id,
        reset_reason: 0,
        fault_before_reset: 0,
        build: cut(build),
        board: cut(board),
    }
}

fn cut<const N: usize>(text: &str) -> heapless::String<N> {
    let mut s = heapless::String::new();
    for c in text.chars() {
        if s.push(c).is_err() {
            break;
        }
    }
    s
}

/// Checks that the peer's hello fits ours.
///
/// # Errors
/// The [`Mismatch`] that keeps the two from talking.
pub fn check(ours: &Hello, theirs: &Hello) -> Result<(), Mismatch> {
    if theirs.magic != MAGIC {
        return Err(Mismatch::NotIhd);
    }
    if theirs.role == ours.role {
        return Err(Mismatch::SameRole);
    }
    if theirs.protocol_major != ours.protocol_major {
        return Err(Mismatch::Major {
            ours: ours.protocol_major,
            theirs: theirs.protocol_major,
        });
    }
    if theirs.protocol_minor == ours.protocol_minor && theirs.schema_hash != ours.schema_hash {
        return Err(Mismatch::Schema {
            ours: ours.schema_hash,
            theirs: theirs.schema_hash,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair() -> (Hello, Hello) {
        (
            ours(ROLE_HOST, 0, 1, "ihd 0.1.0", "host"),
            ours(ROLE_DEVICE, CAP_SIMULATED, 2, "ihd-firmware 0.1.0", "sim"),
        )
    }

    #[test]
    fn builds_of_one_commit_fit() {
        let (host, device) = pair();
        assert_eq!(check(&host, &device), Ok(()));
        assert_eq!(check(&device, &host), Ok(()));
    }

    #[test]
    fn a_newer_minor_fits_whatever_its_hash() {
        let (host, mut device) = pair();
        device.protocol_minor += 1;
        device.schema_hash ^= 1;
        assert_eq!(check(&host, &device), Ok(()));
    }

    #[test]
    fn each_mismatch_is_reported() {
        let (host, device) = pair();
        let with = |change: fn(&mut Hello)| {
            let mut d = device.clone();
            change(&mut d);
            check(&host, &d).unwrap_err()
        };
        assert_eq!(with(|d| d.magic = 0), Mismatch::NotIhd);
        assert_eq!(with(|d| d.role = ROLE_HOST), Mismatch::SameRole);
        assert!(matches!(
            with(|d| d.protocol_major += 1),
            Mismatch::Major { .. }
        ));
        assert!(matches!(
            with(|d| d.schema_hash ^= 1),
            Mismatch::Schema { .. }
        ));
    }

    #[test]
    fn long_names_are_cut_not_refused() {
        let h = ours(
            ROLE_HOST,
            0,
            0,
            "a build name that is longer than the field is",
            "x",
        );
        assert_eq!(h.build.len(), 32);
    }
}
