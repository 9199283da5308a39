//! The shared-memory layouts.
//!
//! Joints, groups and buses have the order of the configuration; unused entries are zero. A
//! message's type name contains its version. A client with another layout cannot open the service.

use crate::codes::{Operation, Refusal, Rejection};
use crate::limits::{
    ANSWER_BYTES_MAX, BUSES_MAX, GROUPS_MAX, IMUS_MAX, INDICATOR_JOINTS_MAX, INDICATORS_MAX, JOINTS_MAX,
};
use crate::plain::{plain, sparse};

pub use crate::bus::BusState;
pub use crate::imu::{IMU_CONTRADICTIONS_SHIFT, IMU_FRESH, IMU_LOST, IMU_VALID, ImuState};
pub use crate::joint::{Applied, JOINT_FRESH, JOINT_MISMATCH, JOINT_VALID, JointState};
pub use crate::plain::Message;

/// `StateMessage::flags`: the emergency stop is latched.
pub const FLAG_EMERGENCY_STOP: u32 = 1 << 0;
/// `StateMessage::flags`: the cycle has real-time scheduling and locked memory.
pub const FLAG_REALTIME: u32 = 1 << 1;
/// `StateMessage::flags`: this cycle began later than its tick by a period or more.
pub const FLAG_OVERRUN: u32 = 1 << 2;
/// `StateMessage::flags`: the daemon is shutting down.
pub const FLAG_SHUTDOWN: u32 = 1 << 3;

/// `StateMessage::flags`: the configuration file has changed since the daemon read it.
pub const FLAG_CONFIG_CHANGED: u32 = 1 << 4;

/// A group index that means every group.
pub const ALL_GROUPS: u32 = u32::MAX;
/// A joint index that names no joint.
pub const NO_JOINT: u32 = u32::MAX;

plain! {
    /// One group in a cycle.
    #[derive(Eq)]
    pub struct GroupState {
        /// The owner's [`Lease`](crate::Lease); 0 for none.
        pub lease: u64,
        /// Sequence number of the setpoint in use; 0 for none.
        pub sequence: u64,
        /// Age of the setpoint in use when the cycle began, ns.
        pub setpoint_age_ns: u64,
        /// Mean time between two setpoint messages of the owner, ns; 0 before the second. While
        /// `setpoint-timeout` is latched, that of the owner that was stopped.
        pub setpoint_period_ns: u64,
        /// Number of the cycle whose states the setpoint in use answers, as its owner reports; 0
        /// without a valid number.
        pub answered_cycle: u64,
        /// Number of the cycle that first used the setpoint in use; 0 for none.
        pub used_cycle: u64,
        /// `Phase` code.
        pub phase: u32,
        /// `Cause` code that is latched; 0 for none.
        pub cause: u32,
        /// Index of the joint that caused the stop; `u32::MAX` without one.
        pub cause_joint: u32,
        /// Id of the process that requested the stop; 0 for none or an unknown one.
        pub cause_pid: u32,
        /// Setpoint messages accepted, modulo 2³².
        pub accepted: u32,
        /// Accepted messages that missed the first cycle after the one that they answer, modulo
        /// 2³².
        pub late: u32,
        /// Horizon of the setpoint in use, ns; 0 for none. While `setpoint-timeout` is latched,
        /// that of the last one.
        pub setpoint_horizon_ns: u32,
        /// Setpoint messages rejected, by `Rejection` code, modulo 2³².
        pub rejected: [u32; Rejection::COUNT],
    }
}

plain! {
    /// The indicators of one joint's motor.
    pub struct JointIndicators {
        /// Index of the joint.
        pub joint: u32,
        /// Values by `Indicator` code, in the unit of [`Indicator::unit`](crate::Indicator::unit),
        /// motor side; NaN where unknown.
        pub values: [f32; INDICATORS_MAX],
    }
}

plain! {
    /// The daemon's whole state after a cycle.
    pub struct StateMessage {
        /// Random, fixed for the life of a daemon: it changes exactly when the daemon restarts.
        pub boot_id: u64,
        /// Cycle number, from 1. It counts ticks: missed ticks leave a gap.
        pub cycle: u64,
        /// The tick with the cycle's number, ns of `CLOCK_MONOTONIC`: a period apart for each
        /// cycle, also after missed ticks.
        pub tick_ns: u64,
        /// Delay of the start after this tick, ns.
        pub wake_latency_ns: u64,
        /// Time when the states were complete, ns of `CLOCK_MONOTONIC`.
        pub publish_ns: u64,
        /// Ticks missed since the start.
        pub overruns: u64,
        /// `FLAG_*`.
        pub flags: u32,
        /// Joints in use.
        pub joint_count: u32,
        /// Groups in use.
        pub group_count: u32,
        /// Buses in use.
        pub bus_count: u32,
        /// Joints with indicators in use.
        pub indicator_count: u32,
        /// IMUs in use.
        pub imu_count: u32,
        /// Joints, in the order of the configuration.
        pub joints: [JointState; JOINTS_MAX],
        /// Groups, in the order of the configuration.
        pub groups: [GroupState; GROUPS_MAX],
        /// Buses, in the order of the configuration.
        pub buses: [BusState; BUSES_MAX],
        /// Joints whose motors have indicators, in the order of the configuration.
        pub indicators: [JointIndicators; INDICATOR_JOINTS_MAX],
        /// IMUs, in the order of the configuration.
        pub imus: [ImuState; IMUS_MAX],
    }
}

impl Message for StateMessage {
    const TYPE_NAME: &'static str = crate::joint::STATE_TYPE;
}

sparse!(StateMessage {
    joints by joint_count,
    groups by group_count,
    buses by bus_count,
    indicators by indicator_count,
    imus by imu_count,
});

impl StateMessage {
    /// Copies the used entries of `other`, and clears those used only here. A robot of 12 joints
    /// uses one fifth of the 8 kB of a message; nothing else is read.
    pub fn copy_from(&mut self, other: &Self) {
        let Self { joints, groups, buses, indicators, imus, .. } = self;
        replace(joints, self.joint_count, &other.joints, other.joint_count);
        replace(groups, self.group_count, &other.groups, other.group_count);
        replace(buses, self.bus_count, &other.buses, other.bus_count);
        replace(indicators, self.indicator_count, &other.indicators, other.indicator_count);
        replace(imus, self.imu_count, &other.imus, other.imu_count);
        self.boot_id = other.boot_id;
        self.cycle = other.cycle;
        self.tick_ns = other.tick_ns;
        self.wake_latency_ns = other.wake_latency_ns;
        self.publish_ns = other.publish_ns;
        self.overruns = other.overruns;
        self.flags = other.flags;
        self.joint_count = other.joint_count;
        self.group_count = other.group_count;
        self.bus_count = other.bus_count;
        self.indicator_count = other.indicator_count;
        self.imu_count = other.imu_count;
    }

    /// Returns the joints in use. A hostile count is limited to the array.
    #[must_use]
    pub fn joints(&self) -> &[JointState] {
        &self.joints[..(self.joint_count as usize).min(JOINTS_MAX)]
    }

    /// Returns the groups in use.
    #[must_use]
    pub fn groups(&self) -> &[GroupState] {
        &self.groups[..(self.group_count as usize).min(GROUPS_MAX)]
    }

    /// Returns the buses in use.
    #[must_use]
    pub fn buses(&self) -> &[BusState] {
        &self.buses[..(self.bus_count as usize).min(BUSES_MAX)]
    }

    /// Returns the joints with indicators in use.
    #[must_use]
    pub fn indicators(&self) -> &[JointIndicators] {
        &self.indicators[..(self.indicator_count as usize).min(INDICATOR_JOINTS_MAX)]
    }

    /// Returns the IMUs in use.
    #[must_use]
    pub fn imus(&self) -> &[ImuState] {
        &self.imus[..(self.imu_count as usize).min(IMUS_MAX)]
    }
}

/// Replaces the first `used` by the first `count` of `new`. A hostile count is limited to the
/// array.
fn replace<T: Copy + Default, const N: usize>(old: &mut [T; N], used: u32, new: &[T; N], count: u32) {
    let [used, count] = [used, count].map(|count| (count as usize).min(N));
    old[..count].copy_from_slice(&new[..count]);
    old[count..used.max(count)].fill(T::default());
}

plain! {
    /// The setpoint of a joint.
    pub struct JointSetpoint {
        /// rad.
        pub position: f32,
        /// rad/s.
        pub velocity: f32,
        /// Stiffness, N·m/rad, not negative.
        pub kp: f32,
        /// Damping, N·m·s/rad, not negative.
        pub kd: f32,
        /// N·m.
        pub torque: f32,
        /// `SetpointMode` code.
        pub mode: u32,
    }
}

plain! {
    /// One frame of setpoints for a whole group.
    pub struct SetpointMessage {
        /// The [`Lease`](crate::Lease) in the answer to the claim.
        pub lease: u64,
        /// Must increase with every message of a lease; the first is 1 or more.
        pub sequence: u64,
        /// Time of sending, ns of `CLOCK_MONOTONIC`.
        pub time_ns: u64,
        /// The cycle whose states it answers: for measuring, and for the last fetch.
        pub cycle: u64,
        /// Joints in use: exactly the joints of the group.
        pub joint_count: u32,
        /// Horizon, ns: until this long after `time_ns`, the daemon moves the setpoints linearly to
        /// these. 0: at once.
        pub horizon_ns: u32,
        /// Joints of the group, in the order of the configuration.
        pub joints: [JointSetpoint; JOINTS_MAX],
    }
}

impl Message for SetpointMessage {
    const TYPE_NAME: &'static str = "motord.Setpoint.v2";
}

sparse!(SetpointMessage { joints by joint_count, });

impl SetpointMessage {
    /// Copies the used entries of `other`, and clears those used only here. Nothing else is read.
    pub fn copy_from(&mut self, other: &Self) {
        replace(&mut self.joints, self.joint_count, &other.joints, other.joint_count);
        self.lease = other.lease;
        self.sequence = other.sequence;
        self.time_ns = other.time_ns;
        self.cycle = other.cycle;
        self.joint_count = other.joint_count;
        self.horizon_ns = other.horizon_ns;
    }
}

plain! {
    /// A cycle for recorders: its state and the setpoints that it used.
    pub struct CycleRecord {
        /// Number of the record of a daemon, from 1. A gap means that this recorder was too slow.
        pub sequence: u64,
        /// Bits of the joints with a setpoint in `setpoints`.
        pub known: u64,
        /// The daemon's whole state after the cycle.
        pub state: StateMessage,
        /// Joints, in the order of the configuration: the setpoint in use as its owner sent it,
        /// before all limits.
        pub setpoints: [JointSetpoint; JOINTS_MAX],
    }
}

impl Message for CycleRecord {
    const TYPE_NAME: &'static str = crate::joint::RECORD_TYPE;
}

impl CycleRecord {
    /// Returns the setpoint of the joint with this index that the cycle used, if any.
    #[must_use]
    pub fn setpoint(&self, joint: usize) -> Option<&JointSetpoint> {
        let is_known = joint < JOINTS_MAX && self.known & (1 << joint) != 0;
        self.setpoints.get(joint).filter(|_| is_known)
    }

    /// Sets the setpoint of a joint.
    pub fn set_setpoint(&mut self, joint: usize, setpoint: JointSetpoint) {
        if let Some(slot) = self.setpoints.get_mut(joint) {
            *slot = setpoint;
            self.known |= 1 << joint;
        }
    }
}

plain! {
    /// A sample of an external IMU, in the frame of the sensor.
    pub struct ImuMessage {
        /// See `StateMessage::boot_id`, of the daemon whose description contains the index `imu`.
        pub boot_id: u64,
        /// The publisher: its process id in the bits 63..32, and a random number. Only the samples
        /// of one publisher are used; another one may begin when none of its samples was used for
        /// `lost-after-ms`.
        pub publisher: u64,
        /// Must increase with every sample of a publisher. A gap counts as missing samples.
        pub sequence: u64,
        /// Time of the measurement, ns of `CLOCK_MONOTONIC`. Must increase.
        pub time_ns: u64,
        /// Index of the IMU.
        pub imu: u32,
        /// Keeps the layout free of implicit padding.
        pub reserved: u32,
        /// Orientation of the sensor in the world: a unit quaternion w, x, y, z.
        pub orientation: [f32; 4],
        /// Angular velocity, rad/s.
        pub angular_velocity: [f32; 3],
        /// Specific force, m/s².
        pub acceleration: [f32; 3],
        /// Temperature, °C; NaN for none.
        pub temperature: f32,
        /// Keeps the layout free of implicit padding.
        pub padding: u32,
    }
}

impl Message for ImuMessage {
    const TYPE_NAME: &'static str = "motord.Imu.v1";
}

plain! {
    /// An administrative request.
    pub struct AdminRequest {
        /// The [`Lease`](crate::Lease) of the owner; 0 in a request of an operator or a watcher.
        pub lease: u64,
        /// `Operation` code.
        pub operation: u32,
        /// Group index, or [`ALL_GROUPS`].
        pub group: u32,
        /// Joint index.
        pub joint: u32,
        /// Process id of the requester. Refusals report it to other requesters when this process is
        /// the reason.
        pub pid: u32,
        /// The namespace of the process id: the inode of `/proc/self/ns/pid`; 0 when unknown.
        pub pid_namespace: u64,
        /// Argument, in the range of [`Operation::argument`]; 0 for an operation without one. An
        /// emergency stop ignores it.
        pub argument: f64,
    }
}

impl Message for AdminRequest {
    const TYPE_NAME: &'static str = "motord.AdminRequest.v3";
}

impl AdminRequest {
    /// Returns the requested operation.
    ///
    /// # Errors
    /// The refusal and its detail: [`Refusal::UnknownOperation`], or [`Refusal::Malformed`] for an
    /// argument outside the range of the operation. An emergency stop is never refused for its
    /// argument.
    pub fn operation(&self) -> Result<Operation, (Refusal, u32)> {
        let unknown = |_| (Refusal::UnknownOperation, self.operation);
        let operation = Operation::try_from(self.operation).map_err(unknown)?;
        let is_sound = match operation.argument() {
            Some(range) => range.contains(&self.argument),
            None => operation == Operation::EmergencyStop || self.argument.to_bits() == 0,
        };
        if is_sound { Ok(operation) } else { Err((Refusal::Malformed, 0)) }
    }
}

plain! {
    /// The head of an answer; for `describe`, `telemetry` and `histograms` JSON text follows it.
    #[derive(Eq)]
    pub struct AdminReply {
        /// The [`Lease`](crate::Lease) that was granted; 0 otherwise.
        pub lease: u64,
        /// 0 for success, otherwise a `Refusal` code.
        pub refusal: u32,
        /// The detail of the refusal: see [`Refusal::detail`](crate::Refusal::detail). A joint
        /// index may be [`NO_JOINT`].
        pub detail: u32,
    }
}

plain! {
    /// An answer. It has a fixed size because iceoryx2 does not check the length of a slice from
    /// another process.
    #[derive(Eq)]
    pub struct AdminAnswer {
        /// Its head.
        pub reply: AdminReply,
        /// Bytes of text in use.
        pub length: u32,
        /// Keeps the layout free of implicit padding.
        pub reserved: u32,
        /// JSON, UTF-8.
        pub text: [u8; ANSWER_BYTES_MAX],
    }
}

impl Message for AdminAnswer {
    const TYPE_NAME: &'static str = "motord.AdminAnswer.v2";
}

sparse!(AdminAnswer { text by length, });

impl AdminAnswer {
    /// Returns the text in use. A hostile length is limited to the array.
    #[must_use]
    pub fn text(&self) -> &[u8] {
        &self.text[..(self.length as usize).min(ANSWER_BYTES_MAX)]
    }
}

const _: () = {
    use core::mem::{offset_of, size_of};
    assert!(size_of::<Applied>() == 20);
    assert!(size_of::<GroupState>() == 76 + 4 * Rejection::COUNT);
    assert!(size_of::<BusState>() == 36);
    assert!(size_of::<JointIndicators>() == 4 + 4 * INDICATORS_MAX);
    assert!(offset_of!(StateMessage, joints) == 72);
    assert!(
        size_of::<StateMessage>()
            == 72
                + 64 * size_of::<JointState>()
                + 8 * size_of::<GroupState>()
                + 16 * 36
                + INDICATOR_JOINTS_MAX * size_of::<JointIndicators>()
                + IMUS_MAX * size_of::<ImuState>()
    );
    assert!(size_of::<JointSetpoint>() == 24);
    assert!(size_of::<SetpointMessage>() == 40 + 64 * 24);
    assert!(size_of::<ImuMessage>() == 88);
    assert!(size_of::<CycleRecord>() == 16 + size_of::<StateMessage>() + 64 * 24);
    assert!(size_of::<AdminRequest>() == 40 && size_of::<AdminReply>() == 16);
    assert!(size_of::<AdminAnswer>() == 24 + ANSWER_BYTES_MAX);
};

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates a message with these counts of joints, groups, buses and joints with indicators, and
    /// every entry filled.
    fn full(counts: [u32; 5]) -> StateMessage {
        let [joint_count, group_count, bus_count, indicator_count, imu_count] = counts;
        let [tick_ns, wake_latency_ns, publish_ns, overruns] = [3, 4, 5, 6];
        StateMessage {
            boot_id: 1,
            cycle: 2,
            tick_ns,
            wake_latency_ns,
            publish_ns,
            overruns,
            flags: 7,
            joint_count,
            group_count,
            bus_count,
            indicator_count,
            imu_count,
            joints: [JointState { missed: 9, ..Default::default() }; JOINTS_MAX],
            groups: [GroupState { lease: 10, ..Default::default() }; GROUPS_MAX],
            buses: [BusState { lost: 11, ..Default::default() }; BUSES_MAX],
            indicators: [JointIndicators { joint: 12, ..Default::default() }; INDICATOR_JOINTS_MAX],
            imus: [ImuState { sequence: 8, ..Default::default() }; IMUS_MAX],
        }
    }

    #[test]
    fn copied_setpoints_hold_used_part_only() {
        let setpoint = JointSetpoint { position: 1.0, velocity: 2.0, kp: 3.0, kd: 4.0, torque: 5.0, mode: 1 };
        let mut copy = SetpointMessage::default();
        for joint_count in [JOINTS_MAX as u32, 12, u32::MAX, 0, 3] {
            let mut original = SetpointMessage {
                lease: 6,
                sequence: 7,
                time_ns: 8,
                cycle: 9,
                joint_count,
                horizon_ns: 10,
                joints: [setpoint; JOINTS_MAX],
            };
            copy.copy_from(&original);
            original.joints[(joint_count as usize).min(JOINTS_MAX)..].fill(JointSetpoint::default());
            assert_eq!(copy, original);
        }
    }

    #[test]
    fn copy_holds_used_part_only() {
        let most =
            [JOINTS_MAX, GROUPS_MAX, BUSES_MAX, INDICATOR_JOINTS_MAX, IMUS_MAX].map(|most| most as u32);
        let mut copy = StateMessage::default();
        for counts in [most, [12, 1, 4, 2, 1], [u32::MAX; 5], [0; 5], [1; 5], [13, 2, 5, 3, 2]] {
            let original = full(counts);
            copy.copy_from(&original);
            let mut expected = original;
            expected.joints[original.joints().len()..].fill(JointState::default());
            expected.groups[original.groups().len()..].fill(GroupState::default());
            expected.buses[original.buses().len()..].fill(BusState::default());
            expected.indicators[original.indicators().len()..].fill(JointIndicators::default());
            expected.imus[original.imus().len()..].fill(ImuState::default());
            assert!(copy == expected, "{counts:?}");
        }
    }

    #[test]
    fn emergency_stop_is_never_refused_for_argument() {
        for argument in [0.0, -0.0, 1.0, f64::NAN, f64::INFINITY] {
            let stop =
                AdminRequest { operation: Operation::EmergencyStop.code(), argument, ..Default::default() };
            assert_eq!(stop.operation(), Ok(Operation::EmergencyStop), "{argument}");
        }
    }

    #[test]
    fn request_with_unexpected_argument_is_malformed() {
        let request =
            |argument| AdminRequest { operation: Operation::Enable.code(), argument, ..Default::default() };
        assert_eq!(request(0.0).operation(), Ok(Operation::Enable));
        for argument in [1.0, -0.0, f64::MIN_POSITIVE, f64::NAN, f64::INFINITY] {
            assert_eq!(request(argument).operation(), Err((Refusal::Malformed, 0)), "{argument}");
        }
        let unknown = AdminRequest { operation: 99, ..Default::default() };
        assert_eq!(unknown.operation(), Err((Refusal::UnknownOperation, 99)));
    }
}
