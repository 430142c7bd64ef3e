//! Stored data for a display: parameters reach the backend, invalid ones are refused.

use ihd_daemon::JournalFilter;
use ihd_daemon::event_bus::now_ms;
use ihd_daemon::model::WindowQuery;
use serde_json::Value;

use crate::backend::Running;
use crate::http::ask;

const DEVICE: &str = "/api/v1/devices/serial%3A%2Fdev%2Ftty%20%C3%A4";

fn get(server: &Running, path: &str) -> (u16, Value) {
    let (status, body) = ask(server.address, &format!("GET {path}"), &[], "");
    (status, serde_json::from_str(&body).unwrap_or_default())
}

#[test]
fn a_history_without_words_is_of_the_last_five_minutes() {
    let server = Running::start();
    let (status, body) = get(&server, &format!("{DEVICE}/history"));
    assert_eq!(status, 200);
    let [from_ms, to_ms] = ["from_ms", "to_ms"].map(|key| body[key].as_i64().unwrap());
    assert_eq!(to_ms - from_ms, 300_000);
    assert!((now_ms() - to_ms).abs() < 5_000);
    let query = "from=1700000000000&to=1700000060000&columns=4000";
    assert_eq!(get(&server, &format!("{DEVICE}/history?{query}")).0, 200);
    assert_eq!(get(&server, &format!("{DEVICE}/history?to=300000")).0, 200);
    let asked = server.fake.asked.lock().unwrap();
    assert_eq!(asked.histories[0].2, 600);
    assert_eq!(
        asked.histories[1],
        (1_700_000_000_000, 1_700_000_060_000, 4_000)
    );
    assert_eq!(asked.histories[2], (0, 300_000, 600));
}

#[test]
fn a_window_is_the_newest_or_the_one_that_is_named() {
    let server = Running::start();
    assert_eq!(get(&server, &format!("{DEVICE}/window")).1["seq"], 5);
    let query = "boot=7&seq=5&from_s=0.001&to_s=0.002&columns=10";
    assert_eq!(get(&server, &format!("{DEVICE}/window?{query}")).0, 200);
    let (status, body) = get(&server, &format!("{DEVICE}/window?boot=7&seq=6"));
    assert_eq!((status, body["error"].as_str()), (404, Some("no-window")));
    let asked = server.fake.asked.lock().unwrap();
    let whole = WindowQuery {
        which: None,
        from_s: 0.0,
        to_s: f64::INFINITY,
        columns: 1_200,
    };
    assert_eq!(asked.scopes[0], whole);
    let part = WindowQuery {
        which: Some((7, 5)),
        from_s: 0.001,
        to_s: 0.002,
        columns: 10,
    };
    assert_eq!(asked.scopes[1], part);
}

#[test]
fn a_map_is_the_devices_own_or_of_a_version() {
    let server = Running::start();
    assert_eq!(get(&server, &format!("{DEVICE}/map")).1["version"], 3);
    assert_eq!(
        get(&server, &format!("{DEVICE}/map?version=0")).1["version"],
        0
    );
    let (status, body) = get(&server, &format!("{DEVICE}/map?version=9"));
    assert_eq!((status, body["error"].as_str()), (404, Some("no-version")));
    assert!(body["message"].as_str().unwrap().contains('9'), "{body}");
}

#[test]
fn the_curve_of_a_pots_temperature_is_given_with_its_deviation() {
    let server = Running::start();
    let (status, curve) = get(&server, &format!("{DEVICE}/pot-temperature"));
    assert_eq!((status, &curve["now"]), (200, &Value::Null));
    let point = &curve["points"][0];
    assert_eq!(
        (
            point["at_ms"].as_i64(),
            point["rise_k"].as_f64(),
            point["sigma_k"].as_f64()
        ),
        (Some(2_000), Some(41.5), Some(5.0))
    );
}

#[test]
fn rows_and_the_filter_of_the_journal_arrive() {
    let server = Running::start();
    for path in [
        &format!("{DEVICE}/windows"),
        &format!("{DEVICE}/windows?limit=7"),
        &format!("{DEVICE}/training"),
        &format!("{DEVICE}/training?limit=10000"),
        "/api/v1/journal",
        "/api/v1/journal?device=b%20c&kind=fault&since=-5&before=9&limit=3",
    ] {
        assert_eq!(get(&server, path), (200, serde_json::json!([])), "{path}");
    }
    let asked = server.fake.asked.lock().unwrap();
    assert_eq!(asked.windows, [100, 7]);
    assert_eq!(asked.trainings, [50, 10_000]);
    let plain = JournalFilter {
        limit: Some(200),
        ..JournalFilter::default()
    };
    let all = JournalFilter {
        device: Some("b c".into()),
        kind: Some("fault".into()),
        since_ms: Some(-5),
        before_ms: Some(9),
        limit: Some(3),
    };
    assert_eq!(asked.journals, [plain, all]);
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
    let asked = server.fake.asked.lock().unwrap();
    assert!(asked.histories.is_empty() && asked.scopes.is_empty() && asked.journals.is_empty());
    drop(asked);
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
