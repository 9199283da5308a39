//! Transactions with an ODrive. No command is answered: what the drive sends by itself confirms them.

use super::frame::{AxisState, Command, Heartbeat, Reply, faults};
use crate::Faults;
use crate::cansimple::commissioning::{HEARTBEAT_MAX, confirm, of_node};
use crate::link::{Error, Link};
use core::f32::consts::TAU;
use motord_bus::Duration;

/// Longest time until an estimate: the factory sends one every 10 ms.
const ESTIMATES_MAX: Duration = Duration::from_millis(50);
/// Largest position after a zero, turns of the rotor.
const ZERO_TOLERANCE: f32 = 0.01;

/// An ODrive Pro, S1 or Micro.
pub struct Odrive<'l> {
    link: &'l mut Link,
    node: u8,
    gear_ratio: f32,
}

impl<'l> Odrive<'l> {
    /// Returns the drive with the id `node` on `link`, behind a gear of this ratio.
    pub fn new(link: &'l mut Link, node: u8, gear_ratio: f32) -> Self {
        Self { link, node, gear_ratio }
    }

    /// Returns position, rad, and velocity, rad/s, at the output. Sends nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`] from a drive that does not send its estimates by itself.
    pub fn estimates(&mut self) -> Result<[f32; 2], Error> {
        let estimates = self.receive(ESTIMATES_MAX, |reply| match reply {
            Reply::Estimates(estimates) => Some(estimates),
            _ => None,
        })?;
        let estimates = estimates.ok_or(self.silent("encoder estimates"))?;
        Ok(estimates.at_output(self.gear_ratio))
    }

    /// Returns the faults. Sends nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`] from a drive without a heartbeat.
    pub fn fault(&mut self) -> Result<Faults, Error> {
        self.heartbeat()?.map(|heartbeat| faults(heartbeat.errors)).ok_or(self.silent("heartbeat"))
    }

    /// Clears the errors. Only [`fault`](Self::fault) reports the result.
    ///
    /// # Errors
    ///
    /// [`Error::Bus`].
    pub fn clear_fault(&mut self) -> Result<(), Error> {
        self.send(Command::ClearErrors)?;
        self.link.pause(HEARTBEAT_MAX);
        Ok(())
    }

    /// Disables the axis, and confirms it by a heartbeat.
    ///
    /// # Errors
    ///
    /// [`Error::Silent`] when no heartbeat reports that the axis is idle.
    pub fn stop(&mut self) -> Result<(), Error> {
        let send = |drive: &mut Self| drive.send(Command::SetState(AxisState::Idle));
        let is_idle = |drive: &mut Self| Ok(drive.heartbeat()?.is_some_and(|beat| beat.state.is_idle()));
        if confirm(self, send, is_idle)? { Ok(()) } else { Err(self.silent("axis state idle")) }
    }

    /// Makes the present position zero until the power is lost. Only for a disabled motor.
    ///
    /// # Errors
    ///
    /// [`Error::Unconfirmed`] when the drive reports another position.
    pub fn set_zero(&mut self) -> Result<(), Error> {
        self.send(Command::SetZero)?;
        self.link.pause(self.link.timeout());
        let [position, _] = self.estimates()?;
        if (position * self.gear_ratio / TAU).abs() <= ZERO_TOLERANCE {
            return Ok(());
        }
        Err(Error::Unconfirmed { id: self.node, item: "zero", written: 0.0 })
    }

    fn heartbeat(&mut self) -> Result<Option<Heartbeat>, Error> {
        self.receive(HEARTBEAT_MAX, |reply| match reply {
            Reply::Heartbeat(heartbeat) => Some(heartbeat),
            _ => None,
        })
    }

    fn silent(&self, request: &'static str) -> Error {
        Error::Silent { id: self.node, request }
    }

    fn receive<T>(
        &mut self,
        time: Duration,
        mut read: impl FnMut(Reply) -> Option<T>,
    ) -> Result<Option<T>, Error> {
        let node = self.node;
        self.link.receive(time, |event| {
            of_node(&event, node).and_then(|(id, payload)| Reply::decode(id, payload)).and_then(&mut read)
        })
    }

    fn send(&mut self, command: Command) -> Result<(), Error> {
        let frame = command.frame(self.node).ok_or(self.silent("command"))?;
        self.link.ask_node(&frame, Duration::ZERO, |_| None::<()>).map(drop)
    }
}
