//! The edge's name: this store claims it, or stays out of the fleet.

use std::sync::Arc;
use std::time::Duration;

use ihd_daemon::fleet::host_name;

use super::link::Link;
use super::refusals::RETRY_PAUSE;
use crate::claims::{self, Claim, ClaimVerdict};
use crate::jetstream::JetStreamError;
use crate::message_ids::MessageIds;
use crate::standing::Standing;

/// Period of the checks: a name may be freed, and a store may be moved.
const POLL_PERIOD: Duration = Duration::from_secs(5);

/// Checks the claim of the name until the edge stops.
pub async fn run(link: Arc<Link>) {
    let mut mine = None;
    while link
        .turn_until_stop("name", RETRY_PAUSE, take_turn(&link, &mut mine))
        .await
    {}
}

/// Checks the claim; returns the pause before the next check.
async fn take_turn(link: &Link, mine: &mut Option<Claim>) -> Result<Duration, JetStreamError> {
    if !link.is_reachable() {
        return Ok(RETRY_PAUSE);
    }
    // After a failure the last known standing stays.
    check_claim(link, mine).await?;
    link.works("name");
    Ok(POLL_PERIOD)
}

async fn check_claim(link: &Link, mine: &mut Option<Claim>) -> Result<(), JetStreamError> {
    if mine.is_none() {
        *mine = Some(own_claim(link).await?);
    }
    let Some(mine) = mine else { return Ok(()) };
    // Another claim may be first, once; the second turn reads it.
    for _ in 0..2 {
        let (there, number) = claims::read_claim(&link.server, &link.edge).await?;
        let standing = link.state().standing.clone();
        match mine.judge(&link.edge, there.as_ref(), &standing) {
            ClaimVerdict::Stands(standing) => {
                set_standing(link, standing);
                return Ok(());
            }
            ClaimVerdict::MustClaim => {
                mine.at_ms = link.daemon.view().now_ms();
                if claims::put(&link.server, &link.edge, mine, number).await? {
                    tracing::info!(edge = link.edge, "the edge's name is this store's");
                    set_standing(link, Standing::Held);
                    return Ok(());
                }
            }
        }
    }
    Ok(())
}

async fn own_claim(link: &Link) -> Result<Claim, JetStreamError> {
    let secret = link.daemon.fleet().secret().await;
    let secret = secret.map_err(|e| JetStreamError::new("store", e))?;
    let folder = link.daemon.fleet().store_folder();
    let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    Ok(Claim {
        identity: MessageIds::new(secret).public(),
        host: host_name(),
        store: folder.display().to_string(),
        run: link.run.clone(),
        at_ms: link.daemon.view().now_ms(),
    })
}

fn set_standing(link: &Link, standing: Standing) {
    let mut state = link.state();
    if state.standing == standing {
        return;
    }
    if let Standing::Refused(why) = &standing {
        tracing::error!("{why}; until then it learns by itself, apart from the fleet");
    }
    state.standing = standing;
    drop(state);
    link.renew_delegation();
    link.wake_waiting();
}
