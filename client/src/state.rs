//! The states of a cycle, with codes as enums instead of numbers.
//!
//! This module validates all values from shared memory. A number that is no code of its table, or
//! an index of no joint, becomes `None`. No value that a daemon can write makes a client panic.

use crate::imu::Imu;
use crate::joint::Joint;
use motord_ports::clock;
use motord_shared::message::{
    FLAG_CONFIG_CHANGED, FLAG_EMERGENCY_STOP, FLAG_OVERRUN, FLAG_REALTIME, FLAG_SHUTDOWN,
};
use motord_shared::{
    BusCondition, BusState, Cause, GroupState, Indicator, JointIndicators, Lease, Phase, Rejection,
    StateMessage,
};
use std::sync::Arc;
use std::time::Duration;

/// The daemon's whole state after a cycle. Clones share the memory.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    message: Arc<StateMessage>,
}

/// Limit on states whose memory is reused.
const POOL_MAX: usize = 4;

/// Memory for states. Released memory is reused for the next state. A controller that keeps fewer
/// than three states causes no allocation after the first.
#[derive(Debug, Default)]
pub(crate) struct StatePool(Vec<Arc<StateMessage>>);

impl StatePool {
    /// Copies `message`.
    pub(crate) fn copy(&mut self, message: &StateMessage) -> State {
        if let Some(free) = self.0.iter_mut().find(|state| Arc::strong_count(state) == 1) {
            Arc::make_mut(free).copy_from(message);
            return State { message: Arc::clone(free) };
        }
        let mut new = StateMessage::default();
        new.copy_from(message);
        let state = State { message: Arc::new(new) };
        if self.0.len() < POOL_MAX {
            self.0.push(Arc::clone(&state.message));
        }
        state
    }
}

impl From<&StateMessage> for State {
    /// Allocates.
    fn from(message: &StateMessage) -> Self {
        StatePool::default().copy(message)
    }
}

impl State {
    /// Returns the message as the daemon wrote it, with unchecked codes: for programs that compare
    /// or store states.
    #[must_use]
    pub fn message(&self) -> &StateMessage {
        &self.message
    }

    /// Returns the number of the cycle, from 1. A gap means that the daemon missed ticks, or that
    /// this client was slow.
    #[must_use]
    pub fn cycle(&self) -> u64 {
        self.message.cycle
    }

    /// Returns the tick with the cycle's number, ns of `CLOCK_MONOTONIC`: two states are as many
    /// periods apart as their cycles.
    #[must_use]
    pub fn tick_ns(&self) -> u64 {
        self.message.tick_ns
    }

    /// Returns [`tick_ns`](Self::tick_ns) since the zero of `CLOCK_MONOTONIC`, for the time between
    /// two states.
    #[must_use]
    pub fn time(&self) -> Duration {
        Duration::from_nanos(self.message.tick_ns)
    }

    /// Returns the time when the states were complete, ns of `CLOCK_MONOTONIC`.
    #[must_use]
    pub fn publish_ns(&self) -> u64 {
        self.message.publish_ns
    }

    /// Returns the time since the states were complete.
    #[must_use]
    pub fn age(&self) -> Duration {
        Duration::from_nanos(clock::now_ns().saturating_sub(self.message.publish_ns))
    }

    /// Returns the delay of the cycle after its tick.
    #[must_use]
    pub fn wake_latency(&self) -> Duration {
        Duration::from_nanos(self.message.wake_latency_ns)
    }

    /// Returns the number of ticks missed since the daemon started.
    #[must_use]
    pub fn overruns(&self) -> u64 {
        self.message.overruns
    }

    /// Returns `true` if the emergency stop is latched.
    #[must_use]
    pub fn emergency_stop(&self) -> bool {
        self.has(FLAG_EMERGENCY_STOP)
    }

    /// Returns `true` if the cycle has real-time scheduling and locked memory.
    #[must_use]
    pub fn realtime(&self) -> bool {
        self.has(FLAG_REALTIME)
    }

    /// Returns `true` if the cycle began a period or more too late.
    #[must_use]
    pub fn overrun(&self) -> bool {
        self.has(FLAG_OVERRUN)
    }

    /// Returns `true` if the daemon is shutting down.
    #[must_use]
    pub fn shutting_down(&self) -> bool {
        self.has(FLAG_SHUTDOWN)
    }

    /// Returns `true` if the configuration file changed after the daemon read it; the daemon
    /// continues with the configuration it read.
    #[must_use]
    pub fn config_changed(&self) -> bool {
        self.has(FLAG_CONFIG_CHANGED)
    }

    /// Returns the joints, in the order of the description.
    pub fn joints(&self) -> impl ExactSizeIterator<Item = Joint> + '_ {
        self.message.joints().iter().map(Joint::from)
    }

    /// Returns the joint with this index in the description.
    #[must_use]
    pub fn joint(&self, index: usize) -> Option<Joint> {
        self.message.joints().get(index).map(Joint::from)
    }

    /// Returns the indicators of the motor of the joint with this index. Only native motors have
    /// indicators, and the daemon publishes those of 16 joints.
    #[must_use]
    pub fn indicators(&self, joint: usize) -> Option<Indicators> {
        let published = self.message.indicators().iter();
        published.copied().find(|indicators| indicators.joint as usize == joint).map(Indicators)
    }

    /// Returns the IMUs, in the order of the description.
    pub fn imus(&self) -> impl ExactSizeIterator<Item = Imu> + '_ {
        self.message.imus().iter().map(Imu::from)
    }

    /// Returns the IMU with this index in the description; [`Client::imu`](crate::Client::imu)
    /// returns the index of a name.
    #[must_use]
    pub fn imu(&self, index: usize) -> Option<Imu> {
        self.message.imus().get(index).map(Imu::from)
    }

    /// Returns the groups, in the order of the description.
    pub fn groups(&self) -> impl ExactSizeIterator<Item = Group> + '_ {
        self.message.groups().iter().map(|group| self.checked(group))
    }

    /// Returns the group with this index in the description.
    #[must_use]
    pub fn group(&self, index: usize) -> Option<Group> {
        self.message.groups().get(index).map(|group| self.checked(group))
    }

    /// Returns the buses, in the order of the description.
    pub fn buses(&self) -> impl ExactSizeIterator<Item = Bus> + '_ {
        self.message.buses().iter().map(Bus::from)
    }

    /// Returns the bus with this index in the description.
    #[must_use]
    pub fn bus(&self, index: usize) -> Option<Bus> {
        self.message.buses().get(index).map(Bus::from)
    }

    pub(crate) fn boot_id(&self) -> u64 {
        self.message.boot_id
    }

    fn has(&self, flag: u32) -> bool {
        self.message.flags & flag != 0
    }

    fn checked(&self, group: &GroupState) -> Group {
        let joint = group.cause_joint as usize;
        Group {
            owned: group.lease != 0,
            lease: Lease::from_raw(group.lease),
            phase: Phase::try_from(group.phase).ok(),
            latched: group.cause != 0,
            cause: Cause::try_from(group.cause).ok(),
            cause_joint: (joint < self.message.joints().len() && group.cause != 0).then_some(joint),
            cause_pid: (group.cause_pid != 0 && group.cause != 0).then_some(group.cause_pid),
            sequence: group.sequence,
            setpoint_age: (group.sequence != 0).then(|| Duration::from_nanos(group.setpoint_age_ns)),
            setpoint_period: (group.setpoint_period_ns != 0)
                .then(|| Duration::from_nanos(group.setpoint_period_ns)),
            setpoint_horizon: (group.setpoint_horizon_ns != 0)
                .then(|| Duration::from_nanos(group.setpoint_horizon_ns.into())),
            control_cycles: group
                .used_cycle
                .checked_sub(group.answered_cycle)
                .filter(|_| group.answered_cycle > 0),
            accepted: group.accepted,
            late: group.late,
            rejected: group.rejected,
        }
    }
}

/// The indicators of one motor, motor side. The daemon queries them in turn, each at about
/// `indicator-hz` of the configuration, by default once a second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Indicators(JointIndicators);

impl Indicators {
    /// Returns the last value, in the [unit](Indicator::unit) of the indicator; `None` while it is
    /// unknown.
    #[must_use]
    pub fn get(&self, indicator: Indicator) -> Option<f32> {
        let value = self.0.values.get(indicator.code() as usize).copied();
        value.filter(|value| value.is_finite())
    }

    /// Returns the known values, in the units of the indicators.
    pub fn iter(&self) -> impl Iterator<Item = (Indicator, f32)> {
        Indicator::ALL.iter().filter_map(|indicator| Some((*indicator, self.get(*indicator)?)))
    }
}

/// One group after a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Group {
    /// `true` if a controller owns the group.
    pub owned: bool,
    /// The owner's lease.
    pub lease: Option<Lease>,
    /// The phase of the group. `None` for a code that this client does not know.
    pub phase: Option<Phase>,
    /// `true` if the group was stopped and needs a reset.
    pub latched: bool,
    /// The latched cause of the stop. `None` without a stop, and for a code that this client does
    /// not know.
    pub cause: Option<Cause>,
    /// The joint that caused the stop, by index in the description.
    pub cause_joint: Option<usize>,
    /// Id of the process that requested the stop, if any.
    pub cause_pid: Option<u32>,
    /// Sequence number of the setpoint in use; 0 for none.
    pub sequence: u64,
    /// Age of the setpoint in use when the cycle began.
    pub setpoint_age: Option<Duration>,
    /// Mean time between two setpoint messages of the owner. While `setpoint-timeout` is latched,
    /// that of the owner that was stopped. `None` when unknown.
    pub setpoint_period: Option<Duration>,
    /// [Horizon](crate::Claim::set_horizon) of the setpoint in use. While `setpoint-timeout` is
    /// latched, that of the last one. `None` without one.
    pub setpoint_horizon: Option<Duration>,
    /// Cycles from the states that the setpoint in use answers to the cycle that first used it: 1
    /// for a timely setpoint. `None` when unknown.
    pub control_cycles: Option<u64>,
    /// Setpoint messages that were accepted, modulo 2³².
    pub accepted: u32,
    /// Accepted messages that missed the first cycle after the one that they answer, modulo 2³².
    pub late: u32,
    rejected: [u32; Rejection::COUNT],
}

impl Group {
    /// Returns the number of setpoint messages rejected for `reason`, modulo 2³².
    #[must_use]
    pub fn rejected(&self, reason: Rejection) -> u32 {
        self.rejected[reason as usize]
    }
}

macro_rules! define_bus {
    ($($(#[doc = $doc:literal])+ $counter:ident;)+) => {
        /// One bus after a cycle. All counters are modulo 2³².
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub struct Bus {
            /// The state of the bus controller. `None` for a code that this client does not know.
            pub condition: Option<BusCondition>,
            $($(#[doc = $doc])+ pub $counter: u32,)+
        }

        impl From<&BusState> for Bus {
            fn from(bus: &BusState) -> Self {
                Self { condition: BusCondition::try_from(bus.condition).ok(), $($counter: bus.$counter,)+ }
            }
        }
    };
}

motord_shared::bus_counters!(define_bus);

#[cfg(test)]
mod tests {
    use super::*;
    use motord_shared::limits::IMUS_MAX;
    use motord_shared::{Fault, ImuContradiction, ImuState, JointState, Limit};

    #[test]
    fn a_lying_daemon_cannot_make_a_client_panic() {
        let mut message = StateMessage {
            flags: u32::MAX,
            joint_count: u32::MAX,
            group_count: u32::MAX,
            bus_count: u32::MAX,
            imu_count: u32::MAX,
            publish_ns: u64::MAX,
            ..StateMessage::default()
        };
        for joint in &mut message.joints {
            *joint = JointState {
                position: f32::NAN,
                torque: f32::INFINITY,
                flags: u32::MAX,
                fault: u32::MAX,
                limits: u32::MAX,
                mode: 77,
                temperature: f32::NAN,
                ..*joint
            };
        }
        for group in &mut message.groups {
            *group = GroupState { phase: 77, cause: 77, cause_joint: 64, ..*group };
        }
        for imu in &mut message.imus {
            *imu = ImuState { flags: u32::MAX, receive_ns: u64::MAX, ..ImuState::UNKNOWN };
        }
        for bus in &mut message.buses {
            bus.condition = 77;
        }
        let state = StatePool::default().copy(&message);
        assert_eq!((state.joints().len(), state.groups().len(), state.buses().len()), (64, 8, 16));
        assert!(state.joints().all(|joint| joint.mode.is_none() && joint.temperature.is_none()));
        assert!(state.joints().all(|joint| joint.position().is_none() && joint.torque().is_none()));
        assert!(state.joints().all(|joint| joint.faults.iter().count() == Fault::ALL.len()));
        assert!(state.joints().all(|joint| joint.limits.iter().count() == Limit::ALL.len()));
        assert!(
            state.groups().all(|group| group.latched && group.cause.is_none() && group.cause_joint.is_none())
        );
        assert!(state.buses().all(|bus| bus.condition.is_none()));
        assert_eq!((state.imus().len(), state.imu(IMUS_MAX)), (IMUS_MAX, None));
        assert!(state.imus().all(|imu| imu.contradictions().count() == ImuContradiction::ALL.len()));
        assert!(state.imus().all(|imu| imu.orientation().is_none() && imu.age() == Some(Duration::ZERO)));
        assert_eq!((state.joint(64), state.age()), (None, Duration::ZERO));
    }

    #[test]
    fn state_memory_is_reused_unless_held() {
        let mut pool = StatePool::default();
        let mut copy = |cycle| pool.copy(&StateMessage { cycle, ..Default::default() });
        let held: Vec<State> = (0..10).map(&mut copy).collect();
        assert!(held.iter().map(State::cycle).eq(0..10), "{held:?}");
        drop(held);
        let mut seen: Vec<*const StateMessage> = Vec::new();
        let mut newest = copy(10);
        for cycle in 11..100 {
            newest = copy(cycle);
            seen.push(Arc::as_ptr(&newest.message));
        }
        seen.sort_unstable();
        seen.dedup();
        assert_eq!((newest.cycle(), seen.len()), (99, 2));
    }
}
