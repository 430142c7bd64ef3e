//! One connection: TLS where there is, a head that must come, a token that must be shown, writes that must go. Each stage has its time,
//! and until the last one the connection gives way to others ([`crate::places`]).

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

use crate::places::Place;
use crate::tls::HTTP2;
use crate::traffic::{Traffic, UnderWay};

/// Longest until the head of a request is there: from the connection's beginning, or from the answer before.
pub(crate) const HEAD_TIMEOUT: Duration = Duration::from_secs(10);

/// Longest TLS handshake.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);

/// Longest until a request is let in: the page and the health are there for strangers, too.
pub(crate) const STRANGER_TIMEOUT: Duration = Duration::from_secs(60);

/// Longest that a reader may take nothing of what is written to him.
pub(crate) const STALL_TIMEOUT: Duration = Duration::from_secs(30);

/// How long requests under way have when the server ends.
const FAREWELL: Duration = Duration::from_secs(1);

/// Largest head of a request, and most that is buffered of a connection, in bytes.
const MAX_BUFFER: usize = 16_384;

/// Requests of one connection at a time, over HTTP/2: more than a browser's windows have.
const MAX_STREAMS: u32 = 32;

/// Requests of a connection that its other end has called back and that nobody has looked at yet, and those that break HTTP/2's rules:
/// whoever goes on so loses the connection.
const MAX_RESET_STREAMS: usize = 20;

/// Of a request's body, what may come before it is read, in bytes: as much as a body may have.
const BODY_WINDOW: u32 = 65_536;

/// What the system may hold of a connection that it has not sent: what lies there is old when it comes, and a display wants what is new.
const UNSENT: usize = 16_384;

/// Whether somebody who reads a connection has not taken yet what was written; its routes find it among a request's extensions.
#[derive(Clone, Default)]
pub(crate) struct Stalled(Arc<AtomicBool>);

impl Stalled {
    /// Whether it is so now.
    pub(crate) fn is_stalled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Serves a connection until it ends, for whatever reason; none of them is worth a log line.
pub(crate) async fn serve(
    stream: TcpStream,
    place: Place,
    tls: Option<TlsAcceptor>,
    router: Router,
    stopping: watch::Receiver<bool>,
) {
    // Events are small and must not wait for the next.
    let _ = stream.set_nodelay(true);
    hold_little(&stream);
    let watched = Watched::new(stream, Some(place.clone()));
    let each = Each {
        stalled: watched.stalled.clone(),
        place: place.clone(),
        traffic: Traffic::default(),
        routes: TowerToHyperService::new(router),
    };
    let serving = async {
        match tls {
            None => speak(watched, each, stopping).await,
            Some(tls) => {
                if let Ok(Ok(stream)) = timeout(HANDSHAKE_TIMEOUT, tls.accept(watched)).await {
                    match stream.get_ref().1.alpn_protocol() {
                        Some(HTTP2) => speak_http2(stream, each, stopping).await,
                        _ => speak(stream, each, stopping).await,
                    }
                }
            }
        }
    };
    tokio::select! {
        () = serving => {}
        () = place.gives_way() => {}
        () = remains_a_stranger(&place) => {}
    }
}

/// Ready where nothing was let in for too long.
async fn remains_a_stranger(place: &Place) {
    sleep(STRANGER_TIMEOUT).await;
    if place.is_known() {
        std::future::pending().await
    }
}

/// Connection of a request, for its routes.
#[derive(Clone)]
struct Each {
    stalled: Stalled,
    place: Place,
    traffic: Traffic,
    routes: TowerToHyperService<Router>,
}

impl Each {
    /// Has a request answered.
    fn answer(
        &self,
        mut request: hyper::Request<Incoming>,
    ) -> impl Future<Output = Result<hyper::Response<UnderWay>, Infallible>> + use<> {
        request.extensions_mut().insert(self.stalled.clone());
        request.extensions_mut().insert(self.place.clone());
        let (place, passing) = (self.place.request(), self.traffic.begin());
        let answering = self.routes.call(request);
        async move {
            let answer = answering.await?;
            Ok(answer.map(|body| UnderWay::new(body, passing, place)))
        }
    }
}

/// Without it a slow reader gets megabytes of the past first. Where the system does not take it, he does.
fn hold_little(stream: &TcpStream) {
    let socket = SockRef::from(stream);
    #[cfg(any(target_os = "android", target_os = "linux"))]
    let _ = socket.set_tcp_notsent_lowat(UNSENT as u32);
    #[cfg(not(any(target_os = "android", target_os = "linux")))]
    let _ = socket.set_send_buffer_size(4 * UNSENT);
}

/// HTTP/1.1: one request after the other.
async fn speak<S>(stream: S, each: Each, mut stopping: watch::Receiver<bool>)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let service = service_fn(move |request| each.answer(request));
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
    let _ = timeout(FAREWELL, connection).await;
}

/// HTTP/2: requests beside each other, of which no one keeps another waiting. What HTTP/1.1 has by itself is added: a connection without a
/// request under way ends, and so does one whose reader takes nothing of an answer.
async fn speak_http2<S>(stream: S, each: Each, mut stopping: watch::Receiver<bool>)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let traffic = each.traffic.clone();
    let service = service_fn(move |mut request: hyper::Request<_>| {
        // Its name stands where HTTP/1.1 has the header, which the routes read.
        let name = request.uri().authority().map(|name| name.as_str());
        let name = name.and_then(|name| HeaderValue::from_str(name).ok());
        if let Some(name) = name {
            request.headers_mut().insert(HOST, name);
        }
        each.answer(request)
    });
    let connection = http2::Builder::new(TokioExecutor::new())
        .timer(TokioTimer::new())
        .max_concurrent_streams(MAX_STREAMS)
        .max_header_list_size(MAX_BUFFER as u32)
        .max_pending_accept_reset_streams(MAX_RESET_STREAMS)
        .max_local_error_reset_streams(MAX_RESET_STREAMS)
        .initial_stream_window_size(BODY_WINDOW)
        .initial_connection_window_size(2 * BODY_WINDOW)
        .max_send_buf_size(UNSENT)
        .serve_connection(TokioIo::new(stream), service);
    let mut connection = std::pin::pin!(connection);
    tokio::select! {
        _ = connection.as_mut() => return,
        _ = stopping.wait_for(|stopping| *stopping) => {}
        () = traffic.rests() => {}
        () = traffic.stalls() => return,
    }
    connection.as_mut().graceful_shutdown();
    let _ = timeout(FAREWELL, connection).await;
}

/// A stream that breaks when its reader takes nothing for [`STALL_TIMEOUT`].
struct Watched<S> {
    stream: S,
    patience: Option<Pin<Box<Sleep>>>,
    stalled: Stalled,
    /// Until the first byte has come.
    silent: Option<Place>,
}

impl<S> Watched<S> {
    fn new(stream: S, silent: Option<Place>) -> Self {
        Self {
            stream,
            patience: None,
            stalled: Stalled::default(),
            silent,
        }
    }

    /// Hands on what became of a write; an error when it waits for too long.
    fn judge<T>(
        &mut self,
        cx: &mut Context<'_>,
        written: Poll<io::Result<T>>,
    ) -> Poll<io::Result<T>> {
        let waits = written.is_pending();
        self.stalled.0.store(waits, Ordering::Relaxed);
        if !waits {
            self.patience = None;
            return written;
        }
        let patience = self
            .patience
            .get_or_insert_with(|| Box::pin(sleep(STALL_TIMEOUT)));
        match patience.as_mut().poll(cx) {
            Poll::Ready(()) => Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
            Poll::Pending => Poll::Pending,
        }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Watched<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(cx, buffer);
        if buffer.filled().len() > before
            && let Some(place) = self.silent.take()
        {
            place.speaks();
        }
        read
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Watched<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.judge(cx, written)
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

    /// Takes a byte each time its `rest` has passed.
    struct Slow {
        rest: Duration,
        next: Pin<Box<Sleep>>,
    }

    impl Slow {
        fn new(rest: Duration) -> Watched<Self> {
            let slow = Self {
                rest,
                next: Box::pin(sleep(rest)),
            };
            Watched::new(slow, None)
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

    async fn write(stream: &mut Watched<Slow>) -> io::Result<usize> {
        poll_fn(|cx| Pin::new(&mut *stream).poll_write(cx, b"x")).await
    }

    /// On the runtime's own clock, which jumps ahead while everybody waits.
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
