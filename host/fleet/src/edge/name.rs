//! The edge's name: this store claims it, or stays out of the fleet.

use std::sync::Arc;
use std::time::Duration;

use ihd_daemon::fleet::host_name;

use super::{Link, TRY_AGAIN};
use crate::claims::{self, Claim, Standing, Verdict};
use crate::engine::EngineError;
use crate::identity::Identity;

/// Between two looks: a name may be freed, and a store may be moved.
const LOOK_EVERY: Duration = Duration::from_secs(5);

/// Looks after the name until the edge ends.
pub async fn run(link: Arc<Link>) {
    let mut mine = None;
    loop {
        let mut pause = TRY_AGAIN;
        if link.reaches() {
            match link.unless_stopping(look(&link, &mut mine)).await {
                None => return,
                Some(Ok(())) => {
                    link.works("name");
                    pause = LOOK_EVERY;
                }
                // What was known stands.
                Some(Err(why)) => link.failed("name", &why),
            }
        }
        if !link.wait(pause).await {
            return;
        }
    }
}

async fn look(link: &Link, mine: &mut Option<Claim>) -> Result<(), EngineError> {
    if mine.is_none() {
        *mine = Some(claim(link).await?);
    }
    let Some(mine) = mine else { return Ok(()) };
    // Somebody may be faster, once; who that is, is seen then.
    for _ in 0..2 {
        let (there, number) = claims::of_edge(&link.server, &link.edge).await?;
        let standing = link.state().standing.clone();
        match mine.judge(&link.edge, there.as_ref(), &standing) {
            Verdict::Stands(standing) => {
                stand(link, standing);
                return Ok(());
            }
            Verdict::Take => {
                mine.at_ms = link.daemon.now_ms();
                if claims::put(&link.server, &link.edge, mine, number).await? {
                    tracing::info!(edge = link.edge, "the edge's name is this store's");
                    stand(link, Standing::Held);
                    return Ok(());
                }
            }
        }
    }
    Ok(())
}

async fn claim(link: &Link) -> Result<Claim, EngineError> {
    let secret = link.daemon.fleet_secret().await;
    let secret = secret.map_err(|e| EngineError::new("store", e))?;
    let folder = link.daemon.store_folder();
    let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    Ok(Claim {
        identity: Identity::new(secret).public(),
        host: host_name(),
        store: folder.display().to_string(),
        at_ms: link.daemon.now_ms(),
    })
}

fn stand(link: &Link, standing: Standing) {
    let mut state = link.state();
    if state.standing == standing {
        return;
    }
    if let Standing::Refused(why) = &standing {
        tracing::error!("{why}; until then it learns by itself, apart from the fleet");
    }
    state.standing = standing;
    drop(state);
    link.renew();
    link.stir();
}
