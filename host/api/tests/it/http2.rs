//! HTTP/2 over TLS: several streams in one connection, with the limits of HTTP/1.1.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use h2::client::{Builder, SendRequest};
use h2::{Reason, RecvStream};
use hyper::{Request, Response};
use ihd_api::ServerOptions;
use ihd_api::access::tokens::Tokens;
use ihd_api::tls::Certificate;
use ihd_model::Role;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use tokio::net::TcpStream;
use tokio::runtime::Runtime;
use tokio::task::JoinHandle;
use tokio_rustls::TlsConnector;

use crate::rig::{Clock, Running};

const OFF: &str = "/api/v1/devices/serial%3A%2Fdev%2Ftty%20%C3%A4/commands";

fn server() -> (Running, Clock) {
    Running::with_clock_and(with_tls)
}

fn with_tls(options: &mut ServerOptions, dir: &Path) {
    options.token_file = Some(dir.join("tokens"));
    options.tls = Some(Certificate::Generated {
        folder: dir.join("tls"),
    });
}

/// Connection of a client.
struct Connection {
    requests: SendRequest<Bytes>,
    token: String,
    authority: String,
    ended: JoinHandle<Result<(), h2::Error>>,
}

impl Connection {
    async fn open(server: &Running) -> Self {
        Self::with(server, &Builder::new()).await
    }

    async fn with(server: &Running, builder: &Builder) -> Self {
        let mut roots = rustls::RootCertStore::empty();
        let file = server.certificate.as_ref().unwrap();
        roots
            .add(CertificateDer::from_pem_file(file).unwrap())
            .unwrap();
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let mut config = rustls::ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(roots)
            .with_no_client_auth();
        config.alpn_protocols = vec![b"h2".to_vec(), b"http/1.1".to_vec()];
        let stream = TcpStream::connect(server.address).await.unwrap();
        let name = ServerName::from(server.address.ip());
        let connector = TlsConnector::from(Arc::new(config));
        let stream = connector.connect(name, stream).await.unwrap();
        assert_eq!(stream.get_ref().1.alpn_protocol(), Some(&b"h2"[..]));
        let (requests, connection) = builder.handshake(stream).await.unwrap();
        let tokens = Tokens::read(&server.dir.path().join("tokens")).unwrap();
        Self {
            requests,
            token: tokens.at_least(Role::Operate).unwrap().to_owned(),
            authority: server.address.to_string(),
            ended: tokio::spawn(connection),
        }
    }

    async fn ask(
        &self,
        method: &str,
        path: &str,
        body: &str,
    ) -> Result<Response<RecvStream>, h2::Error> {
        let request = Request::builder()
            .method(method)
            .uri(format!("https://{}{path}", self.authority))
            .header("authorization", format!("Bearer {}", self.token))
            .header("ihd-holder", "Ada")
            .header("content-type", "application/json")
            .body(())
            .unwrap();
        let mut requests = self.requests.clone().ready().await?;
        let (answer, mut sending) = requests.send_request(request, body.is_empty())?;
        if !body.is_empty() {
            sending.send_data(Bytes::copy_from_slice(body.as_bytes()), true)?;
        }
        answer.await
    }

    /// Returns status and body of a finite response.
    async fn whole(&self, method: &str, path: &str, body: &str) -> (u16, String) {
        let answer = self.ask(method, path, body).await.unwrap();
        let status = answer.status().as_u16();
        let (mut body, mut text) = (answer.into_body(), Vec::new());
        while let Some(part) = body.data().await {
            let part = part.unwrap();
            body.flow_control().release_capacity(part.len()).unwrap();
            text.extend_from_slice(&part);
        }
        (status, String::from_utf8(text).unwrap())
    }

    async fn is_served(&self) {
        assert_eq!(self.whole("GET", "/api/v1/devices", "").await.0, 200);
    }
}

/// A browser opens at most six HTTP/1.1 connections; here a seventh request is answered.
#[test]
fn six_streams_of_events_and_off_share_one_connection() {
    let (mut server, _clock) = Running::with_hobs_and_clock(with_tls);
    Runtime::new().unwrap().block_on(async {
        let page = Connection::open(&server).await;
        let mut streams = Vec::new();
        for k in 0..6 {
            let path = if k % 2 == 0 {
                "/api/v1/events"
            } else {
                "/api/v1/live"
            };
            let answer = page.ask("GET", path, "").await.unwrap();
            assert_eq!(answer.status(), 200);
            let mut events = answer.into_body();
            assert!(!events.data().await.unwrap().unwrap().is_empty());
            streams.push(events);
        }
        page.is_served().await;
        let (status, said) = page.whole("POST", OFF, r#"{"command":"off"}"#).await;
        assert_eq!(status, 200, "{said}");
        let (_, metrics) = page.whole("GET", "/metrics", "").await;
        assert!(
            metrics.contains("\nihd_http_connections_total 1\n"),
            "{metrics}"
        );
    });
    assert_eq!(server.commands(), [("Ada".into(), "off".into())]);
}

#[test]
fn a_name_that_is_not_the_servers_is_refused() {
    let (server, _clock) = server();
    Runtime::new().unwrap().block_on(async {
        let mut page = Connection::open(&server).await;
        page.authority = "hob.example".to_owned();
        let (status, said) = page.whole("GET", "/api/v1/devices", "").await;
        assert!(status >= 400, "{status}: {said}");
    });
}

/// The clock is paused: no time-out frees a slot.
#[test]
fn strangers_give_way_to_who_has_a_token() {
    let (server, _clock) = Running::with_hobs_and_clock(with_tls);
    Runtime::new().unwrap().block_on(async {
        let known = Connection::open(&server).await;
        known.is_served().await;
        let mut strangers = Vec::new();
        for k in 0..100 {
            let mut stranger = Connection::open(&server).await;
            stranger.token = "none".to_owned();
            if k % 2 == 0 {
                let (status, _) = stranger.whole("GET", "/api/v1/devices", "").await;
                assert_eq!(status, 401);
            }
            strangers.push(stranger);
        }
        let off = r#"{"command":"off"}"#;
        assert_eq!(known.whole("POST", OFF, off).await.0, 200);
        let late = Connection::open(&server).await;
        assert_eq!(late.whole("POST", OFF, off).await.0, 200);
        let ended = strangers.into_iter().take(50).map(|s| s.ended);
        for ended in ended {
            let _ = ended.await.unwrap();
        }
    });
}

#[test]
fn a_connection_without_a_request_ends_after_its_time_and_one_with_a_stream_stays() {
    let (server, clock) = server();
    Runtime::new().unwrap().block_on(async {
        let (idle, watching) = (
            Connection::open(&server).await,
            Connection::open(&server).await,
        );
        idle.is_served().await;
        let answer = watching.ask("GET", "/api/v1/live", "").await.unwrap();
        let mut live = answer.into_body();
        for _ in 0..60 {
            // Reading keeps this connection; only the idle one can end.
            let part = live.data().await.unwrap().unwrap();
            live.flow_control().release_capacity(part.len()).unwrap();
            clock.pass(Duration::from_secs(1));
        }
        let _ = idle.ended.await.unwrap();
        watching.is_served().await;
    });
}

/// The flow-control window of the stream stays closed, while the socket is read.
#[test]
fn a_reader_that_takes_nothing_loses_the_connection() {
    let (server, clock) = server();
    Runtime::new().unwrap().block_on(async {
        let mut shut = Builder::new();
        shut.initial_window_size(10);
        let page = Connection::with(&server, &shut).await;
        let answer = page.ask("GET", "/api/v1/live", "").await.unwrap();
        let _untaken = answer.into_body();
        // Further requests on the connection do not count as reading.
        let mut passed_s = 0;
        while page.ask("GET", "/healthz", "").await.is_ok() {
            clock.pass(Duration::from_secs(1));
            passed_s += 1;
            assert!(passed_s < 60, "it goes on");
        }
        assert!(passed_s >= 30, "{passed_s} s");
    });
}

/// Requests that are reset at once cost the server work and the client nothing (CVE-2023-44487): the connection is closed.
#[test]
fn a_flood_of_requests_that_are_called_back_ends_its_connection() {
    let (server, _clock) = server();
    Runtime::new().unwrap().block_on(async {
        let page = Connection::open(&server).await;
        let mut called_back = 0_u32;
        let end = loop {
            let mut requests = match page.requests.clone().ready().await {
                Ok(requests) => requests,
                Err(error) => break error,
            };
            let request = Request::get(format!("https://{}/healthz", page.authority)).body(());
            match requests.send_request(request.unwrap(), true) {
                Ok((_, mut sending)) => sending.send_reset(Reason::CANCEL),
                Err(error) => break error,
            }
            called_back += 1;
            assert!(called_back < 1_000_000, "it goes on");
            if called_back.is_multiple_of(1_000) {
                tokio::task::yield_now().await;
            }
        };
        assert!(end.is_go_away() || end.is_io(), "{end}");
        Connection::open(&server).await.is_served().await;
    });
}

#[test]
fn no_more_than_its_share_of_requests_is_under_way_and_no_head_is_too_large() {
    let (server, _clock) = server();
    Runtime::new().unwrap().block_on(async {
        let page = Connection::open(&server).await;
        page.is_served().await;
        assert_eq!(page.requests.current_max_send_streams(), 32);
        let long = "y".repeat(20_000);
        let request = Request::get(format!("https://{}/healthz", page.authority))
            .header("x", long)
            .body(())
            .unwrap();
        let mut requests = page.requests.clone().ready().await.unwrap();
        let refused = requests.send_request(request, true);
        let status = match refused {
            Ok((answer, _)) => answer.await.map(|answer| answer.status().as_u16()),
            Err(error) => Err(error),
        };
        assert!(!matches!(status, Ok(200)), "{status:?}");
        page.is_served().await;
    });
}
