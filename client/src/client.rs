//! A connection to a daemon: states, claims and requests.

use crate::claim::Claim;
use crate::link::{ANSWER_TIMEOUT, Connection, Subject, locked};
use crate::publisher::{ImuPublisher, imu_of};
use crate::records::Records;
use crate::stop::{SOCKET_TIMEOUT, SocketStop, stop_and_check};
use crate::view::View;
use crate::{Error, State};
use motord_ports::instance::Attachment;
use motord_ports::service::ServiceError;
use motord_ports::stop_socket::StopError;
use motord_ports::stop_source::StopSource;
use motord_ports::{ClientPorts, Instance};
use motord_shared::description::{Histograms, RobotDescription, Telemetry};
use motord_shared::limits::HISTOGRAMS_MAX;
use motord_shared::message::ALL_GROUPS;
use motord_shared::{Operation, Phase};
use std::os::fd::BorrowedFd;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// The timer of [`Client::wait_cycles`] ends this long before the state is due. Timers are less
/// late on most computers.
const EARLY_MAX: Duration = Duration::from_micros(200);
/// With short cycles it ends at most a cycle divided by this number before.
const EARLY_SHARE: u32 = 4;
/// Number of checks for a state between two readings of the clock by a spinning thread: some
/// microseconds.
const GLANCES: u32 = 32;

/// Limit on requests for all histograms: twice their number, since another client may reset them
/// meanwhile.
const HISTOGRAM_PAGES_MAX: usize = 2 * HISTOGRAMS_MAX;

/// A connection to the daemon of one instance.
///
/// Threads may share it: see the [threads](crate#threads) of the crate. Reading the newest state
/// neither allocates nor makes a system call. Sending a setpoint allocates nothing. After a daemon
/// starts or ends, the next call takes up to a millisecond. A request waits for its answer: usually
/// a cycle or two, at most a second.
#[derive(Debug)]
pub struct Client {
    link: Arc<Connection>,
    /// The robot that the caller knows. It differs from the robot of `link` from a restart until a
    /// call reports it.
    robot: Mutex<Arc<RobotDescription>>,
    /// The robot at the connection, for a forked process: a thread that does not exist there may
    /// hold the lock of `robot`.
    first: Arc<RobotDescription>,
}

impl Client {
    /// Connects to the daemon of `instance`, in the runtime directory that daemon and clients agree
    /// on. Takes some milliseconds.
    ///
    /// # Errors
    /// [`Error::NotRunning`], [`Error::Version`], [`Error::Permission`], and those of an invalid
    /// name or directory.
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

    /// Connects to the daemon of `instance` for [`emergency_stop`](Self::emergency_stop). It uses
    /// slots that are reserved for emergency stops, so other clients cannot exhaust them. Use
    /// [`connect`](Self::connect) for everything else. It takes all that the stop needs, so a stop
    /// works when the file descriptors of this process are used up later.
    ///
    /// # Errors
    /// Those of [`connect`](Self::connect).
    pub fn connect_to_stop(instance: &str) -> Result<Self, Error> {
        let instance = Instance::find(instance).map_err(Error::of_instance)?;
        let client = Self::open(instance, ClientPorts::open_to_stop)?;
        client.link.prepare_check();
        Ok(client)
    }

    fn open(
        instance: Instance,
        open: fn(Attachment) -> Result<ClientPorts, ServiceError>,
    ) -> Result<Self, Error> {
        let link = Connection::open(instance, open)?;
        let first = link.robot();
        Ok(Self { robot: Mutex::new(Arc::clone(&first)), first, link: Arc::new(link) })
    }

    /// Checks that the calling process created this client. Every call that needs the daemon does
    /// so first. Neither allocates nor makes a system call, except before Linux 4.14, which needs
    /// one.
    ///
    /// # Errors
    /// [`Error::Forked`]: see [forks](crate#forks).
    pub fn check_process(&self) -> Result<(), Error> {
        self.link.check_process()
    }

    /// Returns names and limits of joints, groups and buses. They change only when a call returns
    /// [`Error::Restarted`]. In a forked process they are those of the connection.
    #[must_use]
    pub fn description(&self) -> Arc<RobotDescription> {
        match self.check_process() {
            Ok(()) => Arc::clone(&locked(&self.robot)),
            Err(_) => Arc::clone(&self.first),
        }
    }

    /// Returns the index of the joint `name`.
    #[must_use]
    pub fn joint(&self, name: &str) -> Option<usize> {
        position(self.description().joints.iter().map(|joint| &joint.name), name)
    }

    /// Returns the index of the IMU `name`, for [`State::imu`].
    #[must_use]
    pub fn imu(&self, name: &str) -> Option<usize> {
        position(self.description().imus.iter().map(|imu| &imu.name), name)
    }

    /// Returns the index of the group `name`.
    #[must_use]
    pub fn group(&self, name: &str) -> Option<usize> {
        position(self.description().groups.iter().map(|group| &group.name), name)
    }

    /// Returns the index of the joint `name`, as [`joint`](Self::joint).
    ///
    /// # Errors
    /// [`Error::UnknownJoint`], which lists the joints.
    pub fn joint_named(&self, name: &str) -> Result<usize, Error> {
        joint_of(&self.description(), name)
    }

    /// Returns the index of the IMU `name`, as [`imu`](Self::imu).
    ///
    /// # Errors
    /// [`Error::UnknownImu`], which lists the IMUs.
    pub fn imu_named(&self, name: &str) -> Result<usize, Error> {
        imu_of(&self.description(), name)
    }

    /// Begins to publish the samples of the external IMU `name`.
    ///
    /// # Errors
    /// [`Error::UnknownImu`], [`Error::NotExternal`]; [`Error::Service`] when every slot is taken.
    pub fn publish_imu(&self, name: &str) -> Result<ImuPublisher, Error> {
        ImuPublisher::new(Arc::clone(&self.link), name)
    }

    /// Returns the index of the group `name`, as [`group`](Self::group).
    ///
    /// # Errors
    /// [`Error::UnknownGroup`], which lists the groups.
    pub fn group_named(&self, name: &str) -> Result<usize, Error> {
        group_of(&self.description(), name)
    }

    /// Sets the time without states after which the daemon counts as [silent](Error::Silent) or
    /// ended. The default is 50 ms, or five cycles if they are longer.
    pub fn set_silence(&self, silence: Duration) {
        self.link.set_silence(silence);
    }

    /// Returns the newest state, unless it was returned before. Does not wait.
    ///
    /// # Errors
    /// [`Error::Restarted`], once after each restart; [`Error::Service`] when the connection is
    /// damaged or every slot is taken. A lack of new states is no error here: see [`State::age`].
    pub fn newest(&self) -> Result<Option<State>, Error> {
        self.link.clear_events()?;
        let mut view = self.link.poll()?;
        self.take(&mut view, 1)
    }

    /// Sleeps until a state arrives that was not returned before. The wake-up takes 5 to 60 µs: see
    /// [`spin`](Self::spin).
    ///
    /// # Errors
    /// [`Error::NotRunning`] or [`Error::Silent`] when no state arrives for the silence time. The
    /// next call waits for its whole `timeout` before it returns that error again.
    /// [`Error::Timeout`]; those of [`newest`](Self::newest).
    pub fn wait(&self, timeout: Duration) -> Result<State, Error> {
        self.next_of(1, timeout, |link, view, seen, remaining| {
            drop(view);
            link.sleep(seen, remaining)
        })
    }

    /// Sleeps until the state of a cycle whose number is a multiple of `n` arrives. Returns the
    /// state of a later cycle if the daemon missed that one, or if a still newer state arrived
    /// before this thread ran: [`State::cycle`] returns its number. The next call waits for the
    /// next multiple. The first call returns the next state. For a controller at an `n`th of the
    /// daemon's rate.
    ///
    /// The call sleeps on a timer until the state is nearly due, so that other cycles do not wake
    /// it, and then as [`wait`](Self::wait) does. `timeout` must be longer than `n` cycles.
    ///
    /// # Errors
    /// Those of [`wait`](Self::wait).
    pub fn wait_cycles(&self, n: u32, timeout: Duration) -> Result<State, Error> {
        let (n, period) = (u64::from(n.max(1)), self.description().period());
        let early = EARLY_MAX.min(period / EARLY_SHARE);
        self.next_of(n, timeout, |link, view, seen, remaining| {
            let due_in = view.due_in(n, period).unwrap_or_default();
            drop(view);
            match due_in.saturating_sub(early) {
                Duration::ZERO => link.sleep(seen, remaining),
                until_early => {
                    std::thread::sleep(until_early.min(remaining));
                    Ok(())
                }
            }
        })
    }

    /// Polls for the next state like [`wait`](Self::wait), without sleeping: occupies a processor
    /// core, and returns the state within a microsecond.
    ///
    /// # Errors
    /// Those of [`wait`](Self::wait).
    pub fn spin(&self, timeout: Duration) -> Result<State, Error> {
        let begun = Instant::now();
        self.link.clear_events()?;
        loop {
            for _ in 0..GLANCES {
                if let Some(state) = self.take(&mut self.link.glance()?, 1)? {
                    return Ok(state);
                }
                std::hint::spin_loop();
            }
            let mut view = self.link.glance()?;
            if !view.is_unseen() {
                self.link.remaining(&mut view, begun.elapsed(), timeout)?;
            }
        }
    }

    /// Returns a file descriptor that becomes readable with each state, for an event loop (`poll`,
    /// `epoll`, `select`). Read the state with [`newest`](Self::newest) and close nothing. The
    /// descriptor belongs to the client, and survives a restart of the daemon.
    ///
    /// The first call opens it and takes milliseconds. From then on each call that returns a state
    /// makes one or two further system calls, and the daemon makes one in each cycle. The
    /// descriptor may be readable without a new state, and an ended daemon leaves it unreadable:
    /// use a timeout, after which [`wait`](Self::wait) returns the reason.
    ///
    /// # Errors
    /// [`Error::Service`] when every slot is taken or no file descriptor is free.
    pub fn file_descriptor(&self) -> Result<BorrowedFd<'_>, Error> {
        self.link.file_descriptor()
    }

    /// Receives every cycle, from one within 0.1 s on, for a process that records. Other calls skip
    /// states that the caller did not read in time.
    ///
    /// # Errors
    /// [`Error::Service`] when two processes record already, or the connection is damaged;
    /// [`Error::NotRunning`] when the daemon has ended; [`Error::Version`], also for a daemon
    /// without records.
    pub fn records(&self) -> Result<Records, Error> {
        Records::new(Arc::clone(&self.link))
    }

    /// Returns the state of the next `n`th cycle. `pause` releases the view and sleeps at most for
    /// the given duration. It does not sleep if a state was published since the given count.
    fn next_of(
        &self,
        n: u64,
        timeout: Duration,
        pause: impl Fn(&Connection, MutexGuard<'_, View>, Option<u32>, Duration) -> Result<(), Error>,
    ) -> Result<State, Error> {
        let begun = Instant::now();
        loop {
            let seen = self.link.published();
            self.link.clear_events()?;
            let mut view = self.link.glance()?;
            if let Some(state) = self.take(&mut view, n)? {
                return Ok(state);
            }
            let remaining = self.link.remaining(&mut view, begun.elapsed(), timeout)?;
            pause(&self.link, view, seen, remaining)?;
        }
    }

    /// Claims `group`, until the claim is released or dropped. One process can own several groups.
    ///
    /// # Errors
    /// [`Error::UnknownGroup`], [`Error::Refused`] naming the owner, and those of every request.
    pub fn claim(&self, group: &str) -> Result<Claim, Error> {
        let robot = self.description();
        let index = group_of(&robot, group)?;
        self.ready(&robot)?;
        Claim::new(Arc::clone(&self.link), &robot, index)
    }

    /// Starts the motors of `group`, as an operator: its owner must be sending setpoints.
    ///
    /// # Errors
    /// [`Error::UnknownGroup`], [`Error::Refused`] with the reason, and those of every request:
    /// [`Error::Restarted`], [`Error::NotRunning`], [`Error::NoAnswer`].
    pub fn enable(&self, group: &str) -> Result<(), Error> {
        self.operate(Operation::Enable, group)
    }

    /// Damps and stops the motors of `group`, as an operator.
    ///
    /// # Errors
    /// Those of [`enable`](Self::enable).
    pub fn disable(&self, group: &str) -> Result<(), Error> {
        self.operate(Operation::Disable, group)
    }

    /// Clears the latched cause of a stop of `group`, also an emergency stop. Other groups keep
    /// their causes.
    ///
    /// # Errors
    /// Those of [`enable`](Self::enable).
    pub fn reset(&self, group: &str) -> Result<(), Error> {
        self.operate(Operation::Reset, group)
    }

    /// Sleeps until `group` is in `phase` or past it, in a state published after the call.
    ///
    /// # Errors
    /// [`Error::Stopped`] immediately when the group is stopped while it should start;
    /// [`Error::NotReached`] after `timeout`; [`Error::UnknownGroup`], [`Error::Restarted`],
    /// [`Error::NotRunning`], [`Error::Silent`].
    pub fn wait_for(&self, group: &str, phase: Phase, timeout: Duration) -> Result<(), Error> {
        let robot = self.description();
        let index = group_of(&robot, group)?;
        self.link.wait_for(index, phase, timeout, || self.ready(&robot))
    }

    /// Returns the joints of `group`, or of all groups, whose motors do not answer after this call,
    /// within `timeout`. After a stop these motors may not have received it: cut their power.
    /// Excluded joints are not among them. Returns as soon as all have answered. Takes no state
    /// from a thread that waits for one.
    ///
    /// # Errors
    /// [`Error::UnknownGroup`]; without states [`Error::NotRunning`], [`Error::Silent`],
    /// [`Error::Timeout`]; [`Error::Restarted`].
    pub fn offline_joints(&self, group: Option<&str>, timeout: Duration) -> Result<Vec<String>, Error> {
        let robot = self.description();
        let index = group.map(|group| group_of(&robot, group)).transpose()?;
        self.link.refresh()?;
        self.must_be(robot.boot_id)?;
        self.link.offline_joints(index, timeout)
    }

    /// Takes `group` from its owner.
    ///
    /// # Errors
    /// Those of [`enable`](Self::enable).
    pub fn force_release(&self, group: &str) -> Result<(), Error> {
        self.operate(Operation::ForceRelease, group)
    }

    /// Damps and stops every motor. Sends the request before it reads any state: first through the
    /// daemon's socket for emergency stops, where no other request precedes it, then over this
    /// connection. The function [`emergency_stop`](crate::emergency_stop) needs no connection. In a
    /// forked process it works too, over a connection of its own.
    ///
    /// After the confirmation it checks that each motor answers, for 0.3 s at most, and takes no
    /// state from a thread that waits for one.
    ///
    /// # Errors
    /// Those of [`emergency_stop`](crate::emergency_stop): the stop is unconfirmed, or motors may
    /// not have received it, as [`Error::MotorsOffline`] with their names.
    pub fn emergency_stop(&self) -> Result<(), Error> {
        self.emergency_stop_for("")
    }

    /// As [`emergency_stop`](Self::emergency_stop). The log of the daemon and the history of the
    /// groups show `source`, such as a person or a button, behind the process: at most 128 bytes.
    ///
    /// # Errors
    /// Those of [`emergency_stop`](crate::emergency_stop).
    pub fn emergency_stop_for(&self, source: &str) -> Result<(), Error> {
        let source = StopSource::new(source);
        if self.check_process().is_err() {
            return stop_and_check(self.link.instance(), &source);
        }
        self.confirm_stop(&source)?;
        self.link.check_answers()
    }

    fn confirm_stop(&self, source: &StopSource) -> Result<(), Error> {
        let mut first = SocketStop::send(self.link.instance(), source);
        if first.is_confirmed_soon() {
            return Ok(());
        }
        let every_group = Subject { group: ALL_GROUPS as usize, ..Subject::default() };
        match self.link.ask(Operation::EmergencyStop, every_group, ANSWER_TIMEOUT) {
            Err(_) if first.is_confirmed(Duration::ZERO) => Ok(()),
            Err(error) => Err(first.reason(Some(error), self.link.instance())),
            Ok(_) => Ok(()),
        }
    }

    /// Damps and stops every motor, from a signal handler too: async-signal-safe. It allocates
    /// nothing, takes no lock, keeps `errno`, and uses the stack and system calls of the list in
    /// signal-safety(7) only. It needs one free file descriptor. Usually takes a cycle or two, at
    /// most 0.2 s.
    ///
    /// It sends the request through the daemon's socket for emergency stops alone.
    /// [`emergency_stop`](Self::emergency_stop) has a second path, over which it stops a robot
    /// whose socket fails.
    ///
    /// `Ok` means that the daemon sent the commands. Whether each motor received them is not known:
    /// a motor without power or bus does not answer. After the handler
    /// [`offline_joints`](Self::offline_joints) names these motors.
    ///
    /// # Errors
    /// The stop is unconfirmed, and motors may still move.
    pub fn emergency_stop_signal_safe(&self) -> Result<(), StopError> {
        self.link.stop_signal_safe(SOCKET_TIMEOUT)
    }

    /// Sets the zero of a stopped motor to its current position.
    ///
    /// # Errors
    /// [`Error::UnknownJoint`], [`Error::Refused`] with the reason, and those of every request.
    pub fn set_zero(&self, joint: &str) -> Result<(), Error> {
        self.service(Operation::SetZero, joint)
    }

    /// Acknowledges a motor's fault.
    ///
    /// # Errors
    /// Those of [`set_zero`](Self::set_zero).
    pub fn clear_fault(&self, joint: &str) -> Result<(), Error> {
        self.service(Operation::ClearFault, joint)
    }

    /// Excludes a joint from its group, which must be disarmed. Its motor receives stop frames
    /// only, and the daemon ignores its setpoints. The group can be enabled without it if the
    /// configuration allows that.
    ///
    /// # Errors
    ///
    /// Those of [`set_zero`](Self::set_zero).
    pub fn exclude(&self, joint: &str) -> Result<(), Error> {
        self.service(Operation::Exclude, joint)
    }

    /// Ends the exclusion of a joint. The daemon searches for its motor again.
    ///
    /// # Errors
    ///
    /// Those of [`set_zero`](Self::set_zero).
    pub fn include(&self, joint: &str) -> Result<(), Error> {
        self.service(Operation::Include, joint)
    }

    /// Returns counters and latencies since the daemon started, or since
    /// [`reset_telemetry`](Self::reset_telemetry).
    ///
    /// # Errors
    /// Those of every request.
    pub fn telemetry(&self) -> Result<Telemetry, Error> {
        self.link.refresh()?;
        self.must_be(self.description().boot_id)?;
        self.link.read(Operation::Telemetry, 0.0)
    }

    /// Returns the histograms of all latencies. Takes several requests. Each histogram is
    /// consistent, but they are some milliseconds apart.
    ///
    /// # Errors
    /// Those of every request; [`Error::Refused`] by a daemon without histograms.
    pub fn histograms(&self) -> Result<Histograms, Error> {
        self.link.refresh()?;
        self.must_be(self.description().boot_id)?;
        let mut all = Histograms::default();
        for _ in 0..HISTOGRAM_PAGES_MAX {
            let from = all.next.unwrap_or_default();
            let page: Histograms = self.link.read(Operation::Histograms, f64::from(from))?;
            if page.resets != all.resets && from > 0 {
                // Another client reset them meanwhile.
                all = Histograms::default();
                continue;
            }
            all.histograms.extend(page.histograms);
            (all.resets, all.next) = (page.resets, page.next.filter(|next| *next > from));
            if all.next.is_none() {
                return Ok(all);
            }
        }
        Err(Error::NotUnderstood { operation: Operation::Histograms })
    }

    /// Resets counters and latencies, for all clients. The daemon's log names the process that
    /// requested it.
    ///
    /// # Errors
    /// Those of every request.
    pub fn reset_telemetry(&self) -> Result<(), Error> {
        let whole_robot = Subject { group: ALL_GROUPS as usize, ..Subject::default() };
        self.ask(Operation::ResetTelemetry, &self.description(), whole_robot)
    }

    fn operate(&self, operation: Operation, group: &str) -> Result<(), Error> {
        self.operate_with(operation, group, 0.0)
    }

    fn operate_with(&self, operation: Operation, group: &str, argument: f64) -> Result<(), Error> {
        let robot = self.description();
        let group = group_of(&robot, group)?;
        self.ask(operation, &robot, Subject { group, argument, ..Subject::default() })
    }

    fn service(&self, operation: Operation, joint: &str) -> Result<(), Error> {
        let robot = self.description();
        let joint = joint_of(&robot, joint)?;
        self.ask(operation, &robot, Subject { joint, ..Subject::default() })
    }

    /// Sends a request to the daemon of `robot`, which defines the indices in `subject`.
    fn ask(&self, operation: Operation, robot: &RobotDescription, subject: Subject) -> Result<(), Error> {
        self.ready(robot)?;
        self.link.ask(operation, subject, ANSWER_TIMEOUT)?;
        Ok(())
    }

    /// Checks that the daemon of `robot` is running.
    fn ready(&self, robot: &RobotDescription) -> Result<(), Error> {
        self.link.refresh()?;
        self.must_be(robot.boot_id)?;
        self.link.check_alive()
    }

    /// Returns the newest state, if it was not taken before and is due for a caller that takes
    /// every `n`th. [`Error::Restarted`] precedes the first state after a restart.
    fn take(&self, view: &mut MutexGuard<'_, View>, n: u64) -> Result<Option<State>, Error> {
        if view.is_unseen() {
            let known = locked(&self.robot).boot_id;
            self.must_be(known)?;
        }
        let state = view.take_unseen(n);
        state.iter().for_each(|state| self.link.taken(state.cycle()));
        Ok(state)
    }

    /// Fails with [`Error::Restarted`] unless the daemon still has this boot id: after a restart an
    /// index may mean another joint. Other threads also get this error if they still use the
    /// previous robot.
    fn must_be(&self, boot_id: u64) -> Result<(), Error> {
        if self.link.boot_id() == boot_id {
            return Ok(());
        }
        *locked(&self.robot) = self.link.robot();
        Err(Error::Restarted)
    }
}

fn joint_of(robot: &RobotDescription, name: &str) -> Result<usize, Error> {
    let names = robot.joints.iter().map(|joint| &joint.name);
    let unknown = || Error::UnknownJoint { name: name.to_owned(), known: listed(names.clone()) };
    position(names.clone(), name).ok_or_else(unknown)
}

fn group_of(robot: &RobotDescription, name: &str) -> Result<usize, Error> {
    let names = robot.groups.iter().map(|group| &group.name);
    let unknown = || Error::UnknownGroup { name: name.to_owned(), known: listed(names.clone()) };
    position(names.clone(), name).ok_or_else(unknown)
}

fn position<'a>(mut names: impl Iterator<Item = &'a String>, name: &str) -> Option<usize> {
    names.position(|known| known == name)
}

fn listed<'a>(names: impl Iterator<Item = &'a String>) -> String {
    let names: Vec<_> = names.map(String::as_str).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}
