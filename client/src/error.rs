//! Errors between a controller and the daemon, with a sentence that advises what to do.

pub use crate::lateness::Stop;

use crate::lateness::Rounded;
use motord_ports::permission::advice;
use motord_ports::service::{self, Obstacle, Part};
use motord_ports::stop_socket::StopError;
use motord_ports::{Forked, Instance, InstanceError, ServiceError, peer};
use motord_shared::codes::{Detail, UnknownCode};
use motord_shared::description::RobotDescription;
use motord_shared::{AdminReply, Cause, Operation, Phase, Refusal, Rejection};
use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

/// The reason why a call to the daemon failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No daemon runs this instance. Calls work again once one does.
    #[error("no motord runs instance {instance:?} in {}: {}", runtime.display(), without_daemon(*died))]
    NotRunning {
        /// The instance.
        instance: String,
        /// Its runtime directory.
        runtime: PathBuf,
        /// Process id of the last daemon, if it died without stopping its motors.
        died: Option<u32>,
    },
    /// The daemon runs but publishes no states. Calls work again once it does.
    #[error("motord published no state for {}: it is stopped or overloaded; see its log", Rounded(*silent_for))]
    Silent {
        /// Time since its last state.
        silent_for: Duration,
    },
    /// No new state arrived in the time given to the call; the daemon is not overdue yet.
    #[error("no new state within {}: allow at least two cycles", Rounded(*waited))]
    Timeout {
        /// The time given.
        waited: Duration,
    },
    /// Another daemon runs this instance now. Every claim is void, and joints and groups may have
    /// changed: query names again, then claim again. A client returns this error once per restart,
    /// a void claim always.
    #[error("motord was restarted: claim the group again")]
    Restarted,
    /// The layouts of client and daemon differ.
    #[error(
        "this client (motord {client}) and the daemon have different layouts of the service {service:?} ({daemon}): \
         install the same version of both, and restart every process of the older version"
    )]
    Version {
        /// The service.
        service: &'static str,
        /// The client's version.
        client: &'static str,
        /// The daemon's layout.
        daemon: String,
    },
    /// The user lacks the permission to use the instance.
    #[error("permission denied for {}: {}", path.display(), advice(path))]
    Permission {
        /// The inaccessible path.
        path: PathBuf,
    },
    /// The daemon refused the operation.
    #[error("motord refused to {operation}: {}", refused(*refusal, about))]
    Refused {
        /// The requested operation.
        operation: Operation,
        /// The reason.
        refusal: Refusal,
        /// The subject of the refusal.
        about: About,
    },
    /// There is no group of this name.
    #[error("there is no group {name:?}; there are {known}")]
    UnknownGroup {
        /// The name.
        name: String,
        /// The names that exist.
        known: String,
    },
    /// There is no joint of this name.
    #[error("there is no joint {name:?}; there are {known}")]
    UnknownJoint {
        /// The name.
        name: String,
        /// The names that exist.
        known: String,
    },
    /// A list of names lacks a joint of the group, or names it twice.
    #[error("{joint} is {} the names; there are {known}", if *is_doubled { "twice in" } else { "not in" })]
    JointOrder {
        /// The joint.
        joint: String,
        /// The list names it twice.
        is_doubled: bool,
        /// The joints of the group.
        known: String,
    },
    /// There is no IMU of this name.
    #[error("there is no IMU {name:?}; there are {known}")]
    UnknownImu {
        /// The name.
        name: String,
        /// The names that exist.
        known: String,
    },
    /// The IMU is not external.
    #[error("IMU {imu} has type = {source_type:?}: only samples of type = \"external\" can be published")]
    NotExternal {
        /// The IMU.
        imu: String,
        /// Its type in the configuration.
        source_type: String,
    },
    /// The daemon would reject the sample of an IMU.
    #[error(
        "the sample of IMU {imu} is not sent: a value is not finite, or its orientation is no unit quaternion"
    )]
    BadSample {
        /// The IMU.
        imu: String,
    },
    /// The time of the sample of an IMU is of another clock, or too old: the daemon would reject
    /// the sample.
    #[error("the sample of IMU {imu} is not sent: its time is {}", of_other_clock(*offset_ns, *clock))]
    SampleTime {
        /// The IMU.
        imu: String,
        /// Its time after now, ns; negative before now.
        offset_ns: i64,
        /// The clock that its time fits.
        clock: Option<&'static str>,
    },
    /// Another process publishes the samples of this IMU.
    #[error("process {process} publishes IMU {imu}: end it first")]
    OtherPublisher {
        /// The IMU.
        imu: String,
        /// The other process.
        process: u32,
    },
    /// A group needs exactly one setpoint for each of its joints.
    #[error(
        "{received} setpoints for a group of {expected} joints: send one per joint, in the order of the group"
    )]
    SetpointCount {
        /// Joints of the group.
        expected: usize,
        /// Setpoints given.
        received: usize,
    },
    /// A joint of the group has no setpoint yet.
    #[error("joint {joint} has no setpoint: a group is sent whole, so set every joint, or hold it, first")]
    NotSet {
        /// The joint.
        joint: String,
    },
    /// The daemon would reject the setpoint, and with it those of the whole group.
    #[error("the setpoint of joint {joint} is not sent: {}", rejection.sentence())]
    BadSetpoint {
        /// The joint.
        joint: String,
        /// The reason for the rejection.
        rejection: Rejection,
    },
    /// The daemon would reject setpoints with this horizon.
    #[error(
        "a horizon of {} ms is longer than setpoint-horizon-max-ms of the configuration permits: {}",
        horizon.as_secs_f64() * 1e3, most.as_secs_f64() * 1e3
    )]
    HorizonTooLong {
        /// The horizon.
        horizon: Duration,
        /// The longest one.
        most: Duration,
    },
    /// The motor has not reported its position since it came online.
    #[error("joint {joint} has not reported its position: check that its motor has power")]
    NotHeard {
        /// The joint.
        joint: String,
    },
    /// The [`Slot`](crate::Slot) belongs to another claim, whose joints may differ: query it again.
    #[error("the slot belongs to another claim: query it again after each claim")]
    OtherClaim,
    /// The claim no longer owns its group, and no stop that it caused is latched: the owner of a
    /// group at rest sent nothing for a second, or another process released the group. Claim again.
    #[error(
        "group {group} no longer belongs to this claim: its owner sent no setpoint for too long, or another process \
         released it; claim it again"
    )]
    ClaimLost {
        /// The group.
        group: String,
    },
    /// The group does not follow setpoints.
    #[error("group {group} {stop}")]
    Stopped {
        /// The group.
        group: String,
        /// The reason.
        stop: Stop,
    },
    /// The group did not reach the phase in the time given to the call.
    #[error(
        "group {group} is {} after {}, not {expected}",
        phase.map_or("in an unknown phase", Phase::name),
        Rounded(*waited)
    )]
    NotReached {
        /// The group.
        group: String,
        /// The phase of the group. `None` when no state arrived, or for a code that this client
        /// does not know.
        phase: Option<Phase>,
        /// The expected phase.
        expected: Phase,
        /// The time given.
        waited: Duration,
    },
    /// The daemon did not answer a request in time. The request may have been executed.
    #[error("motord did not answer {operation} within {}: {}", Rounded(*waited), without_answer(*operation))]
    NoAnswer {
        /// The requested operation.
        operation: Operation,
        /// The time given.
        waited: Duration,
    },
    /// The emergency stop is unconfirmed. The daemon may have executed it.
    #[error(
        "the emergency stop is not confirmed: {socket}{}",
        services.as_ref().map_or_else(String::new, |error| format!("; {error}"))
    )]
    NotStopped {
        /// The failure of the daemon's socket.
        socket: StopError,
        /// The failure of the services. `None` when they did not answer.
        services: Option<Box<Error>>,
    },
    /// The daemon confirmed the emergency stop, but these motors did not answer after it. They may
    /// not have received it: cut their power.
    #[error(
        "the emergency stop is confirmed, but these motors do not answer and may still move, so cut the power: {}",
        joints.join(", ")
    )]
    MotorsOffline {
        /// The joints of these motors, without excluded ones.
        joints: Vec<String>,
    },
    /// The daemon confirmed the emergency stop, but whether each motor answered is not known.
    #[error(
        "the emergency stop is confirmed, but whether each motor answers was not checked, so watch the robot: {reason}"
    )]
    MotorsUnchecked {
        /// The failure of the check.
        reason: Box<Error>,
    },
    /// This client cannot decode the daemon's answer.
    #[error(
        "this client cannot decode motord's answer to {operation}: install the same version of client and daemon"
    )]
    NotUnderstood {
        /// The requested operation.
        operation: Operation,
    },
    /// The calling process was forked from the one that created the object.
    #[error(
        "a forked process cannot use the connection of its parent: connect again in this process, or fork before you connect"
    )]
    Forked,
    /// The instance's name or directory cannot be used.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// A service cannot be used.
    #[error(transparent)]
    Service(#[from] ServiceError),
}

impl From<Forked> for Error {
    fn from(Forked: Forked) -> Self {
        Self::Forked
    }
}

/// Returns advice where no daemon runs; `died` is the process that did not stop its motors.
fn without_daemon(died: Option<u32>) -> String {
    died.map_or_else(
        || "start it with `motord run`, or name its directory in MOTORD_RUNTIME_DIR".to_owned(),
        |pid| {
            format!(
                "process {pid} died without stopping its motors. Unless a dead man's switch did, cut the power or run \
                 `motord safe-stop FILE`"
            )
        },
    )
}

/// Returns the reason of a refusal.
fn refused(refusal: Refusal, about: &About) -> String {
    match about {
        About::Process(pid) if *pid == std::process::id() => {
            "this process owns the group already: release or drop its earlier claim".to_owned()
        }
        About::Process(pid) => {
            let program = peer::program(pid).map_or_else(String::new, |program| format!(" ({program})"));
            format!("process {pid}{program} owns the group")
        }
        about => format!("{}{about}", refusal.sentence()),
    }
}

/// Returns advice for a caller whose request for `operation` was not answered.
fn without_answer(operation: Operation) -> &'static str {
    match operation {
        Operation::Describe | Operation::Telemetry | Operation::Histograms | Operation::ResetTelemetry => {
            "it is frozen or overloaded; see its log"
        }
        _ => "the states show whether it was carried out",
    }
}

/// Returns the end of a sentence about a time that is `offset_ns` after now.
fn of_other_clock(offset_ns: i64, clock: Option<&str>) -> String {
    let side = if offset_ns < 0 { "before" } else { "after" };
    let clock = clock.map_or_else(String::new, |clock| format!(", and fits {clock}"));
    let seconds = offset_ns.unsigned_abs() as f64 * 1e-9;
    format!(
        "{seconds:.3} s {side} now{clock}. Send ns of CLOCK_MONOTONIC (time.monotonic()), or none for now"
    )
}

impl Error {
    /// Returns the exit status for a process that ends because of this error, after `sysexits.h`:
    /// 64 usage, 69 unavailable, 76 protocol, 77 permission; and 80 for motors that do not answer
    /// after a stop.
    #[must_use]
    pub const fn exit_status(&self) -> u8 {
        match self {
            Self::UnknownGroup { .. }
            | Self::UnknownJoint { .. }
            | Self::JointOrder { .. }
            | Self::UnknownImu { .. }
            | Self::NotExternal { .. }
            | Self::BadSample { .. }
            | Self::SampleTime { .. } => 64,
            Self::SetpointCount { .. }
            | Self::NotSet { .. }
            | Self::BadSetpoint { .. }
            | Self::HorizonTooLong { .. }
            | Self::OtherClaim
            | Self::Forked => 64,
            Self::Instance(error) if error.is_a_setting() => 64,
            Self::Permission { .. }
            | Self::Instance(InstanceError::NotPrivate { .. } | InstanceError::NotOurs { .. }) => 77,
            Self::Version { .. } | Self::NotUnderstood { .. } => 76,
            Self::MotorsOffline { .. } => 80,
            _ => 69,
        }
    }

    /// Returns `true` if a retry or a new claim may succeed without a person: the daemon
    /// reconnects, an owner leaves, or a motor gets power. Mistakes of the program or the
    /// installation are not transient. Neither are stops and faults, which a person must inspect.
    #[must_use]
    pub const fn is_transient(&self) -> bool {
        match self {
            Self::NotRunning { .. }
            | Self::Silent { .. }
            | Self::Timeout { .. }
            | Self::Restarted
            | Self::NotHeard { .. }
            | Self::ClaimLost { .. }
            | Self::OtherPublisher { .. }
            | Self::NotReached { .. }
            | Self::NoAnswer { .. }
            | Self::NotStopped { .. } => true,
            Self::Refused { refusal, .. } => refusal.is_transient(),
            Self::Stopped { stop, .. } => matches!(stop, Stop::Starting),
            Self::Service(error) => error.obstacle.is_transient(),
            // Any process may end the lock, and the daemon may be running.
            Self::Instance(error) => matches!(error, InstanceError::Locked { .. }),
            Self::Version { .. }
            | Self::Permission { .. }
            | Self::UnknownGroup { .. }
            | Self::UnknownJoint { .. }
            | Self::JointOrder { .. }
            | Self::UnknownImu { .. }
            | Self::NotExternal { .. }
            | Self::BadSample { .. }
            | Self::SampleTime { .. }
            | Self::SetpointCount { .. }
            | Self::NotSet { .. }
            | Self::BadSetpoint { .. }
            | Self::HorizonTooLong { .. }
            | Self::OtherClaim
            | Self::NotUnderstood { .. }
            | Self::MotorsOffline { .. }
            | Self::MotorsUnchecked { .. }
            | Self::Forked => false,
        }
    }

    pub(crate) fn not_running(instance: &Instance) -> Self {
        Self::NotRunning {
            instance: instance.name().to_owned(),
            runtime: instance.runtime().to_owned(),
            died: instance.died(),
        }
    }

    pub(crate) fn of_instance(error: InstanceError) -> Self {
        match error {
            InstanceError::Permission { path } => Self::Permission { path },
            error => Self::Instance(error),
        }
    }

    pub(crate) fn of_service(error: ServiceError, instance: &Instance) -> Self {
        match error.obstacle {
            Obstacle::Missing => Self::not_running(instance),
            Obstacle::Permission => Self::Permission { path: instance.runtime().to_owned() },
            Obstacle::Version => Self::version(error.part, instance),
            Obstacle::Full { .. }
            | Obstacle::FullHere { .. }
            | Obstacle::NoSpace
            | Obstacle::NoDescriptors
            | Obstacle::Damaged => Self::Service(error),
        }
    }

    pub(crate) fn version(part: Part, instance: &Instance) -> Self {
        let daemon = service::layout(instance, part).unwrap_or_else(|| "another version".to_owned());
        Self::Version { service: part.name(), client: env!("CARGO_PKG_VERSION"), daemon }
    }

    /// Returns the error for a reply that refuses `operation`. `position` returns that of a joint
    /// of `robot`, rad, by index; a joint outside its limits is reported with it.
    #[must_use]
    pub fn refusal(
        operation: Operation,
        reply: AdminReply,
        robot: &RobotDescription,
        position: impl FnOnce(usize) -> Option<f32>,
    ) -> Self {
        let is_outside = reply.refusal == Refusal::OutsideLimits.code();
        let position = if is_outside { position(reply.detail as usize) } else { None };
        Self::refused(operation, reply.refusal, reply.detail, robot).at(position, robot)
    }

    /// Returns the refusal with this code.
    pub(crate) fn refused(operation: Operation, code: u32, detail: u32, robot: &RobotDescription) -> Self {
        match Refusal::try_from(code) {
            Ok(refusal) => Self::Refused { operation, refusal, about: About::of(refusal, detail, robot) },
            Err(UnknownCode(_)) => Self::NotUnderstood { operation },
        }
    }

    /// Adds the position of the joint, `position`, rad, and its limits to a refusal that names a
    /// joint.
    fn at(mut self, position: Option<f32>, robot: &RobotDescription) -> Self {
        if let Self::Refused { about, .. } = &mut self
            && let (About::Joint(name), Some(position)) = (&*about, position)
            && let Some(joint) = robot.joints.iter().find(|joint| joint.name == *name)
        {
            *about = About::Position(joint.outside(position));
        }
        self
    }
}

/// The subject of a refusal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum About {
    /// No subject.
    Nothing,
    /// The process that owns the group.
    Process(u32),
    /// A joint, by name.
    Joint(String),
    /// A joint and its position: `fl-knee is at 0.00 rad, outside -2.70 to -0.50`.
    Position(String),
    /// The latched cause.
    Cause(Cause),
}

impl About {
    fn of(refusal: Refusal, detail: u32, robot: &RobotDescription) -> Self {
        let joint = || robot.joints.get(detail as usize).map(|joint| Self::Joint(joint.name.clone()));
        let about = match refusal.detail() {
            Detail::Joint => joint(),
            Detail::Process => (detail != 0).then_some(Self::Process(detail)),
            Detail::Cause => Cause::try_from(detail).ok().map(Self::Cause),
            Detail::Unknown | Detail::Nothing => None,
        };
        about.unwrap_or(Self::Nothing)
    }
}

impl fmt::Display for About {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nothing => Ok(()),
            Self::Process(pid) => write!(f, " (process {pid})"),
            Self::Joint(name) => write!(f, " (joint {name})"),
            Self::Position(text) => write!(f, " ({text})"),
            Self::Cause(cause) => write!(f, " ({cause}: {})", cause.sentence()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_shared::description::{JointDescription, JointLimits};
    use motord_shared::message::NO_JOINT;

    /// The refusals about one joint. Every other refusal names none.
    const OF_A_JOINT: [Refusal; 17] = [
        Refusal::MotorOffline,
        Refusal::MotorFault,
        Refusal::StateStale,
        Refusal::SetpointTooFar,
        Refusal::OutsideLimits,
        Refusal::NotDisarmed,
        Refusal::BusDown,
        Refusal::Busy,
        Refusal::NotConfirmed,
        Refusal::DuplicateId,
        Refusal::ForeignMaster,
        Refusal::Moving,
        Refusal::TooSoon,
        Refusal::TurnLost,
        Refusal::Excluded,
        Refusal::Mismatch,
        Refusal::Unread,
    ];

    fn refused(refusal: Refusal, detail: u32) -> String {
        let joints = ["hip", "knee"].map(|name| JointDescription { name: name.into(), ..Default::default() });
        let robot = RobotDescription { joints: joints.into(), ..Default::default() };
        Error::refused(Operation::Enable, refusal.code(), detail, &robot).to_string()
    }

    #[test]
    fn refusal_of_a_joint_names_that_joint() {
        for refusal in Refusal::ALL {
            let names_it = refused(*refusal, 1).ends_with("(joint knee)");
            assert_eq!(names_it, OF_A_JOINT.contains(refusal), "{refusal}");
        }
    }

    #[test]
    fn joint_outside_limits_is_reported_with_numbers() {
        let limits = JointLimits { position: [-2.7, -0.5], ..Default::default() };
        let knee = JointDescription { name: "knee".into(), limits, ..Default::default() };
        let robot = RobotDescription { joints: vec![knee], ..Default::default() };
        let refused = Error::refused(Operation::Enable, Refusal::OutsideLimits.code(), 0, &robot);
        let sentence = refused.at(Some(0.0), &robot).to_string();
        assert!(sentence.ends_with("(knee is at 0.00 rad, outside -2.70 to -0.50)"), "{sentence}");
    }

    #[test]
    fn refusal_of_an_owned_group_names_owner() {
        let owned = |pid| refused(Refusal::Owned, pid);
        let own = owned(std::process::id());
        assert_eq!(
            own,
            "motord refused to enable: this process owns the group already: release or drop its earlier claim"
        );
        let parent = std::os::unix::process::parent_id();
        let sentence = owned(parent);
        assert!(sentence.starts_with(&format!("motord refused to enable: process {parent} (")), "{sentence}");
        assert_eq!(owned(u32::MAX), format!("motord refused to enable: process {} owns the group", u32::MAX));
    }

    #[test]
    fn refusal_without_a_joint_names_none() {
        for refusal in OF_A_JOINT {
            assert!(!refused(refusal, NO_JOINT).contains("(joint"), "{refusal}");
        }
    }

    #[test]
    fn transient_errors_are_those_that_pass_unattended() {
        let refused =
            |refusal| Error::Refused { operation: Operation::Enable, refusal, about: About::Nothing };
        let stopped = Error::Stopped { group: "leg".into(), stop: Stop::Disabled };
        let damaged = Error::Service(ServiceError { part: Part::Node, obstacle: Obstacle::Damaged });
        for error in [Error::Restarted, refused(Refusal::Owned), refused(Refusal::MotorOffline), damaged] {
            assert!(error.is_transient(), "{error}");
        }
        for error in [stopped, Error::OtherClaim, refused(Refusal::Latched), refused(Refusal::MotorFault)] {
            assert!(!error.is_transient(), "{error}");
        }
    }
}
