//! Stored data for a display: parameters reach the daemon, invalid ones are refused.

use ihd_model::Command;
use ihd_shared::lookup::{RlLookup, prior::prior};
use serde_json::Value;

use crate::http::ask;
use crate::rig::{DEVICE, NAME, OTHER, Running};

fn get(server: &Running, path: &str) -> (u16, Value) {
    let (status, body) = ask(server.address, &format!("GET {path}"), &[], "");
    (status, serde_json::from_str(&body).unwrap_or_default())
}

/// Returns an answer with status 200 about the first device.
fn of_device(server: &Running, what: &str) -> Value {
    let (status, body) = get(server, &format!("{DEVICE}/{what}"));
    assert_eq!(status, 200, "{what}: {body}");
    body
}

fn rows(value: &Value) -> &[Value] {
    value.as_array().expect("a list")
}

/// A hob that heats sends a window every 0.7 s, of which the learner makes a result.
#[test]
fn what_a_hob_did_is_given_in_the_columns_rows_and_versions_asked_for() {
    let (server, clock) = Running::with_hobs_and_clock(|_, _| {});
    let lookup = RlLookup {
        version: 3,
        ..prior()
    };
    let blob = lookup.to_bytes().to_vec();
    clock.during(|| server.command("Ada", Command::LookupPush { blob }));
    clock.during(|| server.command("Ada", Command::Power { power_w: 1_200 }));
    for _ in 0..75 {
        server.take_lease(NAME, "Ada");
        clock.second();
    }
    for _ in 0..3 {
        for _ in 0..50 {
            server.take_lease(OTHER, "Bob");
            server.release_lease(OTHER, "Bob");
        }
        clock.second();
    }

    // Of a history nobody says more of, the last five minutes.
    let history = of_device(&server, "history");
    let [from_ms, to_ms] = ["from_ms", "to_ms"].map(|key| history[key].as_i64().unwrap());
    assert_eq!((to_ms - from_ms, to_ms), (300_000, server.now_ms()));
    let columns = rows(&history["at_ms"]).len();
    assert!(columns > 70, "{columns}");
    let results = rows(&history["results"]["r_ohm"]).len();
    assert!(results > 50, "{results}");
    // Of 600 columns one is reserved for a start within a column: 599 of five seconds.
    let until_ms = to_ms / 1_000 * 1_000;
    let long_ago = format!("from={}&to={until_ms}", until_ms - 2_995_000);
    for (query, width_ms) in [
        ("", 5_000),
        ("&columns=4000", 1_000),
        ("&columns=10", 360_000),
    ] {
        let history = of_device(&server, &format!("history?{long_ago}{query}"));
        assert_eq!(history["step_ms"], width_ms, "{query}");
        assert_eq!(history["from_ms"], until_ms - 2_995_000, "{query}");
    }
    let past = of_device(&server, &format!("history?to={from_ms}"));
    assert_eq!(past["from_ms"], from_ms - 300_000);
    assert!(rows(&past["at_ms"]).is_empty());

    // Windows and fits, newest first; results since a time.
    let all = of_device(&server, "windows?limit=10000");
    assert!(rows(&all).len() > 100);
    assert_eq!(
        of_device(&server, "windows"),
        Value::from(&rows(&all)[..100])
    );
    assert_eq!(
        of_device(&server, "windows?limit=7"),
        Value::from(&rows(&all)[..7])
    );
    let seqs: Vec<_> = rows(&all).iter().map(|row| row["seq"].as_u64()).collect();
    assert!(seqs.is_sorted_by(|a, b| a > b), "{seqs:?}");
    let fits = of_device(&server, "training?limit=10000");
    assert!(rows(&fits).len() > 50);
    assert_eq!(
        of_device(&server, "training"),
        Value::from(&rows(&fits)[..50])
    );
    let results = of_device(&server, "results?limit=10000");
    assert_eq!(rows(&results).len(), rows(&fits).len());
    let fifth = &rows(&results)[4];
    assert_eq!(
        (&fifth["why"], &fifth["device"]),
        (&"simulated".into(), &NAME.into())
    );
    let since = format!("results?since={}", fifth["at_ms"]);
    assert_eq!(
        of_device(&server, &since),
        Value::from(&rows(&results)[..5])
    );
    assert_eq!(
        rows(&of_device(&server, "results")).len(),
        100.min(rows(&results).len())
    );

    // The newest window, or the one that is named, or a part of it.
    let newest = of_device(&server, "window");
    assert_eq!(
        (&newest["seq"], &newest["from_s"]),
        (&rows(&all)[0]["seq"], &0.0.into())
    );
    let pairs = newest["pairs"].as_u64().unwrap();
    let named = format!("boot={}&seq=4", newest["boot"]);
    let part = of_device(
        &server,
        &format!("window?{named}&from_s=0.00001&to_s=0.00005&columns=10"),
    );
    assert_eq!(
        (part["seq"].as_u64(), rows(&part["t_s"]).len()),
        (Some(4), 10)
    );
    let [from_s, to_s] = ["from_s", "to_s"].map(|key| part[key].as_f64().unwrap());
    assert!(
        (from_s - 1e-5).abs() < 2e-6 && (to_s - 5e-5).abs() < 2e-6,
        "{from_s} {to_s}"
    );
    assert_eq!(rows(&newest["t_s"]).len() as u64, pairs.min(1_200));
    let (status, body) = get(&server, &format!("{DEVICE}/window?boot=7&seq=6"));
    assert_eq!((status, body["error"].as_str()), (404, Some("no-window")));

    // The device's map, or that of a version.
    assert_eq!(of_device(&server, "map")["version"], 3);
    assert_eq!(of_device(&server, "map?version=0")["version"], 0);
    let (status, body) = get(&server, &format!("{DEVICE}/map?version=9"));
    assert_eq!((status, body["error"].as_str()), (404, Some("no-version")));
    assert!(body["message"].as_str().unwrap().contains('9'), "{body}");
    let curve = server.daemon.view().pot_curve(NAME).unwrap();
    let curve = serde_json::to_value(curve).unwrap();
    assert_eq!(of_device(&server, "pot-temperature"), curve);

    // The journal and its filter.
    let journal = |query: &str| {
        let (status, body) = get(&server, &format!("/api/v1/journal{query}"));
        assert_eq!(status, 200, "{query}: {body}");
        body
    };
    let all = journal("?limit=10000");
    assert!(rows(&all).len() > 200);
    assert_eq!(journal(""), Value::from(&rows(&all)[..200]));
    let leases = journal("?device=usb%3A2064&kind=lease&limit=10000");
    let of_leases = |row: &&Value| row["device"] == OTHER && row["kind"] == "lease";
    let expected: Vec<_> = rows(&all).iter().filter(of_leases).cloned().collect();
    assert!(expected.len() >= 200, "{}", expected.len());
    assert_eq!(leases, Value::from(expected));
    let at_ms = |k: usize| rows(&all)[k]["at_ms"].as_i64().unwrap();
    let (since, before) = (at_ms(rows(&all).len() - 2), at_ms(rows(&all).len() - 4));
    let within = journal(&format!("?since={since}&before={before}&limit=10000"));
    let is_within = |row: &&Value| (since..before).contains(&row["at_ms"].as_i64().unwrap());
    let expected: Vec<_> = rows(&all).iter().filter(is_within).cloned().collect();
    assert_eq!(within, Value::from(expected));
}

#[test]
fn what_cannot_be_asked_is_refused_before_the_store_is_asked() {
    let server = Running::start();
    for query in [
        "history?columns=0",
        "history?columns=4001",
        "history?columns=-1",
        "history?from=5&to=5",
        "history?from=6&to=5",
        "history?from=x",
        "history?from=99999999999999999999",
        "history?form=1",
        "windows?limit=0",
        "windows?limit=10001",
        "training?limit=10001",
        "window?boot=7",
        "window?seq=5",
        "window?columns=4001",
        "window?from_s=2&to_s=1",
        "window?from_s=NaN",
        "window?to_s=NaN",
        "window?from_s=inf",
        "map?version=-1",
        "map?version=x",
    ] {
        let (status, body) = get(&server, &format!("{DEVICE}/{query}"));
        assert_eq!(
            (status, body["error"].as_str()),
            (400, Some("query")),
            "{query}: {body}"
        );
    }
    for query in ["limit=0", "limit=10001", "since=x", "kinds=fault"] {
        assert_eq!(
            get(&server, &format!("/api/v1/journal?{query}")).0,
            400,
            "{query}"
        );
    }
    // Limits of the integer type.
    let far = format!("history?from={}&to={}", i64::MIN, i64::MAX);
    assert_eq!(get(&server, &format!("{DEVICE}/{far}")).0, 200);
    let far = format!("history?to={}", i64::MIN);
    assert_eq!(get(&server, &format!("{DEVICE}/{far}")).0, 400);
}

#[test]
fn a_device_that_is_not_there_has_no_past() {
    let server = Running::start();
    for what in [
        "history",
        "windows",
        "window",
        "training",
        "map",
        "pot-temperature",
    ] {
        let (status, body) = get(&server, &format!("/api/v1/devices/nobody/{what}"));
        assert_eq!(
            (status, body["error"].as_str()),
            (404, Some("no-device")),
            "{what}"
        );
    }
}
