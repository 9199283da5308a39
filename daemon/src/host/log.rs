//! The log: a thread of its own writes the lines to standard error.
//!
//! No other thread waits for the reader of the log. A pipe that is not read, a terminal that is
//! held, or a slow disk would block the thread that feeds the watchdog of systemd, or the one that
//! ends the process. A line that does not fit into the queue is dropped and counted.
//!
//! Where the journal of systemd reads, each line begins with its priority, as in `<3>`
//! (`sd-daemon(3)`), and bears no time: the journal has its own. `journalctl -p err` then shows the
//! errors.
//!
//! `tracing-appender` 0.2 does not serve: when the queue is full at the end of the process, its
//! guard prints to standard output, which can block for ever and panics when it is closed; it
//! writes nothing about dropped lines; and it panics when there can be no more threads.

use motord_terminal::printable;
use std::borrow::Cow;
use std::io::{self, IsTerminal, Write};
use std::os::unix::fs::MetadataExt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::Builder;
use std::time::Duration;
use tracing::{Level, Metadata};
use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::fmt::MakeWriter;

/// The most lines in the queue.
const LINES_MAX: usize = 1024;
/// The thread only writes lines. The memory of the process is locked, so every byte of its stack is
/// resident.
const STACK_BYTES: usize = 128 * 1024;
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
    /// Lines begin with their priority.
    for_journal: bool,
    /// Lines have the colours of a terminal.
    is_coloured: bool,
}

/// Writes lines of one level.
pub struct Lines {
    log: Log,
    level: Level,
}

impl Log {
    /// Starts the thread.
    ///
    /// # Errors
    ///
    /// The error of the system when it refuses a thread.
    pub fn to_stderr() -> io::Result<Self> {
        Self::to(io::stderr(), is_read_by_journal(), io::stderr().is_terminal())
    }

    fn to(out: impl Write + Send + 'static, for_journal: bool, is_coloured: bool) -> io::Result<Self> {
        let (messages, received) = sync_channel(LINES_MAX);
        let dropped = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&dropped);
        Builder::new()
            .name("motord-log".into())
            .stack_size(STACK_BYTES)
            .spawn(move || write(out, &received, &counted))?;
        Ok(Self { messages, dropped, for_journal, is_coloured })
    }

    /// Takes the lines of `tracing` from now on, those of `most` and more important ones.
    pub fn capture_tracing(&self, most: LevelFilter) {
        let lines = tracing_subscriber::fmt()
            .with_writer(self.clone())
            .with_max_level(most)
            .with_ansi(self.is_coloured)
            .with_target(false)
            // A closed log must not end a thread.
            .log_internal_errors(false);
        match self.for_journal {
            true => lines.without_time().with_level(false).init(),
            false => lines.init(),
        }
    }

    /// Writes the messages of panics from now on. The cycle damps its motors after the message of
    /// its panic, and must not wait for the writing.
    pub fn capture_panics(&self) {
        let log = self.clone();
        std::panic::set_hook(Box::new(move |panic| {
            let thread = std::thread::current();
            log.error(&format!("{}: {panic}", thread.name().unwrap_or("a thread")));
        }));
    }

    /// Writes an error. Never blocks. The text has no colours of ours: those in it are spelled out.
    pub fn error(&self, text: &str) {
        self.push(Level::ERROR, format!("{}\n", printable(text)).as_bytes());
    }

    /// Queues the lines of `text`, without characters that a terminal obeys or hides.
    fn push(&self, level: Level, text: &[u8]) {
        let text = String::from_utf8_lossy(text);
        let text = if self.is_coloured { except_colours(&text) } else { printable(&text).into_owned() };
        let text = if self.for_journal { with_priority(level, text.as_bytes()) } else { text.into_bytes() };
        if self.messages.try_send(Message::Line(text)).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Waits until every line is written, at most `FLUSH_TIME`; not at all when the queue is full.
    pub fn finish(&self) {
        let (written, answer) = channel();
        if self.messages.try_send(Message::Flush(written)).is_ok() {
            let _in_time = answer.recv_timeout(FLUSH_TIME);
        }
    }
}

impl<'a> MakeWriter<'a> for Log {
    type Writer = Lines;

    fn make_writer(&'a self) -> Lines {
        Lines { log: self.clone(), level: Level::INFO }
    }

    fn make_writer_for(&'a self, event: &Metadata<'_>) -> Lines {
        Lines { log: self.clone(), level: *event.level() }
    }
}

impl Write for Lines {
    /// One call is one message. Never blocks, never fails.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        self.log.push(self.level, line);
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Returns true if standard error is the stream of systemd's journal, whose device and inode are in
/// the environment.
fn is_read_by_journal() -> bool {
    let stream = std::env::var("JOURNAL_STREAM").ok();
    let device_and_inode = std::fs::metadata("/proc/self/fd/2").ok();
    let named = device_and_inode.map(|file| format!("{}:{}", file.dev(), file.ino()));
    stream.is_some() && stream == named
}

/// Spells out what [`printable`] does, without the escapes of colours. `tracing_subscriber` has
/// spelled out the escapes in the values.
fn except_colours(text: &str) -> String {
    const ESCAPE: char = '\u{1b}';
    text.split_inclusive(ESCAPE)
        .flat_map(|part| match part.strip_suffix(ESCAPE) {
            Some(part) => [printable(part), Cow::Borrowed("\u{1b}")],
            None => [printable(part), Cow::Borrowed("")],
        })
        .collect()
}

/// Each line with the priority of `level`, of `syslog(3)`.
fn with_priority(level: Level, text: &[u8]) -> Vec<u8> {
    let priority = match level {
        Level::ERROR => "<3>",
        Level::WARN => "<4>",
        Level::INFO => "<6>",
        Level::DEBUG | Level::TRACE => "<7>",
    };
    let lines = text.split_inclusive(|&byte| byte == b'\n');
    lines.flat_map(|line| [priority.as_bytes(), line].concat()).collect()
}

/// Writes lines until the last sender is gone. A line that cannot be written is lost: there is no
/// place to report it.
fn write(mut out: impl Write, messages: &Receiver<Message>, dropped: &AtomicU64) {
    for message in messages {
        match message {
            Message::Line(line) => {
                let _lost = out.write_all(&line);
            }
            Message::Flush(written) => {
                let _lost = out.flush();
                let _disconnected = written.send(());
            }
        }
        let lines = dropped.swap(0, Ordering::Relaxed);
        if lines > 0 {
            let _lost =
                writeln!(out, "{lines} log lines were dropped: standard error was not read fast enough");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{BufRead, BufReader};
    use std::os::unix::net::UnixStream;

    #[test]
    fn unread_log_blocks_no_thread_and_counts_drops() {
        let (reader, writer) = UnixStream::pair().unwrap();
        let log = Log::to(writer, false, false).unwrap();
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
        let log = Log::to(writer, false, false).unwrap();
        log.error("the motors are stopped");
        log.finish();
        reader.set_nonblocking(true).unwrap();
        assert_eq!(BufReader::new(reader).lines().next().unwrap().unwrap(), "the motors are stopped");
    }

    #[test]
    fn log_neither_reorders_nor_hides_text() {
        for is_coloured in [false, true] {
            let (reader, writer) = UnixStream::pair().unwrap();
            let log = Log::to(writer, false, is_coloured).unwrap();
            let text = "\u{1b}[31mERROR\u{1b}[0m knee\u{202e}\u{7f}\u{200b}\nend\n";
            log.make_writer().write_all(text.as_bytes()).unwrap();
            log.finish();
            reader.set_nonblocking(true).unwrap();
            let lines: Vec<String> = BufReader::new(reader).lines().map_while(Result::ok).collect();
            let escape = if is_coloured { "\u{1b}" } else { "\\u{1b}" };
            let expected = format!("{escape}[31mERROR{escape}[0m knee\\u{{202e}}\\u{{7f}}\\u{{200b}}");
            assert_eq!(lines, [expected.as_str(), "end"]);
        }
    }

    /// Such as the message of a panic, which may contain text of another process.
    #[test]
    fn error_does_not_colour_a_terminal() {
        let (reader, writer) = UnixStream::pair().unwrap();
        let log = Log::to(writer, false, true).unwrap();
        log.error("motord-ipc: panicked at \u{1b}[2Jknee");
        log.finish();
        reader.set_nonblocking(true).unwrap();
        let line = BufReader::new(reader).lines().next().unwrap().unwrap();
        assert_eq!(line, "motord-ipc: panicked at \\u{1b}[2Jknee");
    }

    #[test]
    fn journal_lines_begin_with_their_priority() {
        assert_eq!(with_priority(Level::WARN, b"one\ntwo\n"), b"<4>one\n<4>two\n");
        let priority = |level| with_priority(level, b"x")[1];
        assert_eq!([Level::ERROR, Level::INFO, Level::DEBUG].map(priority), *b"367");
    }
}
