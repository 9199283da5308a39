//! The motors must reply as fast while a disturbance outside their buses lasts as they do without
//! it. No reply may be missing, except for a few that the computer itself delays.
//!
//! Marks: `well` and `ill WORDS` begin a part that is checked, `rest` one that is not.

use super::{Command, Mark, Reply, Rules, Verdict, seconds};
use crate::protocol::mit::Meaning;
use crate::robot::Wiring;
use motord_bus::Duration;

/// Shares of the replies, and of the cycles, that must be as fast as without a disturbance: 50 and
/// 98 of 100. One reply in 100 answers a question for faults, up to 170 µs later than the others:
/// the 99th of 100 lies on the edge between both, now on this side and now on the other.
const SHARES: [f64; 2] = [0.5, 0.98];
/// Share of the replies that a computer with the motors, the daemon and candump on one processor
/// may miss by itself.
const MISSED_SHARE: f64 = 1e-4;

/// Demands on a log.
#[derive(Debug, Clone, Copy)]
pub struct Demand {
    /// Number of parts with a disturbance, and of parts without one.
    pub parts: usize,
    /// Greatest ratio of the times with a disturbance to those without.
    pub ratio: f64,
    /// Ticks per second.
    pub rate: f64,
    /// Total length of the checked parts, s.
    pub seconds: f64,
    /// Share of the ticks that have a cycle.
    pub share: f64,
}

/// The times of one kind of part on one interface, µs.
#[derive(Debug, Clone, Default)]
struct Times {
    /// Time from each command to its reply.
    replies: Vec<u32>,
    /// Time from each cycle to the next.
    cycles: Vec<u32>,
}

/// Commands without a reply, and replies without a command.
#[derive(Debug, Default)]
struct Unmatched {
    missed: usize,
    unasked: usize,
    /// All of them, as sentences.
    complaints: Vec<String>,
}

/// One motor in the current part.
#[derive(Debug, Clone, Copy, Default)]
struct Asked {
    /// Time of the command that it has not answered yet.
    open: Option<Duration>,
    /// Time of its last control command.
    controlled: Option<Duration>,
}

/// The kind of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    Well,
    Ill,
}

/// The rules.
#[derive(Debug)]
pub struct Replies<'a> {
    wiring: &'a Wiring,
    interfaces: Vec<&'a str>,
    demand: Demand,
    part: Option<Part>,
    name: String,
    asked: Vec<Asked>,
    /// Times by part and interface.
    times: [Vec<Times>; 2],
    parts: [usize; 2],
    /// By part.
    unmatched: [Unmatched; 2],
}

impl<'a> Replies<'a> {
    /// Returns the rules before the first event.
    #[must_use]
    pub fn new(wiring: &'a Wiring, demand: Demand) -> Self {
        let interfaces = wiring.interfaces();
        let times = vec![Times::default(); interfaces.len()];
        Self {
            wiring,
            interfaces,
            demand,
            part: None,
            name: String::new(),
            asked: vec![Asked::default(); wiring.motors.len()],
            times: [times.clone(), times],
            parts: [0; 2],
            unmatched: Default::default(),
        }
    }

    /// Returns the times of the current part, on the interface of a motor.
    fn times(&mut self, motor: usize) -> Option<&mut Times> {
        let interface = &self.wiring.motors[motor].interface;
        let index = self.interfaces.iter().position(|known| known == interface)?;
        Some(&mut self.times[self.part? as usize][index])
    }

    /// Returns `true` when this motor is the first of its interface, which receives the first
    /// command of a cycle.
    fn is_first(&self, motor: usize) -> bool {
        let interface = &self.wiring.motors[motor].interface;
        self.wiring.motors.iter().position(|other| other.interface == *interface) == Some(motor)
    }

    fn replies(&self, part: Part) -> usize {
        self.times[part as usize].iter().map(|times| times.replies.len()).sum()
    }

    /// Returns one line for an interface, and `true` when its times are similar in both kinds of
    /// parts.
    fn compare(&self, index: usize) -> (String, bool) {
        let [well, ill] = self.times.each_ref().map(|times| &times[index]);
        let replies = Comparison::of(&well.replies, &ill.replies);
        let cycles = Comparison::of(&well.cycles, &ill.cycles);
        let alike = replies.is_alike(self.demand.ratio) && cycles.is_alike(self.demand.ratio);
        let late = if alike { "" } else { ": TOO LATE" };
        (format!("{}: replies {replies}; cycles {cycles}{late}", self.interfaces[index]), alike)
    }
}

impl Rules for Replies<'_> {
    fn mark(&mut self, mark: &Mark, verdict: &mut Verdict) {
        self.part = match mark.word() {
            "well" => Some(Part::Well),
            "ill" => Some(Part::Ill),
            "rest" => None,
            _ => return verdict.complain(format!("no mark of a part: {}", mark.words.join(" "))),
        };
        if let Some(part) = self.part {
            self.parts[part as usize] += 1;
        }
        self.name = mark.words.join(" ");
        // Commands and replies in flight belong to no part.
        self.asked.fill(Asked::default());
    }

    fn command(&mut self, command: &Command, verdict: &mut Verdict) {
        let Command { at, motor, .. } = *command;
        let Some(part) = self.part else { return };
        let name = &self.wiring.motors[motor].name;
        let is_control = matches!(command.meaning, Some(Meaning::Control { .. }));
        if !is_control && !command.meaning.is_some_and(|meaning| meaning.is_question()) {
            let complaint = format!("at {} s: {} to {name} was not due", seconds(at), command.text);
            return verdict.complain(complaint);
        }
        if self.asked[motor].open.replace(at).is_some() {
            let unmatched = &mut self.unmatched[part as usize];
            unmatched.missed += 1;
            unmatched.complaints.push(format!(
                "{name} did not reply before {} s ({})",
                seconds(at),
                self.name
            ));
        }
        if is_control
            && let Some(before) = self.asked[motor].controlled.replace(at)
            && self.is_first(motor)
            && let Some(times) = self.times(motor)
        {
            times.cycles.push(micros(at - before));
        }
    }

    fn reply(&mut self, reply: &Reply, _verdict: &mut Verdict) {
        let Reply { at, motor } = *reply;
        let Some(part) = self.part else { return };
        // The first reply in a part may answer an earlier command.
        if self.asked[motor].controlled.is_none() {
            return;
        }
        let Some(open) = self.asked[motor].open.take() else {
            let name = &self.wiring.motors[motor].name;
            let unmatched = &mut self.unmatched[part as usize];
            unmatched.unasked += 1;
            unmatched.complaints.push(format!(
                "{name} was not asked before {} s ({})",
                seconds(at),
                self.name
            ));
            return;
        };
        if let Some(times) = self.times(motor) {
            times.replies.push(micros(at - open));
        }
    }

    fn end(&mut self, verdict: &mut Verdict) {
        let Demand { parts, rate, seconds, share, .. } = self.demand;
        for index in 0..self.interfaces.len() {
            let (line, alike) = self.compare(index);
            verdict.demand(alike, || line.clone());
            let cycles: usize = self.times.iter().map(|times| times[index].cycles.len()).sum();
            let least = share * rate * seconds;
            verdict
                .demand(cycles as f64 >= least, || format!("{cycles} cycles on {}", self.interfaces[index]));
            verdict.report.push(line);
        }
        let [well, ill] = self.parts;
        verdict.demand([well, ill] == [parts; 2], || format!("{well} parts well and {ill} ill of {parts}"));
        verdict.report.push(format!("{well} parts well, {ill} ill"));
        for (part, name) in [(Part::Well, "well"), (Part::Ill, "ill")] {
            let Unmatched { missed, unasked, .. } = self.unmatched[part as usize];
            let replies = self.replies(part);
            verdict
                .report
                .push(format!("{name}: {replies} replies, {missed} missed, {unasked} without a command"));
        }
        let unmatched = &self.unmatched[Part::Ill as usize];
        if unmatched.complaints.len() as f64 > MISSED_SHARE * self.replies(Part::Ill) as f64 {
            unmatched.complaints.iter().for_each(|complaints| verdict.complain(complaints));
        }
    }
}

/// Returns microseconds, which are the resolution of candump's clock.
fn micros(time: Duration) -> u32 {
    u32::try_from(time.as_micros()).unwrap_or(u32::MAX)
}

/// The same share of two sets of times, for each of [`SHARES`], and their maxima, µs: without and
/// with a disturbance.
#[derive(Debug)]
struct Comparison {
    shares: [[u32; 2]; 2],
    maxima: [u32; 2],
    counts: [usize; 2],
}

impl Comparison {
    fn of(well: &[u32], ill: &[u32]) -> Self {
        let sorted = [well, ill].map(|times| {
            let mut times = times.to_vec();
            times.sort_unstable();
            times
        });
        let at = |share: f64| sorted.each_ref().map(|times| quantile(times, share));
        Self { shares: SHARES.map(at), maxima: at(1.0), counts: sorted.each_ref().map(Vec::len) }
    }

    /// Returns `true` when there are times, and no share takes more than `ratio` times as long. A
    /// clock of microseconds adds 1 µs to either time.
    fn is_alike(&self, ratio: f64) -> bool {
        let soon = |[well, ill]: &[u32; 2]| f64::from(*ill) <= ratio * f64::from(well + 1) + 1.0;
        !self.counts.contains(&0) && self.shares.iter().all(soon)
    }
}

impl std::fmt::Display for Comparison {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [[half, half_ill], [most, most_ill]] = self.shares;
        let ([longest, longest_ill], [count, count_ill]) = (self.maxima, self.counts);
        write!(
            f,
            "{half}, {most}, {longest} µs (50, 98, 100 % of {count}), ill {half_ill}, {most_ill}, {longest_ill} (of {count_ill})"
        )
    }
}

/// Returns the smallest time that this share of sorted `times` does not exceed; 0 without times.
fn quantile(times: &[u32], share: f64) -> u32 {
    let rank = (share * times.len() as f64).ceil() as usize;
    times.get(rank.saturating_sub(1)).copied().unwrap_or_default()
}
