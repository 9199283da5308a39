//! The writing of the log.

use super::*;
use std::io::{BufRead, BufReader};
use std::os::unix::net::UnixStream;

#[test]
fn unread_log_blocks_no_thread_and_counts_drops() {
    let (reader, writer) = UnixStream::pair().unwrap();
    let log = Log::to(writer, false).unwrap();
    for line in 0..100_000 {
        log.error(&format!("line {line}"));
    }
    log.finish();
    let lines = BufReader::new(reader).lines().map_while(Result::ok);
    let written: Vec<_> = lines.take_while(|line| !line.contains("dropped")).collect();
    assert_eq!(written[0], "line 0");
    assert!(written.len() < 100_000);
}

#[test]
fn lines_before_the_end_are_written() {
    let (reader, writer) = UnixStream::pair().unwrap();
    let log = Log::to(writer, false).unwrap();
    log.error("the motors are stopped");
    log.finish();
    reader.set_nonblocking(true).unwrap();
    assert_eq!(BufReader::new(reader).lines().next().unwrap().unwrap(), "the motors are stopped");
}

#[test]
fn journal_lines_begin_with_their_priority() {
    assert_eq!(with_priority(Level::WARN, b"one\ntwo\n"), b"<4>one\n<4>two\n");
    let priority = |level| with_priority(level, b"x")[1];
    assert_eq!([Level::ERROR, Level::INFO, Level::DEBUG].map(priority), *b"367");
}
