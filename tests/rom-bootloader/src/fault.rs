//! Faults of the chip.

/// A fault, which happens once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The cable is pulled before the request after this many.
    Unplugged {
        /// Requests that are still answered.
        after_requests: u32,
    },
    /// Power goes in the middle of an operation on the flash, which stays half done.
    PowerLost {
        /// Operations that still succeed.
        after_operations: u32,
    },
    /// An operation on the flash does not end.
    StuckBusy {
        /// Operations that still succeed.
        after_operations: u32,
    },
    /// An operation on the flash fails.
    Fails {
        /// Operations that still succeed.
        after_operations: u32,
    },
    /// The bits of the mask do not take when this address is written.
    BadBits {
        /// A byte of the flash.
        address: u32,
        /// Bits that come out inverted.
        mask: u8,
    },
    /// Every write from now on is acknowledged and dropped.
    SilentlyDropped,
}
