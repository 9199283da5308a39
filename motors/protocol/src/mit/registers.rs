//! The registers of a Damiao motor, one transaction at a time. Sources: as for [`register`].

use crate::link::Error;
use crate::link::{Link, LinkEvent};
use crate::register::{self, REQUEST_ID};
use motord_bus::{Duration, Frame, FrameId};

/// Requests of one register before it counts as unanswered.
const TRIES: usize = 2;
/// Time for which a motor may be silent while it stores its registers. The sources give none; it
/// writes a flash memory.
const STORE: Duration = Duration::from_millis(300);

/// The registers of the motor `id`, whose answers have the id `host_id`.
pub struct Registers<'l> {
    link: &'l mut Link,
    id: u8,
    host_id: FrameId,
}

impl<'l> Registers<'l> {
    /// Returns the registers of a motor on `link`.
    pub const fn new(link: &'l mut Link, id: u8, host_id: FrameId) -> Self {
        Self { link, id, host_id }
    }

    /// Reads `register`, which holds an integer or the bits of a float. `None` where the motor does
    /// not answer.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`] when the bus does not accept a frame.
    pub fn read(&mut self, register: u8) -> Result<Option<u32>, Error> {
        let (id, timeout) = (self.id, self.link.timeout());
        for _ in 0..TRIES {
            let request = register::read(id, register);
            let found = self.ask(request, timeout, |payload| register::number(id, register, payload))?;
            if found.is_some() {
                return Ok(found);
            }
        }
        Ok(None)
    }

    /// Gives the motor another id and reply id, reads both back at the new address, and stores them.
    /// Only for a disabled motor. No source states whether a new id takes effect before or after
    /// its answer, nor how a motor confirms that it stored, so only the values that are read back
    /// count: they last when the motor has them after its power was off.
    ///
    /// # Errors
    ///
    /// [`Error::Unconfirmed`] when the motor does not answer at its new address, [`Error::Bus`].
    pub fn set_address(&mut self, id: u8, host_id: FrameId) -> Result<(), Error> {
        self.change("MST_ID", register::REPLY_ID, host_id.raw(), |motor| motor.host_id = host_id)?;
        self.change("ESC_ID", register::ID, id.into(), |motor| motor.id = id)?;
        let _answer = self.ask(register::store(id), STORE, |_| None::<()>)?;
        self.check("ESC_ID", register::ID, id.into())
    }

    /// Writes a register that belongs to the address, follows the motor there, and reads it back.
    fn change(
        &mut self,
        item: &'static str,
        register: u8,
        value: u32,
        follow: impl FnOnce(&mut Self),
    ) -> Result<(), Error> {
        let timeout = self.link.timeout();
        let _answer = self.ask(register::write(self.id, register, value), timeout, |_| Some(()))?;
        follow(self);
        self.check(item, register, value)
    }

    /// Reads a register back.
    fn check(&mut self, item: &'static str, register: u8, value: u32) -> Result<(), Error> {
        match self.read(register)? {
            Some(read) if read == value => Ok(()),
            _ => Err(Error::Unconfirmed { id: self.id, item, written: value.into() }),
        }
    }

    /// Sends a request, and passes the answers of the motor to `read` until it returns a value.
    fn ask<T>(
        &mut self,
        request: [u8; 8],
        timeout: Duration,
        mut read: impl FnMut(&[u8]) -> Option<T>,
    ) -> Result<Option<T>, Error> {
        let Some(request_id) = FrameId::new(REQUEST_ID) else { return Ok(None) };
        let (request, host_id) = (Frame::classic(request_id, request), self.host_id);
        self.link.ask_frame(&request, timeout, |event| match event {
            LinkEvent::Frame(frame) if frame.id() == host_id => read(frame.payload()),
            _ => None,
        })
    }
}

/// Reads the largest position, velocity and torque that the codes of the Damiao motor `id` can
/// have, rad, rad/s and N·m. Its answers have the id `host_id`. `None` where the motor does not
/// answer, or answers with a number that is no end. The motor does not move.
///
/// # Errors
///
/// [`Error::Bus`] when the bus does not accept a frame.
pub fn ends(link: &mut Link, id: u8, host_id: FrameId) -> Result<Option<[f32; 3]>, Error> {
    let (mut ends, mut registers) = ([0.0; 3], Registers::new(link, id, host_id));
    for (end, register) in ends.iter_mut().zip(register::ENDS) {
        match registers.read(register)?.map(f32::from_bits).filter(|end| end.is_finite() && *end > 0.0) {
            Some(value) => *end = value,
            None => return Ok(None),
        }
    }
    Ok(Some(ends))
}
