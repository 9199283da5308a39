//! Transactions with a motor in RobStride's private protocol.

use super::family::HOST_ID;
use super::frame::{Command, Feedback, Id, Reply, faults_of_report};
use super::{ControlCodes, WideScales, parameter};
use crate::Faults;
use crate::link::{Asked, Error, Link, LinkEvent, repeat};
use motord_bus::{Duration, Frame, FrameId};

/// Time for which a motor may be silent while it writes its memory. No source gives one.
const STORE: Duration = Duration::from_millis(300);

/// A motor in its private protocol, on CAN.
pub struct Private<'l> {
    link: &'l mut Link,
    id: u8,
}

impl<'l> Private<'l> {
    /// Returns the motor `id` on `link`.
    pub fn new(link: &'l mut Link, id: u8) -> Self {
        Self { link, id }
    }

    /// Returns the serial numbers of all motors that answer to this id within `window`, and whether
    /// answers collided. Changes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`], as for all following methods.
    pub fn devices(&mut self, window: Duration) -> Result<(Vec<[u8; 8]>, bool), Error> {
        let (mut serials, mut collided) = (Vec::new(), false);
        let id = self.id;
        let _end = self.link.ask_frame(&self.frame(Command::GetDevice), window, |event| {
            match event {
                LinkEvent::Frame(frame) => {
                    serials.extend(match reply(&frame, id) {
                        Some(Reply::Device(serial)) => Some(serial),
                        _ => None,
                    });
                }
                LinkEvent::Collision => collided = true,
                LinkEvent::NotRead => {}
            }
            None::<()>
        })?;
        Ok((serials, collided))
    }

    /// Returns whether exactly one motor answers to this id. Changes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`].
    pub fn is_alone(&mut self) -> Result<bool, Error> {
        let (serials, collided) = self.devices(self.link.timeout())?;
        Ok(serials.len() == 1 && !collided)
    }

    /// Disables the drive, and reports the state.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`].
    pub fn stop(&mut self) -> Result<Feedback, Error> {
        self.state("stop", Command::Stop)
    }

    /// Enables the drive, and reports the state. The caller must have sent a neutral control frame
    /// before: no source excludes that a motor executes one that it stored.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`].
    pub fn start(&mut self) -> Result<Feedback, Error> {
        self.once("enable", Command::Enable)
    }

    /// Commands position, rad, velocity, rad/s, stiffness, N·m/rad, damping, N·m·s/rad, and torque,
    /// N·m, of a motor with these scales.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`]; [`Error::Protocol`] where a value is not finite.
    pub fn control(&mut self, values: [f32; 5], scales: &WideScales) -> Result<Feedback, Error> {
        let reason = "a value of the command is not a finite number";
        let codes = ControlCodes::nearest(values, scales).ok_or(Error::Protocol { id: self.id, reason })?;
        self.once("operation control", Command::Control(codes))
    }

    /// Returns the four numbers of the firmware's version; `None` from firmware that reports none.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`].
    pub fn version(&mut self) -> Result<Option<[u8; 4]>, Error> {
        self.repeat(Command::GetVersion, |reply| match reply {
            Reply::Version(version) => Some(version),
            _ => None,
        })
    }

    /// Disables the drive, and reports its faults: those in its state, and those of its fault
    /// register, where it has one.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`].
    pub fn fault(&mut self) -> Result<Faults, Error> {
        let in_state = self.stop()?.faults();
        let number = self.read(parameter::FAULTS)?.map_or(0, u32::from_le_bytes);
        Ok(in_state.and(faults_of_report(number)))
    }

    /// Disables the drive, and clears its faults. Only [`fault`](Self::fault) reports the result.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`].
    pub fn clear_fault(&mut self) -> Result<(), Error> {
        self.state("clear fault", Command::ClearFault).map(drop)
    }

    /// Makes the present position zero, stores it, and reports the state after it. Only for a
    /// disabled motor.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`].
    pub fn set_zero(&mut self) -> Result<Feedback, Error> {
        let _state = self.ask(Command::SetZero, STORE, |_| Some(()))?;
        let _answer = self.ask(Command::Save, STORE, |_| None::<()>)?;
        self.stop()
    }

    /// Returns the bytes of the parameter with this index, the lowest first; `None` where the motor
    /// refuses or does not answer.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`].
    pub fn read(&mut self, index: u16) -> Result<Option<[u8; 4]>, Error> {
        let value = self.repeat(Command::Read(index), |reply| match reply {
            Reply::Parameter(of, value) if of == index => Some(value),
            _ => None,
        })?;
        Ok(value.flatten())
    }

    /// Writes a parameter, reads it back, and stores all parameters. Only for a disabled motor.
    ///
    /// # Errors
    ///
    /// [`Error::Unconfirmed`] when the motor does not report the value.
    pub fn store(&mut self, item: &'static str, index: u16, value: u32) -> Result<(), Error> {
        let _state =
            self.ask(Command::Write(index, value.to_le_bytes()), self.link.timeout(), |_| Some(()))?;
        let unconfirmed = Error::Unconfirmed { id: self.id, item, written: value.into() };
        let is_kept = |read: Option<[u8; 4]>| read == Some(value.to_le_bytes());
        if !is_kept(self.read(index)?) {
            return Err(unconfirmed);
        }
        // No source states whether the motor answers: it may write its memory in silence.
        let _answer = self.ask(Command::Save, STORE, |_| None::<()>)?;
        if is_kept(self.read(index)?) { Ok(()) } else { Err(unconfirmed) }
    }

    /// Gives the motor another id, which takes effect immediately, and finds it there. Only for a
    /// disabled motor.
    ///
    /// # Errors
    ///
    /// [`Error::Unconfirmed`] when no motor answers there.
    pub fn set_id(&mut self, id: u8) -> Result<(), Error> {
        let _answer = self.ask(Command::SetId(id), STORE, |_| None::<()>)?;
        self.id = id;
        match self.devices(self.link.timeout())? {
            (serials, false) if serials.len() == 1 => Ok(()),
            _ => Err(Error::Unconfirmed { id, item: "id", written: id.into() }),
        }
    }

    /// Lets the motor speak MIT from its next power-on.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`] when it does not confirm the command.
    pub fn change_to_mit(&mut self) -> Result<(), Error> {
        let confirmed = self.ask(Command::SetProtocol(super::MIT), STORE, |reply| match reply {
            Reply::Device(_) => Some(()),
            _ => None,
        })?;
        confirmed.ok_or(Error::Silent { id: self.id, request: "protocol" })
    }

    fn state(&mut self, request: &'static str, command: Command) -> Result<Feedback, Error> {
        let state = self.repeat(command, feedback)?;
        state.ok_or(Error::Silent { id: self.id, request })
    }

    /// Sends a command once.
    fn once(&mut self, request: &'static str, command: Command) -> Result<Feedback, Error> {
        let state = self.ask(command, self.link.timeout(), feedback)?;
        state.ok_or(Error::Silent { id: self.id, request })
    }

    /// Sends a command that may be repeated, until `read` returns a value.
    fn repeat<T>(&mut self, command: Command, read: impl Fn(Reply) -> Option<T>) -> Asked<T> {
        repeat(|| self.ask(command, self.link.timeout(), &read))
    }

    /// Sends `command`, and passes the frames of the motor to `read` until it returns a value.
    fn ask<T>(&mut self, command: Command, time: Duration, read: impl Fn(Reply) -> Option<T>) -> Asked<T> {
        let id = self.id;
        self.link.ask_frame(&self.frame(command), time, |event| match event {
            LinkEvent::Frame(frame) => reply(&frame, id).and_then(&read),
            LinkEvent::NotRead | LinkEvent::Collision => None,
        })
    }

    fn frame(&self, command: Command) -> Frame {
        let (id, payload) = command.encode(self.id, HOST_ID);
        Frame::classic(FrameId::extended(id.raw()).unwrap_or(FrameId::MAX_EXTENDED), payload)
    }
}

const fn feedback(reply: Reply) -> Option<Feedback> {
    match reply {
        Reply::Feedback(feedback) => Some(feedback),
        _ => None,
    }
}

/// Returns the content of a frame from motor `id`.
fn reply(frame: &Frame, id: u8) -> Option<Reply> {
    let is_formed = frame.id().is_extended() && frame.is_classic();
    let (motor, reply) = Reply::decode(Id::of(frame.id().raw()), frame.payload()).filter(|_| is_formed)?;
    (motor == id).then_some(reply)
}
