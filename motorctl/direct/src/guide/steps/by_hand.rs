//! The steps in which a hand moves the joint: zero, direction and range.

use super::{JointGuide, Seen, Taken, degrees, to_joint};
use crate::guide::dialog::{Answer, Halt};
use crate::guide::edit;
use crate::motor;
use crate::zero;

/// Smallest turn by which a direction is recognised, rad: 10°.
const TURN_MIN: f64 = 0.175;
/// Smallest range of a joint, rad: 2°.
const RANGE_MIN: f64 = 0.035;
/// Distance between the ends of a joint and its limits, rad: 3°, where its range is not small.
const MARGIN_MAX: f64 = 0.0524;
/// The same, as a part of the range.
const MARGIN_PART: f64 = 0.05;

impl JointGuide<'_, '_> {
    pub(super) fn zero(&mut self) -> Result<Taken, Halt> {
        let question = format!(
            "{}: bring the joint to its mark by hand: the pose where its motor shall report zero. Then type zero",
            self.joint.name
        );
        let help = "A mark, a stop or a gauge. A zero at a stop can be repeated most exactly.";
        let (taken, _) = self.watch(&question, help, "zero", |seen| degrees(seen.last))?;
        if matches!(taken, Taken::Done) {
            // The joint may have moved since it was shown.
            let (stored, at) = (motor::stored_zero(&mut self.motor)?, zero::position(&mut self.motor)?);
            self.progress.change(&self.joint.name, |record| record.begin_zero(stored, at))?;
            self.set_zero()?;
        }
        Ok(taken)
    }

    /// Makes the present position zero, and checks it.
    pub(super) fn set_zero(&mut self) -> Result<(), Halt> {
        Ok(zero::set(&mut self.motor, 0.0).map(drop)?)
    }

    pub(super) fn direction(&mut self) -> Result<Taken, Halt> {
        let question = format!(
            "{}: turn the joint by hand in its positive direction (up, forward or left), by 10° or more, leave it there and press Enter",
            self.joint.name
        );
        let help = "For most controllers up, forward and left are positive.";
        let begin = zero::position(&mut self.motor)?;
        loop {
            let show = |seen: &Seen| format!("turned by {}", degrees(seen.last - begin));
            let (taken, seen) = self.watch(&question, help, "", show)?;
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
            self.print(&format!("the joint turned by {} only", degrees(turned)))?;
        }
    }

    pub(super) fn range(&mut self) -> Result<Taken, Halt> {
        let question = format!(
            "{}: move the joint by hand to one end and to the other, and press Enter. `keep` keeps the limits of the configuration",
            self.joint.name
        );
        let help = "The limits are written with a margin of 3°, or 5 % of a small range. motord keeps the joint within them.";
        let transmission = self.joint.transmission;
        let ends = move |seen: &Seen| {
            let [a, b] = [seen.low, seen.high].map(|end| to_joint(transmission, end));
            [a.min(b), a.max(b)]
        };
        loop {
            let show = |seen: &Seen| {
                let [low, high] = ends(seen).map(degrees);
                let now = degrees(to_joint(transmission, seen.last));
                format!("now at {now}, from {low} to {high}")
            };
            let (answer, seen) = self.watch_answer(&question, help, show)?;
            match answer {
                Answer::Back => return Ok(Taken::Back),
                Answer::Skip => return Ok(Taken::Skip),
                Answer::Text(text) if text == "keep" => return Ok(Taken::Done),
                Answer::Text(text) => self.print(&format!("`{text}` is no answer here"))?,
                Answer::Enter => {
                    let [low, high] = ends(&seen);
                    if high - low >= RANGE_MIN {
                        self.write_range(low, high)?;
                        return Ok(Taken::Done);
                    }
                    self.print(&format!("the joint moved by {} only", degrees(high - low)))?;
                }
            }
        }
    }

    fn write_range(&mut self, low: f64, high: f64) -> Result<(), Halt> {
        let margin = MARGIN_MAX.min(MARGIN_PART * (high - low));
        let range = format!("[{:.4}, {:.4}]", low + margin, high - margin);
        self.write(&[edit::POSITION], |values| drop(values.insert(edit::POSITION.to_owned(), range)))
    }
}
