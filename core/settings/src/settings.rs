//! The checked configuration: every value present, in range, and in the units of the code.

use crate::sensor::SensorSettings;
use core::num::NonZero;
use motord_bus::arithmetic::FrameLength;
use motord_bus::transport::BusKind;
use motord_bus::{Duration, FrameId};
use motord_protocol::drive::{Addresses, DriveSettings, Transmission};
use motord_protocol::gim::ExecutionTime;
use motord_protocol::{Capabilities, DriveConstants, MotorProtocol, Profile, Scales};
use motord_shared::SetpointMode;

/// Everything that was configured.
#[derive(Debug, Clone)]
pub struct Settings {
    /// The instance's name: its services are `motord/<instance>/…`.
    pub instance: String,
    /// `[cycle]`.
    pub cycle: CycleSettings,
    /// `[ipc]`.
    pub ipc: IpcSettings,
    /// `[safety]`.
    pub safety: SafetySettings,
    /// `[[bus]]`, in the order of the file.
    pub buses: Vec<BusSettings>,
    /// `[[motor]]`, in the order of the file: motor and joint indices everywhere.
    pub motors: Vec<MotorSettings>,
    /// `[motor.simulation]`, in the order of the motors. Simulators use it, and the plan its reply
    /// latency.
    pub simulation: Vec<MotorSimulation>,
    /// `[[group]]`, or one group `all`. Every motor is in exactly one.
    pub groups: Vec<GroupSettings>,
    /// The sensors, such as `[[imu]]`.
    pub sensors: SensorSettings,
}

impl Settings {
    /// Returns the number of turns of a bus in which each of its motors has one. A serial line has
    /// one more, for questions about faults and indicators.
    #[must_use]
    pub fn turns(&self, bus: usize) -> usize {
        let motors = self.motors.iter().filter(|motor| motor.bus == bus).count();
        let polls = self.safety.fault_poll_hz > 0.0 || self.cycle.indicator_hz > 0.0;
        motors + usize::from(polls && self.buses[bus].is_line())
    }

    /// Returns the cycle, below `every`, of the turn number `turn` of a bus. The turns are spread
    /// evenly.
    #[must_use]
    pub fn first_turn(&self, bus: usize, turn: usize) -> u32 {
        let every = self.buses[bus].every.get();
        (turn * every as usize / self.turns(bus).max(1)) as u32
    }
}

/// `[cycle]`.
#[derive(Debug, Clone)]
pub struct CycleSettings {
    /// Cycles per second.
    pub rate_hz: f64,
    /// Time from one cycle to the next.
    pub period: Duration,
    /// The processor the cycle is pinned to; `None` leaves it to the scheduler.
    pub cpu: Option<usize>,
    /// `SCHED_FIFO` priority, 1 to 98.
    pub priority: u8,
    /// The daemon exits when it cannot get `SCHED_FIFO` and locked memory.
    pub require_realtime: bool,
    /// A cycle that begins later than this has lost its time base, which causes a safe stop.
    pub max_lateness: Duration,
    /// Share of the ticks of a second, 0 to 1, that may be missed. A larger share causes a safe
    /// stop.
    pub max_missed_ticks: f32,
    /// From the sending of a cycle's commands: replies that arrive later are missed.
    pub reply_deadline: Duration,
    /// Polls the buses for this long around the usual arrival of the last replies; zero only
    /// sleeps.
    pub busy_poll: Duration,
    /// Rate at which each indicator of a motor is polled, Hz; 0 never polls.
    pub indicator_hz: f64,
}

/// The way the ipc thread waits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IpcMode {
    /// Wakes when the states are ready, and `lead` before the next cycle to fetch setpoints.
    Timed,
    /// Polls. Needs a dedicated processor.
    Spin,
}

/// `[ipc]`.
#[derive(Debug, Clone)]
pub struct IpcSettings {
    /// The way it waits.
    pub mode: IpcMode,
    /// The setpoints are fetched this long before a tick.
    pub lead: Duration,
    /// Longest time that the states of a cycle are polled for in timed mode. Zero never polls.
    pub busy_poll: Duration,
    /// The processor it is pinned to.
    pub cpu: Option<usize>,
    /// `SCHED_FIFO` priority; `None` leaves it normal.
    pub priority: Option<u8>,
}

/// The way a group stops when there is a cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SafeStop {
    /// Damp (kp 0, kd of the motor, torque 0) until slow or for `damp`, then stop the motors. The
    /// default.
    Damp,
    /// Hold the position measured last with the last gains, damped, for `damp`; then damp and stop.
    Hold,
    /// Stop the motors immediately: they go limp.
    Stop,
}

/// The part of the robot that stops when a motor reports a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaultPolicy {
    /// That motor only.
    StopJoint,
    /// Its group. The default.
    StopGroup,
    /// Every group.
    StopAll,
}

/// `[safety]`.
#[derive(Debug, Clone)]
pub struct SafetySettings {
    /// An owner that sends no valid setpoint for this long loses its group.
    pub setpoint_timeout: Duration,
    /// Longest horizon of setpoints; zero permits none.
    pub setpoint_horizon_max: Duration,
    /// The way a group stops when there is a cause, where the group has no such setting.
    pub safe_stop: SafeStop,
    /// The longest a group is damped before its motors are stopped.
    pub damp: Duration,
    /// A damped joint slower than this, rad/s, is at rest.
    pub rest_velocity: f32,
    /// A motor without an answer in this many consecutive turns is lost.
    pub lost_cycles: u32,
    /// Largest distance between a joint and its position setpoint when it is enabled, rad.
    pub start_jump: f32,
    /// The gains rise from zero over this time after a start.
    pub start_ramp: Duration,
    /// The start of a group fails after this time.
    pub start_timeout: Duration,
    /// Rate at which each motor is asked for its faults, Hz; 0 never asks.
    pub fault_poll_hz: f64,
    /// The dead man's switch acts when the heartbeat stops updating for this long.
    pub deadman: Duration,
    /// Every group is stopped while the dead man's switch is unavailable or stalled.
    pub require_deadman: bool,
    /// A group is stopped while another sender commands its motors.
    pub stop_on_foreign_master: bool,
    /// Carry the rounding errors of torque and velocity from cycle to cycle.
    pub error_feedback: bool,
}

/// `[[bus]]`.
#[derive(Debug, Clone)]
pub struct BusSettings {
    /// Its name.
    pub name: String,
    /// Its transport, with the settings of that.
    pub kind: BusKind,
    /// Each of its motors gets a command once in this many cycles.
    pub every: NonZero<u32>,
}

impl BusSettings {
    /// One request at a time, and its reply may come in a later cycle.
    #[must_use]
    pub fn is_line(&self) -> bool {
        self.kind.is_line()
    }

    /// Not every motor gets a command in every cycle.
    #[must_use]
    pub const fn has_turns(&self) -> bool {
        self.every.get() > 1
    }

    /// The CAN interface; `None` for another kind of bus.
    #[must_use]
    pub fn interface(&self) -> Option<&str> {
        self.kind.interface()
    }

    /// The interface or device; the name of a simulated bus.
    #[must_use]
    pub fn device(&self) -> &str {
        self.kind.address().unwrap_or(&self.name)
    }
}

/// The behaviour of a motor beyond the end of its position codes. The vendors' documents do not
/// state it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BeyondRange {
    /// Unknown: stop before the end of the range. The default.
    Stop,
    /// The code wraps round: unwrap it.
    Wrap,
}

/// `[[motor]]`.
#[derive(Debug, Clone)]
pub struct MotorSettings {
    /// The joint's name.
    pub name: String,
    /// Index of its bus.
    pub bus: usize,
    /// Its CAN id (SteadyWin's ConfID 0x12), at least 1.
    pub id: u8,
    /// The id of its replies (SteadyWin's ConfID 0x13).
    pub host_id: FrameId,
    /// Its protocol.
    pub protocol: MotorProtocol,
    /// Its model's name.
    pub model: String,
    /// The facts of its vendor.
    pub profile: &'static Profile,
    /// The scales of its codes.
    pub scales: Scales,
    /// The constants that its scales follow from; `None` for a motor whose codes are torques.
    pub constants: Option<DriveConstants>,
    /// The torques that its winding bears.
    pub winding: WindingSettings,
    /// Its fastest speed without load, output side, rad/s.
    pub max_velocity: f32,
    /// Direction and offset of the joint on its motor.
    pub transmission: Transmission,
    /// The abilities of the motor that decisions depend on.
    pub capabilities: Capabilities,
    /// The values of its registers with which its group may start.
    pub registers: [RegisterRange; REGISTERS_MAX],
    /// Duration of each control command, for a motor whose commands have one. The effect of 0 is
    /// not documented.
    pub duration: ExecutionTime,
    /// Damping of a safe stop, N·m·s/rad. Not used for a motor without impedance mode: its drive
    /// brakes it.
    pub damping_kd: f32,
    /// The reaction at the end of the position range.
    pub beyond_range: BeyondRange,
    /// The part of the robot that stops when this motor reports a fault.
    pub fault_policy: FaultPolicy,
    /// The group may run while the joint is excluded.
    pub may_be_excluded: bool,
    /// The joint is excluded when the daemon starts.
    pub excluded: bool,
    /// `[motor.limits]`.
    pub limits: LimitSettings,
}

impl MotorSettings {
    /// The id of a command to it: the highest, where its commands have several.
    #[must_use]
    #[inline]
    pub fn command_id(&self) -> FrameId {
        self.addresses().command_id
    }

    /// Its ids on the bus.
    #[must_use]
    pub fn addresses(&self) -> Addresses {
        (self.protocol.family().addresses)(self.id, self.host_id)
    }

    /// Returns the lengths of a command to it and of its shortest reply with a state.
    #[must_use]
    pub fn frame_lengths(&self) -> [FrameLength; 2] {
        (self.protocol.family().frame_lengths)(self.profile)
    }

    /// Returns what its dialect knows. `error_feedback` is the setting of the robot.
    #[must_use]
    pub const fn drive(&self, error_feedback: bool) -> DriveSettings {
        DriveSettings {
            id: self.id,
            host_id: self.host_id,
            profile: self.profile,
            scales: self.scales,
            gear_ratio: match self.constants {
                Some(constants) => constants.gear_ratio as f32,
                None => 1.0,
            },
            transmission: self.transmission,
            limits: [self.limits.velocity, self.limits.torque],
            wraps: matches!(self.beyond_range, BeyondRange::Wrap),
            duration: self.duration,
            error_feedback,
        }
    }

    /// Returns whether the motor accepts setpoints of this mode.
    #[must_use]
    #[inline]
    pub fn accepts(&self, mode: SetpointMode) -> bool {
        mode == SetpointMode::Impedance || !self.capabilities.impedance
    }
}

/// Most registers that are read from a motor before its group may start.
pub const REGISTERS_MAX: usize = 3;

/// The values of a register with which the group of its motor may start, in the unit of the
/// register.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RegisterRange {
    /// The least.
    pub least: f32,
    /// The largest.
    pub most: f32,
    /// The value of a motor that does not report the register, as the configuration has it. A motor
    /// that reports none may start if each of its registers has one.
    pub written: Option<f32>,
}

impl RegisterRange {
    /// Every finite number.
    pub const ANY: Self = Self { least: f32::MIN, most: f32::MAX, written: None };

    /// Returns whether the group may start with this `value`; never for NaN and infinity.
    #[must_use]
    pub fn contains(&self, value: f32) -> bool {
        (self.least..=self.most).contains(&value)
    }
}

/// The torques that the winding of a motor bears, output side.
#[derive(Debug, Clone)]
pub struct WindingSettings {
    /// Continuous torque, N·m.
    pub rated_torque: f32,
    /// Highest torque, N·m.
    pub peak_torque: f32,
    /// Twice the rated torque may be given for this long by a cold motor.
    pub overload: Duration,
}

/// Largest position, rad at the motor: its behaviour at the end of the scale is not known.
pub const CAUTIOUS_POSITION: f64 = 12.0;
/// Largest velocity, rad/s.
pub const CAUTIOUS_VELOCITY: f64 = 60.0;
/// The full torque within 20 ms.
pub const TORQUE_SLEW_PER_S: f64 = 50.0;
/// The full gains within 50 ms.
pub const GAIN_SLEW_PER_S: f64 = 20.0;
/// Limits keep this fraction of the protocol's scale away from its end. A control frame whose
/// position, velocity and kp are all at their ends can be a special frame (MIT document 1.1), and a
/// reply at its end may be one that was clamped.
pub const MARGIN: f64 = 0.005;

/// `[motor.limits]`, joint side.
#[derive(Debug, Clone)]
pub struct LimitSettings {
    /// Lowest and highest position, rad.
    pub position: [f32; 2],
    /// Largest speed, rad/s, of setpoints and of the motion of position setpoints. A joint at 1.2
    /// times this speed is stopped.
    pub velocity: f32,
    /// Largest torque, N·m: of setpoints, and of kp·Δp + kd·Δv + torque.
    pub torque: f32,
    /// Largest stiffness, N·m/rad.
    pub kp: f32,
    /// Largest damping, N·m·s/rad.
    pub kd: f32,
    /// Fastest change of torque, N·m/s.
    pub torque_slew: f32,
    /// Fastest change of stiffness, N·m/rad/s.
    pub kp_slew: f32,
    /// Fastest change of damping, N·m·s/rad/s.
    pub kd_slew: f32,
    /// Above this temperature the torque is derated, °C.
    pub temperature_derate: f32,
    /// At this temperature the torque is zero; for a second it causes a safe stop, °C.
    pub temperature: f32,
    /// Largest distance between joint and position setpoint, rad; `None` permits half a turn, and
    /// more below the torque limit or while the joint approaches the setpoint.
    pub following_error: Option<f32>,
    /// Least share of a commanded torque that the motor must report, 0 to 0.9. A motor with less is
    /// off. 0 does not check it.
    pub torque_response: f32,
}

impl LimitSettings {
    /// Returns the limits of a motor with these codes, a continuous torque in N·m, and a velocity
    /// without load in rad/s.
    #[must_use]
    pub fn of(scales: &Scales, rated_torque: f32, max_velocity: f32) -> Self {
        let usable = 1.0 - MARGIN;
        let torque = f64::from(rated_torque).min(scales.torque.max() * usable);
        let velocity = f64::from(max_velocity).min(CAUTIOUS_VELOCITY).min(scales.velocity.max() * usable);
        let (kp, kd) = (100.0, 5.0);
        Self {
            position: [-CAUTIOUS_POSITION, CAUTIOUS_POSITION].map(|position| position as f32),
            velocity: velocity as f32,
            torque: torque as f32,
            kp: kp as f32,
            kd: kd as f32,
            torque_slew: (TORQUE_SLEW_PER_S * torque) as f32,
            kp_slew: (GAIN_SLEW_PER_S * kp) as f32,
            kd_slew: (GAIN_SLEW_PER_S * kd) as f32,
            temperature_derate: 70.0,
            temperature: 90.0,
            following_error: None,
            torque_response: 0.3,
        }
    }
}

/// `[motor.simulation]`: the physics of a simulated motor, output side.
#[derive(Debug, Clone)]
pub struct MotorSimulation {
    /// Position at the start, motor side, rad.
    pub initial_position: f64,
    /// Inertia of the load at the output, kg·m².
    pub load_inertia: f64,
    /// Inertia of the rotor behind its gear, kg·m²; `None`: that of the model.
    pub armature: Option<f64>,
    /// Viscous friction, N·m·s/rad; `None`: that of the model.
    pub viscous_friction: Option<f64>,
    /// Coulomb friction, N·m; `None`: that of the model.
    pub coulomb_friction: Option<f64>,
    /// Time from a command to the answer's first bit.
    pub reply_latency: Duration,
}

/// `[[group]]`.
#[derive(Debug, Clone)]
pub struct GroupSettings {
    /// Its name.
    pub name: String,
    /// Motor indices, rising.
    pub motors: Vec<usize>,
    /// The way it stops when there is a cause.
    pub safe_stop: SafeStop,
    /// Its supply.
    pub supply: SupplySettings,
}

/// The voltages below which most motors of a group must report their supply before motord reacts. 0
/// never reacts.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SupplySettings {
    /// The log has a warning, V.
    pub warn: f32,
    /// The group is stopped, V.
    pub stop: f32,
}
