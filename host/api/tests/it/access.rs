//! Refused requests, with status and message.

use ihd_api::access::tokens::Tokens;
use ihd_daemon::simulation::DiskState;
use ihd_model::Role;
use ihd_model::StoreFailure;

use crate::http::{ask, raw};
use crate::rig::Running;

const OFF: &str = r#"{"command":"off"}"#;
const JSON: &str = "Content-Type: application/json";
const ME: &str = "ihd-holder: test";
const COMMANDS: &str = "POST /api/v1/devices/serial%3A%2Fdev%2Ftty%20%C3%A4/commands";

/// All routes, each with a method that it has.
const ROUTES: [&str; 25] = [
    "GET /",
    "GET /healthz",
    "GET /metrics",
    "GET /api/v1/openapi.json",
    "GET /api/v1/devices",
    "GET /api/v1/devices/x",
    "GET /api/v1/devices/x/lookups",
    "GET /api/v1/devices/x/results",
    "GET /api/v1/events",
    "GET /api/v1/hob",
    "GET /api/v1/fleet",
    "GET /api/v1/journal",
    "GET /api/v1/devices/x/history",
    "GET /api/v1/devices/x/windows",
    "GET /api/v1/devices/x/window",
    "GET /api/v1/devices/x/training",
    "GET /api/v1/devices/x/map",
    "POST /api/v1/devices/x/commands",
    "PUT /api/v1/devices/x/lease",
    "DELETE /api/v1/devices/x/lease",
    "POST /api/v1/store/backup",
    "GET /api/v1/session",
    "POST /api/v1/session",
    "DELETE /api/v1/session",
    "GET /page/index.html",
];

/// Routes that need no token.
const OPEN: [&str; 5] = [
    "GET /",
    "GET /healthz",
    "GET /page/index.html",
    "POST /api/v1/session",
    "DELETE /api/v1/session",
];

#[test]
fn a_foreign_name_is_refused_on_every_route() {
    let server = Running::start();
    for route in ROUTES.into_iter().chain(["GET /nowhere"]) {
        for host in ["Host: evil.example", "Host: localhost.evil.example", "X: y"] {
            let (status, body) = raw(server.address, route, &[host], "");
            let expected = if host == "X: y" {
                [400, 421]
            } else {
                [421, 421]
            };
            assert!(
                expected.contains(&status),
                "{route} {host}: {status} {body}"
            );
            assert!(!body.contains("bench"), "{body}");
        }
    }
    let with_port = format!("Host: 127.0.0.1:{}", server.address.port());
    assert_eq!(
        raw(server.address, "GET /healthz", &[&with_port], "").0,
        200
    );
}

#[test]
fn another_sites_page_commands_nothing() {
    let mut server = Running::with_hobs(|_, _| {});
    for foreign in [
        "Origin: https://evil.example",
        "Origin: null",
        "Sec-Fetch-Site: cross-site",
        "Sec-Fetch-Site: same-site",
        // Another port of this machine is another origin.
        "Origin: http://localhost:1",
    ] {
        let (status, body) = ask(server.address, COMMANDS, &[JSON, ME, foreign], OFF);
        assert_eq!(status, 403, "{foreign}: {body}");
        assert!(body.contains("cross-site"), "{body}");
    }
    assert_eq!(server.commands(), []);
    // The same from its own page, and from a program.
    for own in [
        "Origin: http://localhost",
        "Sec-Fetch-Site: same-origin",
        "X: y",
    ] {
        let (status, body) = ask(server.address, COMMANDS, &[JSON, ME, own], OFF);
        assert_eq!(status, 200, "{own}: {body}");
    }
    assert_eq!(server.commands().len(), 3);
}

#[test]
fn another_sites_script_reads_nothing_and_its_link_opens() {
    let server = Running::start();
    let cross = "Sec-Fetch-Site: cross-site";
    assert_eq!(
        ask(server.address, "GET /api/v1/devices", &[cross], "").0,
        403
    );
    let followed = [cross, "Sec-Fetch-Mode: navigate"];
    assert_eq!(ask(server.address, "GET /", &followed, "").0, 200);
}

#[test]
fn a_form_cannot_command() {
    // What a page may send without asking first: no header of its own, no JSON.
    let mut server = Running::start();
    for kind in ["text/plain", "application/x-www-form-urlencoded"] {
        let kind = format!("Content-Type: {kind}");
        assert_eq!(ask(server.address, COMMANDS, &[&kind, ME], OFF).0, 415);
    }
    assert_eq!(ask(server.address, COMMANDS, &[ME], OFF).0, 415);
    let clear = r#"{"command":"clear-fault"}"#;
    let (status, body) = ask(server.address, COMMANDS, &[JSON], clear);
    assert_eq!(status, 400, "{body}");
    assert!(body.contains("ihd-holder"), "{body}");
    assert_eq!(server.commands(), []);
}

#[test]
fn off_needs_no_name() {
    let mut server = Running::with_hobs(|_, _| {});
    for holder in ["X: y", "ihd-holder:", "ihd-holder: \u{e4}"] {
        let (status, body) = ask(server.address, COMMANDS, &[JSON, holder], OFF);
        assert_eq!(status, 200, "{holder}: {body}");
    }
    assert_eq!(server.commands().len(), 3);
}

#[test]
fn without_the_right_token_nothing_but_health() {
    let mut server =
        Running::with_hobs(|options, dir| options.token_file = Some(dir.join("tokens")));
    let tokens = Tokens::read(&server.dir.path().join("tokens")).unwrap();
    let bearer = |role| format!("Authorization: Bearer {}", tokens.at_least(role).unwrap());
    let wrong = format!("Authorization: Bearer {}", "0".repeat(64));
    for route in ROUTES.into_iter().chain(["GET /nowhere"]) {
        for header in ["X: y", wrong.as_str(), "Authorization: Basic eA=="] {
            let (status, body) = ask(server.address, route, &[header], "");
            if OPEN.contains(&route) {
                assert_ne!(status, 401, "{route} {header}: {body}");
                continue;
            }
            assert_eq!(status, 401, "{route} {header}: {body}");
            assert!(body.contains("\"token\""), "{route}: {body}");
        }
    }
    let read = bearer(Role::Read);
    assert_eq!(ask(server.address, "GET /metrics", &[&read], "").0, 200);
    // The role read does not include commands.
    let changes = |r: &&&str| !r.starts_with("GET") && !OPEN.contains(r);
    for route in ROUTES.iter().filter(changes) {
        let (status, body) = ask(server.address, route, &[&read, JSON, ME], OFF);
        assert_eq!(status, 403, "{route}: {body}");
        assert!(body.contains("operate"), "{body}");
    }
    assert_eq!(server.commands(), []);
    let operate = bearer(Role::Operate);
    let (status, body) = ask(server.address, COMMANDS, &[&operate, JSON, ME], OFF);
    assert_eq!(status, 200, "{body}");
}

#[test]
fn get_changes_nothing() {
    let mut server = Running::start();
    for route in ROUTES
        .iter()
        .filter(|r| !r.starts_with("GET") && !r.ends_with("/session"))
    {
        let (_, path) = route.split_once(' ').unwrap();
        let (status, body) = ask(server.address, &format!("GET {path}"), &[ME], "");
        assert_eq!(status, 405, "{path}: {body}");
        assert!(body.contains("\"method\""), "{body}");
    }
    assert_eq!((server.commands(), server.report().lease), (vec![], None));
    assert!(!server.dir.path().join("backups").exists());
}

#[test]
fn bodies_with_keys_or_values_that_are_none_are_refused() {
    let mut server = Running::start();
    for body in [
        "{}",
        "null",
        r#"{"command":"explode"}"#,
        r#"{"command":"power","power_w":-5}"#,
        r#"{"command":"power","power_w":70000}"#,
        r#"{"command":"power","power_w":500,"for_s":5}"#,
        r#"{"command":"power","power_w":500"#,
    ] {
        let (status, answer) = ask(server.address, COMMANDS, &[JSON, ME], body);
        assert!((400..=422).contains(&status), "{body}: {status} {answer}");
    }
    for query in ["limit=0", "limit=10001", "limit=x", "since=x", "lmit=3"] {
        let line = format!("GET /api/v1/devices/x/results?{query}");
        assert_eq!(ask(server.address, &line, &[], "").0, 400, "{query}");
    }
    assert_eq!(server.commands(), []);
}

#[test]
fn answers_tell_no_version_and_no_path() {
    let server = Running::start();
    let dir = server.dir.path().display().to_string();
    for line in [
        "GET /nowhere",
        "GET /api/v1/devices/x",
        "GET /..%2f..%2fetc/passwd",
    ] {
        let (status, body) = ask(server.address, line, &[], "");
        assert_eq!(status, 404, "{line}");
        for word in [env!("CARGO_PKG_VERSION"), "axum", "hyper", &dir, ".rs"] {
            assert!(!body.contains(word), "{line}: {body}");
        }
    }
}

#[test]
fn a_backup_stays_in_its_folder_and_overwrites_nothing() {
    let server = Running::start();
    let backup = |to: &str| {
        let body = format!("{{\"to\":{to:?}}}");
        ask(server.address, "POST /api/v1/store/backup", &[JSON], &body).0
    };
    for bad in ["../x", "/tmp/x", "", "."] {
        assert_eq!(backup(bad), 400, "{bad}");
    }
    assert_eq!(backup("monday"), 200);
    let folder = server.dir.path().join("backups");
    std::fs::create_dir_all(folder.join("tuesday")).unwrap();
    assert_eq!(backup("tuesday"), 409);
    let copies = std::fs::read_dir(&folder).unwrap().count();
    assert_eq!(copies, 2, "monday's, and tuesday's as it was");
    let monday = ihd_store::StoreReader::open(&folder.join("monday")).unwrap();
    assert!(monday.devices().is_ok(), "it is a store");
}

/// The disk takes no window any more; each hob sends one every 0.7 s.
#[test]
fn health_and_metrics_say_what_is_dropped_why_and_what_to_do() {
    let (server, clock) = Running::with_hobs_and_clock(|_, _| {});
    let health = || {
        let (status, body) = ask(server.address, "GET /healthz", &[], "");
        (
            status,
            serde_json::from_str::<ihd_model::Health>(&body).unwrap(),
        )
    };
    clock.second();
    clock.second();
    let (status, well) = health();
    assert_eq!((status, well.store, well.store_failure), (200, true, None));
    server.world.disk.set(DiskState {
        refuses_windows: true,
        ..DiskState::default()
    });
    for _ in 0..4 {
        clock.second();
    }
    let (status, ill) = health();
    assert_eq!((status, ill.store), (503, false));
    let failure = ill.store_failure.unwrap();
    assert!(failure.dropped.windows >= 8, "{failure:?}");
    assert!(failure.since_ms > 0 && failure.advice.contains("right to write"));
    let whole = StoreFailure::new(failure.cause, failure.since_ms, failure.dropped);
    assert_eq!(failure, whole);
    let (_, metrics) = ask(server.address, "GET /metrics", &[], "");
    let windows = server.report().windows;
    assert!(
        windows.stored >= 2 && windows.not_stored >= 4,
        "{windows:?}"
    );
    let since_s = failure.since_ms as f64 * 1e-3;
    for line in [
        "ihd_store_well 0".to_owned(),
        format!("ihd_store_failing_since_seconds {since_s}"),
        format!(
            "ihd_store_dropped_total{{record=\"windows\"}} {}",
            failure.dropped.windows
        ),
        "ihd_store_dropped_total{record=\"audits\"} 0".to_owned(),
        format!(
            "ihd_windows_total{{device=\"serial:/dev/tty ä\",fate=\"stored\"}} {}",
            windows.stored
        ),
        format!(
            "ihd_windows_total{{device=\"serial:/dev/tty ä\",fate=\"not-stored\"}} {}",
            windows.not_stored
        ),
        "ihd_device_state{device=\"serial:/dev/tty ä\",state=\"idle\"} 1".to_owned(),
        "ihd_device_state{device=\"serial:/dev/tty ä\",state=\"faulted\"} 0".to_owned(),
    ] {
        assert!(
            metrics.lines().any(|l| l == line),
            "{line} not in {metrics}"
        );
    }
}
