//! The thread that prints: the loop that moves the robot never waits for the reader of its output.

use crate::failure::Failure;
use crate::hold::report::{Line, Report};
use std::io::{self, Write};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

/// Lines that wait for a slow reader. Further ones are left out.
const WAITING_MAX: usize = 16;

/// Something to print.
enum Text {
    Sentences(Vec<String>),
    Line(Line),
}

/// The caller's end of the thread.
pub(crate) struct Printer {
    texts: SyncSender<Text>,
    thread: JoinHandle<io::Result<()>>,
}

impl Printer {
    /// Starts the thread, which prints on standard output, `as_json` or as text.
    ///
    /// # Errors
    ///
    /// The thread cannot be started.
    pub(crate) fn start(as_json: bool) -> io::Result<Self> {
        let (texts, taken) = sync_channel(WAITING_MAX);
        let print = move || print(&Report::new(as_json), &taken);
        let thread = std::thread::Builder::new().name("motorctl-print".to_owned()).spawn(print)?;
        Ok(Self { texts, thread })
    }

    /// Prints sentences for people. Never blocks. Returns false once the output cannot be written.
    pub(crate) fn print_text(&self, sentences: Vec<String>) -> bool {
        self.pass(Text::Sentences(sentences))
    }

    /// Prints the joints at one time, or leaves them out where the reader is slow. Never blocks.
    /// Returns false once the output cannot be written.
    pub(crate) fn line(&self, line: Line) -> bool {
        self.pass(Text::Line(line))
    }

    fn pass(&self, text: Text) -> bool {
        !matches!(self.texts.try_send(text), Err(TrySendError::Disconnected(_)))
    }

    /// Waits until everything is printed.
    ///
    /// # Errors
    ///
    /// The output cannot be written.
    pub(crate) fn end(self) -> Result<(), Failure> {
        drop(self.texts);
        let printed = self.thread.join().unwrap_or_else(|_| Err(io::Error::other("the thread panicked")));
        Ok(printed?)
    }
}

fn print(report: &Report, texts: &Receiver<Text>) -> io::Result<()> {
    for text in texts {
        let out = &mut io::stdout().lock();
        match text {
            Text::Sentences(sentences) => {
                sentences.iter().try_for_each(|sentence| report.print_text(out, sentence))?;
                out.flush()?;
            }
            Text::Line(line) => report.line(out, &line)?,
        }
    }
    Ok(())
}
