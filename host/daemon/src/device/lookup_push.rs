//! Push of a lookup that is not active yet.

use ihd_shared::lookup::RlLookup;
use tokio::time::Instant;

use super::request::ReplySender;

/// Lookup that the device has accepted and does not use yet.
pub struct LookupPush {
    pub(super) lookup: RlLookup,
    pub(super) deadline: Instant,
    pub(super) is_learned: bool,
    pub(super) reply: Option<ReplySender>,
}
