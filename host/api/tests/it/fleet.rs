//! Report of the fleet, over a socket and by the client.

use ihd_api::ApiClient;
use ihd_api::access::tokens::Tokens;
use ihd_api::client::ClientError;
use ihd_model::Role;
use ihd_model::{FleetAnswers, FleetDevice, FleetEdge, FleetReport, FleetStates, FleetWorker};
use serde_json::Value;

use crate::http::ask;
use crate::rig::Running;

const FLEET: &str = "GET /api/v1/fleet";
const SESSION: &str = "GET /api/v1/session";

/// Report with two hobs of one edge and one worker, and numbers that need 64 bits.
fn report() -> FleetReport {
    let device = |name: &str, outdated| FleetDevice {
        name: name.into(),
        edge: "cellar".into(),
        state: "waiting-for-pot".into(),
        pot: String::new(),
        build: "ihd 0.1.0".into(),
        protocol: (2, 6),
        lookup_version: 17,
        outdated,
        last_seen_ms: 1_795_000_000_000,
    };
    FleetReport {
        server: "tls://nats.example:4222".into(),
        edge: "cellar".into(),
        connected: false,
        why: "the server does not answer".into(),
        at_ms: 1_795_000_001_000,
        outbox: 3,
        states: FleetStates {
            due: 3,
            answered: 40,
            ..FleetStates::default()
        },
        alarms: vec!["3 windows are due for too long".into()],
        answers: FleetAnswers {
            confirmed: 38,
            refuted: 2,
            ..FleetAnswers::default()
        },
        windows: u64::MAX,
        results: 40,
        backlog: 2,
        dead: 1,
        workers: vec![FleetWorker {
            name: "w1".into(),
            version: "0.1.0".into(),
            threads: 2,
            busy: 1,
            done: 40,
            failed: 1,
            last_seen_ms: 1_795_000_000_500,
        }],
        edges: vec![FleetEdge {
            name: "cellar".into(),
            version: "0.1.0".into(),
            outbox: 3,
            delegates: true,
            states: FleetStates::default(),
            alarms: vec!["3 windows are due for too long".into()],
            last_seen_ms: 1_795_000_000_900,
        }],
        devices: vec![device("bench", false), device("<b>ä", true)],
    }
}

fn edge(server: &Running) {
    server.daemon.fleet().set_report(report());
}

#[test]
fn an_edge_tells_all_that_it_knows() {
    let server = Running::start();
    edge(&server);
    let client = ApiClient::new(&server.url, "me", None, &[]).unwrap();
    assert_eq!(client.fleet().unwrap(), report());
    let (_, session) = ask(server.address, SESSION, &[], "");
    assert!(session.contains("\"fleet\":true"), "{session}");
}

#[test]
fn a_daemon_without_a_fleet_says_how_it_would_have_one() {
    let server = Running::start();
    let client = ApiClient::new(&server.url, "me", None, &[]).unwrap();
    match client.fleet().unwrap_err() {
        ClientError::Refused {
            status, problem, ..
        } => {
            assert_eq!((status, &*problem.error), (404, "no-fleet"));
            assert!(problem.message.contains("[fleet] url in ihd.toml"));
        }
        other => panic!("{other}"),
    }
}

/// The role read is required, as for devices.
#[test]
fn it_is_read_by_whoever_may_read() {
    let server = Running::with(|settings, dir| settings.token_file = Some(dir.join("tokens")));
    edge(&server);
    let tokens = Tokens::read(&server.dir.path().join("tokens")).unwrap();
    let bearer = format!(
        "Authorization: Bearer {}",
        tokens.at_least(Role::Read).unwrap()
    );
    assert_eq!(ask(server.address, FLEET, &[&bearer], "").0, 200);
    let (status, body) = ask(server.address, FLEET, &[], "");
    assert_eq!(status, 401);
    assert!(!body.contains("cellar"), "{body}");
    let other = "POST /api/v1/fleet";
    assert_eq!(ask(server.address, other, &[&bearer], "").0, 403);
}

/// Returns the metrics of the fleet with their labels' values in place of the names.
fn figures_of_a_fleet(server: &Running) -> Vec<(String, f64)> {
    let (_, text) = ask(server.address, "GET /metrics", &[], "");
    let of_fleet = text.lines().filter_map(|l| l.strip_prefix("ihd_fleet_"));
    let sample = |line: &str| {
        let (name, value) = line.rsplit_once(' ').unwrap();
        let label = name.split('"').nth(1).unwrap_or(name);
        (label.to_owned(), value.parse().unwrap())
    };
    of_fleet.map(sample).collect()
}

#[test]
fn a_daemon_tells_what_it_was_told_last_and_counts_it() {
    let server = Running::start();
    assert_eq!(figures_of_a_fleet(&server), []);
    edge(&server);
    let names = |server: &Running| {
        let figures = figures_of_a_fleet(server);
        figures
            .into_iter()
            .map(|(name, _)| name)
            .collect::<Vec<_>>()
    };
    // Of a fleet that was never read, or long ago, its own numbers are unknown.
    for at_ms in [0, server.now_ms() - 60_001] {
        server.daemon.fleet().set_report(FleetReport {
            connected: true,
            at_ms,
            ..report()
        });
        assert_eq!(names(&server)[..3], ["connected", "outbox", "alarms"]);
    }
    server.daemon.fleet().set_report(FleetReport {
        connected: true,
        at_ms: server.now_ms(),
        outbox: 2,
        backlog: 3,
        dead: 4,
        workers: vec![FleetWorker::default(); 5],
        ..report()
    });
    let expected = [
        ("connected", 1.0),
        ("outbox", 2.0),
        ("backlog", 3.0),
        ("dead", 4.0),
        ("workers", 5.0),
        ("alarms", 1.0),
        ("not for fleet", 0.0),
        ("due", 3.0),
        ("sent", 0.0),
        ("answered", 40.0),
        ("learned here", 0.0),
        ("no samples", 0.0),
        ("dead", 0.0),
        ("confirmed", 38.0),
        ("refuted", 2.0),
        ("outdated", 0.0),
        ("unidentified", 0.0),
        ("distrusted", 0.0),
    ];
    let expected = expected.map(|(name, value)| (name.to_owned(), value));
    assert_eq!(figures_of_a_fleet(&server), expected);
}

/// Every string of the report has an escape sequence, a line break and a megabyte.
#[test]
fn no_text_of_another_machine_is_passed_on_as_it_is() {
    let server = Running::start();
    let mut hostile_report = serde_json::to_value(report()).unwrap();
    let bad = format!("\u{1b}[2J\n{}", "x".repeat(1 << 20));
    let hostile = texts(&mut hostile_report, &mut |text| text.clone_from(&bad));
    let hostile_report = serde_json::from_value(hostile_report).unwrap();
    server.daemon.fleet().set_report(hostile_report);
    let (_, known) = ask(server.address, FLEET, &[], "");
    let mut known = serde_json::from_str(&known).unwrap();
    let seen = texts(&mut known, &mut |text| {
        assert!(text.chars().all(|c| !c.is_control()), "{text:.40}");
        assert!(text.len() < 1_000, "{} bytes", text.len());
    });
    // Server, edge, why and an alarm; two of the worker, three of the edge, five of each hob.
    assert_eq!((hostile, seen), (19, 19));
}

/// Calls `see` for every string of a document; returns their number.
fn texts(value: &mut Value, see: &mut impl FnMut(&mut String)) -> usize {
    match value {
        Value::String(text) => {
            see(text);
            1
        }
        Value::Array(all) => all.iter_mut().map(|v| texts(v, see)).sum(),
        Value::Object(all) => all.values_mut().map(|v| texts(v, see)).sum(),
        _ => 0,
    }
}
