//! A serial port whose motors are stopped, in a thread of its own: opening a port and writing to it can take as long as its
//! adapter likes, and no CAN interface waits for that.
//!
//! An RS485 line carries one direction at a time. A motor answers each frame, so the next one leaves after the time for an answer;
//! nobody reads it.

use motord_bus::serial::SerialSender;
use motord_bus::{Duration, Frame, Inbox, Instant, Refusal};
use motord_core::stopper::Outlet;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, channel, sync_channel};
use std::thread::Builder;

/// From one frame to the next. At 921 600 bit/s frame and answer take 0.26 ms, and the motor may take its time.
const PACE: Duration = Duration::from_millis(2);
/// How often an idle thread tests whether the adapter was unplugged. A port that stays open would keep its name from the
/// adapter that is plugged in again.
const IDLE: Duration = Duration::from_millis(100);
/// The rounds that were taken have this time to leave before the port is given up.
const LINGER: Duration = Duration::from_millis(50);
/// The memory of the process is locked: a thread takes no more of it than it needs.
const STACK_BYTES: usize = 256 * 1024;

/// One frame to each motor of a line.
#[derive(Clone, Copy)]
struct Round {
    frames: [Frame; Inbox::CAPACITY],
    count: usize,
}

impl Round {
    /// `None` without a frame. Those beyond the capacity are left out: more were refused when the port was opened.
    fn of(frames: &[Frame]) -> Option<Self> {
        let count = frames.len().min(Inbox::CAPACITY);
        let mut round = Self { frames: [*frames.first()?; Inbox::CAPACITY], count };
        round.frames[..count].copy_from_slice(&frames[..count]);
        Some(round)
    }
}

/// The near end of the thread.
pub(super) struct Port {
    rounds: Option<SyncSender<Round>>,
    /// The port took all frames of the last round, or there was no round yet.
    is_sound: Arc<AtomicBool>,
    ended: Receiver<()>,
}

impl Port {
    /// Starts the thread, which opens `device` at `baud` bit/s, now or when it is there. Allocates.
    ///
    /// # Errors
    ///
    /// The system gives no thread.
    pub(super) fn open(device: &str, baud: u32) -> io::Result<Self> {
        let (rounds, taken) = sync_channel(1);
        let (ends, ended) = channel();
        let is_sound = Arc::new(AtomicBool::new(true));
        let mut line = Line { device: device.to_owned(), baud, sender: None, logged: false };
        let sound = Arc::clone(&is_sound);
        let serve = move || {
            line.serve(&taken, &sound);
            drop(line);
            let _nobody_waits = ends.send(());
        };
        Builder::new().name("motord-port".into()).stack_size(STACK_BYTES).spawn(serve)?;
        Ok(Self { rounds: Some(rounds), is_sound, ended })
    }
}

impl Outlet for Port {
    /// Gives the round to the thread. Refuses while the round before the last one is not sent, and while the port does not
    /// take frames; then it is tried with each round. At most one system call.
    fn send_round(&mut self, _now: Instant, frames: &[Frame]) -> Option<Refusal> {
        let round = Round::of(frames)?;
        let is_taken = self.rounds.as_ref().is_some_and(|rounds| rounds.try_send(round).is_ok());
        match (is_taken, self.is_sound.load(Ordering::Relaxed)) {
            (true, true) => None,
            (true, false) => Some(Refusal::Down),
            (false, _) => Some(Refusal::Full),
        }
    }
}

impl Drop for Port {
    /// Waits for the last rounds, at most [`LINGER`].
    fn drop(&mut self) {
        self.rounds = None;
        let _stuck = self.ended.recv_timeout(LINGER);
    }
}

/// The far end: the port itself.
struct Line {
    device: String,
    baud: u32,
    sender: Option<SerialSender>,
    /// Whether the log says that the port cannot be opened.
    logged: bool,
}

impl Line {
    /// Sends the rounds until the near end is dropped.
    fn serve(&mut self, rounds: &Receiver<Round>, is_sound: &AtomicBool) {
        self.find();
        loop {
            match rounds.recv_timeout(IDLE) {
                Ok(round) => {
                    self.find();
                    is_sound.store(self.send(&round), Ordering::Relaxed);
                }
                Err(RecvTimeoutError::Timeout) => self.find(),
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    /// Opens the port, if it is not open. Closes it when its adapter is not there any more.
    fn find(&mut self) {
        self.sender.take_if(|sender| sender.is_gone());
        if self.sender.is_some() {
            return;
        }
        match SerialSender::open(&self.device, self.baud) {
            Ok(sender) => (self.sender, self.logged) = (Some(sender), false),
            Err(error) if !self.logged => {
                tracing::warn!(
                    see = "interface-missing",
                    "{error}. It is looked for again, also when its motors are to be stopped."
                );
                self.logged = true;
            }
            Err(_) => {}
        }
    }

    /// Sends one frame to each motor. Returns whether the port took all. Takes [`PACE`] for each.
    fn send(&mut self, round: &Round) -> bool {
        let mut took_all = true;
        for frame in &round.frames[..round.count] {
            let sent = self.sender.as_ref().ok_or(Refusal::Gone).and_then(|sender| sender.send(frame));
            took_all &= sent.is_ok();
            if sent == Err(Refusal::Gone) {
                self.sender = None;
                return false;
            }
            std::thread::sleep(PACE);
        }
        took_all
    }
}

#[cfg(test)]
#[path = "../tests/unit/port.rs"]
mod tests;
