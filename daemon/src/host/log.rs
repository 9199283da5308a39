//! The log: a thread of its own writes the lines to standard error.
//!
//! No other thread waits for the reader of the log. A pipe that is not read, a terminal that is held, or a slow disk would
//! block the thread that feeds the watchdog of systemd, or the one that ends the process. A line that does not fit into the
//! queue is dropped and counted.
//!
//! `tracing-appender` 0.2 does not serve: when the queue is full at the end of the process, its guard prints to standard
//! output, which can block for ever and panics when it is closed; it writes nothing about dropped lines; and it panics when
//! there can be no more threads.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::Builder;
use std::time::Duration;

/// The most lines in the queue.
const LINES_MAX: usize = 1024;
/// The most time that the end of the process waits for the reader.
const FLUSH_TIME: Duration = Duration::from_millis(500);

enum Message {
    Line(Vec<u8>),
    /// Answered when all lines before it are written.
    Flush(Sender<()>),
}

/// A writer to standard error that never blocks.
#[derive(Clone)]
pub struct Log {
    messages: SyncSender<Message>,
    dropped: Arc<AtomicU64>,
}

impl Log {
    /// Starts the thread.
    ///
    /// # Errors
    ///
    /// The error of the system when it refuses a thread.
    pub fn to_stderr() -> io::Result<Self> {
        Self::to(io::stderr())
    }

    fn to(out: impl Write + Send + 'static) -> io::Result<Self> {
        let (messages, received) = sync_channel(LINES_MAX);
        let dropped = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&dropped);
        Builder::new().name("motord-log".into()).spawn(move || write(out, &received, &counted))?;
        Ok(Self { messages, dropped })
    }

    /// Writes the messages of panics from now on. The cycle damps its motors after the message of its panic, and must not
    /// wait for it either.
    pub fn hear_panics(&self) {
        let log = self.clone();
        std::panic::set_hook(Box::new(move |panic| {
            let thread = std::thread::current();
            let line = format!("{}: {panic}\n", thread.name().unwrap_or("a thread"));
            let _never_fails = log.clone().write_all(line.as_bytes());
        }));
    }

    /// Waits until every line is written, at most `FLUSH_TIME`.
    pub fn finish(&self) {
        let (written, answer) = channel();
        if self.messages.try_send(Message::Flush(written)).is_ok() {
            let _in_time = answer.recv_timeout(FLUSH_TIME);
        }
    }
}

impl Write for Log {
    /// One call is one line. Never blocks, never fails.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        if self.messages.try_send(Message::Line(line.to_vec())).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Writes lines until the last sender is gone. A line that cannot be written is lost: there is no place to report it.
fn write(mut out: impl Write, messages: &Receiver<Message>, dropped: &AtomicU64) {
    for message in messages {
        match message {
            Message::Line(line) => {
                let _lost = out.write_all(&line);
            }
            Message::Flush(written) => {
                let _lost = out.flush();
                let _gone = written.send(());
            }
        }
        let lines = dropped.swap(0, Ordering::Relaxed);
        if lines > 0 {
            let _lost = writeln!(out, "{lines} lines of this log were dropped: nobody read them");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{BufRead, BufReader};
    use std::os::unix::net::UnixStream;

    #[test]
    fn a_log_that_nobody_reads_blocks_no_thread_and_counts_dropped_lines() {
        let (reader, writer) = UnixStream::pair().unwrap();
        let mut log = Log::to(writer).unwrap();
        for line in 0..100_000 {
            log.write_all(format!("line {line}\n").as_bytes()).unwrap();
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
        let mut log = Log::to(writer).unwrap();
        log.write_all(b"the motors are stopped\n").unwrap();
        log.finish();
        reader.set_nonblocking(true).unwrap();
        assert_eq!(BufReader::new(reader).lines().next().unwrap().unwrap(), "the motors are stopped");
    }
}
