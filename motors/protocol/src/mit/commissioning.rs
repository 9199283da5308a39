//! The MIT commands, with types. Source: MIT document, and those of the profiles.

use crate::link::{ATTEMPTS, Error, Link, LinkEvent};
use crate::mit::{Asked, Command, Impedance, Reply, State};
use crate::profile::STEADYWIN;
use crate::{Faults, Profile, Scales, register};
use motord_bus::{Duration, FrameId};

/// Relatives of these motors do not reply for 1 to 1.5 s after set zero, while they write their
/// flash memory.
const ZEROING_MAX: Duration = Duration::from_secs(3);

/// A motor in MIT mode, on CAN.
pub struct Mit<'l> {
    link: &'l mut Link,
    id: u8,
    host_id: Option<FrameId>,
    profile: &'static Profile,
    scales: Scales,
}

impl<'l> Mit<'l> {
    /// Returns SteadyWin's motor `id` on `link`. Without `host_id` an answer may have any id.
    pub fn new(link: &'l mut Link, id: u8, host_id: Option<FrameId>, scales: Scales) -> Self {
        Self { link, id, host_id, profile: &STEADYWIN, scales }
    }

    /// Returns the same motor with another vendor's profile.
    #[must_use]
    pub fn with_profile(self, profile: &'static Profile) -> Self {
        Self { profile, ..self }
    }

    /// Leaves the running state, and reports the motion.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`] or [`Error::Bus`], as for all following methods.
    pub fn stop(&mut self) -> Result<State, Error> {
        self.state("stop", &Command::Stop, ATTEMPTS)
    }

    /// Enters the running state. The caller must have sent neutral control frames before: a
    /// relative of these motors executes the last one that it stored.
    pub fn start(&mut self) -> Result<State, Error> {
        self.state("start", &Command::Start, 1)
    }

    /// Commands the setpoint `impedance`.
    pub fn control(&mut self, impedance: Impedance) -> Result<State, Error> {
        self.state("dynamic control", &Command::Control(impedance), 1)
    }

    /// Makes the present position zero, and waits until the motor reports again, normally at zero.
    /// Only for a stopped motor.
    pub fn set_zero(&mut self) -> Result<State, Error> {
        let _answer = self.ask(&Command::SetZero, Asked::State)?;
        let deadline = self.link.now() + ZEROING_MAX;
        loop {
            match self.stop() {
                Err(Error::Silent { .. }) if self.link.now() < deadline => {}
                state => return state,
            }
        }
    }

    /// Lets a RobStride motor speak its private protocol from its next power-on. Only for such a
    /// motor, and disabled: another vendor's reads the request as a control frame of full stiffness.
    /// The motor answers with its serial number, under its own id.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`] when it does not confirm the command.
    pub fn change_to_private(&mut self) -> Result<(), Error> {
        /// F_CMD 0 is the private protocol (RobStride's manuals, MIT command 8).
        const REQUEST: [u8; 8] = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x00, 0xFD];
        let (id, timeout) = (self.id, self.link.timeout() * 4);
        let confirmed = self.link.ask(id, REQUEST, timeout, |event| match event {
            LinkEvent::Frame(frame) if frame.id().byte() == Some(id) => Some(()),
            _ => None,
        })?;
        confirmed.ok_or_else(|| self.silent("protocol"))
    }

    /// Reads the faults of the motor. An answer that may be a late state counts when it is
    /// repeated. Only for motors that are known to support the request: others read it as a control
    /// frame of full stiffness.
    pub fn fault(&mut self) -> Result<Faults, Error> {
        if !self.profile.is_asked_for_faults() {
            let state = self.stop()?;
            return Ok(self.profile.faults_of(&state).unwrap_or(Faults::NONE));
        }
        let mut ambiguous = None;
        for _ in 0..ATTEMPTS {
            let Some((faults, is_certain)) = self.fault_answer()? else { continue };
            if is_certain || ambiguous == Some(faults) {
                return Ok(faults);
            }
            // Another late state, or the report behind it, must not answer the next request.
            ambiguous = Some(faults);
            self.link.pause(self.link.timeout());
        }
        Err(self.silent("get fault"))
    }

    /// Asks for the faults once. The second value is false when the answer may be a late state.
    fn fault_answer(&mut self) -> Result<Option<(Faults, bool)>, Error> {
        let (profile, scales) = (self.profile, self.scales);
        self.ask_payload(&Command::GetFault, |payload| match profile.decode(payload, Asked::Fault, &scales) {
            Ok(Reply::Fault { faults, .. }) => Some((faults, profile.is_fault_report(payload))),
            _ => None,
        })
    }

    /// Clears the fault. Only [`fault`](Self::fault) reports the result.
    pub fn clear_fault(&mut self) -> Result<(), Error> {
        match self.ask(&Command::ClearFault, Asked::Clear)? {
            Some(_) => Ok(()),
            None => Err(self.silent("clear fault")),
        }
    }

    fn state(&mut self, name: &'static str, command: &Command, attempts: usize) -> Result<State, Error> {
        for _ in 0..attempts {
            if let Some(Reply::State(state)) = self.ask(command, Asked::State)? {
                return Ok(state);
            }
        }
        Err(self.silent(name))
    }

    fn ask(&mut self, command: &Command, asked: Asked) -> Result<Option<Reply>, Error> {
        let (id, profile, scales) = (self.id, self.profile, self.scales);
        // A late report or the answer for a register is no state.
        let is_other = move |payload: &[u8]| {
            profile.is_fault_report(payload) || profile.has_registers && register::is_answer(id, payload)
        };
        self.ask_payload(command, |payload| {
            let fits = asked != Asked::State || !is_other(payload);
            fits.then(|| profile.decode(payload, asked, &scales).ok()).flatten()
        })
    }

    /// Sends `command`, and passes the answers of the motor to `read` until it returns a value.
    fn ask_payload<T>(
        &mut self,
        command: &Command,
        mut read: impl FnMut(&[u8]) -> Option<T>,
    ) -> Result<Option<T>, Error> {
        let payload = self.profile.encode(command, &self.scales);
        let payload = payload.map_err(|_| Error::not_finite(self.id))?;
        let (id, host_id, profile) = (self.id, self.host_id, self.profile);
        let timeout = self.link.timeout();
        self.link.ask(id, payload, timeout, |event| match event {
            LinkEvent::Frame(frame) if host_id.is_none_or(|host_id| host_id == frame.id()) => {
                let payload = frame.payload();
                if profile.is_from(id, payload) { read(payload) } else { None }
            }
            LinkEvent::Frame(_) | LinkEvent::NotRead | LinkEvent::Collision => None,
        })
    }

    fn silent(&self, request: &'static str) -> Error {
        Error::Silent { id: self.id, request }
    }
}
