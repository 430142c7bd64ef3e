//! Link: commands from a host, and the frames that leave for it.
//!
//! ```text
//! bytes ─► housekeeping ─┬─► control (power, faults)
//!            │           ├─► replay, lookup
//!            │           └─► service ─► board: tests, restart
//!            └─ responses ─► transmit_queue ─► frames
//! ```
//!
//! Everything here runs in the thread, below the sampling interrupt; nothing waits for the host.

pub mod active_lookup;
pub mod channel_test;
pub mod conversation;
pub mod frame_writer;
pub mod housekeeping;
pub mod identity;
pub mod link_test_sender;
pub mod log_ring;
pub mod log_sender;
pub mod replay;
pub mod report;
pub mod response;
pub mod service;
pub mod transmit_queue;
pub mod window_sender;
