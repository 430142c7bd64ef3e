//! Browser sessions: a token is presented once; the cookie is inaccessible to scripts and other sites.

use std::io::{Read, Write};
use std::sync::Arc;
use std::time::Duration;

use ihd_api::access::tokens::Tokens;
use ihd_model::Role;
use rustls::crypto::ring;
use ureq::Agent;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};

use crate::http::{ask, connect, header, whole};
use crate::rig::Running;

const JSON: &str = "Content-Type: application/json";
const ME: &str = "ihd-holder: test";
const OFF: &str = r#"{"command":"off"}"#;
const COMMANDS: &str = "POST /api/v1/devices/serial%3A%2Fdev%2Ftty%20%C3%A4/commands";
const SESSION: &str = "/api/v1/session";

fn with_tokens() -> (Running, Tokens) {
    let server = Running::with_hobs(|options, dir| options.token_file = Some(dir.join("tokens")));
    let tokens = Tokens::read(&server.dir.path().join("tokens")).unwrap();
    (server, tokens)
}

/// Presents a token; returns the header `Cookie` for further requests.
fn cookie(server: &Running, token: &str) -> String {
    let body = format!("{{\"token\":\"{token}\"}}");
    let line = format!("POST {SESSION}");
    let (status, head, _) = whole(server.address, &line, &[JSON], &body);
    assert_eq!(status, 204, "{head}");
    let set = header(&head, "set-cookie").unwrap();
    for attribute in ["httponly", "samesite=strict", "path=/"] {
        assert!(set.split("; ").any(|a| a == attribute), "{set}");
    }
    assert!(!set.contains("domain"), "{set}");
    format!("Cookie: a=b; {}", set.split(';').next().unwrap())
}

#[test]
fn the_cookie_is_good_for_what_its_token_is() {
    let (server, tokens) = with_tokens();
    for role in Role::ALL {
        let cookie = cookie(&server, tokens.at_least(role).unwrap());
        let (status, body) = ask(server.address, &format!("GET {SESSION}"), &[&cookie], "");
        assert_eq!(status, 200);
        let expected = format!(
            "{{\"role\":\"{}\",\"token_needed\":true,\"fleet\":false}}",
            role.name()
        );
        assert_eq!(body, expected);
        let (status, _) = ask(server.address, "GET /api/v1/devices", &[&cookie], "");
        assert_eq!(status, 200);
        let (status, _) = ask(server.address, COMMANDS, &[&cookie, JSON, ME], OFF);
        assert_eq!(status, if role == Role::Read { 403 } else { 200 });
    }
}

#[test]
fn a_wrong_token_gets_no_cookie_and_is_not_told_again() {
    let (server, tokens) = with_tokens();
    let right = tokens.at_least(Role::Read).unwrap();
    for wrong in ["", "x", &"0".repeat(64), &right[1..]] {
        let body = format!("{{\"token\":\"{wrong}\"}}");
        let line = format!("POST {SESSION}");
        let (status, head, answer) = whole(server.address, &line, &[JSON], &body);
        assert_eq!(status, 401, "{wrong}");
        assert_eq!(header(&head, "set-cookie"), None);
        let answer = String::from_utf8(answer).unwrap();
        assert!(answer.contains("\"error\":\"token\""), "{answer}");
        assert!(wrong.len() < 2 || !answer.contains(wrong), "{answer}");
    }
    // The token itself is no session.
    let as_key = format!("Cookie: ihd-session={right}");
    assert_eq!(
        ask(server.address, "GET /api/v1/devices", &[&as_key], "").0,
        401
    );
    let wrong = format!("Cookie: ihd-session={}", "0".repeat(64));
    assert_eq!(
        ask(server.address, "GET /api/v1/devices", &[&wrong], "").0,
        401
    );
    assert_eq!(
        ask(server.address, &format!("GET {SESSION}"), &[], "").0,
        401
    );
    // A token in the URL is not accepted: it would appear in logs and histories.
    let line = format!("GET /api/v1/devices?token={right}");
    assert_eq!(ask(server.address, &line, &[], "").0, 401);
}

#[test]
fn a_header_outranks_the_cookie() {
    let (mut server, tokens) = with_tokens();
    let cookie = cookie(&server, tokens.at_least(Role::Operate).unwrap());
    let read = format!(
        "Authorization: Bearer {}",
        tokens.at_least(Role::Read).unwrap()
    );
    let (status, _) = ask(server.address, COMMANDS, &[&cookie, &read, JSON, ME], OFF);
    assert_eq!(status, 403);
    let wrong = format!("Authorization: Bearer {}", "0".repeat(64));
    let (status, _) = ask(server.address, COMMANDS, &[&cookie, &wrong, JSON, ME], OFF);
    assert_eq!(status, 401);
    assert_eq!(server.commands(), []);
}

#[test]
fn forgetting_ends_the_session_and_deletes_the_cookie() {
    let (server, tokens) = with_tokens();
    let token = tokens.at_least(Role::Read).unwrap();
    let (gone, other) = (cookie(&server, token), cookie(&server, token));
    assert!(
        gone != other && !gone.contains(token),
        "a session is no token"
    );
    let status_of = |cookie: &str| ask(server.address, "GET /api/v1/devices", &[cookie], "").0;
    assert_eq!((status_of(&gone), status_of(&other)), (200, 200));
    let line = format!("DELETE {SESSION}");
    let (status, head, _) = whole(server.address, &line, &[&gone], "");
    assert_eq!(status, 204);
    let set = header(&head, "set-cookie").unwrap();
    assert!(set.starts_with("ihd-session=; max-age=0"), "{set}");
    // A copy of the cookie is invalid, too.
    assert_eq!((status_of(&gone), status_of(&other)), (401, 200));
    // Presenting the token once more closes the previous session.
    let body = format!("{{\"token\":\"{token}\"}}");
    let line = format!("POST {SESSION}");
    assert_eq!(ask(server.address, &line, &[JSON, &other], &body).0, 204);
    assert_eq!(status_of(&other), 401);
}

#[test]
fn a_stream_is_use_of_its_session_and_ends_with_it() {
    const HOURS_11: Duration = Duration::from_secs(11 * 3600);
    for path in ["/api/v1/live", "/api/v1/events"] {
        let (server, clock) = Running::with_clock_and(|options, dir| {
            options.token_file = Some(dir.join("tokens"));
        });
        let tokens = Tokens::read(&server.dir.path().join("tokens")).unwrap();
        let cookie = cookie(&server, tokens.at_least(Role::Read).unwrap());
        let mut stream = connect(server.address);
        write!(
            stream,
            "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{cookie}\r\n\r\n"
        )
        .unwrap();
        stream.read_exact(&mut [0; 15]).unwrap();
        for _ in 0..3 {
            clock.pass(HOURS_11);
        }
        let line = format!("DELETE {SESSION}");
        let get = || ask(server.address, "GET /api/v1/devices", &[&cookie], "").0;
        assert_eq!(get(), 200, "{path}");
        assert_eq!(ask(server.address, &line, &[&cookie], "").0, 204);
        assert_eq!(get(), 401);
        clock.pass(Duration::from_secs(1));
        // Returns at the end of the stream.
        stream.read_to_end(&mut Vec::new()).unwrap();
    }
}

#[test]
fn a_cookie_lets_another_sites_page_command_and_read_nothing() {
    // A browser does not send this cookie with requests of other sites; if one does, the request is refused.
    let (mut server, tokens) = with_tokens();
    let cookie = cookie(&server, tokens.at_least(Role::Operate).unwrap());
    for foreign in [
        "Origin: https://evil.example",
        "Origin: null",
        "Sec-Fetch-Site: cross-site",
        // Another server on this machine is the same site: requests of its page carry the cookie.
        "Sec-Fetch-Site: same-site",
        "Origin: http://localhost:1",
    ] {
        for headers in [
            vec![&cookie[..], JSON, ME, foreign],
            vec![&cookie[..], foreign],
        ] {
            let (status, body) = ask(server.address, COMMANDS, &headers, OFF);
            assert_eq!(status, 403, "{foreign}: {body}");
        }
        // It must not open a session with another token either (login CSRF).
        let body = format!("{{\"token\":\"{}\"}}", tokens.at_least(Role::Read).unwrap());
        let line = format!("POST {SESSION}");
        assert_eq!(ask(server.address, &line, &[JSON, foreign], &body).0, 403);
    }
    assert_eq!(server.commands(), []);
    for site in ["cross-site", "same-site"] {
        for mode in ["cors", "no-cors", "same-origin"] {
            let (site, mode) = (
                format!("Sec-Fetch-Site: {site}"),
                format!("Sec-Fetch-Mode: {mode}"),
            );
            for path in ["/api/v1/events", "/api/v1/live", "/api/v1/devices", SESSION] {
                let headers = [&cookie[..], &site, &mode, "Accept: text/event-stream"];
                let (status, body) = ask(server.address, &format!("GET {path}"), &headers, "");
                assert_eq!(status, 403, "{path} {site} {mode}: {body}");
            }
        }
    }
}

#[test]
fn without_tokens_there_is_nothing_to_show() {
    let server = Running::start();
    let (status, body) = ask(server.address, &format!("GET {SESSION}"), &[], "");
    assert_eq!(
        (status, &*body),
        (
            200,
            "{\"role\":\"operate\",\"token_needed\":false,\"fleet\":false}"
        )
    );
    let line = format!("POST {SESSION}");
    let (status, head, _) = whole(server.address, &line, &[JSON], "{\"token\":\"x\"}");
    assert_eq!((status, header(&head, "set-cookie")), (204, None));
}

#[test]
fn under_tls_the_cookie_goes_nowhere_else() {
    let server = Running::with(|settings, dir| {
        settings.token_file = Some(dir.join("tokens"));
        settings.tls = Some(ihd_api::tls::Certificate::Generated {
            folder: dir.join("tls"),
        });
    });
    let tokens = Tokens::read(&server.dir.path().join("tokens")).unwrap();
    let token = tokens.at_least(Role::Read).unwrap();
    let pem = std::fs::read(server.certificate.as_ref().unwrap()).unwrap();
    let root = match parse_pem(&pem).next() {
        Some(Ok(PemItem::Certificate(root))) => root,
        _ => panic!("no certificate in {:?}", server.certificate),
    };
    let tls = TlsConfig::builder()
        .unversioned_rustls_crypto_provider(Arc::new(ring::default_provider()))
        .root_certs(RootCerts::Specific(Arc::new(vec![root])));
    let agent = Agent::config_builder().tls_config(tls.build()).proxy(None);
    let agent = agent.build().new_agent();
    let request = agent.post(format!("{}{SESSION}", server.url));
    let answer = request.send_json(serde_json::json!({ "token": token }));
    let answer = answer.unwrap();
    let set = answer.headers()["set-cookie"].to_str().unwrap();
    assert!(set.split("; ").any(|a| a == "Secure"), "{set}");
}
