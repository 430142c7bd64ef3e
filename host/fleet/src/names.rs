//! Subjects, streams and buckets: each name is written once, here (docs/fleet.md).

use std::fmt::Display;

/// Version of what is JSON: the second token of its subjects.
pub const VERSION: &str = "v1";

/// Version of windows and answers ([`crate::wire::VERSION`]): the second token of their subjects.
pub const WIRE: &str = "v2";

/// Windows that wait for a worker: a work queue.
pub const WINDOWS: &str = "IHD_WINDOWS";

/// Results, one a window.
pub const RESULTS: &str = "IHD_RESULTS";

/// What happened to hobs.
pub const EVENTS: &str = "IHD_EVENTS";

/// Windows that were given up.
pub const DEAD: &str = "IHD_DEAD";

/// The consumer that all workers of this version share: windows of another version wait for workers of that.
pub const WORKERS: &str = "workers-v2";

/// The consumer of version 1, which took windows of every version.
pub const WORKERS_1: &str = "workers";

/// Bucket of lookups, one key a hob, with their history.
pub const LOOKUPS: &str = "ihd_lookups";

/// Bucket of hobs: who they are and how they do.
pub const HOBS: &str = "ihd_hobs";

/// Bucket of daemons; an entry goes when nobody renews it.
pub const EDGES: &str = "ihd_edges";

/// Bucket of who has which edge's name.
pub const CLAIMS: &str = "ihd_claims";

/// Bucket of workers; an entry goes when nobody renews it.
pub const WORKER_CARDS: &str = "ihd_workers";

/// Bucket of pots that some hob knows, for others to begin with.
pub const POTS: &str = "ihd_pots";

/// Bucket of what `ihd fleet init` decided.
pub const SETTINGS: &str = "ihd_settings";

/// Key of the settings: the firmware's build that hobs should have.
pub const BUILD: &str = "build";

/// Object store of captures.
pub const CAPTURES: &str = "ihd_captures";

/// Subject of a hob's windows.
pub fn window(hob: impl Display) -> String {
    format!("ihd.{WIRE}.{hob}.window")
}

/// Subject of the result of one window: no other message may have it.
pub fn result(hob: impl Display, boot: impl Display, seq: impl Display) -> String {
    format!("ihd.{WIRE}.{hob}.result.{boot}.{seq}")
}

/// Hob, boot and number of the window that a result's subject names.
pub fn window_of_result(subject: &str) -> Option<(String, u32, u32)> {
    let mut tokens = subject.split('.').skip(2);
    let (hob, kind) = (tokens.next()?, tokens.next()?);
    let (boot, seq) = (tokens.next()?.parse().ok()?, tokens.next()?.parse().ok()?);
    (kind == "result" && tokens.next().is_none()).then(|| (hob.to_owned(), boot, seq))
}

/// Subjects of all results of a hob.
pub fn results(hob: impl Display) -> String {
    format!("ihd.{WIRE}.{hob}.result.>")
}

/// Subject of a window that was given up.
pub fn dead(hob: impl Display, boot: impl Display, seq: impl Display) -> String {
    format!("ihd.{WIRE}.{hob}.dead.{boot}.{seq}")
}

/// Subject of what happens to a hob.
pub fn event(hob: impl Display) -> String {
    format!("ihd.{VERSION}.{hob}.event")
}

/// Subject of what a hob does now, once a second; no stream keeps it.
pub fn state(hob: impl Display) -> String {
    format!("ihd.{VERSION}.{hob}.state")
}

/// The consumer by which an edge gets the results of its hobs.
pub fn edge_consumer(edge: &str) -> String {
    format!("edge-{edge}")
}

/// Key in the bucket of daemons of one whose name is another one's.
pub fn refused_edge(edge: &str) -> String {
    format!("{edge}.refused")
}

/// The stream that a bucket is.
pub fn bucket_stream(bucket: &str) -> String {
    format!("KV_{bucket}")
}

/// The subject of a bucket's key.
pub fn key(bucket: &str, key: &str) -> String {
    format!("$KV.{bucket}.{key}")
}
