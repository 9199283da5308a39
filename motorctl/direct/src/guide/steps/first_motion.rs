//! The step in which the joint moves by itself.

use super::{JointGuide, Taken, degrees};
use crate::failure::DirectFailure;
use crate::guide::dialog::{Answer, Halt};
use crate::guide::motion::{self, TRAVEL_MAX};
use crate::guide::progress::Step;
use crate::zero;
use motord_protocol::commissioning::Error;

impl JointGuide<'_, '_> {
    pub(super) fn motion(&mut self) -> Result<Taken, Halt> {
        let at =
            f64::from(self.joint.transmission.position_to_joint(zero::position(&mut self.motor)? as f32));
        let [low, high] = self.joint.limits.position.map(f64::from);
        let (towards, sense) = if at + TRAVEL_MAX <= high { (1.0, "positive") } else { (-1.0, "negative") };
        let question = format!(
            "{}: first motion, by 2° in the {sense} direction and back, softly. Free the joint, take the switch of its power in your \
             hand, and type move",
            self.joint.name
        );
        let help =
            "The pull grows slowly up to 3 N·m, and ends when the joint moves. Ctrl-C stops the motor.";
        let taken = self.confirm(&question, help, "move")?;
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
}
