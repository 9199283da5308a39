//! Questions and answers, over any input and output.

use crate::failure::DirectFailure;
use motord_bus::Refusal;
use motord_protocol::commissioning::Error;
use motord_terminal::{Interrupt, printable};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::termios::{FlushArg, tcflush};
use std::io::{self, Stdin, Write};
use std::os::fd::AsFd;
use std::time::Duration;

/// Time between two readings of a motor while a question is open.
const PERIOD: Duration = Duration::from_millis(50);
/// Longest line that is read.
const LINE_MAX: usize = 256;

/// The source of the answers.
pub(crate) trait Input {
    /// Waits at most this long for a line.
    fn line(&mut self, wait: Duration) -> Line;
    /// Drops what was typed before a question: it cannot be meant for it.
    fn discard(&mut self);
}

/// The state of a source of answers.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Line {
    Text(String),
    Nothing,
    /// The input has ended, or a signal has arrived.
    End,
}

/// An answer to a question.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// Go on.
    Enter,
    Text(String),
    /// Undo the last step.
    Back,
    /// Leave this joint out.
    Skip,
}

/// The end of a question that also watches something.
pub(super) enum Watched<T> {
    Answer(Answer),
    Seen(T),
}

/// The result of a reading.
pub(super) enum Reading<T> {
    /// A line for the person.
    Shows(String),
    /// The end of the question.
    Ends(T),
}

/// The end of the guide before its last step.
#[derive(Debug)]
pub(super) enum Halt {
    /// The person leaves.
    Leave,
    Failure(DirectFailure),
}

impl<F: Into<DirectFailure>> From<F> for Halt {
    fn from(failure: F) -> Self {
        Self::Failure(failure.into())
    }
}

/// The person at the terminal.
pub(super) struct Dialog<'d> {
    input: &'d mut dyn Input,
    output: &'d mut dyn Write,
}

const KEYS: &str = "Enter goes on, `b` undoes the last step, `s` leaves this joint out, `q` leaves: the guide goes on there.";

impl<'d> Dialog<'d> {
    pub(super) fn new(input: &'d mut dyn Input, output: &'d mut dyn Write) -> Self {
        Self { input, output }
    }

    /// Prints a sentence.
    pub(super) fn print(&mut self, sentence: &str) -> Result<(), Halt> {
        Ok(writeln!(self.output, "{}", printable(sentence))?)
    }

    /// Asks until there is an answer. `help` explains the question.
    pub(super) fn ask(&mut self, question: &str, help: &str) -> Result<Answer, Halt> {
        match self.watch(question, help, || Ok(Reading::<()>::Shows(String::new())))? {
            Watched::Answer(answer) => Ok(answer),
            Watched::Seen(()) => Err(Halt::Leave),
        }
    }

    /// Asks, and shows readings until there is an answer or a reading ends the question.
    pub(super) fn watch<T>(
        &mut self,
        question: &str,
        help: &str,
        mut read: impl FnMut() -> Result<Reading<T>, Halt>,
    ) -> Result<Watched<T>, Halt> {
        self.input.discard();
        write!(self.output, "\n{}\n> ", printable(question))?;
        let mut shown = String::new();
        loop {
            match read()? {
                Reading::Ends(seen) => {
                    writeln!(self.output)?;
                    return Ok(Watched::Seen(seen));
                }
                Reading::Shows(text) if text != shown => {
                    write!(self.output, "\r\x1b[K{} > ", printable(&text))?;
                    shown = text;
                }
                Reading::Shows(_) => {}
            }
            self.output.flush()?;
            match self.input.line(PERIOD) {
                Line::Nothing => {}
                Line::End => {
                    writeln!(self.output)?;
                    return Err(Halt::Leave);
                }
                Line::Text(text) => match text.trim() {
                    "?" | "help" => write!(self.output, "{}\n{KEYS}\n> ", printable(help))?,
                    "q" | "quit" => return Err(Halt::Leave),
                    "" => return Ok(Watched::Answer(Answer::Enter)),
                    "b" | "back" => return Ok(Watched::Answer(Answer::Back)),
                    "s" | "skip" => return Ok(Watched::Answer(Answer::Skip)),
                    text => return Ok(Watched::Answer(Answer::Text(text.to_owned()))),
                },
            }
        }
    }
}

/// The lines of a terminal.
pub(super) struct Keyboard<'i> {
    input: Stdin,
    interrupt: &'i Interrupt,
    pending: Vec<u8>,
}

impl<'i> Keyboard<'i> {
    pub(super) fn new(interrupt: &'i Interrupt) -> Self {
        Self { input: io::stdin(), interrupt, pending: Vec::new() }
    }

    /// Removes the first complete line from the bytes that were read.
    fn take_line(&mut self) -> Option<String> {
        let end = self.pending.iter().position(|byte| *byte == b'\n');
        let end = end.or((self.pending.len() >= LINE_MAX).then_some(LINE_MAX - 1))?;
        let line: Vec<u8> = self.pending.drain(..=end).collect();
        Some(String::from_utf8_lossy(&line).into_owned())
    }
}

impl Input for Keyboard<'_> {
    fn line(&mut self, wait: Duration) -> Line {
        if self.interrupt.is_raised() {
            return Line::End;
        }
        if let Some(line) = self.take_line() {
            return Line::Text(line);
        }
        let timeout = PollTimeout::try_from(wait).unwrap_or(PollTimeout::ZERO);
        if poll(&mut [PollFd::new(self.input.as_fd(), PollFlags::POLLIN)], timeout) != Ok(1) {
            return Line::Nothing;
        }
        let mut bytes = [0; LINE_MAX];
        match nix::unistd::read(&self.input, &mut bytes) {
            Ok(0) => Line::End,
            Ok(count) => {
                self.pending.extend(&bytes[..count]);
                self.take_line().map_or(Line::Nothing, Line::Text)
            }
            Err(nix::errno::Errno::EINTR) => Line::Nothing,
            // The terminal is gone.
            Err(_) => Line::End,
        }
    }

    fn discard(&mut self) {
        self.pending.clear();
        let _kept = tcflush(&self.input, FlushArg::TCIFLUSH);
    }
}

/// Returns whether the guide can go on after this failure, once the person has removed its cause.
pub(super) const fn is_curable(failure: &DirectFailure) -> bool {
    match failure {
        // The motor has lost its power, and no node acknowledges a frame.
        DirectFailure::Motor(Error::Bus(Refusal::Full)) => true,
        DirectFailure::Motor(Error::Bus(_) | Error::Interrupted) => false,
        DirectFailure::Motor(_)
        | DirectFailure::Unfit { .. }
        | DirectFailure::NoMotor { .. }
        | DirectFailure::Config(_) => true,
        _ => false,
    }
}
