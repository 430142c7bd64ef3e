//! Times that both ends reckon with.

/// Half-cycles without a frame from the host after which it no longer answers for the power it
/// asked for, and the device switches off: 10 s at 50 Hz, 8.3 s at 60 Hz.
pub const HOST_UNHEARD_HALF_CYCLES: u32 = 1_000;
