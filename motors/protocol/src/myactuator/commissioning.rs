//! Transactions with a motor in MyActuator's protocol.

use super::frame::{Command, MotorStatus, Reply};
use crate::link::{Error, Link, LinkEvent, repeat};
use crate::mit::{ControlCodes, Impedance};
use crate::{Faults, Scales, StateCodes};
use motord_bus::{Duration, Frame, FrameId};

/// Longest time until a motor that restarts answers. No source gives one.
const RESTART: Duration = Duration::from_secs(5);
/// Largest angle after a zero, rad.
const ZERO_TOLERANCE: f32 = 0.01;

/// A motor in MyActuator's protocol, on CAN. No method sends an impedance except
/// [`start`](Self::start) and [`control`](Self::control).
pub struct Rmd<'l> {
    link: &'l mut Link,
    id: u8,
}

impl<'l> Rmd<'l> {
    /// Returns the motor `id` on `link`.
    pub fn new(link: &'l mut Link, id: u8) -> Self {
        Self { link, id }
    }

    /// Returns whether a driver of another family uses the id of the commands to this motor.
    pub(crate) fn is_owned(&self) -> bool {
        let command = self.frame(Command::GetStatus).id();
        self.link.unprompted().iter().any(|driver| driver.sends(command))
    }

    /// Returns the number of motors that answer the question for the status within `window`, and
    /// `true` if answers collided. Equal answers are one frame, so one answer is followed by the question
    /// for the angle, in which motors differ. Moves and changes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`], as for all following methods.
    pub(crate) fn answers(&mut self, window: Duration) -> Result<(usize, bool), Error> {
        let is_status = |reply: &Reply| matches!(reply, Reply::Status(_));
        let (count, collided) = self.count(Command::GetStatus, window, is_status)?;
        if count != 1 || collided {
            return Ok((count, collided));
        }
        let is_angle = |reply: &Reply| matches!(reply, Reply::Angle(_));
        let (angles, collided) = self.count(Command::GetAngle, window, is_angle)?;
        Ok((angles.max(1), collided))
    }

    /// Returns whether exactly one motor answers to this id. Moves and changes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`].
    pub fn is_alone(&mut self) -> Result<bool, Error> {
        Ok(self.answers(self.link.timeout())? == (1, false))
    }

    /// Sends `command`. Returns the number of its answers within `window`, and whether answers collided.
    fn count(
        &mut self,
        command: Command,
        window: Duration,
        is_answer: impl Fn(&Reply) -> bool,
    ) -> Result<(usize, bool), Error> {
        let (id, mut count, mut collided) = (self.id, 0, false);
        let _end = self.link.ask_frame(&self.frame(command), window, |event| {
            collided |= event == LinkEvent::Collision;
            count += usize::from(reply(&event, id).is_some_and(|reply| is_answer(&reply)));
            None::<()>
        })?;
        Ok((count, collided))
    }

    /// Returns temperature, voltage and errors. Moves and changes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`].
    pub fn status(&mut self) -> Result<MotorStatus, Error> {
        self.repeat("status 1 (9A)", Command::GetStatus, |reply| match reply {
            Reply::Status(status) => Some(status),
            _ => None,
        })
    }

    /// Returns the angle over any number of turns, rad. Moves and changes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`].
    pub fn angle(&mut self) -> Result<f32, Error> {
        self.repeat("angle (92)", Command::GetAngle, |reply| match reply {
            Reply::Angle(angle) => Some(angle),
            _ => None,
        })
    }

    /// Returns the date of the firmware, as the number YYYYMMDD.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`].
    pub fn version(&mut self) -> Result<u32, Error> {
        self.repeat("version date (B2)", Command::GetVersion, |reply| match reply {
            Reply::Version(version) => Some(version),
            _ => None,
        })
    }

    /// Returns the faults.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`].
    pub fn fault(&mut self) -> Result<Faults, Error> {
        Ok(self.status()?.faults())
    }

    /// Switches the drive off, which also clears its state. No source has a command that clears errors.
    /// Only [`fault`](Self::fault) reports the result.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`].
    pub fn clear_fault(&mut self) -> Result<(), Error> {
        self.stop()
    }

    /// Switches the drive off.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`].
    pub fn stop(&mut self) -> Result<(), Error> {
        self.confirm("shut down (80)", Command::Stop)
    }

    /// Asks for the status, and lets the motor run with a neutral impedance if it has no error. Returns
    /// its state.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`]; [`Error::Protocol`] for a motor with an error.
    pub fn start(&mut self, scales: &Scales) -> Result<StateCodes, Error> {
        if !self.fault()?.is_none() {
            let reason = "it reports a fault, so it is not started: read it with `motorctl fault get`";
            return Err(Error::Protocol { id: self.id, reason });
        }
        self.control(&Impedance::default(), scales)
    }

    /// Follows an impedance. The motor needs no enable. Returns the codes of the state.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`]; [`Error::Protocol`] where a value is not finite.
    pub fn control(&mut self, wanted: &Impedance, scales: &Scales) -> Result<StateCodes, Error> {
        let codes = ControlCodes::nearest(wanted, scales).map_err(|_| Error::not_finite(self.id))?;
        let state = self.ask(Command::Control(codes), |reply| match reply {
            Reply::State(state) => Some(state),
            _ => None,
        })?;
        state.ok_or(self.silent("motion mode"))
    }

    /// Stores the present position as zero, restarts the motor, and returns the angle after it. Only for
    /// a stopped motor.
    ///
    /// # Errors
    ///
    /// [`Error::Unconfirmed`] when the motor does not return, or reports another angle.
    pub fn set_zero(&mut self) -> Result<f32, Error> {
        self.confirm("zero (64)", Command::SetZero)?;
        let unconfirmed = Error::Unconfirmed { id: self.id, item: "zero", written: 0.0 };
        self.reset()?;
        if !self.returns()? {
            return Err(unconfirmed);
        }
        let after = self.angle()?;
        if after.abs() <= ZERO_TOLERANCE { Ok(after) } else { Err(unconfirmed) }
    }

    /// Gives the motor another id, restarts it, and finds it there. Only for a stopped motor.
    ///
    /// # Errors
    ///
    /// [`Error::Unconfirmed`] when no motor answers there.
    pub fn set_id(&mut self, id: u8) -> Result<(), Error> {
        self.confirm("id (20, 5)", Command::SetId(id))?;
        self.reset()?;
        self.id = id;
        let unconfirmed = Error::Unconfirmed { id, item: "id", written: id.into() };
        if self.returns()? { Ok(()) } else { Err(unconfirmed) }
    }

    /// Restarts the motor.
    fn reset(&mut self) -> Result<(), Error> {
        let _unanswered = self.ask(Command::Reset, |_| None::<()>)?;
        Ok(())
    }

    /// Asks for the status until the motor answers, or a restart would be over.
    fn returns(&mut self) -> Result<bool, Error> {
        let deadline = self.link.now() + RESTART;
        while self.link.now() < deadline {
            if self.answers(self.link.timeout())?.0 > 0 {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn silent(&self, request: &'static str) -> Error {
        Error::Silent { id: self.id, request }
    }

    /// Sends a command until the motor confirms it.
    fn confirm(&mut self, request: &'static str, command: Command) -> Result<(), Error> {
        self.repeat(request, command, |reply| (reply == Reply::Confirmed(command.number())).then_some(()))
    }

    /// Sends a command that may be repeated, until `read` returns a value.
    fn repeat<T>(
        &mut self,
        request: &'static str,
        command: Command,
        read: impl Fn(Reply) -> Option<T>,
    ) -> Result<T, Error> {
        repeat(|| self.ask(command, &read))?.ok_or(self.silent(request))
    }

    /// Sends `command`, and passes the frames of the motor to `read` until it returns a value.
    fn ask<T>(&mut self, command: Command, read: impl Fn(Reply) -> Option<T>) -> Result<Option<T>, Error> {
        let (id, frame) = (self.id, self.frame(command));
        self.link.ask_frame(&frame, self.link.timeout(), |event| reply(&event, id).and_then(&read))
    }

    fn frame(&self, command: Command) -> Frame {
        let (id, payload) = command.encode(self.id);
        Frame::classic(FrameId::new(id).unwrap_or(FrameId::MAX), payload)
    }
}

/// Returns the content of a frame from motor `id`.
fn reply(event: &LinkEvent, id: u8) -> Option<Reply> {
    let LinkEvent::Frame(frame) = event else { return None };
    let is_formed = !frame.id().is_extended() && frame.is_classic();
    Reply::decode(frame.id().raw(), frame.payload(), id).filter(|_| is_formed)
}
