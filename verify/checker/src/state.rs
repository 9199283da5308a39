//! The part of the published state that is judged. The program that runs the cycle fills it in.

/// The state that was published after a cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Number of the cycle; missed ticks leave a gap.
    pub cycle: u64,
    /// Missed ticks.
    pub missed_ticks: u64,
    /// When the cycle began.
    pub begun: motord_bus::Instant,
    /// In the order of [`Robot::motors`](crate::robot::Robot::motors).
    pub joints: Vec<Joint>,
    /// In the order of [`Robot::groups`](crate::robot::Robot::groups).
    pub groups: Vec<Group>,
    /// In the order of [`Robot::buses`](crate::robot::Robot::buses).
    pub buses: Vec<Bus>,
}

/// One joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joint {
    /// rad; not a number when it is not known.
    pub position: f32,
    /// rad/s
    pub velocity: f32,
    /// Stiffness of what was sent in this cycle, N·m/rad.
    pub applied_kp: f32,
    /// Its damping, N·m·s/rad.
    pub applied_kd: f32,
    /// Its velocity, rad/s.
    pub applied_velocity: f32,
    /// The setpoint's position was limited by its slew.
    pub slews: bool,
    /// The state is from a reply of this cycle.
    pub fresh: bool,
    /// Position and velocity are known.
    pub valid: bool,
    /// The mode of its motor.
    pub mode: Mode,
    /// Cycles since the last reply.
    pub age_cycles: u32,
    /// Cycles without a reply.
    pub missed: u32,
    /// Replies that came after their cycle.
    pub late: u32,
    /// When the last reply arrived, ns; 0 before the first.
    pub receive_ns: u64,
}

/// The mode of a motor, as the daemon knows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Mode {
    Offline,
    Idle,
    Starting,
    Active,
    Damping,
    Fault,
    Excluded,
}

/// One group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Group {
    /// Where it is between standing still and following setpoints.
    pub phase: Phase,
    /// Why it was stopped.
    pub cause: Cause,
    /// Setpoint messages, accepted or rejected, modulo 2³².
    pub messages: u32,
}

/// Where a group is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Phase {
    Disarmed,
    Starting,
    Active,
    Damping,
}

/// Why a group was stopped, as far as rules differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// It was not.
    None,
    /// Its owner is late.
    SetpointTimeout,
    /// Its owner is gone.
    OwnerLost,
    /// Somebody asked for it.
    EmergencyStop,
    /// Another, by its number.
    Other(u32),
}

/// One bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bus {
    /// The cycle takes it for lost: off, down or gone.
    pub given_up: bool,
    /// Frames that the bus accepted, modulo 2³².
    pub sent: u32,
    /// All counters of the bus, `sent` among them. They never fall.
    pub counters: [u32; 8],
}
