//! Names of edges, each of one store: a store that has claimed a name keeps it, wherever the store is moved, until an operator frees it.
//!
//! A claim is a key of the bucket `ihd_claims`. It is put by compare-and-set: of two simultaneous claims the server refuses one.

use async_nats::jetstream::Context;
use serde::{Deserialize, Serialize};

use crate::jetstream::{self, JetStreamError};
use crate::names;
use crate::server::{self, FleetServer};
use crate::status;
use crate::stream_message::{Outgoing, PublishFailure, StoredMessage};

pub use crate::standing::Standing;

/// A name's owner (JSON).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Claim {
    /// Public identity of the owner's store ([`crate::MessageIds::public`]).
    pub identity: String,
    /// Host of the daemon.
    pub host: String,
    /// Folder of the store there.
    pub store: String,
    /// Random id of the run of the daemon: two machines from one disk image have all else in common. Empty from an ihd without it.
    #[serde(default)]
    pub run: String,
    /// Time of the claim in milliseconds since 1970, UTC.
    pub at_ms: i64,
}

/// Consequence of the claim on the server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ClaimVerdict {
    /// The name is free, or this store claimed it in an earlier run or at another place: this daemon claims it.
    MustClaim,
    /// Standing, without a new claim.
    Stands(Standing),
}

impl Claim {
    fn place(&self) -> String {
        format!("the store {} on host {}", self.store, self.host)
    }

    fn is_of_run(&self, other: &Self) -> bool {
        (&self.host, &self.store, &self.run) == (&other.host, &other.store, &other.run)
    }

    /// Compares this claim of the name `edge` with the one on the server. A store keeps its name, wherever it is moved: of its daemons the one
    /// that started last holds it, at once, and one that ran before is refused.
    pub fn judge(&self, edge: &str, there: Option<&Self>, standing: &Standing) -> ClaimVerdict {
        let Some(there) = there else {
            return ClaimVerdict::MustClaim;
        };
        let (mine, other) = (self.place(), there.place());
        if there.identity != self.identity {
            return ClaimVerdict::Stands(Standing::Refused(format!(
                "the edge name {edge:?} belongs to {other}, this is {mine}: give this daemon a name of its own ([fleet] edge), or, where \
                 that store is gone for good, `ihd-fleet init --free {edge}`"
            )));
        }
        match standing {
            _ if there.is_of_run(self) => ClaimVerdict::Stands(Standing::Held),
            Standing::Unknown => ClaimVerdict::MustClaim,
            Standing::Held | Standing::Refused(_) => {
                ClaimVerdict::Stands(Standing::Refused(format!(
                    "the edge name {edge:?} was taken along to {other}, by a copy of {mine} that started later: stop the other daemon, then start this one again"
                )))
            }
        }
    }
}

/// Decodes the claim of a name and the number of its entry, 0 without one.
fn read(
    entry: Result<Option<StoredMessage>, String>,
) -> Result<(Option<Claim>, u64), JetStreamError> {
    let Some(message) = entry.map_err(failed)? else {
        return Ok((None, 0));
    };
    let claim = match message.headers.get("KV-Operation") {
        Some(_) => None,
        None => Some(serde_json::from_slice(&message.payload).map_err(failed)?),
    };
    Ok((claim, message.number))
}

/// Returns the claim of a name and the number of its entry, 0 without one.
///
/// # Errors
/// [`JetStreamError`].
pub(crate) async fn read_claim(
    server: &FleetServer,
    edge: &str,
) -> Result<(Option<Claim>, u64), JetStreamError> {
    let bucket = names::bucket_stream(names::CLAIMS);
    read(server.last(&bucket, names::key(names::CLAIMS, edge)).await)
}

/// Claims a name whose entry has the number `after`; returns `false` if another claim was first.
///
/// # Errors
/// [`JetStreamError`].
pub(crate) async fn put(
    server: &FleetServer,
    edge: &str,
    claim: &Claim,
    after: u64,
) -> Result<bool, JetStreamError> {
    let claim = serde_json::to_vec(claim).map_err(failed)?;
    let message = Outgoing {
        subject: names::key(names::CLAIMS, edge),
        payload: claim.into(),
        number: None,
        after: Some(after),
    };
    match server.publish(message).await.map_err(failed)?.await {
        Ok(_) => Ok(true),
        Err(PublishFailure::Occupied) => Ok(false),
        Err(why) => Err(failed(why)),
    }
}

/// Returns the claimed names: the edges that a fleet should have.
///
/// # Errors
/// [`JetStreamError`].
pub async fn edges(context: &Context) -> Result<Vec<String>, JetStreamError> {
    let entries = jetstream::entries(context, names::CLAIMS).await?;
    Ok(entries.into_keys().collect())
}

/// Frees a name for the next claim, and removes its hobs' cards; returns the former claim, `None` without one.
///
/// # Errors
/// [`JetStreamError`].
pub async fn free(context: &Context, edge: &str) -> Result<Option<Claim>, JetStreamError> {
    let bucket = names::bucket_stream(names::CLAIMS);
    let (claim, _) = read(server::last(context, &bucket, names::key(names::CLAIMS, edge)).await)?;
    if claim.is_some() {
        let bucket = jetstream::bucket(context, names::CLAIMS).await?;
        bucket.delete(edge).await.map_err(failed)?;
    }
    for hob in status::hobs_of(context, edge).await? {
        jetstream::remove(context, names::HOBS, &hob).await?;
    }
    Ok(claim)
}

fn failed(why: impl std::fmt::Display) -> JetStreamError {
    let why = why.to_string();
    // Messages of the server for a missing stream, to a request and to a publication.
    let none = ["no responders", "no stream found"];
    match none.iter().any(|text| why.contains(text)) {
        true => jetstream::missing(names::CLAIMS, "not found"),
        false => jetstream::missing(names::CLAIMS, why),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(identity: &str, host: &str) -> Claim {
        Claim {
            identity: identity.into(),
            host: host.into(),
            store: "/var/lib/ihd/store".into(),
            run: "1".into(),
            at_ms: 0,
        }
    }

    fn refusal(verdict: ClaimVerdict) -> String {
        match verdict {
            ClaimVerdict::Stands(Standing::Refused(why)) => why,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_name_is_of_one_store() {
        let mine = claim("a", "cellar");
        let judge = |there: Option<&Claim>, standing| mine.judge("lab-1", there, &standing);
        assert_eq!(judge(None, Standing::Unknown), ClaimVerdict::MustClaim);
        let held = ClaimVerdict::Stands(Standing::Held);
        assert_eq!(judge(Some(&mine), Standing::Unknown), held);
        assert_eq!(judge(Some(&mine), Standing::Held), held);
        for standing in [Standing::Unknown, Standing::Held] {
            let why = refusal(judge(Some(&claim("b", "attic")), standing));
            for word in ["lab-1", "cellar", "attic", "/var/lib/ihd/store", "--free"] {
                assert!(why.contains(word), "{why}");
            }
        }
        // Freed, or the server lost it.
        assert_eq!(
            judge(None, Standing::Refused(String::new())),
            ClaimVerdict::MustClaim
        );
        assert_eq!(judge(None, Standing::Held), ClaimVerdict::MustClaim);
    }

    #[test]
    fn a_store_that_was_moved_takes_its_name_along_and_the_old_place_hears_of_it() {
        let (before, after) = (claim("a", "cellar"), claim("a", "attic"));
        let moved = after.judge("lab-1", Some(&before), &Standing::Unknown);
        assert_eq!(moved, ClaimVerdict::MustClaim);
        let why = refusal(before.judge("lab-1", Some(&after), &Standing::Held));
        assert!(why.contains("cellar") && why.contains("attic"), "{why}");
        let still = before.judge("lab-1", Some(&after), &Standing::Refused(why.clone()));
        assert_eq!(refusal(still), why);
    }

    #[test]
    fn of_two_daemons_from_one_disk_image_the_later_has_the_name() {
        let first = claim("a", "cellar");
        let second = Claim {
            run: "2".into(),
            ..first.clone()
        };
        // Also where the second is the first, started again after `kill -9`.
        let started = second.judge("lab-1", Some(&first), &Standing::Unknown);
        assert_eq!(started, ClaimVerdict::MustClaim);
        let held = second.judge("lab-1", Some(&second), &Standing::Unknown);
        assert_eq!(held, ClaimVerdict::Stands(Standing::Held));
        let why = refusal(first.judge("lab-1", Some(&second), &Standing::Held));
        assert!(why.contains("lab-1") && why.contains("later"), "{why}");
    }
}
