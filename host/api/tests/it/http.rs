//! Raw HTTP/1.1, also malformed.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

/// Time limit of a read; only ends a hanging test.
pub const PATIENCE: Duration = Duration::from_secs(300);

/// Sends a request with `Host: localhost` and `Connection: close`; returns status and body of the response.
pub fn ask(to: SocketAddr, request_line: &str, headers: &[&str], body: &str) -> (u16, String) {
    let mut all = vec!["Host: localhost"];
    all.extend(headers);
    raw(to, request_line, &all, body)
}

/// Does the same as [`ask`], without `Host`.
pub fn raw(to: SocketAddr, request_line: &str, headers: &[&str], body: &str) -> (u16, String) {
    answer(&mut sent(to, request_line, headers, body))
}

/// Does the same as [`ask`]; returns status, head in lower case, and body as bytes.
pub fn whole(
    to: SocketAddr,
    request_line: &str,
    headers: &[&str],
    body: &str,
) -> (u16, String, Vec<u8>) {
    let mut all = vec!["Host: localhost"];
    all.extend(headers);
    let bytes = read_all(&mut sent(to, request_line, &all, body));
    let end = bytes.windows(4).position(|four| four == b"\r\n\r\n");
    let (head, body) = bytes.split_at(end.expect("a head") + 4);
    let head = String::from_utf8_lossy(head).to_lowercase();
    (status(&head), head, body.to_vec())
}

/// Returns the value of a header in a head from [`whole`].
pub fn header<'a>(head: &'a str, name: &str) -> Option<&'a str> {
    let of = |line: &'a str| line.strip_prefix(name)?.strip_prefix(": ");
    head.split("\r\n").find_map(of)
}

fn sent(to: SocketAddr, request_line: &str, headers: &[&str], body: &str) -> TcpStream {
    let mut stream = connect(to);
    let mut request = format!("{request_line} HTTP/1.1\r\nConnection: close\r\n");
    for header in headers {
        request += &format!("{header}\r\n");
    }
    if !body.is_empty() {
        request += &format!("Content-Length: {}\r\n", body.len());
    }
    request += &format!("\r\n{body}");
    // A server that refuses early may close before it has taken everything.
    let _ = stream.write_all(request.as_bytes());
    stream
}

pub fn connect(to: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(to).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

/// Reads a response until the server closes the connection.
pub fn answer(stream: &mut TcpStream) -> (u16, String) {
    let text = String::from_utf8_lossy(&read_all(stream)).into_owned();
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
    (status(head), body.to_owned())
}

fn status(head: &str) -> u16 {
    let status = head.split(' ').nth(1).and_then(|s| s.parse().ok());
    status.unwrap_or(0)
}

fn read_all(stream: &mut TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut buffer = [0; 4096];
    loop {
        match stream.read(&mut buffer) {
            Ok(0) => return bytes,
            Ok(n) => bytes.extend(&buffer[..n]),
            Err(e) if e.kind() == std::io::ErrorKind::ConnectionReset && !bytes.is_empty() => {
                return bytes;
            }
            Err(e) => panic!("{e} after {:?}", String::from_utf8_lossy(&bytes)),
        }
    }
}
