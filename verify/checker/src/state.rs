//! The part of the published state that is checked. The program that runs the cycle fills it in.

/// The state that was published after a cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Number of the cycle; missed ticks leave a gap.
    pub cycle: u64,
    /// Number of missed ticks.
    pub missed_ticks: u64,
    /// Time at which the cycle began.
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
    /// Position, rad; NaN when it is not known.
    pub position: f32,
    /// Velocity, rad/s.
    pub velocity: f32,
    /// Stiffness sent in this cycle, N·m/rad.
    pub applied_kp: f32,
    /// Damping sent in this cycle, N·m·s/rad.
    pub applied_kd: f32,
    /// Velocity sent in this cycle, rad/s.
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
    /// Replies that arrived after their cycle.
    pub late: u32,
    /// Time at which the last reply arrived, ns; 0 before the first.
    pub receive_ns: u64,
}

/// The mode of a motor, as the daemon reports it.
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
    /// Its phase between disarmed and following setpoints.
    pub phase: Phase,
    /// The cause of its stop.
    pub cause: Cause,
    /// Setpoint messages, accepted or rejected, modulo 2³².
    pub messages: u32,
}

/// The phase of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Phase {
    Disarmed,
    Starting,
    Active,
    Damping,
}

/// The cause for which a group was stopped, as far as rules differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// It was not stopped.
    None,
    /// Its owner is late.
    SetpointTimeout,
    /// Its owner has exited.
    OwnerLost,
    /// A client requested it.
    EmergencyStop,
    /// Another cause, by its number.
    Other(u32),
}

/// One bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bus {
    /// The cycle has given the bus up: off, down or gone.
    pub given_up: bool,
    /// None of its motors answers: they receive probes only.
    pub held: bool,
    /// Frames that the bus accepted, modulo 2³².
    pub sent: u32,
    /// All counters of the bus, `sent` among them. They never fall.
    pub counters: [u32; 8],
}
