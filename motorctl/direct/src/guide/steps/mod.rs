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

mod undo;

use crate::failure::DirectFailure;
use crate::guide::dialog::{Answer, Dialog, Halt, Reading, Watched};
use crate::guide::edit::{self, Configuration, Values};
use crate::guide::motion::{self, TRAVEL_MAX};
use crate::guide::motor::{self, Health};
use crate::guide::progress::{Before, Progress, Record, Step};
use crate::target::{Protocol, Session};
use crate::zero;
use motord_bus::FrameId;
use motord_configuration::lock::{Finding, Verdict, findings};
use motord_protocol::commissioning::{Error, Question, Wire, constants, survey};
use motord_settings::settings::MotorSettings;
use motord_terminal::{Interrupt, number};

/// Smallest turn by which a direction is recognised, rad: 10°.
const TURN_MIN: f64 = 0.175;
/// Smallest range of a joint, rad: 2°.
const RANGE_MIN: f64 = 0.035;
/// Distance between the ends of a joint and its limits, rad: 3°, where its range is not small.
const MARGIN_MAX: f64 = 0.0524;
/// The same, as a part of the range.
const MARGIN_PART: f64 = 0.05;

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

    /// Takes the steps that are left.
    ///
    /// # Errors
    ///
    /// The person leaves; the motor or a file fails.
    pub(super) fn run(&mut self) -> Result<Ended, Halt> {
        if !self.is_healthy()? {
            return Ok(Ended::Skipped);
        }
        while let Some(step) = self.next()? {
            match self.take(step)? {
                Taken::Done => {
                    self.mark(step)?;
                    self.say(&format!("{}: saved", step.name()))?;
                }
                Taken::Back if self.undo()? => {}
                Taken::Back => return Ok(Ended::Back),
                Taken::Skip => return Ok(Ended::Skipped),
            }
        }
        Ok(Ended::SetUp)
    }

    /// Shows the state of the motor, until it has no fault and plausible values. `false`: skipped.
    fn is_healthy(&mut self) -> Result<bool, Halt> {
        loop {
            let health = Health::read(&mut self.motor)?;
            self.say(&health.describe())?;
            let Some(problem) = health.problem() else { return Ok(true) };
            let question = format!("{}: {problem}. Enter clears its fault and reads again", self.joint.name);
            match self
                .dialog
                .ask(&question, "A motor is set up without a fault, with a usual supply and temperature.")?
            {
                Answer::Skip => return Ok(false),
                _ => motor::clear_fault(&mut self.motor)?,
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
        let taken = self
            .confirm(&question, "New motors of a vendor share one id. The configuration has the new one.")?;
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
        // An undone rate is stored here, too.
        self.motor.gim().refresh()?;
        let question = format!(
            "{}: the interface has {present} bit/s, and the configuration {rate}. Write {rate} bit/s into the motor? It then answers at that rate only",
            self.joint.name
        );
        let taken = self.confirm(&question, "All motors of a bus and its interface need one bit rate.")?;
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
        self.say(&format!(
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
        let taken = self.confirm(&question, "With wrong values every torque is wrong by their ratio.")?;
        if matches!(taken, Taken::Done) {
            self.write(&[edit::TORQUE_CONSTANT, edit::GEAR_RATIO], |known| known.extend(values))?;
        }
        Ok(taken)
    }

    fn zero(&mut self) -> Result<Taken, Halt> {
        let question = format!(
            "{}: bring the joint to its mark by hand: the pose where its motor shall report zero. Then press Enter",
            self.joint.name
        );
        let help = "A mark, a stop or a gauge. A zero at a stop can be repeated most exactly.";
        let (taken, seen) = self.watch(&question, help, |seen| degrees(seen.last))?;
        if matches!(taken, Taken::Done) {
            let (stored, at) = (motor::stored_zero(&mut self.motor)?, seen.last);
            self.remember(|before| match stored {
                Some(stored) => drop(before.zero.get_or_insert(stored)),
                None => drop(before.zero_at.get_or_insert(at)),
            })?;
            self.set_zero()?;
        }
        Ok(taken)
    }

    /// Makes the present position zero, and checks it.
    fn set_zero(&mut self) -> Result<(), Halt> {
        let before = zero::position(&mut self.motor)?;
        match self.motor.protocol {
            Protocol::Mit => self.motor.mit().set_zero().map(drop)?,
            Protocol::Gim => zero::move_zero(&mut self.motor, before, 0.0)?,
        }
        let after = zero::position(&mut self.motor)?;
        if after.abs() <= zero::TOLERANCE {
            return Ok(());
        }
        let reason = format!(
            "it reports {after:.3} rad after its zero was set: hold the joint still, and set it again"
        );
        Err(self.motor.unfit(&reason).into())
    }

    fn direction(&mut self) -> Result<Taken, Halt> {
        let question = format!(
            "{}: turn the joint by hand in its positive direction (up, forward or left), by 10° or more, leave it there and press Enter",
            self.joint.name
        );
        let help = "For most controllers up, forward and left are positive.";
        let begin = zero::position(&mut self.motor)?;
        loop {
            let show = |seen: &Seen| format!("turned by {}", degrees(seen.last - begin));
            let (taken, seen) = self.watch(&question, help, show)?;
            let turned = seen.last - begin;
            if !matches!(taken, Taken::Done) {
                return Ok(taken);
            }
            if turned.abs() >= TURN_MIN {
                let direction = if turned > 0.0 { "1" } else { "-1" };
                self.write(&[edit::DIRECTION], |values| {
                    values.insert(edit::DIRECTION.to_owned(), direction.to_owned());
                })?;
                return Ok(Taken::Done);
            }
            self.say(&format!("the joint turned by {} only", degrees(turned)))?;
        }
    }

    fn range(&mut self) -> Result<Taken, Halt> {
        let question = format!(
            "{}: move the joint by hand to one end and to the other, and press Enter. `keep` keeps the limits of the configuration",
            self.joint.name
        );
        let help = "The limits are written with a margin of 3°, or 5 % of a small range. motord keeps the joint within them.";
        let transmission = self.joint.transmission;
        let ends = move |seen: &Seen| {
            let [a, b] =
                [seen.low, seen.high].map(|end| f64::from(transmission.position_to_joint(end as f32)));
            [a.min(b), a.max(b)]
        };
        loop {
            let show = |seen: &Seen| {
                let [low, high] = ends(seen).map(degrees);
                let now = degrees(f64::from(transmission.position_to_joint(seen.last as f32)));
                format!("now at {now}, from {low} to {high}")
            };
            let (answer, seen) = self.watch_answer(&question, help, show)?;
            match answer {
                Answer::Back => return Ok(Taken::Back),
                Answer::Skip => return Ok(Taken::Skip),
                Answer::Text(text) if text == "keep" => return Ok(Taken::Done),
                Answer::Text(text) => self.say(&format!("`{text}` is no answer here"))?,
                Answer::Enter => {
                    let [low, high] = ends(&seen);
                    if high - low >= RANGE_MIN {
                        self.write_range(low, high)?;
                        return Ok(Taken::Done);
                    }
                    self.say(&format!("the joint moved by {} only", degrees(high - low)))?;
                }
            }
        }
    }

    fn write_range(&mut self, low: f64, high: f64) -> Result<(), Halt> {
        let margin = MARGIN_MAX.min(MARGIN_PART * (high - low));
        let range = format!("[{:.4}, {:.4}]", low + margin, high - margin);
        self.write(&[edit::POSITION], |values| drop(values.insert(edit::POSITION.to_owned(), range)))
    }

    fn protocol(&mut self) -> Result<Taken, Halt> {
        let question = format!(
            "{}: the configuration has the protocol MIT. This change cannot be undone over CAN, only through the serial port of the \
             motor. Type mit to go on",
            self.joint.name
        );
        loop {
            match self
                .dialog
                .ask(&question, "Legs use MIT: the motor itself then computes stiffness and damping.")?
            {
                Answer::Text(text) if text == "mit" => {
                    motor::set_mit(&mut self.motor)?;
                    return Ok(Taken::Done);
                }
                Answer::Back => return Ok(Taken::Back),
                Answer::Skip => return Ok(Taken::Skip),
                Answer::Enter | Answer::Text(_) => self.say("only `mit` changes the protocol")?,
            }
        }
    }

    fn motion(&mut self) -> Result<Taken, Halt> {
        let at =
            f64::from(self.joint.transmission.position_to_joint(zero::position(&mut self.motor)? as f32));
        let [low, high] = self.joint.limits.position.map(f64::from);
        let (towards, sense) = if at + TRAVEL_MAX <= high { (1.0, "positive") } else { (-1.0, "negative") };
        let question = format!(
            "{}: first motion, by 2° in the {sense} direction and back, softly. Free the joint, take the switch of its power in your \
             hand, and press Enter",
            self.joint.name
        );
        let help =
            "The pull grows slowly up to 3 N·m, and ends when the joint moves. Ctrl-C stops the motor.";
        let taken = self.confirm(&question, help)?;
        if !matches!(taken, Taken::Done) {
            return Ok(taken);
        }
        if !(low..=high).contains(&at) {
            let [at, low, high] = [at, low, high].map(degrees);
            self.say(&format!(
                "the joint is at {at}, outside of its limits {low} to {high}: move it by hand"
            ))?;
            return self.motion();
        }
        let sign = towards * f64::from(self.joint.transmission.direction());
        let moved =
            motion::move_a_little(&mut self.motor, sign, self.interrupt).map_err(
                |failure| match failure {
                    DirectFailure::Motor(Error::Interrupted) => Halt::Leave,
                    failure => failure.into(),
                },
            )?;
        self.say(&format!("moved by {} and stopped", degrees(moved)))?;
        self.check_motion(sense)
    }

    /// Asks whether the right joint moved in the right direction.
    fn check_motion(&mut self, sense: &str) -> Result<Taken, Halt> {
        let question = format!("Did {} move in its {sense} direction, and back? y or n", self.joint.name);
        loop {
            match self.dialog.ask(&question, "If another joint moved, its motor was taken for this one.")? {
                Answer::Text(text) if ["y", "yes"].contains(&text.as_str()) => return Ok(Taken::Done),
                Answer::Text(text) if ["n", "no"].contains(&text.as_str()) => {
                    self.say("then its direction is wrong, or the motor is that of another joint: `b` undoes further steps")?;
                    while self.record().has(Step::Range) && self.undo()? {}
                    return Ok(Taken::Back);
                }
                Answer::Back => return Ok(Taken::Back),
                Answer::Skip => return Ok(Taken::Skip),
                Answer::Enter | Answer::Text(_) => self.say("type y or n")?,
            }
        }
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
        self.progress.change(&self.joint.name, |record| {
            record.done.retain(|done| *done != step);
            record.done.push(step);
        })
    }

    fn say(&mut self, sentence: &str) -> Result<(), Halt> {
        self.dialog.say(&format!("{}: {sentence}", self.joint.name))
    }

    /// Asks until Enter, `b` or `s` is pressed.
    fn confirm(&mut self, question: &str, help: &str) -> Result<Taken, Halt> {
        loop {
            match self.dialog.ask(question, help)? {
                Answer::Enter => return Ok(Taken::Done),
                Answer::Back => return Ok(Taken::Back),
                Answer::Skip => return Ok(Taken::Skip),
                Answer::Text(text) => {
                    self.say(&format!("`{text}` is no answer here: press Enter, or type `?`"))?;
                }
            }
        }
    }

    /// Like [`confirm`](Self::confirm), and shows the positions that the motor reports meanwhile.
    fn watch(
        &mut self,
        question: &str,
        help: &str,
        show: impl Fn(&Seen) -> String,
    ) -> Result<(Taken, Seen), Halt> {
        loop {
            let (answer, seen) = self.watch_answer(question, help, &show)?;
            match answer {
                Answer::Enter => return Ok((Taken::Done, seen)),
                Answer::Back => return Ok((Taken::Back, seen)),
                Answer::Skip => return Ok((Taken::Skip, seen)),
                Answer::Text(text) => {
                    self.say(&format!("`{text}` is no answer here: press Enter, or type `?`"))?;
                }
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
