//! The metrics by HTTP, beside clients that are silent, slow or strange.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

use motord_metrics::{Outputs, Wanted};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// More than the server accepts.
const MANY: usize = 100;
/// A test that waits longer has failed.
const TIMEOUT: Duration = Duration::from_secs(60);

fn serve() -> (Outputs, SocketAddr) {
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let wanted = Wanted { listen: Some(free), ..Wanted::default() };
    let outputs = Outputs::start(&wanted).unwrap();
    outputs.publish("motord_cycles_total 1\n".into());
    (outputs, free)
}

fn connect(server: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(server).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    stream
}

fn ask(server: SocketAddr, request: &str) -> String {
    let mut client = connect(server);
    client.write_all(request.as_bytes()).unwrap();
    io::read_to_string(client).unwrap()
}

fn scrape(server: SocketAddr) -> Duration {
    let began = Instant::now();
    let answer = ask(server, "GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n");
    assert!(answer.starts_with("HTTP/1.1 200 OK\r\n"), "{answer}");
    assert!(answer.ends_with("\r\n\r\nmotord_cycles_total 1\n"), "{answer}");
    began.elapsed()
}

fn is_open(mut stream: &TcpStream) -> bool {
    stream.set_nonblocking(true).unwrap();
    matches!(stream.read(&mut [0; 1024]), Err(error) if error.kind() == ErrorKind::WouldBlock)
}

#[test]
fn silent_connections_delay_no_scrape() {
    let (_outputs, server) = serve();
    let alone = (0..5).map(|_| scrape(server)).max().unwrap();
    let silent: Vec<_> = (0..20).map(|_| connect(server)).collect();
    let among = scrape(server);
    // The scrape waited for the end of none of them.
    let open = silent.iter().filter(|stream| is_open(stream)).count();
    assert_eq!(open, silent.len(), "{among:?} among silent connections, {alone:?} alone");
}

#[test]
fn scrape_is_served_beyond_the_most_connections() {
    let (_outputs, server) = serve();
    let mut silent: Vec<_> = (0..MANY).map(|_| connect(server)).collect();
    scrape(server);
    assert!(is_open(silent.last().unwrap()), "the scrape waited for the end of the last");
    let mut first = silent.swap_remove(0);
    // Closed with or without an answer.
    let _closed = first.read_to_end(&mut Vec::new());
}

#[test]
fn host_of_another_name_is_refused() {
    let (_outputs, server) = serve();
    let status = |host: &str| {
        let answer = ask(server, &format!("GET /metrics HTTP/1.1\r\nHost: {host}\r\n\r\n"));
        answer.split_whitespace().nth(1).map(str::to_owned)
    };
    for host in ["localhost", "LOCALHOST:9464", "127.0.0.1", "127.1.2.3:1", "[::1]:9464"] {
        assert_eq!(status(host).as_deref(), Some("200"), "{host}");
    }
    for host in
        ["attacker.example", "attacker.example:9464", "127.0.0.1.attacker.example", "192.168.0.1", "[::2]"]
    {
        assert_eq!(status(host).as_deref(), Some("421"), "{host}");
    }
}

#[test]
fn request_in_pieces_is_answered() {
    let (_outputs, server) = serve();
    let mut client = connect(server);
    for piece in ["GET /met", "rics HTTP/1.1\r\nHo", "st: localhost\r\n", "\r\n"] {
        client.write_all(piece.as_bytes()).unwrap();
        std::thread::sleep(Duration::from_millis(100));
    }
    let answer = io::read_to_string(client).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200 OK\r\n"), "{answer}");
}

#[test]
fn request_that_never_ends_is_closed() {
    let (_outputs, server) = serve();
    let mut slow = connect(server);
    slow.write_all(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n").unwrap();
    let began = Instant::now();
    while slow.write_all(b"A: b\r\n").is_ok() {
        assert!(began.elapsed() < TIMEOUT, "still open");
        std::thread::sleep(Duration::from_millis(50));
        scrape(server);
    }
}
