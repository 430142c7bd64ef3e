//! What devices do now, for whoever watches: a bounded ring of extremes a device, which each watcher empties at
//! its own pace, and which waits for none.
//!
//! ```text
//! session ─► LiveRing (600 buckets of 0.1 s) ◄─ LiveTap of a watcher: what is new since it last asked
//!            ring.rs                             tap.rs
//! ```

mod ring;
mod tap;

pub use ring::{LiveRing, heats};
pub use tap::LiveTap;
