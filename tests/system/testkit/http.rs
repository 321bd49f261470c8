//! A minimal HTTP client: one request, one answer.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};

use super::PATIENCE;

/// An answer.
#[derive(Debug)]
pub(crate) struct Page {
    pub(crate) code: u16,
    pub(crate) headers: String,
    pub(crate) body: String,
}

/// Requests a page as a client on the same machine.
pub(crate) fn get(at: SocketAddr, path: &str) -> Page {
    ask(at, path, &format!("Host: {at}\r\n"))
}

/// Requests a page with these headers.
pub(crate) fn ask(at: SocketAddr, path: &str, headers: &str) -> Page {
    request(at, &format!("GET {path} HTTP/1.1"), headers)
}

/// Sends a body with these headers.
pub(crate) fn post(at: SocketAddr, path: &str, headers: &str, body: &str) -> Page {
    let length = body.len();
    let headers = format!("Host: {at}\r\n{headers}Content-Length: {length}\r\n");
    send(at, &format!("POST {path} HTTP/1.1"), &headers, body)
}

/// Sends a request line with these headers.
pub(crate) fn request(at: SocketAddr, line: &str, headers: &str) -> Page {
    send(at, line, headers, "")
}

fn send(at: SocketAddr, line: &str, headers: &str, body: &str) -> Page {
    let mut stream = TcpStream::connect(at).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    // A server that refuses a request answers and closes before it has read all of it. Writing and reading
    // then end with an error, but the answer is complete in the receive buffer.
    let sent = write!(stream, "{line}\r\n{headers}Connection: close\r\n\r\n{body}");
    let mut answer = String::new();
    let received = stream.read_to_string(&mut answer);
    let (head, body) =
        answer.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{answer:?} {sent:?} {received:?}"));
    let code = head.split(' ').nth(1).unwrap().parse().unwrap();
    Page { code, headers: head.to_ascii_lowercase(), body: body.into() }
}
