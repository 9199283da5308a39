//! A process's view of the robot.

use crate::claim::Claim;
use crate::link::{ANSWER_TIMEOUT, Link, Subject};
use crate::{Error, State};
use motord_shared::description::{RobotDescription, Telemetry};
use motord_shared::instance::Attachment;
use motord_shared::message::ALL_GROUPS;
use motord_shared::ports::ClientPorts;
use motord_shared::service::ServiceError;
use motord_shared::{Instance, Operation};
use std::cell::{RefCell, RefMut};
use std::path::Path;
use std::rc::Rc;
use std::time::{Duration, Instant};

/// A connection to the daemon of one instance.
///
/// It is used on the thread that made it. Looking for a state neither allocates nor makes a system call, sending a
/// setpoint allocates once; a daemon that comes or goes costs up to a millisecond in the next call. Whatever asks the
/// daemon something waits for its answer, a cycle or two as a rule and a second at most.
#[derive(Debug)]
pub struct Client {
    link: Rc<RefCell<Link>>,
    robot: Rc<RobotDescription>,
    boot_id: u64,
}

impl Client {
    /// Connects to the daemon of `instance`, in the runtime directory that daemon and clients agree on. Takes some
    /// milliseconds.
    ///
    /// # Errors
    /// [`Error::NotRunning`], [`Error::Version`], [`Error::Permission`], and what a wrong name or directory gives.
    pub fn connect(instance: &str) -> Result<Self, Error> {
        Self::open(Instance::find(instance).map_err(Error::of_instance)?, ClientPorts::open)
    }

    /// Connects to the daemon of `instance` in the runtime directory `runtime`.
    ///
    /// # Errors
    /// Those of [`connect`](Self::connect).
    pub fn connect_in(runtime: &Path, instance: &str) -> Result<Self, Error> {
        Self::open(Instance::below(runtime, instance).map_err(Error::of_instance)?, ClientPorts::open)
    }

    /// Connects to the daemon of `instance` for [`emergency_stop`](Self::emergency_stop): there is a place for it however
    /// many others are connected. Whoever wants something else leaves this place free.
    ///
    /// # Errors
    /// Those of [`connect`](Self::connect).
    pub fn connect_to_stop(instance: &str) -> Result<Self, Error> {
        Self::open(Instance::find(instance).map_err(Error::of_instance)?, ClientPorts::open_to_stop)
    }

    fn open(
        instance: Instance,
        open: fn(Attachment) -> Result<ClientPorts, ServiceError>,
    ) -> Result<Self, Error> {
        let link = Link::open(instance, open)?;
        Ok(Self { robot: Rc::clone(&link.robot), boot_id: link.boot_id, link: Rc::new(RefCell::new(link)) })
    }

    /// Names and limits of joints, groups and buses. It changes only when a call returned [`Error::Restarted`].
    #[must_use]
    pub fn description(&self) -> &RobotDescription {
        &self.robot
    }

    /// The index of the joint `name`.
    #[must_use]
    pub fn joint(&self, name: &str) -> Option<usize> {
        self.robot.joints.iter().position(|joint| joint.name == name)
    }

    /// The index of the group `name`.
    #[must_use]
    pub fn group(&self, name: &str) -> Option<usize> {
        self.robot.groups.iter().position(|group| group.name == name)
    }

    /// The index of the joint `name`, as [`joint`](Self::joint).
    ///
    /// # Errors
    /// [`Error::UnknownJoint`], which names those that there are.
    pub fn joint_named(&self, name: &str) -> Result<usize, Error> {
        self.joint(name).ok_or_else(|| {
            let known = listed(self.robot.joints.iter().map(|joint| joint.name.as_str()));
            Error::UnknownJoint { name: name.to_owned(), known }
        })
    }

    /// The index of the group `name`, as [`group`](Self::group).
    ///
    /// # Errors
    /// [`Error::UnknownGroup`], which names those that there are.
    pub fn group_named(&self, name: &str) -> Result<usize, Error> {
        self.group(name).ok_or_else(|| {
            let known = listed(self.robot.groups.iter().map(|group| group.name.as_str()));
            Error::UnknownGroup { name: name.to_owned(), known }
        })
    }

    /// Sets how long states may stop before the daemon counts as [silent](Error::Silent) or gone; 50 ms, or five cycles
    /// when they take longer, unless set.
    pub fn set_silence(&mut self, silence: Duration) {
        self.link.borrow_mut().silence = silence;
    }

    /// The newest state, unless it was returned before. Does not wait.
    ///
    /// # Errors
    /// [`Error::Restarted`], once after each restart; else that the connection is damaged. That states stop is no error
    /// here: see [`State::age`].
    pub fn newest(&mut self) -> Result<Option<State>, Error> {
        Ok(self.polled()?.take_unseen())
    }

    /// Sleeps until there is a state that was not returned before. Costs the daemon a system call per cycle, and the
    /// caller a wake-up, some 50 µs: see [`spin`](Self::spin).
    ///
    /// # Errors
    /// [`Error::NotRunning`] or [`Error::Silent`] as soon as states have stopped for the silence time, again after
    /// `timeout` when called again in spite of it; [`Error::Timeout`]; those of [`newest`](Self::newest).
    pub fn wait(&mut self, timeout: Duration) -> Result<State, Error> {
        self.next(timeout, Link::sleep_until_cycle)
    }

    /// Like [`wait`](Self::wait), but keeps looking instead of sleeping: takes a processor core, and gives the state
    /// within a microsecond.
    ///
    /// # Errors
    /// Those of [`wait`](Self::wait).
    pub fn spin(&mut self, timeout: Duration) -> Result<State, Error> {
        self.next(timeout, |_, _| {
            std::hint::spin_loop();
            Ok(())
        })
    }

    fn next(
        &mut self,
        timeout: Duration,
        pause: impl Fn(&mut Link, Duration) -> Result<(), Error>,
    ) -> Result<State, Error> {
        let begun = Instant::now();
        loop {
            let mut link = self.polled()?;
            if let Some(state) = link.take_unseen() {
                return Ok(state);
            }
            let patience = link.patience(begun.elapsed(), timeout)?;
            pause(&mut link, patience)?;
        }
    }

    /// Becomes the owner of `group`, until the claim is released or dropped. One process can own several groups.
    ///
    /// # Errors
    /// [`Error::UnknownGroup`], [`Error::Refused`] naming the owner, and those of every request.
    pub fn claim(&mut self, group: &str) -> Result<Claim, Error> {
        let index = self.group_named(group)?;
        self.polled()?.check_alive()?;
        Claim::new(Rc::clone(&self.link), index)
    }

    /// Starts the motors of `group`, as an operator: its owner must be sending setpoints.
    ///
    /// # Errors
    /// [`Error::UnknownGroup`], [`Error::Refused`] with the reason, and those of every request: [`Error::Restarted`],
    /// [`Error::NotRunning`], [`Error::NoAnswer`].
    pub fn enable(&mut self, group: &str) -> Result<(), Error> {
        self.operate(Operation::Enable, group)
    }

    /// Damps and stops the motors of `group`, as an operator.
    ///
    /// # Errors
    /// Those of [`enable`](Self::enable).
    pub fn disable(&mut self, group: &str) -> Result<(), Error> {
        self.operate(Operation::Disable, group)
    }

    /// Takes back the latched cause of a stop of `group`, and the emergency stop.
    ///
    /// # Errors
    /// Those of [`enable`](Self::enable).
    pub fn reset(&mut self, group: &str) -> Result<(), Error> {
        self.operate(Operation::Reset, group)
    }

    /// Takes `group` from its owner.
    ///
    /// # Errors
    /// Those of [`enable`](Self::enable).
    pub fn force_release(&mut self, group: &str) -> Result<(), Error> {
        self.operate(Operation::ForceRelease, group)
    }

    /// Damps and stops every motor. It asks before it looks at anything else.
    ///
    /// # Errors
    /// [`Error::Refused`], [`Error::NotRunning`], [`Error::NoAnswer`].
    pub fn emergency_stop(&mut self) -> Result<(), Error> {
        let every_group = Subject { group: ALL_GROUPS as usize, ..Subject::default() };
        self.link.borrow().ask(Operation::EmergencyStop, every_group, ANSWER_TIMEOUT)?;
        Ok(())
    }

    /// Makes the present position of a stopped motor its zero.
    ///
    /// # Errors
    /// [`Error::UnknownJoint`], [`Error::Refused`] with the reason, and those of every request.
    pub fn set_zero(&mut self, joint: &str) -> Result<(), Error> {
        self.service(Operation::SetZero, joint)
    }

    /// Acknowledges a motor's fault.
    ///
    /// # Errors
    /// Those of [`set_zero`](Self::set_zero).
    pub fn clear_fault(&mut self, joint: &str) -> Result<(), Error> {
        self.service(Operation::ClearFault, joint)
    }

    /// Counters and latencies since the daemon started.
    ///
    /// # Errors
    /// Those of every request.
    pub fn telemetry(&mut self) -> Result<Telemetry, Error> {
        self.polled()?.read(Operation::Telemetry)
    }

    fn operate(&mut self, operation: Operation, group: &str) -> Result<(), Error> {
        self.ask(operation, Subject { group: self.group_named(group)?, ..Subject::default() })
    }

    fn service(&mut self, operation: Operation, joint: &str) -> Result<(), Error> {
        self.ask(operation, Subject { joint: self.joint_named(joint)?, ..Subject::default() })
    }

    /// Asks a daemon that is known to live: another one could give an index another meaning.
    fn ask(&mut self, operation: Operation, subject: Subject) -> Result<(), Error> {
        let link = self.polled()?;
        link.check_alive()?;
        link.ask(operation, subject, ANSWER_TIMEOUT)?;
        Ok(())
    }

    /// The link, after taking in what has arrived. An index from before a restart may name another joint after it, so
    /// that the restart is told before anything is asked for.
    fn polled(&mut self) -> Result<RefMut<'_, Link>, Error> {
        let mut link = self.link.borrow_mut();
        link.poll()?;
        if link.boot_id != self.boot_id {
            self.boot_id = link.boot_id;
            self.robot = Rc::clone(&link.robot);
            return Err(Error::Restarted);
        }
        Ok(link)
    }
}

fn listed<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<_> = names.collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}
