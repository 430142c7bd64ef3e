//! A simulated hob that heats, its edge, a worker and the server: results come back and teach the hob. How it goes on alone: silence.rs and the fleet's simulation.

use serde_json::Value;

use super::server::Server;
use super::site::{PATIENCE, Site, Worker, fleet, init, status, until};

fn json(url: &str, arguments: &[&str]) -> Value {
    let (text, code) = fleet(url, arguments);
    assert_eq!(code, 0, "{text}");
    serde_json::from_str(&text).expect("JSON")
}

/// Returns the last lookup of the first hob: its revision, and `true` if it is in use.
fn last_lookup(url: &str) -> Option<(u64, bool)> {
    let last = json(url, &["lookup", "ls", "--json"])[0].clone();
    Some((last["revision"].as_u64()?, last["lookup"]["in_use"] == true))
}

#[test]
fn a_hob_is_taught_by_workers() {
    let server = Server::start("");
    let url = server.url();
    init(&url, &[]);
    let mut site = Site::simulated("lab", 1);
    let hob = site.hobs[0].clone();
    let _worker = Worker::start(site.path(), &url, "w", &["--threads", "1"]);
    site.start(&url);
    let results = || {
        status(&url)
            .and_then(|s| s["results"].as_u64())
            .unwrap_or(0)
    };
    until("the hob in a fleet that is trusted", PATIENCE, || {
        let devices = json(&url, &["status", "devices", "--json"]);
        let trusted = status(&url).is_some_and(|s| s["edges"][0]["trusts_fleet"] == true);
        trusted && devices[0]["name"] == *hob && devices[0]["state"] == "idle"
    });
    // Repeated: on a slow machine ten seconds are few seconds of the hob.
    until("results of the worker", PATIENCE, || {
        site.device(&[&hob, "power", "1500", "--for", "5"]);
        results() >= 10
    });
    until("results in the store", PATIENCE, || {
        site.results().len() >= 10
    });
    until("its lookup in the fleet", PATIENCE, || {
        last_lookup(&url).is_some_and(|(_, in_use)| in_use)
    });
    let (first, _) = last_lookup(&url).expect("a lookup");
    until(
        "an edge that trusts the fleet, and its worker",
        PATIENCE,
        || {
            status(&url).is_some_and(|s| {
                s["edges"][0]["trusts_fleet"] == true && s["workers"][0]["name"] == "w"
            })
        },
    );

    // Somebody wants an older one used: the edge pushes it, and says that it is in use.
    let (text, code) = fleet(&url, &["lookup", "push", &hob, &first.to_string()]);
    assert_eq!(code, 0, "{text}");
    until("the wanted lookup in use", PATIENCE, || {
        last_lookup(&url).is_some_and(|(revision, in_use)| in_use && revision > first + 1)
    });

    site.stop();
    let log = site.log();
    assert!(!log.contains("ERROR"), "{log}");
}
