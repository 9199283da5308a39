//! Finds a motor whose answers are constantly late.
//!
//! A reply does not name its request. A motor that answers each request seven turns late looks like
//! one that lost seven replies and answers in time since. motord omits one command to distinguish
//! them: a reply that still arrives answers an earlier command. If all answers are N turns late,
//! the turn without a reply follows N turns after the omission.
//!
//! ```text
//!            missed reply            PAUSE later             no late reply
//!   Quiet ─────────────▶ Suspected ─────────────▶ Probing ─────────────────▶ Quiet
//!                            ▲                       │
//!                            └───────────────────────┘ late reply, then a turn without an answer: measured
//! ```
//!
//! Two equal measurements in a row are believed: stalls and random losses give no two. A motor that
//! is known to be late is measured further, until two probes find no late reply.
//!
//! Real-time: constant time; no allocation, no system call. A motor that misses no reply costs one
//! comparison per turn.

use motord_bus::{Duration, Instant};

/// Least time between two omitted commands of one motor, unless a measurement is to be confirmed.
const PROBE_PERIOD: Duration = Duration::from_millis(250);
/// Time after a missed reply for a burst of late ones.
const PAUSE: Duration = Duration::from_millis(50);
/// Time after a measurement, before it is confirmed.
const CONFIRM_PAUSE: Duration = Duration::from_millis(20);
/// Most unconfirmed measurements in a row that are repeated without [`PROBE_PERIOD`].
const CONFIRMS_MAX: u32 = 1;
/// A lateness of more turns than this is not measured.
const TURNS_MAX: u32 = 100;
/// A motor whose answers are late by this many turns is not driven.
const UNUSABLE_TURNS: u32 = 3;

/// The search for constantly late answers of one motor.
#[derive(Debug, Clone, Copy)]
pub(super) struct Backlog {
    /// From this time on `Motor::probes` decides about each command.
    due: Instant,
    /// No command is omitted before this time.
    next_probe: Instant,
    stage: Stage,
    /// The last measurement, turns; 0 for none.
    measured: u32,
    /// Consecutive measurements that no second one confirmed.
    unconfirmed: u32,
    /// Probes in a row that found no late reply of a motor that is known to be late.
    refuted: u32,
    /// Turns by which all answers are late; 0 for a motor that answers in time.
    turns: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// Every reply has arrived, or is known to be lost.
    Quiet,
    /// A reply was missed.
    Suspected,
    /// A command was omitted, this many turns ago; `late`: a late reply has arrived since.
    Probing { turns: u32, late: bool },
}

impl Default for Backlog {
    fn default() -> Self {
        Self {
            due: Instant::FAR_FUTURE,
            next_probe: Instant::ZERO,
            stage: Stage::Quiet,
            measured: 0,
            unconfirmed: 0,
            refuted: 0,
            turns: 0,
        }
    }
}

impl Backlog {
    /// Returns whether `Motor::probes` decides about the next command.
    #[inline]
    pub(super) const fn is_due(&self, now: Instant) -> bool {
        now.as_nanos() >= self.due.as_nanos()
    }

    /// Returns the turns by which all answers are late; 0 for a motor that answers in time.
    #[inline]
    pub(super) const fn turns(&self) -> u32 {
        self.turns
    }

    /// Returns whether its answers are too late to drive it.
    pub(super) const fn is_unusable(&self) -> bool {
        self.turns >= UNUSABLE_TURNS
    }

    /// Records a late reply.
    pub(super) const fn late(&mut self) {
        if let Stage::Probing { late, .. } = &mut self.stage {
            *late = true;
        }
    }

    /// Records a missed reply.
    pub(super) fn suspect(&mut self, now: Instant) {
        if self.stage == Stage::Quiet {
            self.stage = Stage::Suspected;
            self.due = self.next_probe.max(now + PAUSE);
        }
    }

    /// Begins a turn. Returns whether its command is omitted, which it is only if it `may` be.
    pub(super) fn begin_turn(&mut self, now: Instant, may: bool) -> bool {
        match &mut self.stage {
            Stage::Quiet => self.due = Instant::FAR_FUTURE,
            Stage::Suspected if may => {
                self.stage = Stage::Probing { turns: 0, late: false };
                self.next_probe = now + PROBE_PERIOD;
                return true;
            }
            Stage::Suspected => {}
            Stage::Probing { turns, late } => {
                *turns += 1;
                // A late reply is read in the turn without a command, or in the one after it.
                if *turns >= 2 && !*late || *turns > TURNS_MAX {
                    self.refute(now);
                }
            }
        }
        false
    }

    /// Ends a turn without an answer. Returns whether it is the one whose command was omitted, as
    /// many turns ago as all answers are late.
    pub(super) fn end_turn(&mut self, now: Instant) -> bool {
        let Stage::Probing { turns: turns @ 1.., late } = self.stage else { return false };
        self.stage = Stage::Suspected;
        self.due = self.next_probe;
        if late {
            self.measure(turns, now);
        }
        late
    }

    fn measure(&mut self, turns: u32, now: Instant) {
        self.refuted = 0;
        if self.measured != 0 && self.measured.abs_diff(turns) <= 1 {
            (self.turns, self.unconfirmed) = (self.measured.max(turns), 0);
        } else if self.unconfirmed < CONFIRMS_MAX {
            self.unconfirmed += 1;
            self.due = now + CONFIRM_PAUSE;
        } else {
            self.unconfirmed = 0;
        }
        self.measured = turns;
    }

    /// Records that no late reply arrived while a command was omitted.
    fn refute(&mut self, now: Instant) {
        self.refuted += 1;
        if self.turns > 0 && self.refuted < 2 {
            self.stage = Stage::Suspected;
            self.due = now + CONFIRM_PAUSE;
        } else {
            *self = Self { next_probe: self.next_probe, ..Self::default() };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURN: Duration = Duration::from_millis(1);

    /// The backlog after some turns, and the commands that were omitted.
    struct Run {
        backlog: Backlog,
        omitted: usize,
    }

    /// Runs `turns` turns of a motor that answers `late` turns late. The reply to a command is lost
    /// if `is_lost` says so of its turn.
    fn run(turns: u32, late: usize, is_lost: impl Fn(u32) -> bool) -> Run {
        let mut run = Run { backlog: Backlog::default(), omitted: 0 };
        let (mut queue, mut answered) = (vec![None; late], false);
        for turn in 0..turns {
            let now = Instant::from_nanos(1_000_000_000) + turn * TURN;
            let omits = run.backlog.is_due(now) && run.backlog.begin_turn(now, answered);
            run.omitted += usize::from(omits);
            queue.push((!omits && !is_lost(turn)).then_some(turn));
            let reply = queue.remove(0);
            answered = reply.is_some() && !omits;
            match (omits, reply) {
                (true, Some(_)) => run.backlog.late(),
                (false, None) if !run.backlog.end_turn(now) => run.backlog.suspect(now),
                _ => {}
            }
        }
        run
    }

    #[test]
    fn constant_lateness_is_measured_in_turns() {
        for late in [1, 2, 3, 7, 40, 99] {
            assert_eq!(run(2000, late, |_| false).backlog.turns, late as u32);
        }
    }

    #[test]
    fn losses_are_no_lateness() {
        let random = |share: u32| move |turn: u32| turn.wrapping_mul(2_654_435_761) >> 22 < share;
        for share in [1, 10, 100, 300] {
            let run = run(100_000, 0, random(share));
            assert_eq!(run.backlog.turns, 0, "{share} of 1024");
            assert!(run.omitted <= 401, "{} of 100 000 commands omitted", run.omitted);
        }
        let stall = run(2000, 0, |turn| (500..512).contains(&turn));
        assert_eq!((stall.backlog.turns, stall.omitted), (0, 1));
    }

    #[test]
    fn lateness_with_losses_is_still_measured() {
        let lost = |turn: u32| turn.wrapping_mul(2_654_435_761) >> 22 < 20;
        assert!((6..=7).contains(&run(20_000, 7, lost).backlog.turns));
    }

    #[test]
    fn healthy_motor_omits_no_command() {
        let run = run(100_000, 0, |_| false);
        assert_eq!((run.omitted, run.backlog.due), (0, Instant::FAR_FUTURE));
    }
}
