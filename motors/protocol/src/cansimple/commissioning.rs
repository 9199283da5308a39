//! Transactions with a driver in the CANSimple dialect.

use super::Errors;
use super::frame::{AxisState, Command, Estimates, Heartbeat, Id, Reply, ReportedState};
use crate::link::{ATTEMPTS, Asked, Error, Link, LinkEvent, repeat};
use crate::mit::{ControlCodes, Impedance};
use crate::{Faults, Scales, StateCodes};
use motord_bus::{Duration, Frame, FrameId};

/// Longest time until a heartbeat: the factory sends one every 100 ms.
pub(crate) const HEARTBEAT_MAX: Duration = Duration::from_millis(350);
/// Longest time until an estimate: the factory sends one every 10 ms.
const ESTIMATES_MAX: Duration = Duration::from_millis(35);
/// Time in which a driver from the factory sends 20 estimates, and two of them 40.
const COUNTED: Duration = Duration::from_millis(200);
/// Most estimates of one driver in that time.
const ESTIMATES_OF_ONE: usize = 30;
/// Time in which a driver stores its configuration. Related firmware restarts after it.
const STORE: Duration = Duration::from_secs(2);
/// Largest position after a zero, turns of the rotor: 0.01 rad at the output of a gear of 8.
const ZERO_TOLERANCE: f32 = 0.0127;

/// A motor with a CANSimple driver.
pub struct Axis<'l> {
    link: &'l mut Link,
    node: u8,
}

impl<'l> Axis<'l> {
    /// Returns the driver with the id `node` on `link`.
    pub fn new(link: &'l mut Link, node: u8) -> Self {
        Self { link, node }
    }

    /// Returns whether the driver sends a heartbeat or answers the request for its estimates. Moves
    /// and changes nothing. Only for an id that no MIT motor may have: one reads the request as a
    /// control frame.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`], as for all following methods.
    pub fn is_there(&mut self) -> Result<bool, Error> {
        Ok(self.heartbeat()?.is_some() || self.ask_estimates()?.is_some())
    }

    /// Returns whether the driver sends no more estimates than one from the factory, and none that
    /// collide with those of another one. Sends nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`].
    pub fn is_alone(&mut self) -> Result<bool, Error> {
        let (node, mut estimates, mut collided) = (self.node, 0, false);
        let _end = self.link.receive(COUNTED, |event| {
            collided |= event == LinkEvent::Collision;
            estimates += usize::from(matches!(reply(&event, node), Some(Reply::Estimates(_))));
            None::<()>
        })?;
        Ok(estimates <= ESTIMATES_OF_ONE && !collided)
    }

    /// Returns the next heartbeat, if the driver sends one. Sends nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`].
    pub fn heartbeat(&mut self) -> Result<Option<Heartbeat>, Error> {
        let node = self.node;
        self.link.receive(HEARTBEAT_MAX, |event| match reply(&event, node) {
            Some(Reply::Heartbeat(heartbeat)) => Some(heartbeat),
            _ => None,
        })
    }

    /// Returns the estimates of the encoder, at the rotor.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`].
    pub fn estimates(&mut self) -> Result<Estimates, Error> {
        self.ask_estimates()?.ok_or(self.silent("encoder estimates"))
    }

    /// First awaits those that the driver sends by itself: a request at the same time has the same id,
    /// and destroys them.
    fn ask_estimates(&mut self) -> Result<Option<Estimates>, Error> {
        let node = self.node;
        let unprompted = self.link.receive(ESTIMATES_MAX, |event| match reply(&event, node) {
            Some(Reply::Estimates(estimates)) => Some(estimates),
            _ => None,
        })?;
        if unprompted.is_some() {
            return Ok(unprompted);
        }
        self.repeat(Command::GetEstimates, |reply| match reply {
            Reply::Estimates(estimates) => Some(estimates),
            _ => None,
        })
    }

    /// Returns voltage, V, and current, A, of the supply; `None` from a driver that does not answer.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`].
    pub fn supply(&mut self) -> Result<Option<[f32; 2]>, Error> {
        self.repeat(Command::GetBus, |reply| match reply {
            Reply::Bus { volts, amperes } => Some([volts, amperes]),
            _ => None,
        })
    }

    /// Returns the faults of axis, encoder and motor.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`] when the driver sends no heartbeat and does not report its errors.
    pub fn fault(&mut self) -> Result<Faults, Error> {
        let motor = self.repeat(Command::GetErrors, |reply| match reply {
            Reply::Errors(errors) => Some(errors),
            _ => None,
        })?;
        let heartbeat = self.heartbeat()?;
        if motor.is_none() && heartbeat.is_none() {
            return Err(self.silent("errors"));
        }
        let mut errors = Errors::default();
        heartbeat.into_iter().for_each(|heartbeat| errors.beat(heartbeat));
        motor.into_iter().for_each(|motor| errors.record_motor(motor));
        Ok(errors.faults())
    }

    /// Clears the errors. Only [`fault`](Self::fault) reports the result.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`].
    pub fn clear_fault(&mut self) -> Result<(), Error> {
        self.send(Command::ClearErrors)?;
        self.link.pause(self.link.timeout());
        Ok(())
    }

    /// Disables the axis, and confirms it by a heartbeat.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`] when no heartbeat reports that the axis is idle.
    pub fn stop(&mut self) -> Result<(), Error> {
        self.enter(AxisState::Idle, ReportedState::is_idle, "axis state idle")
    }

    /// Enables the axis with a neutral impedance, and confirms it by a heartbeat.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`] when no heartbeat reports the closed loop.
    pub fn start(&mut self, scales: &Scales) -> Result<(), Error> {
        self.send(Command::SetMode)?;
        let neutral = self.codes(&Impedance::default(), scales)?;
        self.send(Command::Control(neutral))?;
        self.enter(AxisState::ClosedLoop, ReportedState::is_running, "axis state closed loop")
    }

    fn enter(
        &mut self,
        state: AxisState,
        is_entered: impl Fn(ReportedState) -> bool,
        request: &'static str,
    ) -> Result<(), Error> {
        let send = |axis: &mut Self| axis.send(Command::SetState(state));
        let has_entered = |axis: &mut Self| Ok(axis.heartbeat()?.is_some_and(|beat| is_entered(beat.state)));
        if confirm(self, send, has_entered)? { Ok(()) } else { Err(self.silent(request)) }
    }

    /// Follows an impedance. Returns the codes of the state.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`]; [`Error::Protocol`] where a value is not finite.
    pub fn control(&mut self, wanted: &Impedance, scales: &Scales) -> Result<StateCodes, Error> {
        let codes = self.codes(wanted, scales)?;
        let state = self.ask(Command::Control(codes), self.link.timeout(), |reply| match reply {
            Reply::State(state) => Some(state),
            _ => None,
        })?;
        state.ok_or(self.silent("MIT control"))
    }

    fn codes(&self, wanted: &Impedance, scales: &Scales) -> Result<ControlCodes, Error> {
        ControlCodes::nearest(wanted, scales).map_err(|_| Error::not_finite(self.node))
    }

    /// Makes the present position zero, stores it, and returns the estimates after it. Only for a
    /// disabled motor.
    ///
    /// # Errors
    ///
    /// [`Error::Unconfirmed`] when the driver reports another position.
    pub fn set_zero(&mut self) -> Result<Estimates, Error> {
        self.send(Command::SetZero)?;
        self.link.pause(self.link.timeout());
        self.store()?;
        let after = self.estimates()?;
        if after.position.abs() <= ZERO_TOLERANCE {
            return Ok(after);
        }
        Err(Error::Unconfirmed { id: self.node, item: "zero", written: 0.0 })
    }

    /// Gives the driver another node id, finds it there, and stores its configuration. Only for a
    /// disabled motor, alone on the bus.
    ///
    /// # Errors
    ///
    /// [`Error::Unconfirmed`] when no driver is found there.
    pub fn set_node(&mut self, node: u8) -> Result<(), Error> {
        self.send(Command::SetNode(node))?;
        self.node = node;
        self.link.pause(self.link.timeout());
        if self.is_there()? {
            self.store()?;
            if self.is_there()? {
                return Ok(());
            }
        }
        Err(Error::Unconfirmed { id: node, item: "node id", written: node.into() })
    }

    /// Stores the configuration, and waits until the driver may have restarted.
    fn store(&mut self) -> Result<(), Error> {
        self.send(Command::Save)?;
        self.link.pause(STORE);
        Ok(())
    }

    fn silent(&self, request: &'static str) -> Error {
        Error::Silent { id: self.node, request }
    }

    /// Sends a command that is not answered.
    fn send(&mut self, command: Command) -> Result<(), Error> {
        self.ask(command, Duration::ZERO, |_| None::<()>).map(drop)
    }

    /// Sends a command that may be repeated, until `read` returns a value.
    fn repeat<T>(&mut self, command: Command, read: impl Fn(Reply) -> Option<T>) -> Asked<T> {
        repeat(|| self.ask(command, self.link.timeout(), &read))
    }

    /// Sends `command`, and passes the frames of the driver to `read` until it returns a value.
    fn ask<T>(&mut self, command: Command, time: Duration, read: impl Fn(Reply) -> Option<T>) -> Asked<T> {
        let (node, frame) = (self.node, frame(command.encode(self.node)));
        self.link.ask_node(&frame, time, |event| reply(&event, node).and_then(&read))
    }
}

/// Repeats a command that is not answered until a heartbeat confirms it. Returns whether one does.
///
/// # Errors
///
/// Those of the functions.
pub(crate) fn confirm<D>(
    drive: &mut D,
    send: impl Fn(&mut D) -> Result<(), Error>,
    is_confirmed: impl Fn(&mut D) -> Result<bool, Error>,
) -> Result<bool, Error> {
    for _ in 0..ATTEMPTS {
        send(drive)?;
        // The first heartbeat may be older than the command.
        for _ in 0..2 {
            if is_confirmed(drive)? {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

/// Returns a command as a frame.
pub(crate) fn frame((id, payload): (Id, [u8; 8])) -> Frame {
    Frame::classic(FrameId::new(id.raw()).unwrap_or(FrameId::MAX), payload)
}

/// Returns id and payload of a frame from `node`.
pub(crate) fn of_node(event: &LinkEvent, node: u8) -> Option<(Id, &[u8])> {
    let LinkEvent::Frame(frame) = event else { return None };
    let id = Id::of(frame.id().raw());
    let is_formed = !frame.id().is_extended() && frame.is_classic() && id.node == node;
    is_formed.then_some((id, frame.payload()))
}

/// Returns the content of a frame from `node`.
fn reply(event: &LinkEvent, node: u8) -> Option<Reply> {
    of_node(event, node).and_then(|(id, payload)| Reply::decode(id, payload))
}
