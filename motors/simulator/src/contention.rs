//! Frames that contend for the wire, and the answers of motors that wait for it.

use motord_bus::{Duration, Frame, Instant};

/// Most waiting answers per motor. Further ones are lost, as in a drive with few mailboxes.
const ANSWERS_PER_MOTOR: usize = 8;
/// Separates two answers that would be ready at the same time.
const MOMENT: Duration = Duration::from_nanos(1);

/// The sender of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sender {
    Host,
    Motor(usize),
    Imu(usize),
    Flood,
    /// A collision: no node receives the frame.
    Several,
}

/// A frame that contends for the wire.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Contender {
    pub(crate) sender: Sender,
    pub(crate) frame: Frame,
    /// Earliest time at which it may begin.
    pub(crate) ready: Instant,
    /// Its time on the wire.
    pub(crate) duration: Duration,
}

#[derive(Debug, Clone, Copy)]
struct Answer {
    contender: Contender,
    /// Held back until the motor's next answer.
    held: bool,
}

/// The answers of all motors of a bus. Never grows.
#[derive(Debug, Clone)]
pub(crate) struct Answers {
    waiting: Vec<Answer>,
    capacity: usize,
}

impl Answers {
    /// Of this number of motors and IMUs.
    pub(crate) fn new(nodes: usize) -> Self {
        let capacity = ANSWERS_PER_MOTOR * nodes;
        Self { waiting: Vec::with_capacity(capacity), capacity }
    }

    /// Returns the answers that may begin once they are ready.
    pub(crate) fn contenders(&self) -> impl Iterator<Item = Contender> + '_ {
        self.waiting.iter().filter(|answer| !answer.held).map(|answer| answer.contender)
    }

    /// Adds an answer, which waits for the wire. With `reorder`, every other answer waits until its
    /// successor was sent.
    pub(crate) fn admit(&mut self, contender: Contender, reorder: bool, duplicate: bool) {
        let later = contender.ready + MOMENT;
        let overtaken = self.release(contender.sender, later);
        self.push(Answer { contender, held: reorder && !overtaken });
        if duplicate {
            self.push(Answer { contender: Contender { ready: later, ..contender }, held: false });
        }
    }

    /// Releases the answer that `sender` holds back, if there is one.
    fn release(&mut self, sender: Sender, ready: Instant) -> bool {
        let held = self.waiting.iter_mut().find(|answer| answer.held && answer.contender.sender == sender);
        let found = held.is_some();
        if let Some(answer) = held {
            answer.held = false;
            answer.contender.ready = ready;
        }
        found
    }

    fn push(&mut self, answer: Answer) {
        if self.waiting.len() < self.capacity {
            self.waiting.push(answer);
        }
    }

    /// Returns whether frames of `sender` wait for the wire.
    pub(crate) fn has(&self, sender: Sender) -> bool {
        self.contenders().any(|contender| contender.sender == sender)
    }

    /// Drops the answers of `sender`, which has lost its power.
    pub(crate) fn forget(&mut self, sender: Sender) {
        self.waiting.retain(|answer| answer.contender.sender != sender);
    }

    /// Returns `true` when another motor sends the winner's id at `start` with other bytes. That
    /// motor tries again a moment after the winner. The winner tries again as soon as the collision
    /// is over.
    pub(crate) fn collide(&mut self, winner: &Contender, start: Instant) -> bool {
        let mut collided = false;
        for answer in self.waiting.iter_mut().filter(|answer| !answer.held) {
            let rival = &mut answer.contender;
            let together = rival.ready <= start && rival.sender != winner.sender;
            if together && rival.frame.id() == winner.frame.id() && rival.frame != winner.frame {
                collided = true;
                rival.ready = start + winner.duration + MOMENT;
            }
        }
        collided
    }

    /// Returns `true` when another motor sends at the same time as the winner, on a line without
    /// arbitration. The bytes of all senders are damaged, and none tries again.
    pub(crate) fn clash(&mut self, winner: &Contender, start: Instant) -> bool {
        let together = |answer: &Answer| !answer.held && answer.contender.ready < start + winner.duration;
        let clashes =
            self.waiting.iter().any(|answer| together(answer) && answer.contender.sender != winner.sender);
        if clashes {
            self.waiting.retain(|answer| !together(answer));
        }
        clashes
    }

    /// Removes the winner, and the answers that send the same bits at `start`.
    pub(crate) fn withdraw(&mut self, winner: &Contender, start: Instant) {
        self.waiting.retain(|Answer { contender, held }| {
            let together = contender.sender != winner.sender && contender.ready <= start;
            *held || contender.frame != winner.frame || !(together || contender.ready == winner.ready)
        });
    }
}
