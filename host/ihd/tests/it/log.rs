//! `ihd log` with a board on TCP that says what it is told to.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::thread::{self, JoinHandle};

use ihd_fakes::log_board::Logged;
use ihd_fakes::{LogBoard, SampleImage, SampleLog, free_address};
use serde_json::Value;

/// Talks until the host is gone, or, where the cable is `short`, until it has logged.
fn talk(mut stream: TcpStream, mut board: LogBoard, short: bool) {
    let mut byte = [0];
    while stream.read(&mut byte).is_ok_and(|n| n == 1) {
        let sent = stream.write_all(&board.receive(byte[0]));
        if sent.is_err() || (short && board.has_logged) {
            return;
        }
    }
}

/// A board for so many connections, each with what it logs; all but the last are cut off.
pub fn board(build_id: u8, connections: Vec<Vec<Logged>>) -> (String, JoinHandle<()>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp:{}", listener.local_addr().unwrap());
    let board = thread::spawn(move || {
        let last = connections.len() - 1;
        for (k, logs) in connections.into_iter().enumerate() {
            let (stream, _) = listener.accept().unwrap();
            talk(stream, LogBoard::new(build_id, logs), k < last);
        }
    });
    (address, board)
}

/// The image of the board: its build id is all 0xB1.
pub fn image(dir: &Path) {
    let elf = SampleLog::of_everything().within(SampleImage::default().elf());
    std::fs::write(dir.join("board.elf"), elf).unwrap();
}

fn log(dir: &Path, address: &str, options: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ihd"));
    command
        .current_dir(dir)
        .env("XDG_DATA_HOME", dir.join("data"))
        .env_remove("RUST_BACKTRACE")
        .args(["log", address])
        .args(options)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// ^C, and what it said.
fn interrupted(child: Child) -> Output {
    let pid = child.id().to_string();
    let kill = Command::new("kill").args(["-INT", &pid]).status().unwrap();
    assert!(kill.success());
    child.wait_with_output().unwrap()
}

/// Its first `n` objects, then ^C; and what else it said.
fn objects(mut child: Child, n: usize) -> (Vec<Value>, Output) {
    let mut stdout = BufReader::new(child.stdout.take().unwrap());
    let mut objects = Vec::new();
    for _ in 0..n {
        let mut line = String::new();
        stdout.read_line(&mut line).unwrap();
        assert!(
            line.chars().all(|c| c == '\n' || !c.is_control()),
            "{line:?}"
        );
        objects.push(serde_json::from_str(&line).unwrap_or_else(|why| panic!("{why}: {line:?}")));
    }
    let output = interrupted(child);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    (objects, output)
}

#[test]
fn messages_come_as_objects_and_a_cable_that_comes_back_is_told_once() {
    let dir = tempfile::tempdir().unwrap();
    image(dir.path());
    let evil = "\x1b]0;owned\x07\n{\"event\":\"away\"}";
    let text = [
        &[evil.len() as u8, 0, 0, 0][..],
        evil.as_bytes(),
        &[13, 0],
        &[0; 7],
    ]
    .concat();
    let first = SampleLog::frame(1, &[1, 0, 0, 0]);
    let next = first.len() as u32;
    let (address, board) = board(
        0xB1,
        vec![
            vec![(0, 2, first), (next + 9, 2, SampleLog::frame(3, &text))],
            vec![(
                70,
                3,
                [vec![9, 9, 0], SampleLog::frame(2, &[7, 0])].concat(),
            )],
        ],
    );
    let options = ["--json", "--image", "board.elf"];
    let child = log(dir.path(), &address, &options).spawn().unwrap();
    let (lines, _) = objects(child, 6);
    board.join().unwrap();
    let events: Vec<_> = lines.iter().map(|line| line["event"].as_str()).collect();
    assert_eq!(
        events,
        [
            Some("connected"),
            None,
            None,
            Some("away"),
            Some("back"),
            None
        ]
    );
    assert_eq!(lines[0]["build_id"], "b1".repeat(20));
    assert_eq!(lines[0]["image"], "board.elf");
    assert_eq!(lines[1]["message"], "watchdog runs: 1 µs");
    assert_eq!(lines[1]["level"], "info");
    assert_eq!(
        (&lines[1]["dropped"], &lines[1]["lost_bytes"]),
        (&2.into(), &0.into())
    );
    assert_eq!(
        (&lines[2]["dropped"], &lines[2]["lost_bytes"]),
        (&0.into(), &9.into())
    );
    let shown = lines[2]["message"].as_str().unwrap();
    assert!(shown.starts_with(r"\u{1b}]0;owned\u{7}\u{a}{"), "{shown}");
    assert_eq!(lines[5]["message"], "self-test: fault 0x0007");
    assert_eq!(
        (&lines[5]["dropped"], &lines[5]["malformed"]),
        (&1.into(), &1.into())
    );
}

#[test]
fn another_images_texts_are_never_used() {
    let dir = tempfile::tempdir().unwrap();
    image(dir.path());
    let (address, board) = board(0x22, vec![vec![]]);
    let refused = log(dir.path(), &address, &["--image", "board.elf"])
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1), "{stderr}");
    assert!(
        stderr.contains("b1b1b1b1") && stderr.contains("22222222"),
        "{stderr}"
    );
    board.join().unwrap();
}

#[test]
fn without_the_image_messages_are_counted_and_it_says_where_it_looked() {
    let dir = tempfile::tempdir().unwrap();
    let logs = vec![(0, 0, SampleLog::frame(1, &[1, 0, 0, 0]).repeat(3))];
    let (address, board) = board(0x33, vec![logs]);
    let mut child = log(dir.path(), &address, &[]).spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
    let head: Vec<String> = said.by_ref().take(2).map(Result::unwrap).collect();
    assert!(
        head[1].contains("33333333") && head[1].contains("--image"),
        "{head:?}"
    );
    // What the board sent behind its answer is here by then.
    thread::sleep(std::time::Duration::from_millis(300));
    let output = interrupted(child);
    assert_eq!(output.status.code(), Some(0));
    assert!(output.stdout.is_empty());
    let tail: Vec<String> = said.map(Result::unwrap).collect();
    assert!(
        tail.iter()
            .any(|line| line.contains("3 messages whose texts are not here")),
        "{tail:?}"
    );
    board.join().unwrap();
}

#[test]
fn what_is_not_there_is_3_and_what_is_no_device_is_2() {
    let dir = tempfile::tempdir().unwrap();
    let nowhere = free_address();
    for (device, code) in [
        (format!("tcp:{nowhere}"), 3),
        ("tpc:x:1".into(), 2),
        ("sim".into(), 2),
    ] {
        let output = log(dir.path(), &device, &[]).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{device}: {stderr}");
        assert!(
            stderr.starts_with("ihd: ") && stderr.lines().count() == 1,
            "{stderr}"
        );
    }
}
