//! A motor that is stopped when its command ends, however it ends.

use motord_protocol::commissioning::{Error, Native};
use std::ops::{Deref, DerefMut};

/// A motor that can be stopped.
pub(crate) trait Stop {
    /// Stops the motor.
    fn stop(&mut self) -> Result<(), Error>;
}

impl Stop for Native<'_> {
    fn stop(&mut self) -> Result<(), Error> {
        Native::stop(self)
    }
}

/// Stops its motor when dropped: after every error, and in a panic.
///
/// Create it before the start is sent: a motor whose answer was lost may run.
pub(crate) struct StopOnDrop<M: Stop> {
    motor: M,
    is_stopped: bool,
}

impl<M: Stop> StopOnDrop<M> {
    /// Guards `motor`. Sends nothing.
    pub(crate) fn new(motor: M) -> Self {
        Self { motor, is_stopped: false }
    }

    /// Stops the motor now. Returns the error of an unconfirmed stop, which a drop only prints.
    pub(crate) fn stop(mut self) -> Result<(), Error> {
        self.is_stopped = true;
        self.motor.stop()
    }
}

impl<M: Stop> Drop for StopOnDrop<M> {
    fn drop(&mut self) {
        if !self.is_stopped
            && let Err(error) = self.motor.stop()
        {
            eprintln!("motorctl: the stop is not confirmed: cut the power of the motor: {error}");
        }
    }
}

impl<M: Stop> Deref for StopOnDrop<M> {
    type Target = M;

    fn deref(&self) -> &M {
        &self.motor
    }
}

impl<M: Stop> DerefMut for StopOnDrop<M> {
    fn deref_mut(&mut self) -> &mut M {
        &mut self.motor
    }
}
