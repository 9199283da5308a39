//! Undoes the steps of a joint, the last one first.

use super::{JointGuide, Seen, Taken, degrees};
use crate::failure::DirectFailure;
use crate::guide::dialog::Halt;
use crate::guide::edit;
use crate::guide::progress::{Before, Step};
use crate::motor;
use crate::target::Protocol;
use crate::zero;
use motord_bus::FrameId;

impl JointGuide<'_, '_> {
    /// Undoes the last step that can be undone, or the zero that was begun. `false` when there is
    /// none.
    pub(super) fn undo(&mut self) -> Result<bool, Halt> {
        let record = self.record();
        let begun = record.before.zero_at.filter(|_| !record.has(Step::Zero)).map(|_| Step::Zero);
        for step in record.done.into_iter().chain(begun).rev() {
            if let Some(reason) = self.stays(step) {
                self.print(&format!("{}: {reason}", step.name()))?;
                if step == Step::Protocol {
                    continue;
                }
                return Ok(false);
            }
            if step == Step::Address && record.before.id.is_none() {
                self.unmark(step)?;
                return Ok(false);
            }
            if self.revert(step, &record.before)? {
                self.unmark(step)?;
                self.print(&format!("{}: undone", step.name()))?;
            }
            return Ok(true);
        }
        Ok(false)
    }

    /// Returns why a step cannot be undone.
    fn stays(&self, step: Step) -> Option<&'static str> {
        let is_mit = self.motor.protocol == Protocol::Mit;
        match step {
            Step::Protocol => Some("stays: over CAN it cannot be undone"),
            Step::BitRate if is_mit => Some("stays: in MIT mode it cannot be changed over CAN"),
            Step::Address if is_mit && !self.joint.profile.has_registers => {
                Some("stays: in MIT mode it cannot be changed over CAN")
            }
            _ => None,
        }
    }

    /// Restores what the step has replaced. `false`: it stays for another time.
    fn revert(&mut self, step: Step, before: &Before) -> Result<bool, Halt> {
        match (step, before.zero.filter(|_| self.motor.protocol == Protocol::Gim)) {
            (Step::Address, _) => {
                let host_id = before.host_id.and_then(FrameId::new);
                if let (Some(id), Some(host_id)) = (before.id, host_id) {
                    motor::set_address(&mut self.motor, id, host_id)?;
                }
            }
            (Step::BitRate, _) => {
                if let Some(rate) = before.bit_rate {
                    motor::set_bit_rate(&mut self.motor, rate)?;
                    self.unmark(step)?;
                    return self.leave_bus(rate).map(|_| true);
                }
            }
            (Step::Constants, _) => self.restore(&[edit::TORQUE_CONSTANT, edit::GEAR_RATIO], before)?,
            (Step::Direction, _) => self.restore(&[edit::DIRECTION], before)?,
            (Step::Range, _) => self.restore(&[edit::POSITION], before)?,
            (Step::Zero, Some(zero)) => motor::restore_zero(&mut self.motor, zero)?,
            (Step::Zero, None) => return self.restore_zero_by_hand(before.zero_at),
            (Step::Protocol | Step::Motion, _) => {}
        }
        self.differences = None;
        Ok(true)
    }

    /// A motor in MIT mode can only make its present position zero: the joint has to go where its
    /// zero was. `false`: the zero stays for another time.
    fn restore_zero_by_hand(&mut self, at: Option<f64>) -> Result<bool, Halt> {
        let Some(at) = at else { return Ok(true) };
        let question = format!(
            "{}: in MIT mode only its present position can become zero. Turn the joint until it reads 0.0°, and type zero; `s` keeps \
             the new zero and forgets the former one",
            self.joint.name
        );
        let show = |seen: &Seen| degrees(seen.last + at);
        loop {
            match self.watch(&question, "The former zero of the motor is there.", "zero", show)?.0 {
                Taken::Done => {}
                Taken::Back => return Ok(false),
                Taken::Skip => {
                    self.unmark(Step::Zero)?;
                    self.print("zero: the new one is kept")?;
                    return Ok(false);
                }
            }
            let off = zero::position(&mut self.motor)? + at;
            if off.abs() <= zero::TOLERANCE {
                self.set_zero()?;
                return Ok(true);
            }
            self.print(&format!("the joint is not there yet: it reads {}", degrees(off)))?;
        }
    }

    fn restore(&mut self, keys: &[&str], before: &Before) -> Result<(), Halt> {
        let mut values = before.file.clone();
        values.retain(|_, value| !value.is_empty());
        Ok(self.file.set(&self.joint.name, keys, &values)?)
    }

    fn unmark(&mut self, step: Step) -> Result<(), DirectFailure> {
        self.progress.change(&self.joint.name, |record| record.unmark(step))
    }
}
