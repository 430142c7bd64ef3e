//! Requests of one connection: detects that none is in progress, and that the client reads no response.
//!
//! Over HTTP/1.1 hyper limits the time until the next request head, and a client that reads nothing blocks the socket. Over HTTP/2 several
//! requests share the socket, each with its own flow-control window, so that both states can only be detected here.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use hyper::body::{Frame, SizeHint};
use ihd_daemon::locking::lock;
use tokio::sync::watch;
use tokio::time::{Instant, sleep, timeout};

use crate::slots::RequestGuard;

/// Maximum time until a request head is complete, from the start of the connection or from the previous response.
pub(crate) const HEAD_TIMEOUT: Duration = Duration::from_secs(10);

/// Maximum time for which a client may read nothing of what is written to it.
pub(crate) const STALL_TIMEOUT: Duration = Duration::from_secs(30);

/// Requests of a connection.
#[derive(Clone)]
pub(crate) struct Traffic(Arc<Shared>);

struct Shared {
    /// Number of requests in progress.
    active: watch::Sender<u32>,
    unread: Mutex<UnreadResponses>,
}

/// Responses with a frame that was handed out and a next one that was not requested yet.
#[derive(Default)]
struct UnreadResponses {
    next_id: u64,
    /// Time of that frame, by request.
    since: BTreeMap<u64, Instant>,
}

impl Default for Traffic {
    fn default() -> Self {
        Self(Arc::new(Shared {
            active: watch::channel(0).0,
            unread: Mutex::default(),
        }))
    }
}

impl Traffic {
    /// Begins a request, which is in progress until the returned value is dropped.
    pub(crate) fn begin(&self) -> ActiveRequest {
        self.0.active.send_modify(|count| *count += 1);
        let mut unread = self.unread();
        unread.next_id += 1;
        ActiveRequest {
            traffic: self.clone(),
            id: unread.next_id,
        }
    }

    fn unread(&self) -> MutexGuard<'_, UnreadResponses> {
        lock(&self.0.unread)
    }

    /// Completes once no request was in progress for [`HEAD_TIMEOUT`].
    pub(crate) async fn idle(&self) {
        let mut active = self.0.active.subscribe();
        loop {
            // `self` holds the sender: the wait cannot fail.
            let _ = active.wait_for(|&count| count == 0).await;
            let next = active.wait_for(|&count| count > 0);
            if timeout(HEAD_TIMEOUT, next).await.is_err() {
                return;
            }
        }
    }

    /// Completes once a response was not read for [`STALL_TIMEOUT`], or up to half of it later.
    pub(crate) async fn stalled(&self) {
        loop {
            sleep(STALL_TIMEOUT / 2).await;
            let now = Instant::now();
            let is_over = |since: &Instant| now.saturating_duration_since(*since) >= STALL_TIMEOUT;
            if self.unread().since.values().any(is_over) {
                return;
            }
        }
    }
}

/// Request in progress.
pub(crate) struct ActiveRequest {
    traffic: Traffic,
    id: u64,
}

impl ActiveRequest {
    fn frame_sent(&self) {
        self.traffic.unread().since.insert(self.id, Instant::now());
    }

    fn frame_read(&self) {
        self.traffic.unread().since.remove(&self.id);
    }
}

impl Drop for ActiveRequest {
    fn drop(&mut self) {
        self.frame_read();
        self.traffic.0.active.send_modify(|count| *count -= 1);
    }
}

/// Body of a response; its request ends when it is dropped.
pub(crate) struct TrackedBody {
    body: Body,
    request: ActiveRequest,
    _slot: RequestGuard,
}

impl TrackedBody {
    pub(crate) fn new(body: Body, request: ActiveRequest, slot: RequestGuard) -> Self {
        Self {
            body,
            request,
            _slot: slot,
        }
    }
}

impl HttpBody for TrackedBody {
    type Data = Bytes;
    type Error = axum::Error;

    /// hyper polls only if there is room for the next frame: the frame before was read.
    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        self.request.frame_read();
        let frame = Pin::new(&mut self.body).poll_frame(cx);
        if let Poll::Ready(Some(_)) = frame {
            self.request.frame_sent();
        }
        frame
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

    /// Seconds until the first of both completes, on the runtime's paused clock, which jumps ahead while all tasks wait.
    async fn ends_after_s(traffic: &Traffic) -> u64 {
        let began = Instant::now();
        tokio::select! {
            () = traffic.idle() => {}
            () = traffic.stalled() => {}
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
    async fn an_unread_response_ends_the_connection_and_a_silent_one_does_not() {
        let traffic = Traffic::default();
        let (silent, stalled) = (traffic.begin(), traffic.begin());
        silent.frame_sent();
        silent.frame_read();
        stalled.frame_sent();
        let after_s = ends_after_s(&traffic).await;
        let limit_s = STALL_TIMEOUT.as_secs();
        assert!((limit_s..=limit_s * 3 / 2).contains(&after_s), "{after_s}");
        drop(stalled);
        let waiting = timeout(100 * STALL_TIMEOUT, ends_after_s(&traffic));
        assert!(waiting.await.is_err());
        drop(silent);
    }
}
