//! From the fleet to the learner: results of this edge's hobs. A result is acknowledged once it is stored, and comes again until then.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use async_nats::jetstream::consumer::{Consumer, pull};
use async_nats::jetstream::{self, AckKind};
use futures_util::StreamExt;
use ihd_daemon::fleet::Received;
use ihd_daemon::learning::Answer;
use ihd_store::FleetMark;
use tokio::time::Instant;

use super::{Link, TRY_AGAIN, lock, now_ms, outbox};
use crate::engine::{self, EngineError};
use crate::names;
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
    let consumer = consumer(link, &hobs).await?;
    known_server(link, &consumer).await?;
    // The first request may wait for its whole time.
    heard(link);
    while link.hobs() == hobs && link.is_admitted() {
        take_some(link, &consumer).await?;
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
async fn take_some(link: &Link, consumer: &Consumer<pull::Config>) -> Result<(), EngineError> {
    let failed = |why: String| EngineError::new(names::RESULTS, why);
    let asked = Instant::now();
    let fetched = consumer.fetch().max_messages(AT_ONCE).expires(ASK_FOR);
    let fetched = fetched.messages().await;
    let fetched = fetched.map_err(|e| failed(e.to_string()))?;
    let (came, broken) = (AtomicBool::new(false), Mutex::new(None));
    let taken = fetched.for_each_concurrent(AT_ONCE, |message| async {
        match message {
            Ok(message) => {
                came.store(true, Relaxed);
                take_one(link, message).await;
            }
            // The server has lost the consumer, or the connection has ended.
            Err(why) => *lock(&broken) = Some(why.to_string()),
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
async fn known_server(link: &Link, consumer: &Consumer<pull::Config>) -> Result<(), EngineError> {
    let made = consumer.cached_info().created.unix_timestamp_nanos() / 1_000;
    let made = i64::try_from(made).unwrap_or(0);
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

/// The one that the operator has made; on a server where every key may do all, it is made and kept up to date.
async fn consumer(link: &Link, hobs: &[String]) -> Result<Consumer<pull::Config>, EngineError> {
    let config = engine::edge_consumer(&link.edge, hobs);
    let context = &link.context;
    let made = context.create_consumer_on_stream(config, names::RESULTS);
    if let Ok(consumer) = made.await {
        return Ok(consumer);
    }
    let name = names::edge_consumer(&link.edge);
    let found = context.get_consumer_from_stream(&name, names::RESULTS);
    found.await.map_err(|e| {
        let (edge, hobs) = (&link.edge, hobs.join(","));
        let why = format!("{e}: the operator makes it, `ihd fleet init --edge {edge}={hobs}`");
        EngineError::new(&name, why)
    })
}

async fn take_one(link: &Link, message: jetstream::Message) {
    let AnswerMessage {
        hob,
        boot,
        seq,
        answer,
        ..
    } = match read(&message) {
        Ok(read) => read,
        Err(why) => {
            tracing::warn!(subject = %message.subject, why, "an answer cannot be used");
            let _ = message.ack_with(AckKind::Term).await;
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
            let _ = message.ack().await;
        }
        Err(why) => {
            tracing::debug!(%why, "an answer is taken in later");
            let _ = message.ack_with(AckKind::Nak(Some(AGAIN_AFTER))).await;
        }
    }
}

/// Reads an answer, whose subject says for which window it is. One that cannot be read is an answer without R and L: the window is
/// identified here.
fn read(message: &jetstream::Message) -> Result<AnswerMessage, String> {
    let (hob, boot, seq) =
        names::window_of_result(&message.subject).ok_or("its subject names no window")?;
    let unread = |why: String| AnswerMessage {
        hob: hob.clone(),
        boot,
        seq,
        window_at_ms: 0,
        at_ms: now_ms(),
        answer: Answer {
            by: UNREADABLE.to_owned(),
            skew_s: None,
            found: Err(why),
            busy: Duration::ZERO,
        },
    };
    let read =
        AnswerMessage::from_bytes(&message.payload).unwrap_or_else(|e| unread(e.to_string()));
    match (&read.hob, read.boot, read.seq) == (&hob, boot, seq) {
        true => Ok(read),
        false => Ok(unread("it says that it is another window's".to_owned())),
    }
}
