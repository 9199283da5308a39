//! The step in which the joint moves by itself.

use super::{JointGuide, Seen, Taken, degrees, to_joint};
use crate::failure::DirectFailure;
use crate::guide::dialog::{Answer, Halt};
use crate::guide::motion::{self, TRAVEL_MAX};
use crate::guide::progress::Step;
use crate::target::Protocol;
use crate::zero;
use motord_protocol::commissioning::Error;

/// Smallest distance to the limit on the side of the motion, rad: 3°.
const CLEARANCE_MIN: f64 = 0.0524;

/// The direction of the first motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Positive,
    Negative,
}

impl Side {
    /// Returns the side on which a joint at `at`, rad, has clearance within its limits, rad: the
    /// positive one, if it is enough for any motion that is not stopped.
    fn free(at: f64, limits: [f64; 2]) -> Option<Self> {
        let distances = [TRAVEL_MAX, CLEARANCE_MIN].into_iter();
        let sides = distances.flat_map(|least| [(Self::Positive, least), (Self::Negative, least)]);
        sides.into_iter().find(|(side, least)| side.has_clearance(at, limits, *least)).map(|(side, _)| side)
    }

    fn has_clearance(self, at: f64, [low, high]: [f64; 2], least: f64) -> bool {
        let free = if self == Self::Positive { high - at } else { at - low };
        (low..=high).contains(&at) && free >= least
    }

    const fn sign(self) -> f64 {
        match self {
            Self::Positive => 1.0,
            Self::Negative => -1.0,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Positive => "positive",
            Self::Negative => "negative",
        }
    }
}

impl JointGuide<'_, '_> {
    pub(super) fn motion(&mut self) -> Result<Taken, Halt> {
        loop {
            let side = self.free_side()?;
            let taken = match &side {
                Ok(side) => self.confirm_motion(*side)?,
                Err(reason) => self.ask_for_clearance(reason)?,
            };
            let (Taken::Done, Ok(side)) = (&taken, side) else {
                if matches!(taken, Taken::Done) {
                    continue;
                }
                return Ok(taken);
            };
            // A hand may have moved the joint while the question was open.
            if side.has_clearance(self.position()?, self.limits(), CLEARANCE_MIN) {
                return self.move_to(side);
            }
            self.print("the joint was moved meanwhile, and is too near its limits")?;
        }
    }

    /// Returns the side on which the joint has clearance, or why it has none.
    fn free_side(&mut self) -> Result<Result<Side, String>, Halt> {
        let (at, limits) = (self.position()?, self.limits());
        Ok(Side::free(at, limits).ok_or_else(|| {
            let [at, low, high] = [at, limits[0], limits[1]].map(degrees);
            format!("the joint is at {at}, its limits are {low} to {high}, and the first motion needs 3° up to one of them")
        }))
    }

    /// Reads the position of the joint, rad.
    fn position(&mut self) -> Result<f64, Halt> {
        Ok(to_joint(self.joint.transmission, zero::position(&mut self.motor)?))
    }

    fn limits(&self) -> [f64; 2] {
        self.joint.limits.position.map(f64::from)
    }

    fn ask_for_clearance(&mut self, reason: &str) -> Result<Taken, Halt> {
        let question = format!("{}: {reason}. Move it by hand, and press Enter", self.joint.name);
        let help = "If its limits are wrong, `b` goes back to its range.";
        let transmission = self.joint.transmission;
        let show = |seen: &Seen| degrees(to_joint(transmission, seen.last));
        self.watch(&question, help, "", show).map(|(taken, _)| taken)
    }

    fn confirm_motion(&mut self, side: Side) -> Result<Taken, Halt> {
        let question = format!(
            "{}: first motion, by 2° in the {} direction and back, softly. Free the joint, keep the switch of its power in your hand, \
             and type move",
            self.joint.name,
            side.name()
        );
        let most = motion::torque_max(&self.motor);
        let help = match self.motor.protocol {
            Protocol::Mit | Protocol::RobStride | Protocol::CanSimple | Protocol::MyActuator => format!(
                "The pull grows slowly up to {most:.1} N·m, and ends when the joint moves. Ctrl-C stops the motor. If the guide itself is \
                 killed, the motor holds its last pull: cut its power."
            ),
            Protocol::Gim | Protocol::ODrive => format!(
                "The motor follows a speed that grows slowly up to 0.3 rad/s, and is stopped when it reports more than {most:.1} N·m. \
                 Ctrl-C stops the motor."
            ),
        };
        self.confirm(&question, &help, "move")
    }

    fn move_to(&mut self, side: Side) -> Result<Taken, Halt> {
        let sign = side.sign() * f64::from(self.joint.transmission.direction());
        let moved =
            motion::move_a_little(&mut self.motor, sign, self.interrupt).map_err(
                |failure| match failure {
                    DirectFailure::Motor(Error::Interrupted) => Halt::Leave,
                    failure => failure.into(),
                },
            )?;
        self.print(&format!("moved by {} and stopped", degrees(moved)))?;
        self.check_motion(side.name())
    }

    /// Asks whether the right joint moved in the right direction.
    fn check_motion(&mut self, sense: &str) -> Result<Taken, Halt> {
        let question = format!("Did {} move in its {sense} direction, and back? y or n", self.joint.name);
        loop {
            match self.dialog.ask(&question, "If another joint moved, its motor was taken for this one.")? {
                Answer::Text(text) if ["y", "yes"].contains(&text.as_str()) => return Ok(Taken::Done),
                Answer::Text(text) if ["n", "no"].contains(&text.as_str()) => {
                    self.print("then its direction is wrong, or the motor is that of another joint: `b` undoes further steps")?;
                    while self.record().has(Step::Range) && self.undo()? {}
                    return Ok(Taken::Back);
                }
                Answer::Back => return Ok(Taken::Back),
                Answer::Skip => return Ok(Taken::Skip),
                Answer::Enter | Answer::Text(_) => self.print("type y or n")?,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_needs_clearance_on_its_side() {
        let limits = [-0.5, 0.5];
        let table = [
            (0.0, Some(Side::Positive)),
            (0.45, Some(Side::Negative)),
            (-0.45, Some(Side::Positive)),
            (0.6, None),
            (-0.6, None),
        ];
        for (at, side) in table {
            assert_eq!(Side::free(at, limits), side, "{at}");
        }
        assert!(
            Side::Positive.has_clearance(0.42, limits, CLEARANCE_MIN)
                && !Side::Positive.has_clearance(0.46, limits, CLEARANCE_MIN)
        );
        assert_eq!(Side::free(0.0, [-0.04, 0.04]), None);
        assert_eq!(Side::free(0.03, [-0.06, 0.04]), Some(Side::Negative));
    }
}
