//! Waits for the one motor that is set up next.

use super::dialog::{Halt, Reading};
use super::edit::Configuration;
use super::progress::{Progress, Step};
use crate::file::FACTORY_ID;
use crate::motor;
use crate::target::{OpenLine, Protocol};
use motord_bus::{Duration, Refusal};
use motord_protocol::commissioning::{Error, Family, Found, Scan, scan};
use motord_settings::settings::{BusSettings, MotorSettings};
use std::collections::VecDeque;

/// Ids of each bus that a round asks beyond the likely ones.
const OTHERS: usize = 8;
/// Time for late answers, after a bus was full or another question was open.
const SETTLE: Duration = Duration::from_millis(100);
/// Rounds without a motor until the likely causes are named.
const QUIET_ROUNDS: u32 = 4;

const LOOKING: &str = "looking for a motor";

/// The index of a bus, and a motor that answered there.
type Answer = (usize, Found);

/// The motor that is set up next.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Candidate {
    /// Index of its bus.
    pub(super) bus: usize,
    pub(super) found: Found,
    /// The joint whose address it has.
    pub(super) joint: Option<String>,
    /// The name of its vendor's profile, as far as its answers show it.
    pub(super) vendor: &'static str,
}

impl Candidate {
    /// Returns why the motor cannot be that of `joint`, in words.
    pub(super) fn mismatch(&self, joint: &MotorSettings) -> Option<String> {
        let beyond_guide = || {
            format!(
                "the guide sets up motors with MIT or the GIM protocol: for {} use `motorctl id`, `motorctl zero` and `motorctl setup --config \
                 FILE`",
                joint.name
            )
        };
        let is_beyond = Protocol::of(self.found.family).has_one_id();
        motor::mismatch(self.vendor, self.found.family, joint).or_else(|| is_beyond.then(beyond_guide))
    }
}

/// Asks the ids of all buses, in rounds. A round asks the likely ids, that of a motor
/// in the round before, and some of the others.
pub(super) struct Search<'s> {
    file: &'s Configuration,
    progress: &'s Progress,
    skipped: &'s [String],
    lines: &'s mut [Option<OpenLine>],
    queue: VecDeque<(usize, u8)>,
    answers: Vec<Answer>,
    collisions: Vec<(usize, u8)>,
    /// Buses that were full in this round.
    full: Vec<usize>,
    /// Buses that were full in the round before: the answers to their waiting requests may arrive.
    late: Vec<usize>,
    next_other: u8,
    rounds: u32,
    last: Option<Candidate>,
    /// The line that is shown until the next round ends.
    shown: String,
}

impl<'s> Search<'s> {
    pub(super) fn new(
        file: &'s Configuration,
        progress: &'s Progress,
        skipped: &'s [String],
        lines: &'s mut [Option<OpenLine>],
    ) -> Self {
        Self {
            file,
            progress,
            skipped,
            lines,
            queue: VecDeque::new(),
            answers: Vec::new(),
            collisions: Vec::new(),
            full: Vec::new(),
            late: Vec::new(),
            next_other: 1,
            rounds: 0,
            last: None,
            shown: LOOKING.to_owned(),
        }
    }

    /// Asks one id. A motor counts when it is alone in two rounds.
    ///
    /// # Errors
    ///
    /// The bus is down or gone.
    pub(super) fn poll(&mut self) -> Result<Reading<Candidate>, Halt> {
        let Some((bus, id)) = self.queue.pop_front() else {
            self.fill();
            return Ok(Reading::Shows(self.shown.clone()));
        };
        self.ask(bus, id)?;
        if self.queue.is_empty()
            && let Some(candidate) = self.end_round()?
        {
            return Ok(Reading::Ends(candidate));
        }
        Ok(Reading::Shows(self.shown.clone()))
    }

    fn ask(&mut self, bus: usize, id: u8) -> Result<(), Halt> {
        let Some(line) = &mut self.lines[bus] else { return Ok(()) };
        let only = Scan { ids: id..=id, listen: Duration::ZERO, ..Scan::default() };
        let before = line.link.formats();
        let report = match scan(&mut line.link, &only, &mut |_| true) {
            Err(Error::Bus(Refusal::Full)) => {
                self.full.push(bus);
                self.leave_out(bus);
                return Ok(());
            }
            Err(Error::InUse { .. } | Error::Reports { .. }) if self.late.contains(&bus) => {
                self.leave_out(bus);
                return Ok(());
            }
            report => report?,
        };
        self.answers.extend(report.found.iter().map(|found| (bus, *found)));
        // The answers of two motors with one id are no frames on a serial line.
        let is_damaged = report.found.is_empty() && line.link.formats().since(before).is_any();
        let is_doubled = report.found.len() > 1 || !report.collisions.is_empty() || is_damaged;
        self.collisions.extend(is_doubled.then_some((bus, id)));
        Ok(())
    }

    /// Asks no further ids of a bus in this round. Without a motor with power no node acknowledges
    /// a CAN frame, and requests wait in the send buffer.
    fn leave_out(&mut self, bus: usize) {
        self.queue.retain(|(queued, _)| *queued != bus);
    }

    /// Begins a round.
    fn fill(&mut self) {
        self.answers.clear();
        self.collisions.clear();
        self.late = std::mem::take(&mut self.full);
        let others: Vec<u8> = (self.next_other..=0xFE).take(OTHERS).collect();
        self.next_other = others.last().filter(|last| **last < 0xFE).map_or(1, |last| last + 1);
        for bus in 0..self.lines.len() {
            let Some(line) = &mut self.lines[bus] else { continue };
            if self.rounds == 0 || self.late.contains(&bus) {
                line.link.pause(SETTLE);
            }
            let own = self.file.settings.motors.iter().filter(|motor| motor.bus == bus).map(|motor| motor.id);
            // A motor has to answer in two rounds.
            let seen = self.last.iter().filter(|last| last.bus == bus).map(|last| last.found.id);
            let likely = [FACTORY_ID].into_iter().chain(own).chain(seen);
            let mut ids: Vec<u8> = likely.chain(others.clone()).collect();
            ids.sort_unstable();
            ids.dedup();
            self.queue.extend(ids.into_iter().map(|id| (bus, id)));
        }
    }

    /// Returns the motor that is alone in this round and was in the one before. Describes what else
    /// answered.
    fn end_round(&mut self) -> Result<Option<Candidate>, Halt> {
        self.rounds += 1;
        let last = self.last.take();
        let answers = std::mem::take(&mut self.answers);
        let (known, new): (Vec<Answer>, Vec<Answer>) =
            answers.into_iter().partition(|(bus, found)| self.is_known(*bus, found));
        self.shown = match (self.collisions.first().copied(), &new[..]) {
            (Some((bus, id)), _) => self.describe_collision(bus, id),
            (None, []) => self.describe_known(&known),
            (None, [(bus, found)]) if matches!(found.family, Family::RobStride { .. }) => {
                self.describe_private(*bus, found)
            }
            (None, [(bus, found)]) if found.family == Family::CanSimple => self.describe_node(*bus, found),
            (None, [(bus, found)]) if found.family == Family::MyActuator => self.describe_rmd(*bus, found),
            (None, [(bus, found)]) if !self.is_alone(*bus, found)? => self.describe_collision(*bus, found.id),
            (None, [(bus, found)]) => {
                let joint = self.joint_at(*bus, found).map(|joint| joint.name.clone());
                let joint = joint.filter(|joint| self.has_address(joint));
                let vendor = self.vendor(*bus, found)?;
                let candidate = Candidate { bus: *bus, found: *found, joint, vendor };
                if last.as_ref() == Some(&candidate) {
                    return Ok(last);
                }
                self.last = Some(candidate);
                format!("{}: a motor answers as id {}", self.bus(*bus).device(), found.id)
            }
            (None, several) => {
                let names: Vec<_> = several.iter().map(|(bus, found)| self.name(*bus, found)).collect();
                format!("{} answer: take the power from all but one of them", names.join(" and "))
            }
        };
        Ok(None)
    }

    fn describe_collision(&self, bus: usize, id: u8) -> String {
        let is_it =
            |joint: &&MotorSettings| joint.bus == bus && joint.id == id && self.has_address(&joint.name);
        let joint = self.file.settings.motors.iter().find(is_it);
        let owner = joint.map_or_else(String::new, |joint| format!(", which is that of {}", joint.name));
        let bus = self.bus(bus).device();
        format!("{bus}: several motors answer as id {id}{owner}: take the power from all but one")
    }

    /// The guide sets up motors in MIT mode and native ones.
    fn describe_private(&self, bus: usize, found: &Found) -> String {
        format!(
            "motor {} on {} speaks RobStride's private protocol: set it up with `motorctl id`, `motorctl zero` and `motorctl setup`, or \
             change it with `motorctl protocol mit`",
            found.id,
            self.bus(bus).device()
        )
    }

    fn describe_node(&self, bus: usize, found: &Found) -> String {
        format!(
            "motor {} on {} speaks CANSimple: set it up with `motorctl id --protocol cansimple`, `motorctl zero` and `motorctl setup`",
            found.id,
            self.bus(bus).device()
        )
    }

    fn describe_rmd(&self, bus: usize, found: &Found) -> String {
        format!(
            "motor {} on {} speaks MyActuator's protocol: set it up with `motorctl id`, `motorctl zero` and `motorctl setup`",
            found.id,
            self.bus(bus).device()
        )
    }

    fn describe_known(&self, known: &[Answer]) -> String {
        match known.first().and_then(|(bus, found)| self.joint_at(*bus, found)) {
            Some(joint) => {
                format!("the motor of {} answers and needs nothing: give power to the next motor", joint.name)
            }
            None if !self.full.is_empty() => {
                let full: Vec<_> = self.full.iter().map(|bus| self.bus(*bus).device()).collect();
                let full = full.join(", ");
                format!(
                    "{full}: no node acknowledges: no motor has power, or its wires or bit rate are wrong"
                )
            }
            None if self.rounds < QUIET_ROUNDS => LOOKING.to_owned(),
            None => {
                "no motor answers: check its power, wires and bit rate; a motor with a fault may be silent"
                    .to_owned()
            }
        }
    }

    fn bus(&self, bus: usize) -> &BusSettings {
        &self.file.settings.buses[bus]
    }

    fn name(&self, bus: usize, found: &Found) -> String {
        match self.joint_at(bus, found).filter(|joint| self.has_address(&joint.name)) {
            Some(joint) => format!("the motor of {}", joint.name),
            None => format!("motor {} on {}", found.id, self.bus(bus).device()),
        }
    }

    /// Returns the joint that has this address in the configuration.
    fn joint_at(&self, bus: usize, found: &Found) -> Option<&MotorSettings> {
        self.file
            .settings
            .motors
            .iter()
            .find(|motor| motor.bus == bus && motor.id == found.id && Some(motor.host_id) == found.host_id)
    }

    fn has_address(&self, joint: &str) -> bool {
        self.progress.find(joint).is_some_and(|record| record.has(Step::Address))
    }

    /// Returns whether the motor needs nothing: its joint is done, or was left out.
    fn is_known(&self, bus: usize, found: &Found) -> bool {
        self.joint_at(bus, found).is_some_and(|joint| {
            self.progress.is_done(&joint.name)
                || self.skipped.contains(&joint.name) && self.has_address(&joint.name)
        })
    }

    fn is_alone(&mut self, bus: usize, found: &Found) -> Result<bool, Halt> {
        let Some(line) = &mut self.lines[bus] else { return Ok(true) };
        Ok(motor::is_alone(&mut line.link, found)?)
    }

    fn vendor(&mut self, bus: usize, found: &Found) -> Result<&'static str, Halt> {
        let Some(line) = &mut self.lines[bus] else { return Ok("unknown") };
        Ok(motor::vendor(&mut line.link, found)?)
    }
}
