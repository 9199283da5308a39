//! A serial port whose motors are stopped, in a dedicated thread. Opening a port and writing to it
//! have no time limit, and no CAN interface waits for them.
//!
//! An RS485 line carries one direction at a time. A motor answers each frame, so the next one
//! leaves after the time for an answer. The answers are not read.

use motord_bus::serial::SerialSender;
use motord_bus::{Duration, Frame, Inbox, Instant, Refusal};
use motord_core::stopper::Outlet;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, channel, sync_channel};
use std::thread::Builder;

/// Time from one frame to the next. At 921 600 bit/s frame and answer take 0.26 ms; the rest is for
/// the motor.
const PACE: Duration = Duration::from_millis(2);
/// Period in which an idle thread checks whether the adapter was unplugged. A port that stays open
/// would keep its name from the adapter that is plugged in again.
const IDLE: Duration = Duration::from_millis(100);
/// Longest time to send the queued rounds before the port is closed.
const LINGER: Duration = Duration::from_millis(50);
/// Stack of the thread. The memory of the process is locked, so all of it is resident.
const STACK_BYTES: usize = 256 * 1024;

/// One frame to each motor of a line.
#[derive(Clone, Copy)]
struct Round {
    frames: [Frame; Inbox::CAPACITY],
    count: usize,
}

impl Round {
    /// Returns `None` without a frame. Drops frames beyond the capacity: opening the port refuses
    /// more.
    fn of(frames: &[Frame]) -> Option<Self> {
        let count = frames.len().min(Inbox::CAPACITY);
        let mut round = Self { frames: [*frames.first()?; Inbox::CAPACITY], count };
        round.frames[..count].copy_from_slice(&frames[..count]);
        Some(round)
    }
}

/// The caller's end of the thread.
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
        let mut line = PortThread { device: device.to_owned(), baud, sender: None, logged: false };
        let sound = Arc::clone(&is_sound);
        let serve = move || {
            line.serve(&taken, &sound);
            drop(line);
            let _receiver_dropped = ends.send(());
        };
        Builder::new().name("motord-port".into()).stack_size(STACK_BYTES).spawn(serve)?;
        Ok(Self { rounds: Some(rounds), is_sound, ended })
    }
}

impl Outlet for Port {
    /// Queues the round for the thread. Refuses while the round before the last one is not sent,
    /// and while the port accepts no frames; each round tries again. At most one system call.
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

/// The thread's end: the port itself.
struct PortThread {
    device: String,
    baud: u32,
    sender: Option<SerialSender>,
    /// The log has reported that the port cannot be opened.
    logged: bool,
}

impl PortThread {
    /// Sends the rounds until the caller's end is dropped.
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

    /// Opens the port, if it is not open. Closes it when its adapter was unplugged.
    fn find(&mut self) {
        self.sender.take_if(|sender| sender.is_disconnected());
        if self.sender.is_some() {
            return;
        }
        match SerialSender::open(&self.device, self.baud) {
            Ok(sender) => (self.sender, self.logged) = (Some(sender), false),
            Err(error) if !self.logged => {
                tracing::warn!(
                    see = "interface-missing",
                    "{error}. The switch keeps trying to open it, also while it stops the motors."
                );
                self.logged = true;
            }
            Err(_) => {}
        }
    }

    /// Sends one frame to each motor. Returns true when the port accepted all. Takes [`PACE`] for
    /// each.
    fn send(&mut self, round: &Round) -> bool {
        let mut accepted_all = true;
        for frame in &round.frames[..round.count] {
            let sent = self.sender.as_ref().ok_or(Refusal::Gone).and_then(|sender| sender.send(frame));
            accepted_all &= sent.is_ok();
            if sent == Err(Refusal::Gone) {
                self.sender = None;
                return false;
            }
            std::thread::sleep(PACE);
        }
        accepted_all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::FrameId;
    use nix::pty::{OpenptyResult, openpty};
    use std::fs::File;
    use std::io::Read;
    use std::os::fd::OwnedFd;
    use std::time::Instant as Clock;

    fn stops() -> [Frame; 3] {
        [1, 2, 3].map(|id| Frame::classic(FrameId::from(id), [0x92, 0, 0x80, 0, 0, 0, 8, 0]))
    }

    /// The motors' end of a line, and the device.
    fn pty() -> (File, OwnedFd, String) {
        let OpenptyResult { master, slave } = openpty(None, None).unwrap();
        let device = nix::unistd::ttyname(&slave).unwrap().to_str().unwrap().to_owned();
        (master.into(), slave, device)
    }

    #[test]
    fn every_motor_of_line_gets_stop_and_time() {
        let (mut motors, _slave, device) = pty();
        let mut port = Port::open(&device, 921_600).unwrap();
        std::thread::sleep(Duration::from_millis(50));
        assert_eq!(port.send_round(Instant::ZERO, &stops()), None);
        let mut received = [0; 36];
        let begun = Clock::now();
        motors.read_exact(&mut received).unwrap();
        assert!(begun.elapsed() >= PACE, "they collide with the answers");
        assert_eq!(received.chunks(12).map(|frame| frame[0]).collect::<Vec<_>>(), [1, 2, 3]);
        assert_eq!(received[..5], [0x01, 0x00, 0x08, 0x09, 0x92], "GIM document, table 3");
    }

    #[test]
    fn accepted_round_leaves_before_port_is_released() {
        let (mut motors, _slave, device) = pty();
        let mut port = Port::open(&device, 921_600).unwrap();
        std::thread::sleep(Duration::from_millis(50));
        assert_eq!(port.send_round(Instant::ZERO, &stops()), None);
        drop(port);
        motors.read_exact(&mut [0; 36]).unwrap();
    }

    #[test]
    fn missing_port_refuses_immediately_and_serves_when_present() {
        let directory = tempfile::tempdir().unwrap();
        let link = directory.path().join("adapter");
        let mut port = Port::open(link.to_str().unwrap(), 921_600).unwrap();
        let begun = Clock::now();
        let refused = (0..3).map(|_| {
            let refused = port.send_round(Instant::ZERO, &stops());
            std::thread::sleep(Duration::from_millis(20));
            refused
        });
        assert!(refused.collect::<Vec<_>>().contains(&Some(Refusal::Down)));
        assert!(begun.elapsed() < Duration::from_millis(500), "it blocked");
        let (mut motors, _slave, device) = pty();
        std::os::unix::fs::symlink(device, link).unwrap();
        port.send_round(Instant::ZERO, &stops());
        motors.read_exact(&mut [0; 36]).unwrap();
        std::thread::sleep(Duration::from_millis(20));
        assert_eq!(port.send_round(Instant::ZERO, &stops()), None);
    }

    #[test]
    fn an_adapter_that_was_unplugged_is_let_go() {
        let (motors, slave, device) = pty();
        let port = Port::open(&device, 921_600).unwrap();
        std::thread::sleep(Duration::from_millis(50));
        drop((motors, slave));
        // The name is free now, and a port of another test may get it.
        let deleted = format!("{device} (deleted)");
        let is_open = || {
            let open = std::fs::read_dir("/proc/self/fd").unwrap();
            let mut links = open.filter_map(|entry| std::fs::read_link(entry.unwrap().path()).ok());
            links.any(|link| link.to_string_lossy() == deleted)
        };
        assert!(is_open(), "the port's thread has it until it looks");
        let begun = Clock::now();
        while is_open() {
            assert!(begun.elapsed() < Duration::from_secs(30), "{deleted} is still open");
            std::thread::sleep(IDLE / 4);
        }
        drop(port);
    }
}
