//! The settings of a robot whose configuration names only what has no default: its buses and
//! motors. Cautious, and meant for a real robot.
//!
//! The configuration uses the same values: its test `omitted_keys_are_these_defaults` compares
//! them.

use crate::sensor::SensorSettings;
use crate::settings::{
    BeyondRange, BusSettings, CycleSettings, FaultPolicy, IpcMode, IpcSettings, LimitSettings, MARGIN,
    MotorSettings, MotorSimulation, REGISTERS_MAX, RegisterRange, SafeStop, SafetySettings, Settings,
    WindingSettings,
};
use core::num::NonZero;
use motord_bus::transport::BusKind;
use motord_bus::{Duration, FrameId};
use motord_protocol::drive::Transmission;
use motord_protocol::{DriveConstants, Model, MotorProtocol, Profile, Scales};
use motord_shared::DEFAULT_INSTANCE;

/// Busy polling of a cycle with a dedicated processor.
pub const BUSY_POLL: Duration = Duration::from_micros(30);
/// `SCHED_FIFO` priority of the ipc thread: above threaded interrupts, below the cycle.
pub const IPC_PRIORITY: u8 = 70;
/// Least setpoint timeout.
pub const SETPOINT_TIMEOUT: Duration = Duration::from_millis(20);
/// The dead man's switch waits for the largest lateness of a cycle, and for this many cycles.
pub const DEADMAN_CYCLES: u32 = 2;
/// Damping of a safe stop, N·m·s/rad.
pub const DAMPING_KD: f64 = 2.0;
/// A limit may be beyond what is usable by this fraction: the sum of a position limit and its
/// offset is rounded to `f32`.
pub const ROUNDING: f64 = 1e-5;
/// Beyond these values a register holds no end of a code: rad, rad/s, N·m.
const LARGEST_ENDS: [f64; REGISTERS_MAX] = [1000.0, 10_000.0, 10_000.0];

impl Default for Settings {
    /// A robot without buses and motors at 1 kHz.
    fn default() -> Self {
        Self {
            instance: DEFAULT_INSTANCE.to_owned(),
            cycle: CycleSettings::default(),
            ipc: IpcSettings::default(),
            safety: SafetySettings::default(),
            buses: Vec::new(),
            motors: Vec::new(),
            simulation: Vec::new(),
            groups: Vec::new(),
            sensors: SensorSettings::default(),
        }
    }
}

impl CycleSettings {
    /// Returns the settings for `rate_hz` cycles per second, above 0.
    ///
    /// # Panics
    ///
    /// If the period is not a duration.
    #[must_use]
    pub fn at_rate(rate_hz: f64) -> Self {
        let period = Duration::from_secs_f64(1.0 / rate_hz);
        Self {
            rate_hz,
            period,
            cpu: None,
            priority: 80,
            require_realtime: false,
            max_lateness: Duration::from_millis(5),
            max_missed_ticks: 0.5,
            reply_deadline: period.mul_f64(0.8),
            busy_poll: Duration::ZERO,
            indicator_hz: 1.0,
        }
    }
}

impl Default for CycleSettings {
    /// 1 kHz.
    fn default() -> Self {
        Self::at_rate(1000.0)
    }
}

impl IpcSettings {
    /// Returns the settings beside this cycle.
    #[must_use]
    pub fn beside(cycle: &CycleSettings) -> Self {
        Self {
            mode: IpcMode::Timed,
            lead: Duration::from_micros(20),
            busy_poll: Duration::from_micros(60),
            cpu: None,
            priority: Some(IPC_PRIORITY.min(cycle.priority.saturating_sub(1)).max(1)),
        }
    }
}

impl Default for IpcSettings {
    /// Those beside a default cycle.
    fn default() -> Self {
        Self::beside(&CycleSettings::default())
    }
}

impl SafetySettings {
    /// Returns the settings of a robot with this cycle.
    #[must_use]
    pub fn of(cycle: &CycleSettings) -> Self {
        Self {
            setpoint_timeout: SETPOINT_TIMEOUT.max(2 * cycle.period),
            setpoint_horizon_max: Duration::from_millis(40),
            safe_stop: SafeStop::Damp,
            damp: Duration::from_secs(2),
            rest_velocity: 0.2,
            lost_cycles: 10,
            start_jump: 0.1,
            start_ramp: Duration::from_millis(100),
            start_timeout: Duration::from_secs(1),
            fault_poll_hz: 10.0,
            deadman: cycle.max_lateness + DEADMAN_CYCLES * cycle.period,
            require_deadman: false,
            stop_on_foreign_master: true,
            error_feedback: true,
        }
    }
}

impl Default for SafetySettings {
    /// Those of a default cycle.
    fn default() -> Self {
        Self::of(&CycleSettings::default())
    }
}

impl BusSettings {
    /// Returns a bus whose motors get a command in every cycle.
    #[must_use]
    pub fn new(name: &str, kind: impl Into<BusKind>) -> Self {
        Self { name: name.to_owned(), kind: kind.into(), every: NonZero::<u32>::MIN }
    }
}

impl MotorSettings {
    /// Returns a motor on the first bus, which is a CAN bus, with the facts of its model. `None`
    /// for an unknown model, a protocol that its vendor does not speak, an id that its vendor does
    /// not permit, and a protocol whose torque codes only the motor's documents give
    /// ([`Family::needs_torque_end`](motord_protocol::Family::needs_torque_end)).
    ///
    /// Larger limits need registers to match: a motor whose register reports a smaller end does not
    /// start.
    #[must_use]
    pub fn of_model(name: &str, id: u8, protocol: MotorProtocol, model: &str) -> Option<Self> {
        let (profile, model) = Profile::of_model(model)?;
        let family = protocol.family();
        let [least, largest] = (family.ids)(profile);
        let is_spoken = family.is_spoken_by(profile) && !family.needs_torque_end;
        let may_be = (least..=largest).contains(&id) && is_spoken;
        let of_protocol = family.ends.map(|ends| Scales::of(&ends));
        let scales = of_protocol.or_else(|| model.scales().ok()).filter(|_| may_be)?;
        let winding = WindingSettings::of(model, &scales);
        let max_velocity = f64::from(model.max_velocity).min(scales.velocity.max()) as f32;
        let limits = LimitSettings::of(&scales, winding.rated_torque, max_velocity);
        Some(Self {
            name: name.to_owned(),
            bus: 0,
            id,
            host_id: FrameId::new((protocol.family().default_host_id)(profile, id))?,
            protocol,
            model: model.name.to_owned(),
            profile,
            scales,
            constants: family.uses_constants(model).then(|| DriveConstants::of(model)),
            winding,
            max_velocity,
            transmission: Transmission::new(1.0, 0.0),
            capabilities: (protocol.family().capabilities)(profile, &scales),
            registers: RegisterRange::beyond(&limits),
            duration: Default::default(),
            damping_kd: DAMPING_KD.min(limits.kd.into()) as f32,
            beyond_range: BeyondRange::Stop,
            fault_policy: FaultPolicy::StopGroup,
            may_be_excluded: false,
            excluded: false,
            limits,
        })
    }
}

impl WindingSettings {
    fn of(model: &Model, scales: &Scales) -> Self {
        let peak = f64::from(model.peak_torque).min(scales.torque.max());
        Self {
            rated_torque: f64::from(model.rated_torque).min(peak) as f32,
            peak_torque: peak as f32,
            overload: Duration::from_secs(10),
        }
    }
}

impl RegisterRange {
    /// Returns the ends of position, velocity and torque within which these limits are. No end is
    /// zero.
    fn beyond(limits: &LimitSettings) -> [Self; REGISTERS_MAX] {
        let reaches =
            [limits.position[0].abs().max(limits.position[1].abs()), limits.velocity, limits.torque];
        core::array::from_fn(|index| Self::reaching(reaches[index].into(), index))
    }

    /// Returns the ends of the codes of the register `index` with which its motor reaches a value.
    #[must_use]
    pub fn reaching(value: f64, index: usize) -> Self {
        let least = (value * (1.0 - ROUNDING) / (1.0 - MARGIN)).max(0.01);
        Self { least: least as f32, most: LARGEST_ENDS[index] as f32, written: None }
    }
}

impl Default for MotorSimulation {
    /// A motor at its zero, with the inertia and friction of its model.
    fn default() -> Self {
        Self {
            initial_position: 0.0,
            load_inertia: 0.01,
            armature: None,
            viscous_friction: None,
            coulomb_friction: None,
            reply_latency: Duration::from_micros(50),
        }
    }
}
