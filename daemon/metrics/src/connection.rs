//! A connection to the server of the metrics: the head of one request in, one answer out, without
//! waiting.

use bytes::Bytes;
use http::header::{CONTENT_LENGTH, TRANSFER_ENCODING};
use http::{Method, Request, Response, StatusCode, Version};
use httparse::{EMPTY_HEADER, Error, Status};
use nix::poll::{PollFd, PollFlags};
use std::io::{self, ErrorKind, IoSlice, Read, Write};
use std::net::TcpStream;
use std::os::fd::AsFd;
use std::time::{Duration, Instant, SystemTime};

/// Longest head of a request, in bytes.
pub(crate) const HEAD_BYTES_MAX: usize = 8 * 1024;
/// Most header fields of a request.
pub(crate) const HEADERS_MAX: usize = 64;

/// Bounds of the connections.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Most connections. One more closes the oldest.
    pub(crate) connections: usize,
    /// Longest time until the head of the request is complete, also of a connection that sends
    /// nothing.
    pub(crate) head: Duration,
    /// Longest time of a connection, also of one that reads no answer.
    pub(crate) connection: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self { connections: 32, head: Duration::from_secs(2), connection: Duration::from_secs(10) }
    }
}

/// An open connection.
#[derive(Debug)]
pub(crate) struct Connection {
    stream: TcpStream,
    opened: Instant,
    limits: Limits,
    /// The part of the request that was received, at most [`HEAD_BYTES_MAX`].
    request: Vec<u8>,
    answer: Option<Answer>,
}

/// An answer, of which `sent` bytes are sent.
#[derive(Debug)]
struct Answer {
    head: Vec<u8>,
    body: Bytes,
    sent: usize,
}

impl Connection {
    /// Begins to serve `stream`, which does not block.
    pub(crate) fn new(stream: TcpStream, limits: Limits) -> Self {
        Self { stream, opened: Instant::now(), limits, request: Vec::new(), answer: None }
    }

    /// When it must be closed.
    pub(crate) fn deadline(&self) -> Instant {
        self.opened + if self.answer.is_some() { self.limits.connection } else { self.limits.head }
    }

    /// The event that it waits for.
    pub(crate) fn poll(&self) -> PollFd<'_> {
        let flags = if self.answer.is_some() { PollFlags::POLLOUT } else { PollFlags::POLLIN };
        PollFd::new(self.stream.as_fd(), flags)
    }

    /// Receives and sends what it can without waiting. Returns `false` at the end of the
    /// connection.
    pub(crate) fn advance(&mut self, answer: impl FnOnce(&Request<()>) -> Response<Bytes>) -> bool {
        self.transfer(answer)
            .unwrap_or_else(|error| matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted))
    }

    fn transfer(&mut self, answer: impl FnOnce(&Request<()>) -> Response<Bytes>) -> io::Result<bool> {
        if self.answer.is_none() {
            let mut received = [0; HEAD_BYTES_MAX];
            let count = self.stream.read(&mut received[..HEAD_BYTES_MAX - self.request.len()])?;
            self.request.extend_from_slice(&received[..count]);
            self.answer = match parse(&self.request) {
                _ if count == 0 => return Ok(false),
                Ok(None) => return Ok(true),
                Ok(Some(request)) => Some(Answer::new(&request, &answer(&request))),
                Err(status) => Some(Answer::refusal(status)),
            };
        }
        self.answer.as_mut().map_or(Ok(true), |answer| answer.send(&mut self.stream))
    }
}

impl Answer {
    fn new(request: &Request<()>, answer: &Response<Bytes>) -> Self {
        let minor = u8::from(request.version() != Version::HTTP_10);
        let status = answer.status();
        let mut head = format!("HTTP/1.{minor} {status}\r\n").into_bytes();
        for (name, value) in answer.headers() {
            head.extend([name.as_str().as_bytes(), b": ", value.as_bytes(), b"\r\n"].concat());
        }
        // Of HTTP/1.0 it is the default.
        let closes = if minor == 0 { "" } else { "connection: close\r\n" };
        let (length, date) = (answer.body().len(), httpdate::fmt_http_date(SystemTime::now()));
        head.extend(format!("{closes}content-length: {length}\r\ndate: {date}\r\n\r\n").bytes());
        let has_body = request.method() != Method::HEAD;
        Self { head, body: if has_body { answer.body().clone() } else { Bytes::new() }, sent: 0 }
    }

    /// The answer to a request that cannot be read.
    fn refusal(status: StatusCode) -> Self {
        let mut answer = Response::new(Bytes::new());
        *answer.status_mut() = status;
        Self::new(&Request::new(()), &answer)
    }

    /// Sends what the system accepts. Returns `false` when all is sent.
    fn send(&mut self, stream: &mut TcpStream) -> io::Result<bool> {
        let head = &self.head[self.sent.min(self.head.len())..];
        let body = &self.body[self.sent.saturating_sub(self.head.len())..];
        self.sent += stream.write_vectored(&[IoSlice::new(head), IoSlice::new(body)])?;
        Ok(self.sent < self.head.len() + self.body.len())
    }
}

/// Returns the request once its head is complete.
///
/// # Errors
/// The status of a request that is no HTTP, or beyond the bounds.
fn parse(bytes: &[u8]) -> Result<Option<Request<()>>, StatusCode> {
    let mut fields = [EMPTY_HEADER; HEADERS_MAX];
    let mut parsed = httparse::Request::new(&mut fields);
    match parsed.parse(bytes) {
        Ok(Status::Complete(_)) => {}
        Ok(Status::Partial) if bytes.len() < HEAD_BYTES_MAX => return Ok(None),
        Ok(Status::Partial) | Err(Error::TooManyHeaders) => {
            return Err(StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE);
        }
        Err(_) => return Err(StatusCode::BAD_REQUEST),
    }
    let version = if parsed.version == Some(0) { Version::HTTP_10 } else { Version::HTTP_11 };
    let mut request = Request::builder()
        .method(parsed.method.unwrap_or_default())
        .uri(parsed.path.unwrap_or_default())
        .version(version);
    for field in parsed.headers {
        request = request.header(field.name, field.value);
    }
    let request = request.body(()).ok().filter(has_valid_length);
    request.map(Some).ok_or(StatusCode::BAD_REQUEST)
}

/// Returns whether the header states the length of the body as RFC 9112, section 6.3 requires. The
/// body itself is not read.
fn has_valid_length(request: &Request<()>) -> bool {
    let lengths = request.headers().get_all(CONTENT_LENGTH);
    let first = lengths.iter().next();
    if let Some(coding) = request.headers().get_all(TRANSFER_ENCODING).iter().next_back() {
        let last = coding.as_bytes().rsplit(|byte| *byte == b',').next().unwrap_or_default();
        return request.version() == Version::HTTP_11 && last.trim_ascii().eq_ignore_ascii_case(b"chunked");
    }
    let is_number = |length: &[u8]| length.iter().all(u8::is_ascii_digit) && !length.is_empty();
    lengths.iter().all(|length| is_number(length.as_bytes()) && Some(length) == first)
}
