//! The joints whose motors answer.

use crate::error::Error;
use crate::link::Connection;
use motord_ports::clock;
use std::time::{Duration, Instant};

/// Time in which each motor must answer after a confirmed stop, and the same in cycles: lost
/// replies must not look like a lost motor.
const ANSWERS_MIN: Duration = Duration::from_millis(300);
const ANSWERS_CYCLES: u32 = 5;

/// Returns the error of a confirmed stop after which the answers of the motors are not known.
pub(crate) fn unchecked(reason: Error) -> Error {
    Error::MotorsUnchecked { reason: Box::new(reason) }
}

impl Connection {
    /// Checks that each motor answers, after a confirmed stop.
    ///
    /// # Errors
    /// [`Error::MotorsOffline`], [`Error::MotorsUnchecked`].
    pub(crate) fn check_answers(&self) -> Result<(), Error> {
        let most = ANSWERS_MIN.max(self.robot().period().saturating_mul(ANSWERS_CYCLES));
        let joints = self.offline_joints(None, most).map_err(unchecked)?;
        if joints.is_empty() { Ok(()) } else { Err(Error::MotorsOffline { joints }) }
    }

    /// Returns the joints of the group with this index, or of all groups, whose motors do not
    /// answer after this call, within `timeout`, without excluded joints. Returns as soon as all
    /// have answered. Takes no state from a thread that waits for one.
    ///
    /// # Errors
    /// [`Error::NotRunning`], [`Error::Silent`] and [`Error::Timeout`] when no state arrives.
    pub(crate) fn offline_joints(
        &self,
        group: Option<usize>,
        timeout: Duration,
    ) -> Result<Vec<String>, Error> {
        let (begun, asked_ns) = (Instant::now(), clock::now_ns());
        let mut offline = None;
        loop {
            let seen = self.published();
            offline = self.offline_since(asked_ns, group)?.or(offline);
            let left = timeout.saturating_sub(begun.elapsed());
            match offline {
                Some(joints) if joints.is_empty() || left.is_zero() => return Ok(joints),
                None if left.is_zero() => {
                    self.check_alive()?;
                    return Err(Error::Timeout { waited: timeout });
                }
                _ => self.sleep(seen, left)?,
            }
        }
    }

    /// Returns the joints whose motors have not answered after `asked_ns`, by the newest state;
    /// `None` for a state of before.
    fn offline_since(&self, asked_ns: u64, group: Option<usize>) -> Result<Option<Vec<String>>, Error> {
        let view = self.poll()?;
        let Some(state) = view.newest.as_ref().filter(|state| state.publish_ns() > asked_ns) else {
            return Ok(None);
        };
        let robot = self.robot();
        let members = group.and_then(|group| robot.groups.get(group)).map(|group| &group.joints);
        let has_answered = |index| {
            state.joint(index).is_some_and(|joint| joint.is_excluded() || joint.receive_ns > asked_ns)
        };
        let offline = robot.joints.iter().enumerate().filter(|(index, _)| {
            members.is_none_or(|members| members.contains(index)) && !has_answered(*index)
        });
        Ok(Some(offline.map(|(_, joint)| joint.name.clone()).collect()))
    }
}
