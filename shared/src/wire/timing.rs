//! Times that both ends reckon with.

/// Time without a request from the host after which the power that it asked for ends, in milliseconds.
pub const HOST_UNHEARD_MS: u32 = 10_000;

/// Half-cycles for which a device keeps a window that it has sent after the host's last request for it: 0.2 s at 50 Hz.
pub const WINDOW_KEPT_HALF_CYCLES: u8 = 20;

/// From the answer to a `Restart` until the device goes, in milliseconds: time for the answer to leave.
pub const RESTART_AFTER_MS: u32 = 100;
