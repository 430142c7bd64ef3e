//! Times that both ends reckon with.

/// Half-cycles without a frame from the host after which it no longer answers for the power it
/// asked for, and the device switches off: 10 s at 50 Hz, 8.3 s at 60 Hz.
pub const HOST_UNHEARD_HALF_CYCLES: u32 = 1_000;

/// Half-cycles for which a device keeps a window that it has sent after the host's last request for it: 0.2 s at 50 Hz.
pub const WINDOW_KEPT_HALF_CYCLES: u8 = 20;

/// From the answer to a `Restart` until the device goes, in milliseconds: time for the answer to leave.
pub const RESTART_AFTER_MS: u32 = 100;
