//! Settings of a simulated bus and its motors: physical properties, and the choices that the vendor
//! documents leave open.

use crate::dialect::Dialect;
use crate::drive_facts::DriveFacts;
use crate::imu_node::ImuNodeSettings;
use motord_bus::Duration;

/// Settings of one bus.
#[derive(Debug, Clone, PartialEq)]
pub struct BusSettings {
    /// The name that fault verbs use for it.
    pub name: String,
    /// The wire: CAN or a serial line.
    pub medium: Medium,
    /// Bit rate of the host's controller, bit/s. A motor that is configured for another rate does
    /// not receive its frames.
    pub bitrate: u32,
    /// Bit rate of the wire itself, bit/s, if it is not `bitrate`. A high rate compensates for the
    /// delays of a slow machine.
    pub wire_bitrate: Option<u32>,
    /// Bit rate of the wire for the payload of CAN FD frames with BRS, bit/s.
    pub data_bitrate: u32,
    /// Frames that can wait for the wire before [`Refusal::Full`](motord_bus::Refusal::Full); Linux
    /// has 10 by default.
    pub tx_queue: usize,
    /// Frames that the adapter keeps, in addition to `tx_queue`, while no node has power: a frame is
    /// repeated until another node acknowledges it. `None` is a bus on which frames also leave
    /// without such a node, as on one with another device.
    pub adapter: Option<usize>,
    /// Arrivals that can wait to be received. Further ones are lost and counted, as in a socket's
    /// buffer.
    pub rx_queue: usize,
    /// Number of frames that [`SimulatedBus::take_record`](crate::SimulatedBus::take_record) keeps,
    /// the newest; 0: none.
    pub record: usize,
    /// The IMUs on it. A serial line has none.
    pub imus: Vec<ImuNodeSettings>,
}

impl Default for BusSettings {
    fn default() -> Self {
        Self {
            name: "can0".into(),
            medium: Medium::Can,
            bitrate: 1_000_000,
            wire_bitrate: None,
            data_bitrate: 5_000_000,
            tx_queue: 10,
            adapter: None,
            rx_queue: 256,
            record: 0,
            imus: Vec::new(),
        }
    }
}

/// The kind of wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Medium {
    /// The lowest id is sent first when the wire is idle.
    Can,
    /// RS485 or RS232 at 10 bits a byte. Answers that overlap destroy each other, so the host must
    /// keep only one request open at a time. A frame's id is the address byte of its header.
    Serial,
}

/// Settings of one motor. Every value must be finite. The rotor's inertia, constants, ratios, peaks
/// and time constants must be above zero. The load's inertia, friction and the winding's properties
/// must be zero or above. The default is a GIM8108-8 on a light leg, by its published figures where
/// they exist.
#[derive(Debug, Clone, PartialEq)]
pub struct MotorSettings {
    /// The name that fault verbs and tests use for it.
    pub name: String,
    /// The motor has the vendor's defaults: id 1, host id 0, 1 Mbit/s, SteadyWin's and RobStride's in
    /// their own protocol and others in MIT mode. The ids and the protocol below are then ignored. A
    /// driver with CANSimple has no other protocol, and 500 kbit/s. An ODrive has no other protocol,
    /// and 250 kbit/s, and sends only its heartbeat and its estimates by itself.
    pub is_new: bool,
    /// The motor has power at the start. The verb `on` gives it power.
    pub has_power: bool,
    /// CAN ID (ConfID 0x12); a value above 0x7FF counts as 0x7FF.
    pub id: u16,
    /// Id of its answers (ConfID 0x13); a value above 0x7FF counts as 0x7FF.
    pub host_id: u16,
    /// Protocol over CAN at the start.
    pub dialect: Dialect,
    /// Vendor of its MIT protocol: `steadywin`, or another name that the simulator supports.
    pub vendor: &'static str,
    /// Facts of its drive, for a vendor that the simulator does not support by name.
    pub drive: Option<DriveFacts>,
    /// Values of the largest codes of position, rad, velocity, rad/s, and torque, N·m. `None` means
    /// SteadyWin's: 12.5 rad, 65 rad/s, and the torque of 225 A.
    pub ends: Option<[f64; 3]>,
    /// Values of the largest codes of stiffness, N·m/rad, and damping, N·m·s/rad.
    pub gain_ends: [f64; 2],
    /// Rotor side, N·m/A.
    pub torque_constant: f64,
    /// Rotor turns per output turn.
    pub gear_ratio: f64,
    /// Highest torque, output side, N·m.
    pub torque_peak: f64,
    /// No-load speed, output side, rad/s. Driving torque decreases linearly to zero at this speed.
    pub velocity_max: f64,
    /// Of the rotor alone, kg·m².
    pub rotor_inertia: f64,
    /// Inertia of the load on the output, kg·m².
    pub load_inertia: f64,
    /// Constant external torque on the output, N·m.
    pub load_torque: f64,
    /// Output side, N·m·s/rad.
    pub viscous_friction: f64,
    /// Output side, N·m.
    pub coulomb_friction: f64,
    /// With CANSimple: error of the zero after each boot, rad.
    pub zero_shift: f64,
    /// Position that the motor reports at the start, rad.
    pub initial_position: f64,
    /// Line to line, Ω.
    pub winding_resistance: f64,
    /// Line to line, H.
    pub winding_inductance: f64,
    /// Electrical turns per rotor turn.
    pub pole_pairs: u8,
    /// Winding to air, K/W.
    pub thermal_resistance: f64,
    /// Time constant of the winding's temperature, s.
    pub thermal_time: f64,
    /// Air, °C.
    pub ambient_celsius: f64,
    /// Voltage at the motor's power connector, V.
    pub supply_voltage: f64,
    /// Answer to get-version.
    pub version: u32,
    /// Time from the end of a command to the moment at which its answer contends for the wire.
    pub reply_latency: Duration,
    /// Random variation of each answer's latency: uniform from `reply_latency` minus this to
    /// `reply_latency` plus this.
    pub reply_jitter: Duration,
    /// Time for which a calibration turns the shaft. The answer follows it, even if the calibration
    /// was stopped before.
    pub calibration_time: Duration,
    /// Time for which a motor is silent after its power returned.
    pub boot_time: Duration,
    /// Interval of the estimates and torques that an ODrive sends by itself; zero: it sends none.
    pub report_period: Duration,
    /// An ODrive also sends its torques by itself, and its supply each 100 ms.
    pub reports_torque: bool,
    /// The choices that the documents leave open.
    pub behaviour: Behaviour,
}

impl Default for MotorSettings {
    fn default() -> Self {
        Self {
            name: "motor".into(),
            is_new: false,
            has_power: true,
            id: 1,
            host_id: 0x101,
            dialect: Dialect::Mit,
            vendor: "steadywin",
            drive: None,
            ends: None,
            gain_ends: [500.0, 5.0],
            torque_constant: 0.125,
            gear_ratio: 8.0,
            torque_peak: 22.0,
            velocity_max: 33.5,
            rotor_inertia: 6e-5,
            load_inertia: 0.01,
            load_torque: 0.0,
            viscous_friction: 0.02,
            coulomb_friction: 0.15,
            zero_shift: 0.0,
            initial_position: 0.0,
            winding_resistance: 0.67,
            winding_inductance: 0.45e-3,
            pole_pairs: 21,
            thermal_resistance: 2.0,
            thermal_time: 40.0,
            ambient_celsius: 25.0,
            supply_voltage: 48.0,
            version: 0x0001_0203,
            reply_latency: Duration::from_micros(50),
            reply_jitter: Duration::ZERO,
            calibration_time: Duration::from_secs(5),
            boot_time: Duration::from_millis(300),
            report_period: Duration::from_millis(10),
            reports_torque: true,
            behaviour: Behaviour::default(),
        }
    }
}

impl MotorSettings {
    /// Returns the amplitude of the back EMF of a phase, V per rad/s of the rotor. The power
    /// balance of amplitude-invariant axes, 3/2 · vq · iq = torque · velocity, gives it from the
    /// torque constant.
    pub(crate) const fn back_emf(&self) -> f64 {
        self.torque_constant / 1.5
    }

    /// Checks the settings.
    ///
    /// # Panics
    ///
    /// When no motor can have these properties. The author of the settings must notice it before a
    /// robot is tested with them.
    pub(crate) fn assert_physical(&self) {
        let positive = [
            self.torque_constant,
            self.gear_ratio,
            self.torque_peak,
            self.velocity_max,
            self.rotor_inertia,
            self.thermal_time,
        ];
        let not_negative = [
            self.load_inertia,
            self.viscous_friction,
            self.coulomb_friction,
            self.winding_resistance,
            self.winding_inductance,
            self.thermal_resistance,
        ];
        let any = [
            self.zero_shift,
            self.load_torque,
            self.initial_position,
            self.ambient_celsius,
            self.supply_voltage,
        ];
        let physical = positive.iter().all(|value| *value > 0.0)
            && not_negative.iter().all(|value| *value >= 0.0)
            && [&positive[..], &not_negative, &any].concat().iter().all(|value| value.is_finite());
        assert!(physical, "no motor has the properties of {}: {self:?}", self.name);
    }
}

/// The choices that the vendor documents leave open. Each default is the harder one for the host,
/// with three exceptions: the silence after set zero, which only other vendors' motors have, the
/// stale bytes, and the motor at another bit rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Behaviour {
    /// The state in an answer.
    pub reply_timing: ReplyTiming,
    /// Codes in answers are truncated instead of rounded, as by a cast in C.
    pub truncates: bool,
    /// The reaction to a silent host.
    pub host_loss: HostLoss,
    /// The refusal of a motor in fault.
    pub in_fault: InFault,
    /// The position that is reported beyond the range of its code.
    pub beyond_range: BeyondRange,
    /// An MIT motor executes control frames only after a start command. Without it, the first
    /// control frame after its power returns moves it.
    pub needs_start: bool,
    /// A stopped MIT motor stores control frames, and the start command executes the last one.
    pub remembers_control: bool,
    /// An MIT motor is silent for this time after set zero.
    pub zeroing_silence: Duration,
    /// The end of a native control command with a duration.
    pub duration_end: DurationEnd,
    /// Event at which a written configuration item becomes non-volatile.
    pub persistence: Persistence,
    /// The reaction to a CAN bus of another bit rate.
    pub other_bitrate: OtherBitrate,
    /// Bytes of an answer without a meaning (NULL in the GIM document) are those of the previous
    /// answer, instead of zero.
    pub stale_bytes: bool,
    /// The firmware of a RobStride motor.
    pub firmware: RobStrideFirmware,
}

impl Default for Behaviour {
    fn default() -> Self {
        Self {
            reply_timing: ReplyTiming::BeforeCommand,
            truncates: true,
            host_loss: HostLoss::KeepsCommand,
            in_fault: InFault::Silent,
            beyond_range: BeyondRange::Wraps,
            needs_start: true,
            remembers_control: true,
            zeroing_silence: Duration::ZERO,
            duration_end: DurationEnd::GoesLimp,
            persistence: Persistence::OnRefresh,
            other_bitrate: OtherBitrate::Silent,
            stale_bytes: false,
            firmware: RobStrideFirmware::Manual2026,
        }
    }
}

/// The firmware of a RobStride motor, by the manual that describes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RobStrideFirmware {
    /// English manuals 1.0 of 2025-11-25: bytes 6 and 7 of a state are the temperature. A drive in
    /// fault does not report that in a state.
    Manual2025,
    /// Chinese manuals 1.1 of 2026-04-10: byte 6 of a state has mode, fault and warning above a
    /// temperature of 12 bits. A drive in fault answers with such a state.
    Manual2026,
}

/// The state in the answer to a control frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReplyTiming {
    /// The state before the command.
    BeforeCommand,
    /// The state with the new command's torque.
    AfterCommand,
}

/// The reaction of an MIT motor when control frames stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HostLoss {
    /// It continues the last one.
    KeepsCommand,
    /// It goes limp and stays started.
    GoesLimp {
        /// Time without control frames until then.
        after: Duration,
    },
}

/// Effect on a native control command when its duration is over. GIM document 3.2.7 to 3.2.9 call
/// it the "execution time". A duration of 0 is unlimited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DurationEnd {
    /// The motor goes limp and stays started. A position is reached by then.
    GoesLimp,
    /// It keeps torque or speed, and holds the position.
    HoldsCommand,
}

/// The reaction of a motor to a CAN bus with another bit rate than its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OtherBitrate {
    /// It takes no part in the bus.
    Silent,
    /// It destroys the first 16 frames that it receives after power-on. Its controller is then
    /// error passive (ISO 11898-1: receive error counter above 127). The senders repeat their
    /// frames.
    Disturbs,
}

/// Event at which a written configuration item becomes non-volatile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Persistence {
    /// The write.
    AtOnce,
    /// The next refresh configuration (GIM document 3.2.2).
    OnRefresh,
}

/// The answer of a motor with an unacknowledged fault to a command that it does not execute. Get
/// and clear fault always work. The English GIM document (3.2.16) uses the term "decline", the
/// Chinese one "refuse to respond".
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InFault {
    /// Natively with result 0x01, in MIT with its state.
    Refuses,
    /// No answer.
    Silent,
}

/// The reported code of a position that 16 bits cannot hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BeyondRange {
    /// The code modulo 65536.
    Wraps,
    /// The code at the end of the range.
    Clamps,
}
