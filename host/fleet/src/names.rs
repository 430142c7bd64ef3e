//! Names of subjects, streams and buckets (docs/fleet.md).

use std::fmt::Display;

/// Version of the JSON messages: the second token of their subjects.
pub const VERSION: &str = "v1";

/// Version of windows and answers ([`crate::wire::VERSION`]): the second token of their subjects.
pub const WIRE: &str = "v2";

/// Windows that wait for a worker: a work queue.
pub const WINDOWS: &str = "IHD_WINDOWS";

/// Results, one a window.
pub const RESULTS: &str = "IHD_RESULTS";

/// Events of hobs.
pub const EVENTS: &str = "IHD_EVENTS";

/// Dead letters: windows that were given up.
pub const DEAD: &str = "IHD_DEAD";

/// Consumer that all workers of this version share; windows of another version wait for workers of that version.
pub const WORKERS: &str = "workers-v2";

/// Consumer of version 1, which took windows of every version.
pub const WORKERS_1: &str = "workers";

/// Bucket of lookups, one key a hob, with their history.
pub const LOOKUPS: &str = "ihd_lookups";

/// Bucket of hobs: identity and state.
pub const HOBS: &str = "ihd_hobs";

/// Bucket of daemons; an entry expires unless it is renewed.
pub const EDGES: &str = "ihd_edges";

/// Bucket of the owners of edge names.
pub const CLAIMS: &str = "ihd_claims";

/// Bucket of workers; an entry expires unless it is renewed.
pub const WORKER_CARDS: &str = "ihd_workers";

/// Bucket of pots identified by the hobs, as starting points for other hobs.
pub const POTS: &str = "ihd_pots";

/// Bucket of the settings of `ihd-fleet init`.
pub const SETTINGS: &str = "ihd_settings";

/// Key of the settings: the firmware's build that hobs should have.
pub const BUILD: &str = "build";

/// Object store of captures.
pub const CAPTURES: &str = "ihd_captures";

/// Stream of the object store.
pub const CAPTURES_STREAM: &str = "OBJ_ihd_captures";

/// Returns the subject of a hob's windows.
pub fn window(hob: impl Display) -> String {
    format!("ihd.{WIRE}.{hob}.window")
}

/// Returns the subject of the result of one window, which holds one message.
pub fn result(hob: impl Display, boot: impl Display, seq: impl Display) -> String {
    format!("ihd.{WIRE}.{hob}.result.{boot}.{seq}")
}

/// Returns hob, boot and number of the window of a result's subject.
pub fn window_of_result(subject: &str) -> Option<(String, u32, u32)> {
    let mut tokens = subject.split('.').skip(2);
    let (hob, kind) = (tokens.next()?, tokens.next()?);
    let (boot, seq) = (tokens.next()?.parse().ok()?, tokens.next()?.parse().ok()?);
    (kind == "result" && tokens.next().is_none()).then(|| (hob.to_owned(), boot, seq))
}

/// Returns the subjects of all results of a hob.
pub fn results(hob: impl Display) -> String {
    format!("ihd.{WIRE}.{hob}.result.>")
}

/// Returns the subject of a window that was given up.
pub fn dead_letter(hob: impl Display, boot: impl Display, seq: impl Display) -> String {
    format!("ihd.{WIRE}.{hob}.dead.{boot}.{seq}")
}

/// Returns the subject of a hob's events.
pub fn event(hob: impl Display) -> String {
    format!("ihd.{VERSION}.{hob}.event")
}

/// Returns the subject of a hob's state, published once a second; no stream stores it.
pub fn state(hob: impl Display) -> String {
    format!("ihd.{VERSION}.{hob}.state")
}

/// Returns the name of the consumer of an edge's results.
pub fn edge_consumer(edge: &str) -> String {
    format!("edge-{edge}")
}

/// Returns the key in the bucket of daemons for an edge whose name is another store's.
pub fn refused_edge(edge: &str) -> String {
    format!("{edge}.refused")
}

/// Returns the name of a bucket's stream.
pub fn bucket_stream(bucket: &str) -> String {
    format!("KV_{bucket}")
}

/// Returns the subject of a bucket's key.
pub fn key(bucket: &str, key: &str) -> String {
    format!("$KV.{bucket}.{key}")
}
