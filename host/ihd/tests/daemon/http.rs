//! The daemon's API, asked by hand: HTTP/1.0, so that an answer ends with its connection.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use serde_json::Value;

use crate::process::PATIENCE;

/// Holder of the lease in these tests.
const HOLDER: &str = "tests";

/// Status and body of an answer that comes within `timeout`.
pub fn ask(
    to: SocketAddr,
    method: &str,
    path: &str,
    body: &str,
    timeout: Duration,
) -> io::Result<(u16, String)> {
    let mut stream = TcpStream::connect_timeout(&to, timeout)?;
    stream.set_read_timeout(Some(timeout))?;
    stream.set_write_timeout(Some(timeout))?;
    write!(
        stream,
        "{method} {path} HTTP/1.0\r\nHost: {to}\r\nihd-holder: {HOLDER}\r\nContent-Type: application/json\r\n\
         Content-Length: {}\r\n\r\n{body}",
        body.len()
    )?;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer)?;
    let answer = String::from_utf8_lossy(&answer);
    let (head, body) = answer
        .split_once("\r\n\r\n")
        .ok_or(io::ErrorKind::InvalidData)?;
    let status = head.split(' ').nth(1).and_then(|s| s.parse().ok());
    Ok((status.ok_or(io::ErrorKind::InvalidData)?, body.to_owned()))
}

/// A `GET` that must be answered with JSON.
pub fn get(from: SocketAddr, path: &str) -> io::Result<Value> {
    let (status, body) = ask(from, "GET", path, "", PATIENCE)?;
    match status {
        200 => serde_json::from_str(&body).map_err(io::Error::other),
        _ => Err(io::Error::other(format!("{path}: {status}: {body}"))),
    }
}

/// Notices as they come, until the stream ends.
pub struct Watch {
    /// Those that have come whole.
    pub notices: Arc<Mutex<Vec<Value>>>,
    reader: Option<thread::JoinHandle<()>>,
}

impl Watch {
    /// Begins to listen; returns once the daemon has said that it will tell.
    pub fn begin(from: SocketAddr) -> io::Result<Self> {
        let mut stream = TcpStream::connect_timeout(&from, PATIENCE)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        write!(
            stream,
            "GET /api/v1/events HTTP/1.0\r\nHost: {from}\r\n\r\n"
        )?;
        let mut lines = BufReader::new(stream).lines();
        // The head, and the first comment.
        for line in lines.by_ref() {
            if line?.starts_with(':') {
                break;
            }
        }
        let notices = Arc::new(Mutex::new(Vec::new()));
        let own = Arc::clone(&notices);
        let reader = thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let notice = line
                    .strip_prefix("data:")
                    .map(str::trim)
                    .map(serde_json::from_str);
                if let Some(Ok(notice)) = notice {
                    own.lock().unwrap().push(notice);
                }
            }
        });
        Ok(Self {
            notices,
            reader: Some(reader),
        })
    }

    /// Returns the events until the stream ended; the daemon must have ended.
    pub fn end(mut self) -> Vec<Value> {
        if let Some(reader) = self.reader.take() {
            let _ = reader.join();
        }
        std::mem::take(&mut self.notices.lock().unwrap())
    }
}
