//! Where lines of the log go: to a thread of its own that writes them to standard error.
//!
//! Nobody else waits for whoever reads them. A pipe that is not read, a terminal that is held, or a disk that is slow would
//! else hold up the thread that tells systemd that the cycle lives, or the one that is told to end. A line that finds no room
//! is dropped, and the number of them told.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::Builder;
use std::time::Duration;

/// Lines that may wait for their reader.
const LINES_MAX: usize = 1024;
/// How long the end of the process waits for a reader.
const FLUSH_TIME: Duration = Duration::from_millis(500);

enum Message {
    Line(Vec<u8>),
    /// Everything before it was written.
    Flush(Sender<()>),
}

/// Standard error, without waiting for it.
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
    /// When there can be no more threads.
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

    /// Takes what panics say from now on: the cycle damps its motors after its panic was told, and must not wait either.
    pub fn hear_panics(&self) {
        let log = self.clone();
        std::panic::set_hook(Box::new(move |panic| {
            let thread = std::thread::current();
            let line = format!("{}: {panic}\n", thread.name().unwrap_or("a thread"));
            let _never_fails = log.clone().write_all(line.as_bytes());
        }));
    }

    /// Waits until every line is written, half a second at most.
    pub fn finish(&self) {
        let (written, answer) = channel();
        if self.messages.try_send(Message::Flush(written)).is_ok() {
            let _in_time = answer.recv_timeout(FLUSH_TIME);
        }
    }
}

impl Write for Log {
    /// One call is one line. Never waits, never fails.
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

/// What cannot be written is lost: there is nowhere to say so.
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
    fn a_log_that_nobody_reads_holds_nobody_up_and_tells_what_was_dropped() {
        let (reader, writer) = UnixStream::pair().unwrap();
        let mut log = Log::to(writer).unwrap();
        for line in 0..100_000 {
            log.write_all(format!("line {line}\n").as_bytes()).unwrap();
        }
        log.finish();
        let lines = BufReader::new(reader).lines().map_while(Result::ok);
        let told: Vec<_> = lines.take_while(|line| !line.contains("dropped")).collect();
        assert_eq!(told[0], "line 0");
        assert!(told.len() < 100_000);
    }

    #[test]
    fn what_was_logged_before_the_end_is_written() {
        let (reader, writer) = UnixStream::pair().unwrap();
        let mut log = Log::to(writer).unwrap();
        log.write_all(b"the motors are stopped\n").unwrap();
        log.finish();
        reader.set_nonblocking(true).unwrap();
        assert_eq!(BufReader::new(reader).lines().next().unwrap().unwrap(), "the motors are stopped");
    }
}
