//! What devices did, second by second, on its way to the store and back.
//!
//! ```text
//! session ─► Seconds (memory, bounded) ── every 5 s ─► store ─► Columns ─► History
//!            seconds.rs                    keeper.rs            columns.rs
//!               └──────── seconds that are not written yet ───────┘
//! ```

mod columns;
mod keeper;
mod seconds;

pub use columns::{Columns, Grid, MAX_COLUMNS};
pub use keeper::{keep, write};
pub use seconds::Seconds;
