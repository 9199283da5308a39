//! The last seconds of a robot, in memory.

use crate::clock::{ClockStep, Origin};
use crate::{Counts, Reader, Writer};
use motord_shared::CycleRecord;
use motord_shared::description::RobotDescription;
use std::collections::VecDeque;
use std::io::{self, Write};
use std::sync::Arc;
use std::time::Duration;

/// Length of a part, ns.
const PART_NS: u64 = 1_000_000_000;

/// Limit on the steps of the clock. The oldest is dropped when it is reached.
const STEPS_MAX: usize = 256;

/// A complete file of a second, and the tick of its first cycle.
#[derive(Debug, Clone)]
struct Second {
    from_ns: u64,
    bytes: Arc<Vec<u8>>,
}

/// The last seconds of a robot, compressed. The oldest second is dropped when the limit is reached.
pub struct Memory {
    robot: RobotDescription,
    parts: VecDeque<Second>,
    steps: VecDeque<ClockStep>,
    /// The unfinished part, and the tick of its first cycle.
    current: Option<(u64, Writer<Vec<u8>>)>,
    parts_max: usize,
    bytes_max: usize,
}

/// The content of a [`Memory`] at one time.
#[derive(Debug, Clone)]
pub struct Remembered {
    robot: RobotDescription,
    origin: Origin,
    parts: Vec<Second>,
    steps: Vec<ClockStep>,
}

impl Memory {
    /// Creates a memory for the last `time` of `robot`, and up to a second more. It holds less if
    /// that takes more than `bytes_max` bytes.
    #[must_use]
    pub fn new(robot: &RobotDescription, time: Duration, bytes_max: usize) -> Self {
        let parts_max = usize::try_from(time.as_secs()).unwrap_or(usize::MAX).saturating_add(1);
        let (parts, steps) = (VecDeque::new(), VecDeque::new());
        Self { robot: robot.clone(), parts, steps, current: None, parts_max, bytes_max }
    }

    /// Stores that the computer's clock was set.
    pub fn take_step(&mut self, step: ClockStep) {
        if self.steps.len() >= STEPS_MAX {
            self.steps.pop_front();
        }
        self.steps.push_back(step);
    }

    /// Stores a cycle.
    ///
    /// # Errors
    /// The cycle cannot be encoded.
    pub fn take(&mut self, record: &CycleRecord) -> io::Result<()> {
        let tick_ns = record.state.tick_ns;
        if self.current.as_ref().is_some_and(|(from_ns, _)| tick_ns.saturating_sub(*from_ns) >= PART_NS) {
            self.end_part()?;
        }
        let (from_ns, mut writer) = match self.current.take() {
            Some(current) => current,
            None => (tick_ns, Writer::new(Vec::new(), &self.robot, Origin::default(), tick_ns)?),
        };
        writer.write(record)?;
        self.current = Some((from_ns, writer));
        Ok(())
    }

    /// Returns the current content, all times of which count from `origin`. Later cycles do not
    /// change it.
    ///
    /// # Errors
    /// Those of [`take`](Self::take).
    pub fn remembered(&mut self, origin: Origin) -> io::Result<Remembered> {
        self.end_part()?;
        let Self { robot, parts, steps, .. } = self;
        let from_ns = parts.front().map_or(0, |part| part.from_ns);
        let steps = steps.iter().filter(|step| step.at_ns >= from_ns).copied().collect();
        Ok(Remembered { robot: robot.clone(), origin, parts: parts.iter().cloned().collect(), steps })
    }

    fn end_part(&mut self) -> io::Result<()> {
        if let Some((from_ns, writer)) = self.current.take() {
            let bytes = writer.finish(&Counts::default())?;
            self.parts.push_back(Second { from_ns, bytes: Arc::new(bytes) });
        }
        let mut bytes: usize = self.parts.iter().map(|part| part.bytes.len()).sum();
        while self.parts.len() > self.parts_max || bytes > self.bytes_max {
            let Some(oldest) = self.parts.pop_front() else { break };
            bytes -= oldest.bytes.len();
        }
        Ok(())
    }
}

impl Remembered {
    /// Writes the content as one file. Returns the number of its cycles.
    ///
    /// # Errors
    /// `out` cannot be written.
    pub fn write(&self, out: impl Write) -> io::Result<u64> {
        let from_ns = self.parts.first().map_or(0, |part| part.from_ns);
        let mut writer = Writer::new(out, &self.robot, self.origin, from_ns)?;
        let (mut recorded, mut steps) = (0, self.steps.iter().peekable());
        for part in &self.parts {
            let mut reader = Reader::new(&part.bytes[..]).map_err(io::Error::other)?;
            while let Some(record) = reader.next_cycle() {
                while let Some(step) = steps.next_if(|step| step.at_ns <= record.state.tick_ns) {
                    writer.write_step(*step)?;
                }
                writer.write(record)?;
                recorded += 1;
            }
        }
        steps.try_for_each(|step| writer.write_step(*step))?;
        writer.finish(&Counts { recorded, ..Counts::default() })?.flush()?;
        Ok(recorded)
    }
}
