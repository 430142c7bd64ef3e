//! HTTP by hand: what no well-behaved client would send.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

/// Sends a request as it is; gives status and body of the answer. `Host: localhost` and `Connection: close` are added.
pub fn ask(to: SocketAddr, request_line: &str, headers: &[&str], body: &str) -> (u16, String) {
    let mut all = vec!["Host: localhost"];
    all.extend(headers);
    raw(to, request_line, &all, body)
}

/// As [`ask`], without a host of its own.
pub fn raw(to: SocketAddr, request_line: &str, headers: &[&str], body: &str) -> (u16, String) {
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
    answer(&mut stream)
}

pub fn connect(to: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(to).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(30)))
        .unwrap();
    stream
}

/// Reads until the other end closes.
pub fn answer(stream: &mut TcpStream) -> (u16, String) {
    let mut bytes = Vec::new();
    let mut buffer = [0; 4096];
    loop {
        match stream.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => bytes.extend(&buffer[..n]),
            Err(e) if e.kind() == std::io::ErrorKind::ConnectionReset && !bytes.is_empty() => break,
            Err(e) => panic!("{e} after {:?}", String::from_utf8_lossy(&bytes)),
        }
    }
    let text = String::from_utf8_lossy(&bytes).into_owned();
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
    let status = head.split(' ').nth(1).and_then(|s| s.parse().ok());
    (status.unwrap_or(0), body.to_owned())
}
