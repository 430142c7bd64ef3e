//! One connection: TLS handshake, request head, admission, writes. Each stage has its time limit, and the connection may be evicted in
//! favour of others ([`crate::slots`]).

use std::convert::Infallible;
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::Router;
use axum::http::HeaderValue;
use axum::http::header::HOST;
use hyper::body::Incoming;
use hyper::server::conn::{http1, http2};
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use socket2::SockRef;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::watch;
use tokio::time::{Sleep, sleep, timeout};
use tokio_rustls::TlsAcceptor;

use crate::slots::Slot;
use crate::tls::HTTP2;
use crate::traffic::{HEAD_TIMEOUT, STALL_TIMEOUT, TrackedBody, Traffic};

/// Maximum duration of the TLS handshake.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);

/// Maximum time until a request is admitted; the page and `/healthz` are served before that.
pub(crate) const ADMISSION_TIMEOUT: Duration = Duration::from_secs(60);

/// Time that requests in progress have when the server ends.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(1);

/// Maximum size of a request head and of the buffer of a connection, in bytes.
const MAX_BUFFER: usize = 16_384;

/// Maximum number of simultaneous requests of an HTTP/2 connection; more than the windows of a browser need.
const MAX_STREAMS: u32 = 32;

/// Maximum number of requests that the client has reset before they were accepted, and of requests that violate HTTP/2. One more ends the
/// connection.
const MAX_RESET_STREAMS: usize = 20;

/// Maximum size of a request body, in bytes; a lookup as JSON has 3 kB.
pub(crate) const MAX_BODY_BYTES: usize = 65_536;

/// Flow-control window of a request body, in bytes.
const BODY_WINDOW: u32 = MAX_BODY_BYTES as u32;

/// Maximum of unsent data that the system may buffer for a connection, in bytes: buffered telemetry is old when it arrives.
const MAX_UNSENT: usize = 16_384;

/// State of a connection's writes, for its routes; among the extensions of each request.
#[derive(Clone, Default)]
pub(crate) struct WriteStall(Arc<AtomicBool>);

impl WriteStall {
    /// Returns `true` while a write waits for the client to read.
    pub(crate) fn is_stalled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Serves a connection until it ends. The reason is not logged.
pub(crate) async fn serve(
    stream: TcpStream,
    slot: Slot,
    tls: Option<TlsAcceptor>,
    router: Router,
    stopping: watch::Receiver<bool>,
) {
    // Events are small and must not wait for the next one (Nagle).
    let _ = stream.set_nodelay(true);
    limit_unsent(&stream);
    let stream = MonitoredStream::new(stream, Some(slot.clone()));
    let handler = RequestHandler {
        stall: stream.stall.clone(),
        slot: slot.clone(),
        traffic: Traffic::default(),
        routes: TowerToHyperService::new(router),
    };
    let serving = async {
        match tls {
            None => serve_http1(stream, handler, stopping).await,
            Some(tls) => {
                if let Ok(Ok(stream)) = timeout(HANDSHAKE_TIMEOUT, tls.accept(stream)).await {
                    match stream.get_ref().1.alpn_protocol() {
                        Some(HTTP2) => serve_http2(stream, handler, stopping).await,
                        _ => serve_http1(stream, handler, stopping).await,
                    }
                }
            }
        }
    };
    tokio::select! {
        () = serving => {}
        () = slot.evicted() => {}
        () = admission_timed_out(&slot) => {}
    }
}

/// Completes if no request was admitted within [`ADMISSION_TIMEOUT`].
async fn admission_timed_out(slot: &Slot) {
    sleep(ADMISSION_TIMEOUT).await;
    if slot.is_admitted() {
        std::future::pending().await
    }
}

/// Passes the requests of a connection to the routes.
#[derive(Clone)]
struct RequestHandler {
    stall: WriteStall,
    slot: Slot,
    traffic: Traffic,
    routes: TowerToHyperService<Router>,
}

impl RequestHandler {
    /// Returns the response to a request.
    fn handle(
        &self,
        mut request: hyper::Request<Incoming>,
    ) -> impl Future<Output = Result<hyper::Response<TrackedBody>, Infallible>> + use<> {
        request.extensions_mut().insert(self.stall.clone());
        request.extensions_mut().insert(self.slot.clone());
        let (slot, active) = (self.slot.begin_request(), self.traffic.begin());
        let responding = self.routes.call(request);
        async move {
            let response = responding.await?;
            Ok(response.map(|body| TrackedBody::new(body, active, slot)))
        }
    }
}

/// Limits unsent data of a connection: without it a slow client first receives megabytes of old data. Best effort.
fn limit_unsent(stream: &TcpStream) {
    let socket = SockRef::from(stream);
    #[cfg(any(target_os = "android", target_os = "linux"))]
    let _ = socket.set_tcp_notsent_lowat(MAX_UNSENT as u32);
    #[cfg(not(any(target_os = "android", target_os = "linux")))]
    let _ = socket.set_send_buffer_size(4 * MAX_UNSENT);
}

/// Serves HTTP/1.1: one request after the other.
async fn serve_http1<S>(stream: S, handler: RequestHandler, mut stopping: watch::Receiver<bool>)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let service = service_fn(move |request| handler.handle(request));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_TIMEOUT)
        .max_buf_size(MAX_BUFFER)
        .serve_connection(TokioIo::new(stream), service);
    let mut connection = std::pin::pin!(connection);
    tokio::select! {
        _ = connection.as_mut() => return,
        _ = stopping.wait_for(|stopping| *stopping) => {}
    }
    connection.as_mut().graceful_shutdown();
    let _ = timeout(SHUTDOWN_TIMEOUT, connection).await;
}

/// Serves HTTP/2: simultaneous requests. Adds two limits that HTTP/1.1 has already: a connection ends if it has no request in progress, or
/// if its client does not read a response.
async fn serve_http2<S>(stream: S, handler: RequestHandler, mut stopping: watch::Receiver<bool>)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let traffic = handler.traffic.clone();
    let service = service_fn(move |mut request: hyper::Request<_>| {
        // HTTP/2 has the host name in `:authority`; the routes read the header `Host`.
        let name = request.uri().authority().map(|name| name.as_str());
        let name = name.and_then(|name| HeaderValue::from_str(name).ok());
        if let Some(name) = name {
            request.headers_mut().insert(HOST, name);
        }
        handler.handle(request)
    });
    let connection = http2::Builder::new(TokioExecutor::new())
        .timer(TokioTimer::new())
        .max_concurrent_streams(MAX_STREAMS)
        .max_header_list_size(MAX_BUFFER as u32)
        .max_pending_accept_reset_streams(MAX_RESET_STREAMS)
        .max_local_error_reset_streams(MAX_RESET_STREAMS)
        .initial_stream_window_size(BODY_WINDOW)
        .initial_connection_window_size(2 * BODY_WINDOW)
        .max_send_buf_size(MAX_UNSENT)
        .serve_connection(TokioIo::new(stream), service);
    let mut connection = std::pin::pin!(connection);
    tokio::select! {
        _ = connection.as_mut() => return,
        _ = stopping.wait_for(|stopping| *stopping) => {}
        () = traffic.idle() => {}
        () = traffic.stalled() => return,
    }
    connection.as_mut().graceful_shutdown();
    let _ = timeout(SHUTDOWN_TIMEOUT, connection).await;
}

/// Stream whose writes fail once the client has read nothing for [`STALL_TIMEOUT`].
struct MonitoredStream<S> {
    stream: S,
    /// Time limit of a write that waits.
    deadline: Option<Pin<Box<Sleep>>>,
    stall: WriteStall,
    /// `Some` until the first byte is received.
    silent: Option<Slot>,
}

impl<S> MonitoredStream<S> {
    fn new(stream: S, silent: Option<Slot>) -> Self {
        Self {
            stream,
            deadline: None,
            stall: WriteStall::default(),
            silent,
        }
    }

    /// Returns the result of a write, or an error if it has waited for [`STALL_TIMEOUT`].
    fn limit_wait<T>(
        &mut self,
        cx: &mut Context<'_>,
        written: Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        let waits = written.is_pending();
        self.stall.0.store(waits, Ordering::Relaxed);
        if !waits {
            self.deadline = None;
            return written;
        }
        let deadline = self
            .deadline
            .get_or_insert_with(|| Box::pin(sleep(STALL_TIMEOUT)));
        match deadline.as_mut().poll(cx) {
            Poll::Ready(()) => Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
            Poll::Pending => Poll::Pending,
        }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for MonitoredStream<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(cx, buffer);
        if buffer.filled().len() > before
            && let Some(slot) = self.silent.take()
        {
            slot.first_byte_received();
        }
        read
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for MonitoredStream<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.limit_wait(cx, written)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use std::future::poll_fn;

    use tokio::time::Instant;

    use super::*;

    /// Accepts one byte after each `rest`.
    struct Slow {
        rest: Duration,
        next: Pin<Box<Sleep>>,
    }

    impl Slow {
        fn new(rest: Duration) -> MonitoredStream<Self> {
            let slow = Self {
                rest,
                next: Box::pin(sleep(rest)),
            };
            MonitoredStream::new(slow, None)
        }
    }

    impl AsyncWrite for Slow {
        fn poll_write(
            mut self: Pin<&mut Self>,
            cx: &mut Context<'_>,
            _: &[u8],
        ) -> Poll<io::Result<usize>> {
            std::task::ready!(self.next.as_mut().poll(cx));
            self.next = Box::pin(sleep(self.rest));
            Poll::Ready(Ok(1))
        }

        fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }

        fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }
    }

    async fn write(stream: &mut MonitoredStream<Slow>) -> io::Result<usize> {
        poll_fn(|cx| Pin::new(&mut *stream).poll_write(cx, b"x")).await
    }

    /// On the runtime's paused clock, which jumps ahead while all tasks wait.
    #[tokio::test(start_paused = true)]
    async fn a_reader_that_takes_nothing_loses_the_connection() {
        let began = Instant::now();
        let mut stream = Slow::new(Duration::from_secs(3_600));
        let error = write(&mut stream).await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        assert_eq!(began.elapsed().as_secs(), STALL_TIMEOUT.as_secs());
    }

    #[tokio::test(start_paused = true)]
    async fn a_slow_reader_keeps_it() {
        let mut stream = Slow::new(STALL_TIMEOUT / 2);
        for _ in 0..5 {
            assert_eq!(write(&mut stream).await.unwrap(), 1);
        }
    }
}
