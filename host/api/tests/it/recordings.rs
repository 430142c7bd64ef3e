//! Recordings: list, download, tables; path traversal, slow clients.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use ihd_api::ApiClient;
use ihd_api::client::ClientError;
use ihd_capture::mcap::SessionRecorder;
use ihd_capture::{OpenOptions, mcap, open};
use ihd_link::Client;
use ihd_model::Problem;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;

use crate::http::{ask, connect, header, whole};
use crate::rig::Running;

const NAME: &str = "bench-2026-11-22T08-30-00.123.mcap";

/// Records half a second of a simulated hob into the server's folder.
fn recorded(server: &Running, power_w: u16) -> PathBuf {
    recorded_for(server, power_w, Duration::from_millis(500))
}

fn recorded_for(server: &Running, power_w: u16, duration: Duration) -> PathBuf {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let mut client = Client::connect(Box::new(hob)).unwrap();
    client.set_power(power_w).unwrap();
    client.stream(1, 20).unwrap();
    let path = server.recordings().join(NAME);
    let recorder = SessionRecorder::create(&path, client.hello(), client.front_end()).unwrap();
    client.record_to(recorder);
    let until = client.clock() + duration;
    while client.clock() < until {
        client.next_event(until - client.clock()).unwrap();
    }
    client.finish_recording().unwrap();
    path
}

/// Sends a GET; returns head in lower case and body as bytes.
fn get(server: &Running, path: &str) -> (String, Vec<u8>) {
    let mut stream = connect(server.address);
    let request = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    let head = bytes.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
    let body = bytes.split_off(head + 4);
    (String::from_utf8(bytes).unwrap().to_lowercase(), body)
}

#[test]
fn a_recording_is_listed_and_downloaded_as_it_is() {
    let server = Running::start();
    let path = recorded(&server, 1_000);
    let client = ApiClient::new(&server.url, "Ada", None, &[]).unwrap();
    let all = client.recordings().unwrap();
    let bytes = fs::read(&path).unwrap();
    assert_eq!(
        (all[0].file.as_str(), all[0].bytes),
        (NAME, bytes.len() as u64)
    );
    let mut here = Vec::new();
    let length = client.download_recording(NAME, &mut here).unwrap();
    assert!(here == bytes && length == bytes.len() as u64);
    let (head, body) = get(&server, &format!("/api/v1/recordings/{NAME}"));
    assert!(body == bytes, "{head}");
    for line in [
        "http/1.1 200",
        &format!(
            "content-disposition: attachment; filename=\"{}\"",
            NAME.to_lowercase()
        ),
        &format!("content-length: {}", bytes.len()),
        "x-content-type-options: nosniff",
    ] {
        assert!(head.contains(line), "{line} not in {head}");
    }
    let mut small = [0; 10];
    let full = client.download_recording(NAME, &mut &mut small[..]);
    let full = full.unwrap_err();
    assert!(matches!(full, ClientError::Write { .. }), "{full}");
    match client
        .download_recording("none.mcap", &mut here)
        .unwrap_err()
    {
        ClientError::Refused {
            status: 404,
            problem,
            ..
        } => assert_eq!(problem.error, "no-recording"),
        other => panic!("{other}"),
    }
}

#[test]
fn a_broken_download_goes_on_where_it_was_unless_the_file_is_another() {
    let server = Running::start();
    let path = server.recordings().join(NAME);
    let bytes: Vec<u8> = (0..1_000_000u32).map(|k| ((k * 7) >> 3) as u8).collect();
    fs::write(&path, &bytes).unwrap();
    let get = |headers: &[&str]| {
        let line = format!("GET /api/v1/recordings/{NAME}");
        whole(server.address, &line, headers, "")
    };
    let (status, head, body) = get(&[]);
    assert!(status == 200 && body == bytes, "{head}");
    assert_eq!(header(&head, "accept-ranges"), Some("bytes"));
    let etag = header(&head, "etag").unwrap().to_owned();
    let same = format!("If-Range: {etag}");
    for (range, from, to) in [
        ("bytes=400000-", 400_000, 1_000_000),
        ("bytes=0-0", 0, 1),
        ("bytes=10-19", 10, 20),
        ("bytes=-5", 999_995, 1_000_000),
        ("bytes=999990-2000000", 999_990, 1_000_000),
    ] {
        let (status, head, body) = get(&[&format!("Range: {range}"), &same]);
        assert_eq!(status, 206, "{range}: {head}");
        assert!(body == bytes[from..to], "{range}");
        let of = format!("bytes {from}-{}/1000000", to - 1);
        assert_eq!(header(&head, "content-range"), Some(&of[..]));
    }
    assert_eq!(get(&["Range: bytes=1000000-"]).0, 416);
    for whole in ["bytes=0-1,5-6", "lines=1-2", "bytes=x", "bytes"] {
        let (status, head, body) = get(&[&format!("Range: {whole}")]);
        assert!(status == 200 && body == bytes, "{whole}: {head}");
    }
    // The file has changed: its first part may differ.
    fs::write(&path, &bytes[..999_999]).unwrap();
    let (status, head, body) = get(&["Range: bytes=400000-", &same]);
    assert!(status == 200 && body == bytes[..999_999], "{head}");
    assert_ne!(header(&head, "etag"), Some(&etag[..]));
}

#[test]
fn tables_hold_what_the_file_holds() {
    let server = Running::start();
    let path = recorded(&server, 1_000);
    let capture = mcap::read(&path).unwrap();
    let dir = tempfile::tempdir().unwrap();
    for (format, ending) in [("csv", ".csv"), ("npz", ".npz")] {
        let (head, body) = get(
            &server,
            &format!("/api/v1/recordings/{NAME}?format={format}"),
        );
        assert!(
            head.contains("http/1.1 200") && head.contains(&format!("{ending}\"")),
            "{head}"
        );
        assert!(
            head.contains(&format!("content-length: {}", body.len())),
            "{head}"
        );
        let here = dir.path().join(format!("a{ending}"));
        fs::write(&here, body).unwrap();
        let again = open(&here, &OpenOptions::default()).unwrap();
        assert!(
            again.v_v == capture.v_v && again.i_a == capture.i_a,
            "{format}"
        );
    }
    let (head, body) = get(
        &server,
        &format!("/api/v1/recordings/{NAME}?format=half-cycles"),
    );
    assert!(head.contains(".half-cycles.csv\""), "{head}");
    let lines = body.iter().filter(|b| **b == b'\n').count();
    assert!(lines.abs_diff(51) < 5, "{lines}");
    // Nothing is left beside the recordings.
    assert_eq!(fs::read_dir(server.recordings()).unwrap().count(), 1);
}

#[test]
fn a_table_of_a_damaged_recording_says_so() {
    let server = Running::start();
    // Several chunks, of which one is damaged.
    let path = recorded_for(&server, 1_000, Duration::from_millis(1_500));
    let mut bytes = fs::read(&path).unwrap();
    let (all, whole) = get(&server, &format!("/api/v1/recordings/{NAME}?format=csv"));
    assert_eq!(header(&all, "ihd-damaged-records"), None);
    let middle = bytes.len() / 2;
    bytes[middle..middle + 3].iter_mut().for_each(|b| *b = !*b);
    fs::write(&path, bytes).unwrap();
    for (format, ending) in [("csv", ".damaged.csv"), ("npz", ".damaged.npz")] {
        let (head, body) = get(
            &server,
            &format!("/api/v1/recordings/{NAME}?format={format}"),
        );
        assert_eq!(header(&head, "ihd-damaged-records"), Some("1"), "{head}");
        assert!(head.contains(&format!("{ending}\"")), "{head}");
        assert!(format != "csv" || body.len() < whole.len());
    }
}

#[test]
fn what_cannot_be_had_says_why() {
    let server = Running::start();
    let path = recorded(&server, 0);
    let refused = |path: &str, status: u16, error: &str| {
        let (got, body) = ask(server.address, &format!("GET {path}"), &[], "");
        assert_eq!(got, status, "{path}: {body}");
        let problem: Problem = serde_json::from_str(&body).unwrap();
        assert_eq!(problem.error, error, "{path}: {body}");
    };
    let of = |format: &str| format!("/api/v1/recordings/{NAME}?format={format}");
    refused(&of("csv"), 409, "nothing");
    refused(&of("xlsx"), 400, "query");
    fs::write(&path, b"no recording at all").unwrap();
    refused(&of("npz"), 409, "damaged");
    // Names of other files: the token file, the folder above, a folder.
    fs::write(server.recordings().join("tokens"), "secret").unwrap();
    fs::create_dir(server.recordings().join("folder.mcap")).unwrap();
    for name in [
        "tokens",
        "..%2Ftokens.mcap",
        "%2Fetc%2Fpasswd",
        "..",
        ".mcap",
        "folder.mcap",
        "a%00.mcap",
        "a.mcap%2F..%2Ftokens",
    ] {
        let (status, body) = ask(
            server.address,
            &format!("GET /api/v1/recordings/{name}"),
            &[],
            "",
        );
        assert_eq!(status, 404, "{name}: {body}");
        assert!(!body.contains("secret"), "{name}");
    }
    #[cfg(unix)]
    {
        let outside = server.dir.path().join("outside");
        fs::write(&outside, "secret").unwrap();
        let link = server.recordings().join("link.mcap");
        std::os::unix::fs::symlink(outside, link).unwrap();
        refused("/api/v1/recordings/link.mcap", 404, "no-recording");
    }
}

fn sparse(path: &Path, bytes: u64) {
    File::create(path).unwrap().set_len(bytes).unwrap();
}

#[test]
fn a_download_that_takes_longer_than_a_request_may_is_not_cut() {
    const BYTES: u64 = 64 << 20;
    let (server, clock) = Running::with_clock();
    sparse(&server.recordings().join(NAME), BYTES);
    let mut stream = connect(server.address);
    let request = format!(
        "GET /api/v1/recordings/{NAME} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    );
    stream.write_all(request.as_bytes()).unwrap();
    let (mut taken, mut buffer) = (0_u64, vec![0; 3 << 19]);
    while taken < BYTES / 2 {
        taken += stream.read(&mut buffer).unwrap() as u64;
    }
    // Bytes appended meanwhile are not sent: `Content-Length` was sent before.
    let file = File::options()
        .append(true)
        .open(server.recordings().join(NAME));
    file.unwrap().write_all(&[1; 100]).unwrap();
    // Six minutes, more than the time limit of a recording request; the client never pauses for long.
    for _ in 0..18 {
        clock.pass(Duration::from_secs(20));
        stream.read_exact(&mut buffer).unwrap();
        taken += buffer.len() as u64;
    }
    loop {
        match stream.read(&mut buffer).unwrap() {
            0 => break,
            n => taken += n as u64,
        }
    }
    assert!(
        (BYTES..BYTES + 1_000).contains(&taken),
        "{taken} of {BYTES}"
    );
}
