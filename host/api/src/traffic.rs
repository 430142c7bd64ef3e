//! Requests of one connection: whether one is under way, and whether somebody takes what is answered.
//!
//! Over HTTP/1.1 the head of the next request has its time, and a reader who takes nothing stops the socket. Over HTTP/2 several requests
//! share the socket and each has a window of its own, so that both are seen here alone.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};

use axum::body::{Body, Bytes, HttpBody};
use hyper::body::{Frame, SizeHint};
use tokio::sync::watch;
use tokio::time::{Instant, sleep, timeout};

use crate::connection::{HEAD_TIMEOUT, STALL_TIMEOUT};
use crate::places::Request;

/// Requests of a connection.
#[derive(Clone)]
pub(crate) struct Traffic(Arc<Shared>);

struct Shared {
    /// Number of those under way.
    under_way: watch::Sender<u32>,
    untaken: Mutex<Untaken>,
}

/// Answers of which a part was handed out and the next is not asked for yet, since when.
#[derive(Default)]
struct Untaken {
    next: u64,
    since: BTreeMap<u64, Instant>,
}

impl Default for Traffic {
    fn default() -> Self {
        Self(Arc::new(Shared {
            under_way: watch::channel(0).0,
            untaken: Mutex::default(),
        }))
    }
}

impl Traffic {
    /// A request, under way until it is dropped.
    pub(crate) fn begin(&self) -> Passing {
        self.0.under_way.send_modify(|count| *count += 1);
        let mut untaken = self.untaken();
        untaken.next += 1;
        Passing {
            traffic: self.clone(),
            id: untaken.next,
        }
    }

    fn untaken(&self) -> MutexGuard<'_, Untaken> {
        // Every change is complete in itself.
        let untaken = &self.0.untaken;
        untaken.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ready once no request was under way for [`HEAD_TIMEOUT`].
    pub(crate) async fn rests(&self) {
        let mut under_way = self.0.under_way.subscribe();
        loop {
            // The sender is here.
            let _ = under_way.wait_for(|&count| count == 0).await;
            let next = under_way.wait_for(|&count| count > 0);
            if timeout(HEAD_TIMEOUT, next).await.is_err() {
                return;
            }
        }
    }

    /// Ready once nothing was taken of an answer for [`STALL_TIMEOUT`], or up to half of it later.
    pub(crate) async fn stalls(&self) {
        loop {
            sleep(STALL_TIMEOUT / 2).await;
            let now = Instant::now();
            let waits = |since: &Instant| now.saturating_duration_since(*since) >= STALL_TIMEOUT;
            if self.untaken().since.values().any(waits) {
                return;
            }
        }
    }
}

/// A request under way.
pub(crate) struct Passing {
    traffic: Traffic,
    id: u64,
}

impl Passing {
    fn handed_out(&self) {
        self.traffic.untaken().since.insert(self.id, Instant::now());
    }

    fn is_taken(&self) {
        self.traffic.untaken().since.remove(&self.id);
    }
}

impl Drop for Passing {
    fn drop(&mut self) {
        self.is_taken();
        self.traffic.0.under_way.send_modify(|count| *count -= 1);
    }
}

/// The body of an answer, with which its request ends.
pub(crate) struct UnderWay {
    body: Body,
    passing: Passing,
    _place: Request,
}

impl UnderWay {
    pub(crate) fn new(body: Body, passing: Passing, place: Request) -> Self {
        Self {
            body,
            passing,
            _place: place,
        }
    }
}

impl HttpBody for UnderWay {
    type Data = Bytes;
    type Error = axum::Error;

    /// Is asked for more only when there is room for it.
    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        self.passing.is_taken();
        let part = Pin::new(&mut self.body).poll_frame(cx);
        if let Poll::Ready(Some(_)) = part {
            self.passing.handed_out();
        }
        part
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds until the first of both is ready, on the runtime's own clock, which jumps ahead while everybody waits.
    async fn ends_after_s(traffic: &Traffic) -> u64 {
        let began = Instant::now();
        tokio::select! {
            () = traffic.rests() => {}
            () = traffic.stalls() => {}
        }
        began.elapsed().as_secs()
    }

    #[tokio::test(start_paused = true)]
    async fn a_connection_without_a_request_ends() {
        let traffic = Traffic::default();
        assert_eq!(ends_after_s(&traffic).await, HEAD_TIMEOUT.as_secs());
        let first = traffic.begin();
        let later = async {
            sleep(10 * STALL_TIMEOUT).await;
            drop(first);
        };
        let (after_s, ()) = tokio::join!(ends_after_s(&traffic), later);
        let expected = 10 * STALL_TIMEOUT + HEAD_TIMEOUT;
        assert_eq!(after_s, expected.as_secs());
    }

    #[tokio::test(start_paused = true)]
    async fn an_answer_that_nobody_takes_ends_it_and_a_silent_one_does_not() {
        let traffic = Traffic::default();
        let (silent, stalled) = (traffic.begin(), traffic.begin());
        silent.handed_out();
        silent.is_taken();
        stalled.handed_out();
        let after_s = ends_after_s(&traffic).await;
        let limit_s = STALL_TIMEOUT.as_secs();
        assert!((limit_s..=limit_s * 3 / 2).contains(&after_s), "{after_s}");
        drop(stalled);
        let waiting = timeout(100 * STALL_TIMEOUT, ends_after_s(&traffic));
        assert!(waiting.await.is_err());
        drop(silent);
    }
}
