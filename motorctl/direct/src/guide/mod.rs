//! `motorctl setup --guide`: sets up the motors of a configuration, one after the other.
//!
//! ```text
//!  wait for one motor ▶ which joint? ▶ its steps (steps/) ▶ lock file ▶ wait … ▶ all are done
//! ```

mod dialog;
mod edit;
mod motion;
mod progress;
mod search;
mod steps;
#[cfg(test)]
mod tests;

use crate::failure::DirectFailure;
use crate::file::FACTORY_ID;
use crate::setup;
use crate::target::{self, OpenLine, Session};
use dialog::{Answer, Dialog, Halt, Keyboard, Watched, is_curable};
use edit::Configuration;
use motord_configuration as config;
use motord_protocol::commissioning::{Found, LISTEN};
use motord_settings::settings::MotorSettings;
use motord_terminal::Interrupt;
use progress::{Configured, Progress, Record, Step};
use search::{Candidate, Search};
use std::io::{self, IsTerminal};
use std::path::Path;
use steps::{Ended, JointGuide};

/// `motorctl setup --guide`: of these joints, or of all.
pub(crate) fn run(path: &Path, joints: &[String]) -> Result<(), DirectFailure> {
    if !io::stdin().is_terminal() {
        let usage =
            "--guide asks questions and needs a terminal: docs/first-motor.md has the single commands";
        return Err(DirectFailure::Usage(usage.to_owned()));
    }
    if !path.exists() {
        let path = path.display();
        let usage = format!("there is no {path}: `motord init --file {path}` writes it");
        return Err(DirectFailure::Usage(usage));
    }
    let file = Configuration::load(path)?;
    setup::chosen(&file.settings, joints)?;
    let interrupt = Interrupt::register();
    let (lines, closed) = open(&file)?;
    let progress = Progress::load(path)?;
    let (mut keyboard, mut output) = (Keyboard::new(&interrupt), io::stdout());
    let dialog = Dialog::new(&mut keyboard, &mut output);
    let mut guide =
        Guide { dialog, file, progress, lines, joints, skipped: Vec::new(), interrupt: &interrupt };
    guide.run_to_the_end(&closed)
}

/// Opens the buses of the configuration. Returns the lines by the index of their bus, and the
/// reasons for which the others cannot be used.
fn open(file: &Configuration) -> Result<(Vec<Option<OpenLine>>, Vec<String>), DirectFailure> {
    let (mut lines, mut closed) = (Vec::new(), Vec::new());
    let mut failure = None;
    for bus in &file.settings.buses {
        let Some(address) = bus.kind.address() else {
            closed.push(format!("{} is simulated inside the daemon", bus.name));
            lines.push(None);
            continue;
        };
        let line = target::open(address, bus.kind.bitrate());
        match line.and_then(|mut line| Ok(line.link.listen(LISTEN).map(|()| line)?)) {
            Ok(line) => lines.push(Some(line)),
            Err(error) => {
                closed.push(error.to_string());
                failure.get_or_insert(error);
                lines.push(None);
            }
        }
    }
    if lines.iter().any(Option::is_some) {
        return Ok((lines, closed));
    }
    let only_simulated = || {
        let usage = "every bus of the configuration is simulated inside the daemon: its motors need no set-up. `motord-sim --new` simulates \
                     new motors on real buses";
        DirectFailure::Usage(usage.to_owned())
    };
    Err(failure.unwrap_or_else(only_simulated))
}

/// The whole guide.
struct Guide<'g> {
    dialog: Dialog<'g>,
    file: Configuration,
    progress: Progress,
    /// By the index of the bus; `None` for a bus that cannot be used.
    lines: Vec<Option<OpenLine>>,
    /// Only these joints; empty: all.
    joints: &'g [String],
    skipped: Vec<String>,
    interrupt: &'g Interrupt,
}

impl Guide<'_> {
    /// Runs until all joints are done or the person leaves.
    fn run_to_the_end(&mut self, closed: &[String]) -> Result<(), DirectFailure> {
        let ended = self.introduce(closed).and_then(|()| self.set_up_all());
        match ended {
            Ok(()) => Ok(()),
            Err(Halt::Leave) => {
                let path = self.file.path.display();
                let next =
                    format!("\nEverything is saved. Go on with:\n  motorctl setup --guide --config {path}");
                // The terminal may be closed.
                let _unread = self.dialog.print(&next);
                Ok(())
            }
            Err(Halt::Failure(failure)) => Err(failure),
        }
    }

    fn introduce(&mut self, closed: &[String]) -> Result<(), Halt> {
        let path = self.file.path.display().to_string();
        self.dialog.print(&format!(
            "This sets up the motors of {path}, one after the other. Nothing moves before you allow it.\n\
             Enter goes on, b undoes the last step, s leaves a joint out, q leaves, ? explains."
        ))?;
        for reason in closed {
            self.dialog.print(&format!("Left out: {reason}"))?;
        }
        for joint in self.progress.reopen(&self.file.settings)? {
            self.dialog
                .print(&format!("{joint} has another bus, id or model by now: its steps begin again"))?;
        }
        for joint in self.file.settings.motors.clone() {
            let bus = self.file.settings.buses[joint.bus].device();
            let state = match self.progress.find(&joint.name) {
                Some(record) if record.has(Step::Motion) => "done".to_owned(),
                Some(record) if !record.done.is_empty() => {
                    let done: Vec<_> = record.done.iter().map(|step| step.name()).collect();
                    format!("begun: {}", done.join(", "))
                }
                _ => "to do".to_owned(),
            };
            self.dialog.print(&format!("  {:12} {} on {bus}: {state}", joint.name, joint.model))?;
        }
        Ok(())
    }

    fn set_up_all(&mut self) -> Result<(), Halt> {
        while !self.left().is_empty() {
            match self.set_up_next() {
                Err(Halt::Failure(failure)) if is_curable(&failure) => {
                    let question = format!("{failure}\nRemove the cause, and press Enter to try again");
                    self.dialog.ask(&question, "What was done so far is saved.")?;
                }
                ended => ended?,
            }
        }
        self.finish()
    }

    /// Returns the joints that are to be set up, on a bus that can be used.
    fn left(&self) -> Vec<MotorSettings> {
        let is_left = |joint: &&MotorSettings| {
            let is_chosen = self.joints.is_empty() || self.joints.contains(&joint.name);
            is_chosen
                && self.lines[joint.bus].is_some()
                && !self.progress.is_done(&joint.name)
                && !self.skipped.contains(&joint.name)
        };
        self.file.settings.motors.iter().filter(is_left).cloned().collect()
    }

    /// Waits for a motor, and sets it up.
    fn set_up_next(&mut self) -> Result<(), Halt> {
        let Some(candidate) = self.find()? else { return Ok(()) };
        let Some(joint) = self.joint_of(&candidate)? else { return Ok(()) };
        let Some(line) = self.lines[candidate.bus].take() else { return Ok(()) };
        let session = Session::with(line, &candidate.found);
        let Self { dialog, file, progress, interrupt, .. } = self;
        let mut guide = JointGuide::new(dialog, file, progress, interrupt, session, joint.clone());
        let ended = guide.run();
        let mut session = guide.into_motor();
        let stored = match &ended {
            Ok(Ended::SetUp) => {
                setup::record(&self.file.path, &self.file.settings, &joint.name, &mut session.line)
            }
            _ => Ok(Vec::new()),
        };
        self.lines[candidate.bus] = Some(session.line);
        match ended? {
            Ended::SetUp => {
                for difference in stored? {
                    self.dialog.print(&difference)?;
                }
                let configured = Configured::of(&joint, &self.file.settings);
                self.progress.change(&joint.name, |record| record.mark(Step::Motion, configured))?;
                let power = match joint.id {
                    FACTORY_ID => "Take its power: new motors have its id, 1",
                    _ => "It may keep its power",
                };
                self.dialog.print(&format!("{} is done. {power}.", joint.name))
            }
            Ended::Skipped => {
                self.skipped.push(joint.name);
                Ok(())
            }
            Ended::Back => Ok(()),
        }
    }

    /// Waits until exactly one motor answers that is not set up.
    fn find(&mut self) -> Result<Option<Candidate>, Halt> {
        let names: Vec<_> = self.left().into_iter().map(|joint| joint.name).collect();
        let question = format!("Give power to one motor of: {}", names.join(", "));
        let help =
            "New motors share one id: only one of them may have power. Those that are done may keep theirs.";
        loop {
            let mut search = Search::new(&self.file, &self.progress, &self.skipped, &mut self.lines);
            match self.dialog.watch(&question, help, || search.poll())? {
                Watched::Seen(candidate) => return Ok(Some(candidate)),
                Watched::Answer(Answer::Back) => {
                    let last = self.progress.last().map(|record| record.name.clone());
                    let Some(last) = last.filter(|last| self.progress.is_done(last)) else {
                        self.dialog.print("there is no step to undo")?;
                        continue;
                    };
                    self.progress.change(&last, |record| record.unmark(Step::Motion))?;
                    self.dialog.print(&format!("{last} is open again: give power to its motor"))?;
                    return Ok(None);
                }
                Watched::Answer(Answer::Skip) => {
                    self.dialog.print("a joint can be left out when its motor answers; q leaves")?;
                }
                Watched::Answer(Answer::Enter | Answer::Text(_)) => {}
            }
        }
    }

    /// Returns the joint of the motor: the one that has its address, or the one that is named.
    fn joint_of(&mut self, candidate: &Candidate) -> Result<Option<MotorSettings>, Halt> {
        let bus = self.file.settings.buses[candidate.bus].device().to_owned();
        let left: Vec<_> = self.left().into_iter().filter(|joint| joint.bus == candidate.bus).collect();
        if let Some(joint) = left.iter().find(|joint| candidate.joint.as_ref() == Some(&joint.name)) {
            if let Some(reason) = candidate.mismatch(joint) {
                return self
                    .refuse(&format!("A motor answers on {bus} with the id of {}. {reason}", joint.name));
            }
            self.dialog.print(&format!("{}: its motor answers on {bus}, as id {}", joint.name, joint.id))?;
            return Ok(Some(joint.clone()));
        }
        if left.is_empty() {
            return self.refuse(&format!("A motor answers on {bus}, and every joint there is done"));
        }
        self.ask_joint(candidate, &left, &bus)
    }

    /// Waits until the person has seen why a motor cannot be set up.
    fn refuse(&mut self, reason: &str) -> Result<Option<MotorSettings>, Halt> {
        let question = format!("{reason}. Take its power, and press Enter");
        self.dialog.ask(&question, "Only the joints of the configuration can be set up.")?;
        Ok(None)
    }

    fn ask_joint(
        &mut self,
        candidate: &Candidate,
        left: &[MotorSettings],
        bus: &str,
    ) -> Result<Option<MotorSettings>, Halt> {
        let names = left.iter().map(|joint| joint.name.as_str()).collect::<Vec<_>>().join(", ");
        let likely = self.likely_joint(candidate, left).map(|joint| joint.name.clone());
        let offer = likely.as_ref().map_or("Type its name".to_owned(), |name| format!("Enter takes {name}"));
        let (vendor, id) = (candidate.vendor, candidate.found.id);
        let question =
            format!("A motor answers on {bus}: {vendor}, id {id}. Which joint is it: {names}? {offer}");
        loop {
            let name = match self.dialog.ask(&question, "The motor gets the id of this joint.")? {
                Answer::Enter => likely.clone().unwrap_or_default(),
                Answer::Text(text) => text,
                Answer::Back | Answer::Skip => return Ok(None),
            };
            let reason = match left.iter().find(|joint| joint.name == name) {
                None if name.is_empty() => format!("type one of: {names}"),
                None if self.progress.is_done(&name) => format!("{name} is done already"),
                None => format!("no joint {name} is to do on {bus}: {names}"),
                Some(joint) => match candidate.mismatch(joint) {
                    None if self.may_take(&joint.name)? => return Ok(Some(joint.clone())),
                    None => continue,
                    Some(reason) => reason,
                },
            };
            self.dialog.print(&reason)?;
        }
    }

    /// Returns the joint that Enter takes: the one with the address of the motor, or the first. Not
    /// one that has begun: its motor has its address.
    fn likely_joint<'l>(
        &self,
        candidate: &Candidate,
        left: &'l [MotorSettings],
    ) -> Option<&'l MotorSettings> {
        let Found { id, host_id, .. } = candidate.found;
        let fits = |joint: &&MotorSettings| {
            candidate.mismatch(joint).is_none() && !self.progress.has_begun(&joint.name)
        };
        let has_address = |joint: &&MotorSettings| joint.id == id && Some(joint.host_id) == host_id;
        left.iter().filter(fits).find(has_address).or_else(|| left.iter().find(fits))
    }

    /// Returns whether a motor without the address of `joint` may take it. If the joint has begun,
    /// the person is asked whether this is another motor, for which its steps begin again.
    fn may_take(&mut self, joint: &str) -> Result<bool, Halt> {
        if !self.progress.has_begun(joint) {
            return Ok(true);
        }
        let question = format!(
            "{joint} was begun with a motor that has its id by now, and this one has another id. If this motor takes its place, type new: \
             its steps begin again"
        );
        let help = "Two motors with one id destroy each other's answers: the former one must not return to this bus.";
        loop {
            match self.dialog.ask(&question, help)? {
                Answer::Text(text) if text == "new" => {
                    self.progress.change(joint, Record::begin_again)?;
                    return Ok(true);
                }
                Answer::Back | Answer::Skip => return Ok(false),
                Answer::Enter | Answer::Text(_) => {
                    self.dialog.print("only `new` takes another motor; `b` goes back to the joints")?;
                }
            }
        }
    }

    /// Prints the verdict on the configuration, and the next commands.
    fn finish(&mut self) -> Result<(), Halt> {
        let undone: Vec<_> =
            self.file.settings.motors.iter().filter(|motor| !self.progress.is_done(&motor.name)).collect();
        if !undone.is_empty() {
            let names = undone.iter().map(|motor| motor.name.as_str()).collect::<Vec<_>>().join(", ");
            self.dialog.print(&format!("\nLeft out: {names}"))?;
            return Err(Halt::Leave);
        }
        let path = self.file.path.display().to_string();
        let loaded = config::load(&self.file.path)?;
        self.dialog.print(&format!("\nAll joints are done, and motord accepts {path}."))?;
        for warning in &loaded.warnings {
            self.dialog.print(&format!("warning: {warning}"))?;
        }
        let lock = config::lock::Lock::path(&self.file.path);
        self.dialog.print(&format!(
            "The reports of the motors are in {}. Next, after the power of all motors was off once:",
            lock.display()
        ))?;
        self.dialog.print(&format!("  motorctl setup --config {path}\n  motord run --config {path}"))
    }
}
