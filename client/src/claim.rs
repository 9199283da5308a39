//! The ownership of a group of joints.

use crate::lateness::{Lateness, Sent};
use crate::link::{ANSWER_TIMEOUT, Connection, Subject};
use crate::members::{JointKey, Members, Slot};
use crate::state::Group;
use crate::{Error, Setpoint, State, Stop};
use motord_ports::{ForkGuard, SetpointPort, clock};
use motord_shared::description::{JointLimits, RobotDescription};
use motord_shared::{Cause, Lease, Operation, Phase, Refusal, SetpointMessage};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Longest time that dropping a claim takes. Without the message, the daemon detects the end by the
/// missing setpoints.
const RELEASE_TIMEOUT: Duration = Duration::from_millis(100);

/// Interval at which a setpoint is sent again until the daemon has read it: about a cycle.
const REPEAT_PERIOD: Duration = Duration::from_millis(1);

/// Ownership of a group. Dropping it releases the group; an active group is stopped. A claim
/// belongs to the process that created it and ends with it. In a forked process calls return
/// [`Error::Forked`], and dropping it does nothing.
///
/// [`set`](Self::set) and [`hold`](Self::hold) store setpoints by name; each stays until it is
/// replaced. [`commit`](Self::commit) sends the stored setpoints. [`send`](Self::send) stores and
/// sends a whole group, in its order.
#[derive(Debug)]
pub struct Claim {
    link: Arc<Connection>,
    port: ForkGuard<SetpointPort>,
    members: Arc<Members>,
    /// The stored setpoints. The sequence is 0 until the first message is sent.
    message: SetpointMessage,
    /// The joints with a setpoint, one bit each.
    set: u64,
    sent: Sent,
    /// The group was starting or active when this claim last sent.
    follows: bool,
    /// The lateness that stopped the group, as it was when the claim noticed the stop. `None` until
    /// this claim has enabled the group: a stop from before is not its own.
    lateness: Option<OnceLock<Option<Lateness>>>,
    released: bool,
}

impl Claim {
    /// Claims the group with this index of `robot`.
    pub(crate) fn new(link: Arc<Connection>, robot: &RobotDescription, index: usize) -> Result<Self, Error> {
        let port = link.setpoint_port()?;
        let subject = Subject { group: index, ..Subject::default() };
        let (reply, _) = link.ask(Operation::Claim, subject, ANSWER_TIMEOUT)?;
        let lease =
            Lease::from_raw(reply.lease).ok_or(Error::NotUnderstood { operation: Operation::Claim })?;
        let members = Members::new(robot, index, lease, link.newest_cycle()?);
        let joint_count = members.joints.len() as u32;
        Ok(Self {
            link,
            port,
            members: Arc::new(members),
            message: SetpointMessage { lease: lease.raw(), joint_count, ..SetpointMessage::default() },
            set: 0,
            sent: Sent::default(),
            follows: false,
            lateness: None,
            released: false,
        })
    }

    /// Name of the group.
    #[must_use]
    pub fn group(&self) -> &str {
        &self.members.name
    }

    /// Index of the group in the description.
    #[must_use]
    pub fn index(&self) -> usize {
        self.members.index
    }

    /// Returns the joints of the group, by index in the description. Setpoints have the same order.
    #[must_use]
    pub fn joints(&self) -> &[usize] {
        &self.members.joints
    }

    /// Returns the names of the joints of the group, in the same order.
    pub fn names(&self) -> impl ExactSizeIterator<Item = &str> {
        self.members.names.iter().map(String::as_str)
    }

    /// Returns the slot of the joint `name`: a key that saves the comparison of names in each
    /// cycle. It is valid for this claim only.
    ///
    /// # Errors
    /// [`Error::UnknownJoint`], which lists the joints of the group.
    pub fn slot(&self, name: &str) -> Result<Slot, Error> {
        self.members.slot(name)
    }

    /// Returns the slots of several joints, in the order of `names`.
    ///
    /// # Errors
    /// Those of [`slot`](Self::slot).
    pub fn slots<N: AsRef<str>>(&self, names: impl IntoIterator<Item = N>) -> Result<Vec<Slot>, Error> {
        names.into_iter().map(|name| self.slot(name.as_ref())).collect()
    }

    /// Returns the slots of all joints, in the order of `names`, such as that of a URDF or of a
    /// policy. Call it once, before the loop: it allocates.
    ///
    /// # Errors
    /// [`Error::UnknownJoint`]; [`Error::JointOrder`] naming a joint that `names` lacks or has
    /// twice.
    pub fn order<N: AsRef<str>>(&self, names: impl IntoIterator<Item = N>) -> Result<Vec<Slot>, Error> {
        let names: Vec<N> = names.into_iter().collect();
        self.members.order(names.iter().map(AsRef::as_ref))
    }

    /// Returns the limits of a joint.
    ///
    /// # Errors
    /// [`Error::UnknownJoint`], [`Error::OtherClaim`].
    pub fn limits(&self, joint: impl JointKey) -> Result<JointLimits, Error> {
        Ok(self.members.limits[joint.joint_index(&self.members)?])
    }

    /// Stores the setpoint of a joint, for [`commit`](Self::commit) to send. It stays until it is
    /// replaced. Neither allocates nor waits.
    ///
    /// # Errors
    /// [`Error::UnknownJoint`], which lists the joints of the group; [`Error::OtherClaim`];
    /// [`Error::BadSetpoint`] for a value that is not finite or a negative gain. The previous
    /// setpoint remains after an error.
    pub fn set(&mut self, joint: impl JointKey, setpoint: Setpoint) -> Result<(), Error> {
        self.link.check_process()?;
        let index = joint.joint_index(&self.members)?;
        self.put(index, self.members.checked(index, setpoint)?);
        Ok(())
    }

    /// Returns the stored setpoint of a joint; all zero before the first.
    ///
    /// # Errors
    /// [`Error::UnknownJoint`], [`Error::OtherClaim`].
    pub fn setpoint(&self, joint: impl JointKey) -> Result<Setpoint, Error> {
        Ok(Setpoint::from(&self.message.joints[joint.joint_index(&self.members)?]))
    }

    /// Stores for each joint the setpoint that holds its position in `state`, with the stiffness
    /// `kp`, N·m/rad, and the damping `kd`, N·m·s/rad. An [excluded](crate::Joint::is_excluded)
    /// joint gets zero torque.
    ///
    /// # Errors
    /// [`Error::NotHeard`] naming a joint whose motor has not reported its position;
    /// [`Error::BadSetpoint`] for a gain that is not finite or negative; [`Error::Restarted`] for a
    /// state of another daemon. No setpoint changes after an error.
    pub fn hold(&mut self, state: &State, kp: f32, kd: f32) -> Result<(), Error> {
        self.link.check_process()?;
        let members = Arc::clone(&self.members);
        if state.boot_id() != members.boot_id {
            return Err(Error::Restarted);
        }
        let hold = |index: usize| {
            let joint = state.joint(members.joints[index]);
            if joint.is_some_and(|joint| joint.is_excluded()) {
                return Ok(Setpoint::torque(0.0));
            }
            let position = joint.and_then(|joint| joint.position());
            let unreported = || Error::NotHeard { joint: members.names[index].clone() };
            members.checked(index, Setpoint::hold(position.ok_or_else(unreported)?, kp, kd))
        };
        for index in 0..members.joints.len() {
            hold(index)?;
        }
        for index in 0..members.joints.len() {
            self.put(index, hold(index)?);
        }
        Ok(())
    }

    /// Sets the horizon of the setpoints that are sent from now on: the daemon moves position,
    /// velocity and torque linearly from the present command to the setpoint within this time after
    /// it was sent, inside all limits. Zero, the initial value, applies setpoints immediately. The
    /// setpoint timeout begins at the end of the horizon.
    ///
    /// For a controller slower than the cycle, such as a policy at 50 Hz: for even motion, set the
    /// horizon to its period plus the largest lateness of its setpoints. Setpoints sent while the
    /// group is not active have none.
    ///
    /// # Errors
    /// [`Error::HorizonTooLong`]; the horizon stays as it was.
    pub fn set_horizon(&mut self, horizon: Duration) -> Result<(), Error> {
        self.link.check_process()?;
        let most = self.members.horizon_max;
        let nanos = u32::try_from(horizon.as_nanos()).ok().filter(|_| horizon <= most);
        self.message.horizon_ns = nanos.ok_or(Error::HorizonTooLong { horizon, most })?;
        Ok(())
    }

    /// Sends the [stored](Self::set) setpoints. Call it in every cycle of the controller, even if
    /// nothing changed: the daemon stops a group when its owner sends nothing for the setpoint
    /// timeout.
    ///
    /// After a stop of the active group the setpoints are sent nevertheless: they keep a claim that
    /// the stop did not end, until a person has reset the group. The daemon does not follow them.
    ///
    /// # Errors
    /// [`Error::NotSet`] naming a joint without a setpoint; those of [`send`](Self::send).
    pub fn commit(&mut self) -> Result<(), Error> {
        self.link.check_process()?;
        if let Some(index) = (0..self.members.joints.len()).find(|index| self.set >> index & 1 == 0) {
            return Err(Error::NotSet { joint: self.members.names[index].clone() });
        }
        self.check_daemon()?;
        self.message.cycle = self.link.answered();
        self.transmit_checked()
    }

    /// Sends the stored setpoints again, as [`commit`](Self::commit) does, but as the answer to no
    /// state: for a program that computes nothing at present. A program that repeats setpoints in a
    /// separate thread removes the setpoint timeout from itself: bound the time.
    ///
    /// # Errors
    /// Those of [`send`](Self::send).
    pub fn repeat(&mut self) -> Result<(), Error> {
        self.link.check_process()?;
        self.check_daemon()?;
        self.transmit_checked()
    }

    /// Transmits, then checks daemon and group: polling for states takes time, and the setpoint
    /// does not wait for it.
    fn transmit_checked(&mut self) -> Result<(), Error> {
        self.transmit()?;
        self.refresh()?;
        self.link.check_alive_at(self.message.time_ns)?;
        self.check_stop()
    }

    /// Sends one setpoint per joint. The newest setpoint replaces one that the daemon has not read.
    /// Does not wait. The counters and `applied` of the next states report whether the daemon
    /// accepted it.
    ///
    /// # Errors
    /// [`Error::SetpointCount`]; [`Error::BadSetpoint`] naming a joint with a value that is not
    /// finite or a negative gain: then nothing is stored or sent. [`Error::Stopped`] with each call
    /// after a stop of the group that this claim had started, until a reset; [`Error::ClaimLost`].
    /// [`Error::Restarted`] with each call after a restart; [`Error::NotRunning`] or
    /// [`Error::Silent`] when no states arrive. The setpoints may have been sent nevertheless; the
    /// daemon does not use them.
    pub fn send(&mut self, setpoints: &[Setpoint]) -> Result<(), Error> {
        self.link.check_process()?;
        let (expected, received) = (self.members.joints.len(), setpoints.len());
        if expected != received {
            return Err(Error::SetpointCount { expected, received });
        }
        for (index, setpoint) in setpoints.iter().enumerate() {
            self.members.checked(index, *setpoint)?;
        }
        setpoints.iter().enumerate().for_each(|(index, setpoint)| self.put(index, *setpoint));
        self.commit()
    }

    /// Starts the motors of the group towards the last setpoints sent, which must be near the
    /// positions of the joints. Repeats them until the daemon answers, within a few cycles.
    /// Afterwards the caller must continue to send, or [wait for](Self::wait_for)
    /// [`Phase::Active`].
    ///
    /// # Errors
    /// [`Error::Refused`] with the reason, [`Error::Restarted`], [`Error::NotRunning`],
    /// [`Error::Silent`], [`Error::NoAnswer`].
    pub fn enable(&mut self) -> Result<(), Error> {
        // The daemon reads requests and setpoints at different times of a cycle: it could read the
        // request first.
        let (begun, before) = (Instant::now(), self.message.sequence);
        while before > 0 && !self.is_accepted_after(before)? && begun.elapsed() < ANSWER_TIMEOUT {
            self.transmit()?;
            std::thread::sleep(REPEAT_PERIOD);
        }
        self.ready()?;
        let link = Arc::clone(&self.link);
        link.ask_while(Operation::Enable, self.subject(), ANSWER_TIMEOUT, || match before {
            0 => Ok(()),
            _ => self.transmit(),
        })?;
        self.lateness = Some(OnceLock::new());
        Ok(())
    }

    /// Sleeps until the group is in `phase` or past it, and repeats the last setpoints in each
    /// cycle. Call it after [`enable`](Self::enable) with [`Phase::Active`]. Call it after
    /// [`disable`](Self::disable) and before [`reset`](Self::reset) with [`Phase::Disarmed`].
    /// States published before the call do not count.
    ///
    /// With [`Phase::Active`] the last setpoints have the longest [horizon](Self::set_horizon), so
    /// that the loop of a slow controller may begin a period later: see
    /// [`keep_for`](Self::keep_for).
    ///
    /// # Errors
    /// [`Error::Stopped`] immediately when the group is stopped while it should start;
    /// [`Error::NotReached`] after `timeout`; [`Error::Restarted`], [`Error::NotRunning`],
    /// [`Error::Silent`].
    pub fn wait_for(&mut self, phase: Phase, timeout: Duration) -> Result<(), Error> {
        let link = Arc::clone(&self.link);
        let reached = link.wait_for(self.members.index, phase, timeout, || {
            self.ready()?;
            if self.message.sequence > 0 { self.transmit() } else { Ok(()) }
        });
        reached.map_err(|error| match error {
            Error::Stopped { group, stop } => Error::Stopped { group, stop: self.with_lateness(stop) },
            other => other,
        })?;
        if phase == Phase::Active {
            self.follows = true;
            self.keep_for(Duration::MAX)?;
        }
        Ok(())
    }

    /// Sends the last setpoints again if the daemon would stop the group for their age within
    /// `time`. They get the horizon that `time` needs, as far as `setpoint-horizon-max-ms` permits.
    /// Call it before a pause, such as the one between a loop in every cycle and the first state of
    /// a slow loop: a controller that hangs in the pause is stopped as much later. Does nothing
    /// while the group does not follow this claim.
    ///
    /// # Errors
    /// [`Error::Restarted`], [`Error::NotRunning`], [`Error::Silent`].
    pub fn keep_for(&mut self, time: Duration) -> Result<(), Error> {
        self.ready()?;
        let Members { timeout, horizon_max, .. } = *self.members;
        if !self.follows || self.message.sequence == 0 || self.sent.lasts(clock::now_ns(), timeout) >= time {
            return Ok(());
        }
        let horizon = time.saturating_sub(timeout).min(horizon_max);
        let horizon_ns = u32::try_from(horizon.as_nanos()).unwrap_or(u32::MAX);
        let own = std::mem::replace(&mut self.message.horizon_ns, horizon_ns);
        let sent = self.transmit();
        self.message.horizon_ns = own;
        sent
    }

    /// Damps and stops the motors of the group. They are stopped when the group is
    /// [`Phase::Disarmed`].
    ///
    /// # Errors
    /// Those of [`enable`](Self::enable).
    pub fn disable(&mut self) -> Result<(), Error> {
        self.operate(Operation::Disable)
    }

    /// Clears the latched cause of a stop. The group must be [`Phase::Disarmed`]. A controller
    /// should leave this to a person who has inspected the robot.
    ///
    /// # Errors
    /// Those of [`enable`](Self::enable).
    pub fn reset(&mut self) -> Result<(), Error> {
        self.operate(Operation::Reset)?;
        self.follows = false;
        Ok(())
    }

    /// Releases the group, if the claim still owns it.
    ///
    /// # Errors
    /// Those of [`enable`](Self::enable). The claim ends in any case.
    pub fn release(mut self) -> Result<(), Error> {
        self.released = true;
        match self.operate(Operation::Release) {
            Err(Error::Refused { refusal: Refusal::NotOwner, .. }) => Ok(()),
            released => released,
        }
    }

    /// Returns the group, shared by the claim and its [`GroupView`](crate::GroupView)s.
    pub(crate) fn members(&self) -> &Arc<Members> {
        &self.members
    }

    fn put(&mut self, index: usize, setpoint: Setpoint) {
        self.message.joints[index] = setpoint.into();
        self.set |= 1 << index;
    }

    /// Sends the message with the next sequence number and the current time.
    fn transmit(&mut self) -> Result<(), Error> {
        let port = self.port.get()?;
        self.message.sequence += 1;
        self.message.time_ns = clock::now_ns();
        self.sent.record(self.message.time_ns, self.message.horizon_ns);
        let sent = port.send(&self.message);
        // A repeated message answers no state.
        self.message.cycle = 0;
        sent.map_err(|error| Error::of_service(error, self.link.instance()))
    }

    /// Fails once the newest state shows that the daemon does not follow the setpoints of this
    /// claim any more. Does not allocate while it succeeds.
    fn check_stop(&mut self) -> Result<(), Error> {
        let Some(group) = self.link.try_group(self.members.index, self.members.since) else { return Ok(()) };
        if group.lease != Some(self.members.lease) {
            return Err(self.end(&group));
        }
        match group.latched {
            true if self.follows => Err(self.stopped(&group)),
            true => Ok(()),
            false => {
                self.follows = matches!(group.phase, Some(Phase::Starting | Phase::Active));
                Ok(())
            }
        }
    }

    /// Returns the reason why `group` does not belong to this claim any more: a stop, which a new
    /// claim does not end, or another owner.
    pub(crate) fn end(&self, group: &Group) -> Error {
        if self.follows && group.latched {
            self.stopped(group)
        } else {
            Error::ClaimLost { group: self.members.name.clone() }
        }
    }

    fn stopped(&self, group: &Group) -> Error {
        let stop = Stop::of(group, group.cause_joint.and_then(|joint| self.members.name_of(joint)));
        Error::Stopped { group: self.members.name.clone(), stop: self.with_lateness(stop) }
    }

    /// Adds to the stop of this claim for `setpoint-timeout` how late it was.
    fn with_lateness(&self, stop: Stop) -> Stop {
        let measured = || self.sent.lateness(clock::now_ns(), self.members.timeout);
        match (stop, &self.lateness) {
            (Stop::Cause { cause: cause @ Cause::SetpointTimeout, joint, pid, .. }, Some(lateness)) => {
                Stop::Cause { cause, joint, pid, lateness: *lateness.get_or_init(measured) }
            }
            (other, _) => other,
        }
    }

    /// Returns `true` if the daemon has accepted a setpoint of this claim sent after the one with
    /// sequence `before`.
    fn is_accepted_after(&self, before: u64) -> Result<bool, Error> {
        self.ready()?;
        let group = self.link.try_group(self.members.index, 0);
        Ok(group.is_some_and(|group| group.lease == Some(self.members.lease) && group.sequence > before))
    }

    fn operate(&self, operation: Operation) -> Result<(), Error> {
        self.ready()?;
        self.link.ask(operation, self.subject(), ANSWER_TIMEOUT)?;
        Ok(())
    }

    fn subject(&self) -> Subject {
        Subject { lease: Some(self.members.lease), group: self.members.index, ..Subject::default() }
    }

    /// Checks that the daemon that granted the claim is running.
    fn ready(&self) -> Result<(), Error> {
        self.refresh()?;
        self.link.check_alive()
    }

    /// Processes the states that have arrived, and checks that they come from the daemon that
    /// granted the claim.
    fn refresh(&self) -> Result<(), Error> {
        self.link.refresh()?;
        self.check_daemon()
    }

    /// Checks that the newest known daemon is the one that granted the claim.
    fn check_daemon(&self) -> Result<(), Error> {
        if self.link.boot_id() == self.members.boot_id { Ok(()) } else { Err(Error::Restarted) }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        let is_foreign = self.link.check_process().is_err();
        if is_foreign || self.released || self.link.check_alive().is_err() {
            return;
        }
        // The daemon stops the group at the setpoint timeout if it does not receive this request.
        let _ = self.link.ask(Operation::Release, self.subject(), RELEASE_TIMEOUT);
    }
}
