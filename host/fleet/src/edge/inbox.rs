//! Results of this edge's hobs, from the fleet to the learner. A result is acknowledged once it is stored, and redelivered until then.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures_util::StreamExt;
use ihd_daemon::fleet::ReceiveOutcome;
use ihd_daemon::learning::WorkerAnswer;
use ihd_daemon::locking::lock;
use ihd_store::FleetMark;
use tokio::time::Instant;

use super::link::{Link, RESULTS};
use super::outbox;
use super::refusals::RETRY_PAUSE;
use super::trust::WindowKey;
use crate::jetstream::JetStreamError;
use crate::names;
use crate::server::{Incoming, ResultConsumer};
use crate::wire::AnswerMessage;

/// Results processed at once.
const RESULT_BATCH: usize = 32;

/// Delay of the redelivery of a result that could not be stored.
const AGAIN_AFTER: Duration = Duration::from_secs(5);

/// Name of the worker of an unreadable answer, which contains the real one.
const UNREADABLE: &str = "unreadable";

/// Duration of one request for results.
const REQUEST_TIME: Duration = Duration::from_secs(5);

/// Longest wait for the answer to a request. The client ends a request 5 s after its duration in any case.
const ANSWERED_WITHIN: Duration = Duration::from_secs(REQUEST_TIME.as_secs() + 4);

/// Period of reading the consumer again while it lacks a hob.
const LACKING_PERIOD: Duration = Duration::from_secs(30);

/// Receives results until the edge stops.
pub async fn run(link: Arc<Link>) {
    while link
        .turn_until_stop(RESULTS, RETRY_PAUSE, take_turn(&link))
        .await
    {}
}

/// Receives results as long as the server answers; returns the pause before the next attempt.
async fn take_turn(link: &Link) -> Result<Duration, JetStreamError> {
    if link.is_admitted()
        && let Err(why) = receive_results(link).await
    {
        link.failed(RESULTS, &why);
    }
    link.state().signs.answered(false, Instant::now());
    link.renew_delegation();
    Ok(RETRY_PAUSE)
}

/// Receives results until the consumer fails, the server does not answer or the daemon's devices change.
async fn receive_results(link: &Link) -> Result<(), JetStreamError> {
    let hobs = link.hobs();
    if hobs.is_empty() {
        return Ok(());
    }
    let results = link.server.results(&link.edge, &hobs).await?;
    detect_lost_data(link, &results).await?;
    let (is_whole, read) = (note_missing(link, &results, &hobs), Instant::now());
    // The first request may last for its whole duration.
    record_answer(link);
    while link.hobs() == hobs && link.is_admitted() && (is_whole || read.elapsed() < LACKING_PERIOD)
    {
        receive_batch(link, &results).await?;
        record_answer(link);
        link.works(RESULTS);
    }
    Ok(())
}

/// Records the hobs whose results do not arrive: their windows are not sent meanwhile. Returns `true` if there are none.
fn note_missing(link: &Link, results: &ResultConsumer, hobs: &[String]) -> bool {
    let missing = results.missing(hobs);
    for hob in hobs {
        if missing.contains(&hob.as_str()) {
            let (edge, all) = (&link.edge, hobs.join(","));
            let why = format!(
                "its answers would not arrive, so its windows are not sent: the operator adds it, `ihd-fleet init --edge {edge}={all}`"
            );
            link.lacks(RESULTS, hob, &why);
        } else {
            link.accepted(RESULTS, hob);
        }
    }
    missing.is_empty()
}

/// Records that the server has answered.
fn record_answer(link: &Link) {
    link.state().signs.answered(true, Instant::now());
    link.renew_delegation();
}

/// Receives the results of one request.
async fn receive_batch(link: &Link, results: &ResultConsumer) -> Result<(), JetStreamError> {
    let failed = |why: String| JetStreamError::new(names::RESULTS, why);
    let asked = Instant::now();
    let fetched = results
        .fetch(RESULT_BATCH, REQUEST_TIME)
        .await
        .map_err(failed)?;
    let (came, broken) = (AtomicBool::new(false), Mutex::new(None));
    let received = fetched.for_each_concurrent(RESULT_BATCH, |message| async {
        match message {
            Ok(message) => {
                came.store(true, Relaxed);
                receive_one(link, message).await;
            }
            // The server has lost the consumer, or the connection has ended.
            Err(why) => *lock(&broken) = Some(why),
        }
    });
    received.await;
    if let Some(why) = lock(&broken).take() {
        return Err(failed(why));
    }
    match came.into_inner() || asked.elapsed() < ANSWERED_WITHIN {
        true => Ok(()),
        false => Err(failed("the server does not answer".to_owned())),
    }
}

/// Sends unanswered windows again if the consumer is a new one: the server has lost the former one, and with it all other data.
async fn detect_lost_data(link: &Link, results: &ResultConsumer) -> Result<(), JetStreamError> {
    let made = results.made_us();
    let noted = async {
        let before = link.daemon.fleet().mark(FleetMark::ConsumerMade).await?;
        if before.is_some_and(|before| before != made) {
            outbox::resend_all(link, "the consumer of its results was made anew").await?;
        }
        if before != Some(made) {
            link.daemon
                .fleet()
                .set_mark(FleetMark::ConsumerMade, made)
                .await?;
        }
        Ok::<_, ihd_daemon::StoreThreadError>(())
    };
    let noted = noted.await;
    noted.map_err(|e| JetStreamError::new("store", e))
}

async fn receive_one(link: &Link, message: Incoming) {
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
            message.terminate().await;
            return;
        }
    };
    let (by, key) = (answer.by.clone(), (hob.clone(), boot, seq));
    match link.daemon.fleet().receive(&hob, boot, seq, answer).await {
        Ok(received) => {
            match received {
                ReceiveOutcome::Foreign => {
                    let is_first = link.state().oddities.foreign(&key);
                    if is_first {
                        let what =
                            "an answer for a boot that is not known here; further ones are counted";
                        tracing::warn!(hob, boot, seq, what);
                    }
                }
                ReceiveOutcome::Unrequested => {
                    let is_first = link.state().oddities.unrequested(key, &by);
                    if is_first {
                        let what = "an answer to a window that the fleet was never sent: refused; further ones are counted";
                        tracing::warn!(hob, boot, seq, by, what);
                    }
                }
                ReceiveOutcome::Stored | ReceiveOutcome::Duplicate | ReceiveOutcome::TooLate => {
                    link.state().answers.remove(&key);
                }
            }
            // If this is lost, it comes again and is a duplicate.
            message.ack().await;
        }
        Err(why) => {
            tracing::debug!(%why, "an answer is taken in later");
            message.redeliver(AGAIN_AFTER).await;
        }
    }
}

/// Takes a window in as one without an answer, because its answer does not arrive: it is identified here.
pub(super) async fn receive_nothing(link: &Link, (hob, boot, seq): &WindowKey) {
    let answer = no_answer("the place of its answer was taken".to_owned());
    let received = link.daemon.fleet().receive(hob, *boot, *seq, answer).await;
    match received {
        Ok(_) => {
            let key = (hob.clone(), *boot, *seq);
            let mut state = link.state();
            state.answers.remove(&key);
            state.oddities.settled(&key);
        }
        // It stays unanswered until the next call.
        Err(why) => tracing::debug!(%why, "a window without an answer is taken in later"),
    }
}

fn no_answer(why: String) -> WorkerAnswer {
    WorkerAnswer {
        by: UNREADABLE.to_owned(),
        skew_s: None,
        load: Err(why),
        busy: Duration::ZERO,
    }
}

/// Reads an answer; its subject names the window. An unreadable one counts as an answer without R and L: the window is identified
/// here.
fn read(link: &Link, message: &Incoming) -> Result<AnswerMessage, String> {
    let (hob, boot, seq) =
        names::window_of_result(message.subject()).ok_or("its subject names no window")?;
    let unread = |why: String| AnswerMessage {
        hob: hob.clone(),
        boot,
        seq,
        window_at_ms: 0,
        at_ms: link.daemon.view().now_ms(),
        answer: no_answer(why),
    };
    let read =
        AnswerMessage::from_bytes(message.payload()).unwrap_or_else(|e| unread(e.to_string()));
    match (&read.hob, read.boot, read.seq) == (&hob, boot, seq) {
        true => Ok(read),
        false => Ok(unread("it says that it is another window's".to_owned())),
    }
}
