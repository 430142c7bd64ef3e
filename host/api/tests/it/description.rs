//! OpenAPI document: complete, all references valid, no unintended change.

use std::collections::BTreeSet;

use serde_json::Value;

use crate::http::ask;
use crate::rig::Running;

fn document() -> Value {
    let server = Running::start();
    let (status, body) = ask(server.address, "GET /api/v1/openapi.json", &[], "");
    assert_eq!(status, 200);
    serde_json::from_str(&body).unwrap()
}

/// Stable routes of the API. Removing or changing a line breaks clients and requires /api/v2.
const ROUTES: &str = "\
GET /api/v1/devices -> 200 401 403 421 500 504
GET /api/v1/devices/{name} -> 200 400 401 403 404 421 500 504
DELETE /api/v1/devices/{name}/lease -> 204 400 401 403 404 421 423 500 504
PUT /api/v1/devices/{name}/lease -> 200 400 401 403 404 413 415 421 422 423 500 504
POST /api/v1/devices/{name}/commands -> 200 400 401 403 404 409 413 415 421 422 423 500 503 504
GET /api/v1/devices/{name}/lookups -> 200 400 401 403 404 421 500 504
GET /api/v1/devices/{name}/results -> 200 400 401 403 404 421 500 504
GET /api/v1/events -> 200 400 401 403 421 500 503 504
GET /api/v1/fleet -> 200 401 403 404 421 500 504
GET /api/v1/hob -> 200 401 403 421 500 504
GET /api/v1/devices/{name}/history -> 200 400 401 403 404 421 500 504
GET /api/v1/devices/{name}/windows -> 200 400 401 403 404 421 500 504
GET /api/v1/devices/{name}/window -> 200 400 401 403 404 421 500 504
GET /api/v1/devices/{name}/training -> 200 400 401 403 404 421 500 504
GET /api/v1/devices/{name}/map -> 200 400 401 403 404 421 500 504
GET /api/v1/devices/{name}/pot-temperature -> 200 400 401 403 404 421 500 504
GET /api/v1/journal -> 200 400 401 403 421 500 504
GET /api/v1/live -> 200 400 401 403 421 500 503 504
GET /api/v1/openapi.json -> 200 401 403 421 500 504
GET /api/v1/recordings -> 200 401 403 421 500 504
GET /api/v1/recordings/{file} -> 200 206 400 401 403 404 409 413 416 421 500 503 504
DELETE /api/v1/session -> 204 403 421 500 504
GET /api/v1/session -> 200 401 403 421 500 504
POST /api/v1/session -> 204 400 401 403 413 415 421 422 500 504
POST /api/v1/store/backup -> 200 400 401 403 409 413 415 421 422 500 504
GET /healthz -> 200 403 421 500 503 504
GET /metrics -> 200 401 403 421 500 504
";

#[test]
fn the_routes_are_those_that_were_promised() {
    let document = document();
    let mut lines = BTreeSet::new();
    for (path, operations) in document["paths"].as_object().unwrap() {
        for (method, operation) in operations.as_object().unwrap() {
            if !operation.is_object() {
                continue;
            }
            let mut statuses: Vec<&str> = operation["responses"]
                .as_object()
                .unwrap()
                .keys()
                .map(String::as_str)
                .collect();
            statuses.sort_unstable();
            let method = method.to_uppercase();
            lines.insert(format!("{method} {path} -> {}", statuses.join(" ")));
        }
    }
    let expected: BTreeSet<String> = ROUTES.lines().map(str::to_owned).collect();
    assert_eq!(lines, expected);
}

#[test]
fn a_client_made_from_the_document_knows_how_to_show_its_token() {
    let document = document();
    let scheme = &document["components"]["securitySchemes"]["token"];
    assert_eq!(
        (&scheme["type"], &scheme["scheme"]),
        (&"http".into(), &"bearer".into())
    );
    assert_eq!(document["security"], serde_json::json!([{}, {"token": []}]));
}

/// Calls `see` for every object of a document.
fn walk<'a>(value: &'a Value, see: &mut impl FnMut(&'a serde_json::Map<String, Value>)) {
    match value {
        Value::Object(map) => {
            see(map);
            map.values().for_each(|v| walk(v, see));
        }
        Value::Array(all) => all.iter().for_each(|v| walk(v, see)),
        _ => {}
    }
}

#[test]
fn every_reference_leads_somewhere_and_no_schema_is_idle() {
    let document = document();
    assert_eq!(
        document["openapi"].as_str().map(|v| v.starts_with("3.1")),
        Some(true)
    );
    let mut referred = BTreeSet::new();
    walk(&document, &mut |map| {
        if let Some(Value::String(to)) = map.get("$ref") {
            let pointer = to.strip_prefix('#').expect("within the document");
            assert!(document.pointer(pointer).is_some(), "{to} leads nowhere");
            referred.insert(to.clone());
        }
    });
    for name in [
        "DeviceReport",
        "Command",
        "Notice",
        "Problem",
        "Lease",
        "Done",
    ] {
        let to = format!("#/components/schemas/{name}");
        assert!(referred.contains(&to), "{name} is referred to by nobody");
    }
    for name in document["components"]["schemas"]
        .as_object()
        .unwrap()
        .keys()
    {
        let to = format!("#/components/schemas/{name}");
        assert!(referred.contains(&to), "{name} is idle");
    }
}

#[test]
fn every_parameter_of_a_path_and_every_operation_is_described() {
    let document = document();
    let mut names = BTreeSet::new();
    for (path, operations) in document["paths"].as_object().unwrap() {
        for operation in operations.as_object().unwrap().values() {
            let has_text = |key: &str| operation[key].as_str().is_some_and(|w| !w.is_empty());
            assert!(has_text("summary"), "{path}: {operation:#}");
            let id = operation["operationId"].as_str().unwrap();
            assert!(names.insert(id.to_owned()), "{id} twice");
            let given: Vec<&str> = operation["parameters"]
                .as_array()
                .into_iter()
                .flatten()
                .filter(|p| p["in"] == "path")
                .filter_map(|p| p["name"].as_str())
                .collect();
            let expected: Vec<&str> = path
                .split('/')
                .filter_map(|part| part.strip_prefix('{')?.strip_suffix('}'))
                .collect();
            assert_eq!(given, expected, "{path}");
        }
    }
}

#[test]
fn every_route_of_the_document_is_there() {
    let server = Running::start();
    for line in ROUTES.lines() {
        let (request, _) = line.split_once(" -> ").unwrap();
        if request.ends_with("/events") || request.ends_with("/live") {
            continue; // Endless streams; tested in the modules of these names.
        }
        let (status, body) = ask(server.address, &request.replace("{name}", "x"), &[], "");
        assert!(
            status != 405 && !body.contains("no-route"),
            "{request}: {status} {body}"
        );
    }
}

#[test]
fn a_name_that_is_no_text_is_a_problem() {
    let server = Running::start();
    for path in ["devices/%ff/map", "devices/%ff", "recordings/%ff"] {
        let (status, body) = ask(server.address, &format!("GET /api/v1/{path}"), &[], "");
        let problem: Value = serde_json::from_str(&body).unwrap();
        assert_eq!((status, problem["error"].as_str()), (400, Some("path")));
    }
}

#[test]
fn metrics_are_in_prometheus_text_format() {
    let server = Running::start();
    let (status, text) = ask(server.address, "GET /metrics", &[], "");
    assert_eq!(status, 200);
    let mut family = String::new();
    let mut samples = 0;
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix("# TYPE ") {
            let (name, kind) = rest.split_once(' ').unwrap();
            assert!(["counter", "gauge"].contains(&kind), "{line}");
            assert_eq!(kind == "counter", name.ends_with("_total"), "{line}");
            assert_ne!(family, name, "a family is described once");
            family = name.into();
        } else if !line.starts_with("# HELP ") {
            assert!(line.starts_with(&family), "{line} is not of {family}");
            let (_, value) = line.rsplit_once(' ').unwrap();
            assert!(value == "NaN" || value.parse::<f64>().is_ok(), "{line}");
            samples += 1;
        }
    }
    assert!(samples > 20, "{text}");
}
