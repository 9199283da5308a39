//! The steps of one joint.
//!
//! ```text
//!  address ▶ bit rate ▶ constants ▶ zero ▶ direction ▶ range ▶ protocol ▶ motion ▶ set up
//!     ◀──────────────── `b` undoes the last step, except the protocol ────────────────
//! ```
//!
//! A step that finds nothing to change is not taken. Each step first records what it replaces, then
//! changes the motor or the configuration, and then is done. The motor decides whether it has its
//! address, bit rate and protocol, so that a step goes on that was interrupted between the two.

mod by_hand;
mod first_motion;
mod undo;

use crate::failure::DirectFailure;
use crate::guide::dialog::{Answer, Dialog, Halt, Reading, Watched};
use crate::guide::edit::{self, Configuration, Values};
use crate::guide::progress::{Before, Configured, Progress, Record, Step};
use crate::motor::{self, Health};
use crate::target::{Protocol, Session};
use crate::zero;
use motord_bus::FrameId;
use motord_configuration::lock::{Finding, Verdict, findings};
use motord_protocol::commissioning::{Question, Wire, constants, survey};
use motord_protocol::drive::Transmission;
use motord_settings::settings::MotorSettings;
use motord_terminal::{Interrupt, number};

/// The end of the steps of a joint.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Ended {
    SetUp,
    Skipped,
    /// Back to the question for the joint.
    Back,
}

/// The end of a question.
enum Taken {
    Done,
    Back,
    Skip,
}

/// Positions, rad, that a motor reported while a question was open.
struct Seen {
    last: f64,
    low: f64,
    high: f64,
}

/// One joint and its motor.
pub(super) struct JointGuide<'g, 'd> {
    dialog: &'g mut Dialog<'d>,
    file: &'g mut Configuration,
    progress: &'g mut Progress,
    interrupt: &'g Interrupt,
    motor: Session,
    joint: MotorSettings,
    /// Differences of the constants; `None` until they were read.
    differences: Option<Vec<Finding>>,
}

impl<'g, 'd> JointGuide<'g, 'd> {
    /// Returns the guide for `joint` with the motor of `session`.
    pub(super) fn new(
        dialog: &'g mut Dialog<'d>,
        file: &'g mut Configuration,
        progress: &'g mut Progress,
        interrupt: &'g Interrupt,
        session: Session,
        joint: MotorSettings,
    ) -> Self {
        let motor = Session { settings: Some(joint.clone()), ..session };
        Self { dialog, file, progress, interrupt, motor, joint, differences: None }
    }

    /// Returns the motor.
    pub(super) fn into_motor(self) -> Session {
        self.motor
    }

    /// Takes the steps that are left. The caller marks the motion, once the motor is recorded.
    ///
    /// # Errors
    ///
    /// The person leaves; the motor or a file fails.
    pub(super) fn run(&mut self) -> Result<Ended, Halt> {
        match self.cure()? {
            Taken::Done => {}
            Taken::Back => return Ok(Ended::Back),
            Taken::Skip => return Ok(Ended::Skipped),
        }
        while let Some(step) = self.next()? {
            match self.take(step)? {
                Taken::Done if step == Step::Motion => return Ok(Ended::SetUp),
                Taken::Done => {
                    self.mark(step)?;
                    self.print(&format!("{}: saved", step.name()))?;
                }
                Taken::Back if self.undo()? => {}
                Taken::Back => return Ok(Ended::Back),
                Taken::Skip => return Ok(Ended::Skipped),
            }
        }
        Ok(Ended::SetUp)
    }

    /// Shows the state of the motor, until it has no fault and plausible values.
    fn cure(&mut self) -> Result<Taken, Halt> {
        loop {
            let health = Health::read(&mut self.motor)?;
            self.print(&health.describe())?;
            let Some(problem) = health.problem() else { return Ok(Taken::Done) };
            let question = format!("{}: {problem}. Enter clears its fault and reads again", self.joint.name);
            let help = "A motor is set up without a fault, with a usual supply and temperature.";
            match self.confirm(&question, help, "")? {
                Taken::Done => motor::clear_fault(&mut self.motor)?,
                taken => return Ok(taken),
            }
        }
    }

    /// Returns the first step that is left.
    fn next(&mut self) -> Result<Option<Step>, Halt> {
        self.refresh()?;
        for step in Step::ALL {
            if self.needs(step)? {
                return Ok(Some(step));
            }
        }
        Ok(None)
    }

    /// Takes over the settings of the joint and the scales of its motor.
    fn refresh(&mut self) -> Result<(), Halt> {
        let joint = self.file.settings.motors.iter().find(|motor| motor.name == self.joint.name);
        self.joint = joint.cloned().unwrap_or_else(|| self.joint.clone());
        self.motor.settings = Some(self.joint.clone());
        if self.has_address() { Ok(self.motor.read_ends()?) } else { Ok(()) }
    }

    fn has_address(&self) -> bool {
        self.motor.id == self.joint.id && self.motor.host_id == Some(self.joint.host_id)
    }

    fn needs(&mut self, step: Step) -> Result<bool, Halt> {
        let is_native = self.motor.protocol == Protocol::Gim && self.motor.line.link.wire() == Wire::Can;
        let is_done = self.record().has(step);
        match step {
            Step::Address if self.has_address() => {
                if !is_done {
                    self.mark(step)?;
                }
                Ok(false)
            }
            Step::Address => Ok(true),
            Step::BitRate if is_native && self.other_bit_rate().is_some() => Ok(true),
            Step::BitRate => {
                // It could not receive the request to store its new rate at the former one.
                if is_native && !is_done && self.record().before.bit_rate.is_some() {
                    self.motor.gim().refresh()?;
                    self.mark(step)?;
                }
                Ok(false)
            }
            Step::Constants => Ok(!is_done && !self.differences()?.is_empty()),
            Step::Protocol => Ok(is_native && self.joint.protocol.name() != Protocol::Gim.name()),
            Step::Zero | Step::Direction | Step::Range | Step::Motion => Ok(!is_done),
        }
    }

    fn take(&mut self, step: Step) -> Result<Taken, Halt> {
        match step {
            Step::Address => self.address(),
            Step::BitRate => self.bit_rate(),
            Step::Constants => self.constants(),
            Step::Zero => self.zero(),
            Step::Direction => self.direction(),
            Step::Range => self.range(),
            Step::Protocol => self.protocol(),
            Step::Motion => self.motion(),
        }
    }

    fn address(&mut self) -> Result<Taken, Halt> {
        let (id, host_id, before) = (self.joint.id, self.joint.host_id, self.motor.host_id);
        let raw = |id: FrameId| format!("{:#05X}", id.raw());
        let question = format!(
            "{}: write id {id} and host id {} into this motor, which has id {} and host id {}?",
            self.joint.name,
            raw(host_id),
            self.motor.id,
            before.map_or("-".to_owned(), raw)
        );
        let taken = self.confirm(
            &question,
            "New motors of a vendor share one id. The configuration has the new one.",
            "",
        )?;
        if matches!(taken, Taken::Done) {
            let (id_before, host_id_before) =
                (self.motor.id, before.and_then(|id| u16::try_from(id.raw()).ok()));
            self.remember(|before| {
                before.id.get_or_insert(id_before);
                before.host_id = before.host_id.or(host_id_before);
            })?;
            motor::set_address(&mut self.motor, id, host_id)?;
        }
        Ok(taken)
    }

    /// Returns the bit rate of the configuration, where that of the interface is another one.
    fn other_bit_rate(&self) -> Option<u32> {
        let configured = self.file.settings.buses[self.joint.bus].kind.bitrate();
        self.motor.line.bitrate.filter(|present| *present != configured).map(|_| configured)
    }

    fn bit_rate(&mut self) -> Result<Taken, Halt> {
        let (Some(rate), Some(present)) = (self.other_bit_rate(), self.motor.line.bitrate) else {
            return Ok(Taken::Done);
        };
        // Also stores a rate that was undone.
        self.motor.gim().refresh()?;
        let question = format!(
            "{}: the interface has {present} bit/s, and the configuration {rate}. Write {rate} bit/s into the motor? It then answers at that rate only",
            self.joint.name
        );
        let taken =
            self.confirm(&question, "All motors of a bus and its interface need one bit rate.", "")?;
        if matches!(taken, Taken::Done) {
            self.remember(|before| before.bit_rate = before.bit_rate.or(Some(present)))?;
            motor::set_bit_rate(&mut self.motor, rate)?;
            return self.leave_bus(rate);
        }
        Ok(taken)
    }

    /// Ends the guide, because the motor does not answer on this bus until its interface has `rate`.
    fn leave_bus(&mut self, rate: u32) -> Result<Taken, Halt> {
        let bus = self.motor.line.name.clone();
        self.print(&format!(
            "the motor has {rate} bit/s now, and stores it when the guide goes on: keep its power, and give its interface the same rate:\n  sudo ip link set {bus} down; sudo ip link set {bus} type can bitrate {rate}; sudo ip link set {bus} up"
        ))?;
        Err(Halt::Leave)
    }

    /// Returns the differences between the constants of motor and configuration.
    fn differences(&mut self) -> Result<&[Finding], Halt> {
        if self.differences.is_none() {
            let bus = self.file.settings.buses[self.joint.bus].name.clone();
            let survey = survey(&mut self.motor.line.link, self.motor.id, Question::Both, constants())?;
            let reported = survey.map(|survey| survey.reported(&self.joint.name, &bus));
            let found =
                reported.map_or_else(Vec::new, |it| findings(&self.file.settings, &self.joint, Some(&it)));
            let is_constant = |it: &Finding| key_of(it.value).is_some() && it.verdict == Verdict::Differs;
            self.differences = Some(found.into_iter().filter(is_constant).collect());
        }
        Ok(self.differences.as_deref().unwrap_or_default())
    }

    fn constants(&mut self) -> Result<Taken, Halt> {
        let mut values = Values::new();
        let mut question = format!("{}: the motor is not as its model says.", self.joint.name);
        for Finding { value, configured, reported, .. } in self.differences()? {
            let reported = reported.clone().unwrap_or_default();
            question += &format!("\n  {value}: {reported} in the motor, {configured} in the configuration");
            values.extend(key_of(value).map(|key| (key.to_owned(), reported)));
        }
        question += "\nWrite the values of the motor into the configuration? If its model is wrong there, leave with q and correct it";
        let taken = self.confirm(&question, "With wrong values every torque is wrong by their ratio.", "")?;
        if matches!(taken, Taken::Done) {
            self.write(&[edit::TORQUE_CONSTANT, edit::GEAR_RATIO], |known| known.extend(values))?;
        }
        Ok(taken)
    }

    fn protocol(&mut self) -> Result<Taken, Halt> {
        let question = format!(
            "{}: the configuration has the protocol MIT. This change cannot be undone over CAN, only through the serial port of the \
             motor. Type mit to go on",
            self.joint.name
        );
        let help = "Legs use MIT: the motor itself then computes stiffness and damping.";
        let taken = self.confirm(&question, help, "mit")?;
        if matches!(taken, Taken::Done) {
            motor::set_mit(&mut self.motor)?;
        }
        Ok(taken)
    }

    /// Records the values of `keys`, and writes them as `change` leaves them.
    fn write(&mut self, keys: &[&str], change: impl FnOnce(&mut Values)) -> Result<(), Halt> {
        let mut values = self.file.values(&self.joint.name, keys)?;
        let present = values.clone();
        self.remember(|before| {
            for key in keys {
                // A key without a value was not written.
                let value = present.get(*key).cloned().unwrap_or_default();
                before.file.entry((*key).to_owned()).or_insert(value);
            }
        })?;
        change(&mut values);
        Ok(self.file.set(&self.joint.name, keys, &values)?)
    }

    fn record(&self) -> Record {
        self.progress.find(&self.joint.name).cloned().unwrap_or_default()
    }

    fn remember(&mut self, change: impl FnOnce(&mut Before)) -> Result<(), DirectFailure> {
        self.progress.change(&self.joint.name, |record| change(&mut record.before))
    }

    fn mark(&mut self, step: Step) -> Result<(), DirectFailure> {
        let configured = Configured::of(&self.joint, &self.file.settings);
        self.progress.change(&self.joint.name, |record| record.mark(step, configured))
    }

    fn print(&mut self, sentence: &str) -> Result<(), Halt> {
        self.dialog.print(&format!("{}: {sentence}", self.joint.name))
    }

    /// Asks until `word`, `b` or `s` is typed. Without a word Enter goes on.
    fn confirm(&mut self, question: &str, help: &str, word: &str) -> Result<Taken, Halt> {
        loop {
            match taken(self.dialog.ask(question, help)?, word) {
                Ok(taken) => return Ok(taken),
                Err(reason) => self.print(&reason)?,
            }
        }
    }

    /// Like [`confirm`](Self::confirm), and shows the positions that the motor reports meanwhile.
    fn watch(
        &mut self,
        question: &str,
        help: &str,
        word: &str,
        show: impl Fn(&Seen) -> String,
    ) -> Result<(Taken, Seen), Halt> {
        loop {
            let (answer, seen) = self.watch_answer(question, help, &show)?;
            match taken(answer, word) {
                Ok(taken) => return Ok((taken, seen)),
                Err(reason) => self.print(&reason)?,
            }
        }
    }

    fn watch_answer(
        &mut self,
        question: &str,
        help: &str,
        show: impl Fn(&Seen) -> String,
    ) -> Result<(Answer, Seen), Halt> {
        let Self { dialog, motor, .. } = self;
        let first = zero::position(motor)?;
        let mut seen = Seen { last: first, low: first, high: first };
        let watched = dialog.watch(question, help, || {
            let at = zero::position(motor)?;
            seen = Seen { last: at, low: seen.low.min(at), high: seen.high.max(at) };
            Ok(Reading::<()>::Shows(show(&seen)))
        })?;
        match watched {
            Watched::Answer(answer) => Ok((answer, seen)),
            Watched::Seen(()) => Err(Halt::Leave),
        }
    }
}

/// Returns the meaning of an answer where `word` goes on, or Enter without a word.
fn taken(answer: Answer, word: &str) -> Result<Taken, String> {
    match answer {
        Answer::Back => Ok(Taken::Back),
        Answer::Skip => Ok(Taken::Skip),
        Answer::Enter if word.is_empty() => Ok(Taken::Done),
        Answer::Text(text) if text == word => Ok(Taken::Done),
        Answer::Text(text) if word.is_empty() => {
            Err(format!("`{text}` is no answer here: press Enter, or type `?`"))
        }
        Answer::Enter | Answer::Text(_) => Err(format!("only `{word}` goes on")),
    }
}

/// Returns the position of a joint, rad, for that of its motor.
fn to_joint(transmission: Transmission, position: f64) -> f64 {
    transmission.position_to_joint(position as f32).into()
}

/// Formats an angle, rad, in degrees.
fn degrees(angle: f64) -> String {
    format!("{}°", number(Some(angle.to_degrees()), 1))
}

/// Returns the key of a constant in the configuration.
fn key_of(constant: &str) -> Option<&'static str> {
    match constant {
        "torque-constant" => Some(edit::TORQUE_CONSTANT),
        "gear-ratio" => Some(edit::GEAR_RATIO),
        _ => None,
    }
}
