//! From the fleet to the learner: results of this edge's hobs. A result is acknowledged once it is stored, and comes again until then.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures_util::StreamExt;
use ihd_daemon::fleet::Received;
use ihd_daemon::learning::WorkerAnswer;
use ihd_store::FleetMark;
use tokio::time::Instant;

use super::{Link, TRY_AGAIN, lock, outbox};
use crate::engine::EngineError;
use crate::names;
use crate::server::{Incoming, Results};
use crate::wire::AnswerMessage;

/// Results that are taken in at once.
const AT_ONCE: usize = 32;

/// When a result that could not be stored comes again.
const AGAIN_AFTER: Duration = Duration::from_secs(5);

/// Name under which answers are recorded that nobody can read: their worker's is in them.
const UNREADABLE: &str = "unreadable";

/// How long one request for results waits.
const ASK_FOR: Duration = Duration::from_secs(5);

/// Longest wait for the answer to a request. The client ends it 5 s after its time, answered or not.
const ANSWERED_WITHIN: Duration = Duration::from_secs(ASK_FOR.as_secs() + 4);

/// Takes results in until the edge ends.
pub async fn run(link: Arc<Link>) {
    loop {
        if link.is_admitted() {
            let taken = link.unless_stopping(take(&link)).await;
            match taken {
                None => return,
                Some(Ok(())) => {}
                Some(Err(why)) => link.failed("results", &why),
            }
        }
        link.state().signs.answered(false, Instant::now());
        link.renew();
        if !link.wait(TRY_AGAIN).await {
            return;
        }
    }
}

/// Until the consumer breaks or the server does not answer, or this daemon has other devices.
async fn take(link: &Link) -> Result<(), EngineError> {
    let hobs = link.hobs();
    if hobs.is_empty() {
        return Ok(());
    }
    let results = link.server.results(&link.edge, &hobs).await?;
    known_server(link, &results).await?;
    // The first request may wait for its whole time.
    heard(link);
    while link.hobs() == hobs && link.is_admitted() {
        take_some(link, &results).await?;
        heard(link);
        link.works("results");
    }
    Ok(())
}

/// The server has answered.
fn heard(link: &Link) {
    link.state().signs.answered(true, Instant::now());
    link.renew();
}

/// Takes in the results that one request brings.
async fn take_some(link: &Link, results: &Results) -> Result<(), EngineError> {
    let failed = |why: String| EngineError::new(names::RESULTS, why);
    let asked = Instant::now();
    let fetched = results.fetch(AT_ONCE, ASK_FOR).await.map_err(failed)?;
    let (came, broken) = (AtomicBool::new(false), Mutex::new(None));
    let taken = fetched.for_each_concurrent(AT_ONCE, |message| async {
        match message {
            Ok(message) => {
                came.store(true, Relaxed);
                take_one(link, message).await;
            }
            // The server has lost the consumer, or the connection has ended.
            Err(why) => *lock(&broken) = Some(why),
        }
    });
    taken.await;
    if let Some(why) = lock(&broken).take() {
        return Err(failed(why));
    }
    match came.into_inner() || asked.elapsed() < ANSWERED_WITHIN {
        true => Ok(()),
        false => Err(failed("the server does not answer".to_owned())),
    }
}

/// Sends again what is not answered where the consumer is not the one of before: the server has lost that, and with it what else it had.
async fn known_server(link: &Link, results: &Results) -> Result<(), EngineError> {
    let made = results.made_us();
    let noted = async {
        let before = link.daemon.fleet_mark(FleetMark::ConsumerMade).await?;
        if before.is_some_and(|before| before != made) {
            outbox::send_all_again(link, "the consumer of its results was made anew").await?;
        }
        if before != Some(made) {
            link.daemon
                .mark_fleet(FleetMark::ConsumerMade, made)
                .await?;
        }
        Ok::<_, ihd_daemon::StoreTrouble>(())
    };
    let noted = noted.await;
    noted.map_err(|e| EngineError::new("store", e))
}

async fn take_one(link: &Link, message: Incoming) {
    let AnswerMessage {
        hob,
        boot,
        seq,
        answer,
        ..
    } = match read(link, &message) {
        Ok(read) => read,
        Err(why) => {
            tracing::warn!(subject = message.subject(), why, "an answer cannot be used");
            message.end().await;
            return;
        }
    };
    let by = answer.by.clone();
    match link.daemon.receive(&hob, boot, seq, answer).await {
        Ok(received) => {
            match received {
                Received::Foreign => {
                    tracing::info!(
                        hob,
                        boot,
                        seq,
                        "an answer for a boot that is not known here"
                    );
                }
                Received::Unasked => {
                    tracing::warn!(
                        hob,
                        boot,
                        seq,
                        by,
                        "an answer to a window that the fleet was never sent: refused"
                    );
                }
                Received::Stored | Received::Known => {
                    link.state().answers.came(&(hob, boot, seq));
                }
            }
            // Where this is lost, it comes again and is known.
            message.ack().await;
        }
        Err(why) => {
            tracing::debug!(%why, "an answer is taken in later");
            message.again(AGAIN_AFTER).await;
        }
    }
}

/// Reads an answer, whose subject says for which window it is. One that cannot be read is an answer without R and L: the window is
/// identified here.
fn read(link: &Link, message: &Incoming) -> Result<AnswerMessage, String> {
    let (hob, boot, seq) =
        names::window_of_result(message.subject()).ok_or("its subject names no window")?;
    let unread = |why: String| AnswerMessage {
        hob: hob.clone(),
        boot,
        seq,
        window_at_ms: 0,
        at_ms: link.daemon.now_ms(),
        answer: WorkerAnswer {
            by: UNREADABLE.to_owned(),
            skew_s: None,
            found: Err(why),
            busy: Duration::ZERO,
        },
    };
    let read =
        AnswerMessage::from_bytes(message.payload()).unwrap_or_else(|e| unread(e.to_string()));
    match (&read.hob, read.boot, read.seq) == (&hob, boot, seq) {
        true => Ok(read),
        false => Ok(unread("it says that it is another window's".to_owned())),
    }
}
