//! The meaning of the integers in the messages.
//!
//! One table per kind of code: number, kebab-case name (for JSON and the command line), and a
//! sentence for people.

use crate::limits::HISTOGRAMS_MAX;
use core::ops::RangeInclusive;

/// Declares an enum whose variants have a stable number, a name and a sentence.
macro_rules! codes {
    ($(#[$doc:meta])* $type:ident { $($variant:ident = $code:literal $name:literal $sentence:literal,)+ }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u32)]
        pub enum $type {
            $(#[doc = $sentence] $variant = $code,)+
        }

        impl $type {
            /// All codes, in ascending order of their numbers.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)+];

            /// The names of the codes, in ascending order of their numbers.
            pub const NAMES: &'static [&'static str] = &[$($name,)+];

            /// Returns the number in the messages.
            #[must_use]
            pub const fn code(self) -> u32 {
                self as u32
            }

            /// Returns the kebab-case name, as in JSON and on the command line.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)+ }
            }

            /// Returns a sentence for people.
            #[must_use]
            pub const fn sentence(self) -> &'static str {
                match self { $(Self::$variant => $sentence,)+ }
            }
        }

        impl TryFrom<u32> for $type {
            type Error = UnknownCode;
            fn try_from(code: u32) -> Result<Self, UnknownCode> {
                match code { $($code => Ok(Self::$variant),)+ _ => Err(UnknownCode(code)) }
            }
        }

        impl core::fmt::Display for $type {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str(self.name())
            }
        }
    };
}

/// A number that is no code of its table: the other side is newer, or hostile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("unknown code {0}")]
pub struct UnknownCode(pub u32);

codes! {
    /// The state of one motor, as far as the daemon knows.
    MotorMode {
        Offline = 0 "offline" "The motor has not answered, or stopped answering.",
        Idle = 1 "idle" "The motor answers and is stopped.",
        Starting = 2 "starting" "The motor receives neutral commands and is being started.",
        Active = 3 "active" "The motor follows setpoints.",
        Damping = 4 "damping" "The motor is being damped; it will be stopped.",
        Fault = 5 "fault" "The motor reported a fault; it is stopped until the fault is cleared.",
        Excluded = 6 "excluded" "The joint is excluded: its motor gets stop frames only, and its group runs without it.",
    }
}

codes! {
    /// The phase of a group of joints, from rest to following setpoints.
    Phase {
        Disarmed = 0 "disarmed" "Every motor of the group is stopped.",
        Starting = 1 "starting" "The motors of the group are being started.",
        Active = 2 "active" "The group follows its owner's setpoints.",
        Damping = 3 "damping" "The group is being damped and will be stopped.",
    }
}

codes! {
    /// The cause of a group's stop. It stays latched until a reset.
    Cause {
        SetpointTimeout = 1 "setpoint-timeout" "The owner sent no valid setpoint within the setpoint timeout.",
        EmergencyStop = 2 "emergency-stop" "An emergency stop was requested.",
        MotorLost = 3 "motor-lost" "A motor stopped answering.",
        MotorFault = 4 "motor-fault" "A motor reported a fault.",
        TimeBase = 5 "time-base" "The cycle woke up too late: the time base is broken.",
        BusOff = 6 "bus-off" "A CAN controller left its bus after too many errors.",
        BusGone = 7 "bus-gone" "A bus interface went down or was unplugged.",
        TransmitStall = 8 "transmit-stall" "A bus did not accept frames for several cycles.",
        Implausible = 9 "implausible" "A motor reported states that physics does not allow.",
        EncoderStuck = 10 "encoder-stuck" "A motor reported a speed while its position did not change.",
        Overspeed = 11 "overspeed" "A joint turned faster than its limit allows.",
        FollowingError = 12 "following-error" "A joint stayed too far from its position setpoint.",
        DuplicateId = 13 "duplicate-id" "Two motors answered to one id.",
        OverTemperature = 14 "over-temperature" "A motor stayed too hot, or gave too much torque for too long.",
        Overload = 16 "overload" "Too many cycles came too late.",
        Shutdown = 17 "shutdown" "The daemon is shutting down.",
        StartFailed = 18 "start-failed" "A motor did not start in time.",
        OwnerLost = 20 "owner-lost" "The group was taken from its owner while it was active.",
        Suspended = 21 "suspended" "The computer was suspended.",
        RangeEnd = 22 "range-end" "A motor reached the end of the position range that it can report.",
        MotorOff = 23 "motor-off" "A motor reported that it is off, or almost none of its torque, while it should follow setpoints.",
        Disabled = 24 "disabled" "Another client than its owner disabled the group.",
        OwnerDied = 27 "owner-died" "The owner's process ended while its group was active.",
        DirectoryLost = 28 "directory-lost" "The daemon's files were removed from the runtime directory: no new client can reach it.",
        SwitchLost = 29 "switch-lost" "The dead man's switch was missing or hung, and the configuration requires it.",
        ForeignMaster = 33 "foreign-master" "Another program or device commanded a motor of the group.",
        ImuLost = 34 "imu-lost" "An IMU delivered no sample for too long, and the configuration stops for that.",
        TemperatureSensor = 35 "temperature-sensor" "A motor reported a temperature that no motor can have, for a second.",
        FramesLost = 36 "frames-lost" "A motor stopped answering while its bus lost received frames.",
        PowerLost = 37 "power-lost" "All motors of a bus stopped answering together.",
        SupplyLow = 38 "supply-low" "Most motors of the group reported a supply below the configured voltage.",
    }
}

impl Cause {
    /// Returns the next step of a person after a stop for this cause, as a sentence without its
    /// full stop. A reset follows it.
    #[must_use]
    pub const fn advice(self) -> &'static str {
        match self {
            Self::SetpointTimeout | Self::OwnerLost | Self::OwnerDied => {
                "Find out why the controller ended or was late"
            }
            Self::DirectoryLost => "Find out who removed the files, and start the daemon again",
            Self::SwitchLost => "Start `motord deadman`, or find out in its log why it hangs",
            Self::EmergencyStop => "Make sure that the robot may move safely",
            Self::MotorLost => "Check the motor's power, its CAN cable and its id",
            Self::FramesLost => {
                "Find the line `frames-lost` of the log, which names what is too slow: the adapter and its driver, or the cycle"
            }
            Self::PowerLost => {
                "Check the emergency stop, the fuse and the supply of the motors, and the cable between computer and motors"
            }
            Self::MotorFault => {
                "Find the faults in `motorctl status`, remove their cause, and run `motorctl fault clear JOINT`"
            }
            Self::TimeBase | Self::Overload => {
                "Reduce the other load of the computer, or give the cycle a separate processor: `motorctl doctor` prints the commands"
            }
            Self::BusOff => "Check the wiring, the termination and the bit rate of the bus",
            Self::SupplyLow => "Charge or replace the battery, or check the supply and its wires",
            Self::BusGone => "Plug in the adapter, and bring the interface up",
            Self::TransmitStall => {
                "Check that a motor on the bus has power: a CAN frame must be acknowledged by another node"
            }
            Self::Implausible | Self::EncoderStuck => "Check the motor's encoder and cable",
            Self::Overspeed | Self::FollowingError => {
                "Check the controller's setpoints and that the joint moves freely"
            }
            Self::ForeignMaster => {
                "Find the sender of the ids that the log names, such as another program or a device on the cable, and stop it"
            }
            Self::ImuLost => "Check the cable and the power of the IMU that the log names",
            Self::DuplicateId => "Connect the motors of the bus one at a time, and give each its own id",
            Self::OverTemperature => "Let the motor cool down",
            Self::TemperatureSensor => {
                "Read the motor's temperature with its vendor's tool, and replace a motor whose sensor is broken"
            }
            Self::Shutdown => "Start the daemon again",
            Self::StartFailed => "Check the motor's power, and that it uses the configured protocol",
            Self::Suspended => "Disable suspension of the computer",
            Self::Disabled => "Ask the operator who disabled the group whether it may move again",
            Self::MotorOff => "Check the motor's supply: the motor may have restarted",
            Self::RangeEnd => "Turn the joint by hand to the middle of its range",
        }
    }
}

codes! {
    /// A fault that a motor reports, in words that all vendors share; the number is its bit in
    /// `JointState::fault` and in `motord_protocol::Faults`.
    Fault {
        FocFrequency = 0 "foc-frequency" "The current loop could not keep its rate (FOC frequency too high).",
        OverVoltage = 1 "over-voltage" "The bus voltage is above the driver's threshold.",
        UnderVoltage = 2 "under-voltage" "The bus voltage is below the driver's threshold.",
        OverTemperature = 3 "over-temperature" "The motor or its driver is hotter than the driver's threshold.",
        StartFailure = 4 "start-failure" "The motor could not be started.",
        OverCurrent = 6 "over-current" "The current was above what the driver allows.",
        Software = 7 "software" "The driver's software met a condition it could not handle (software exception).",
        DriverOverTemperature = 8 "driver-over-temperature" "The driver's transistors are hotter than its threshold.",
        MotorOverTemperature = 9 "motor-over-temperature" "The motor's winding is hotter than the driver's threshold.",
        HostSilent = 10 "host-silent" "The driver received no command for longer than its timeout.",
        Overload = 11 "overload" "The motor was overloaded or stalled for too long.",
        DriverChip = 12 "driver-chip" "The driver's gate driver chip reports a fault.",
        Encoder = 13 "encoder" "The encoder is not calibrated, or does not work.",
        Hardware = 14 "hardware" "The driver does not recognise its own hardware.",
        Position = 15 "position" "The driver could not find the motor's position at its start.",
        Unrecognised = 23 "unrecognised" "The motor reports a fault that is in no document: look at the number in the highest byte.",
    }
}

impl Fault {
    /// Returns the bit of this fault in `JointState::fault`.
    #[must_use]
    pub const fn bit(self) -> u32 {
        1 << self.code()
    }

    /// Returns the faults whose bits are set, lowest bit first.
    pub fn of_bits(bits: u32) -> impl Iterator<Item = Self> {
        Self::ALL.iter().copied().filter(move |fault| bits & fault.bit() != 0)
    }

    /// Returns the bits without a name, and the vendor's number in the highest byte.
    #[must_use]
    pub fn unnamed(bits: u32) -> u32 {
        Self::of_bits(bits).fold(bits, |rest, fault| rest & !fault.bit())
    }
}

codes! {
    /// The operation of an administrative request.
    Operation {
        Claim = 1 "claim" "Become the owner of a group.",
        Release = 2 "release" "Release a group.",
        ForceRelease = 3 "force-release" "Remove the owner of a group.",
        Enable = 4 "enable" "Start the motors of a group and follow its owner's setpoints.",
        Disable = 5 "disable" "Damp and stop the motors of a group.",
        Reset = 6 "reset" "Clear the latched cause of a stop.",
        EmergencyStop = 7 "emergency-stop" "Damp and stop every motor now.",
        SetZero = 8 "set-zero" "Store the present position of a stopped motor as its zero.",
        ClearFault = 9 "clear-fault" "Clear the fault of a motor.",
        Describe = 10 "describe" "Return names and limits of joints, groups and buses, as JSON.",
        Telemetry = 11 "telemetry" "Return counters and latency percentiles, as JSON.",
        Exclude = 12 "exclude" "Exclude a joint that is missing or broken from its group.",
        Include = 13 "include" "End the exclusion of a joint.",
        Histograms = 14 "histograms" "Return latency histograms, from the one with this number on, as JSON.",
        ResetTelemetry = 15 "reset-telemetry" "Reset the counters and histograms of telemetry.",
    }
}

codes! {
    /// The reason why an administrative request was refused. 0 is success; 19 was used once, and
    /// stays free.
    Refusal {
        UnknownOperation = 1 "unknown-operation" "The daemon does not know this request; is the client newer than the daemon?",
        UnknownGroup = 2 "unknown-group" "There is no such group.",
        UnknownJoint = 3 "unknown-joint" "There is no such joint.",
        Owned = 4 "owned" "Another process owns this group.",
        NotOwner = 5 "not-owner" "The claim does not own this group, or no longer owns it: claim it again.",
        NoOwner = 6 "no-owner" "No process owns this group: a controller must claim it and send setpoints first.",
        Latched = 7 "latched" "The group was stopped for a cause that is still latched: reset it first, with `motorctl reset`.",
        EmergencyStopActive = 8 "emergency-stop-active" "The emergency stop is latched: reset it first, with `motorctl reset`.",
        MotorOffline = 9 "motor-offline" "A motor of the group does not answer.",
        MotorFault = 10 "motor-fault" "A motor of the group reports a fault: clear it first.",
        StateStale = 11 "state-stale" "The state of a motor of the group is not fresh.",
        NoSetpoint = 12 "no-setpoint" "The owner sends no valid setpoints.",
        SetpointTooFar = 13 "setpoint-too-far" "A position setpoint is too far from its joint: the joint would jump when it is enabled.",
        NotDisarmed = 14 "not-disarmed" "The group must be stopped first.",
        NotNeutral = 15 "not-neutral" "Every motor of the group must be stopped before a reset.",
        BusDown = 16 "bus-down" "A bus of the group is not working.",
        Busy = 17 "busy" "Too many requests are under way: try again.",
        ShuttingDown = 18 "shutting-down" "The daemon is shutting down.",
        NoLease = 20 "no-lease" "The daemon ran out of leases.",
        Malformed = 21 "malformed" "The request is not well formed.",
        NotConfirmed = 22 "not-confirmed" "The motor did not confirm it in time.",
        DuplicateId = 23 "duplicate-id" "Two motors answer to the id of a motor of the group.",
        Moving = 24 "moving" "The joint moves, or its velocity is not known.",
        Mismatch = 25 "mismatch" "A motor of the group is not the motor that is configured: the daemon's log names the difference; `motorctl setup` compares all of them.",
        Excluded = 26 "excluded" "The joint is excluded: include it, or allow in the configuration that its group runs without it.",
        OutsideLimits = 27 "outside-limits" "A joint is outside its position limits, and would be pulled back into them: move it by hand, or correct its limits.",
        TooSoon = 28 "too-soon" "The zero of this joint was set less than ten seconds ago, and each zero is a write to the flash of its motor: wait.",
        TurnLost = 29 "turn-lost" "The position of a joint differs by whole turns of its motor from the one before it was silent, or by more than it can have moved: switch the motor off, turn the joint to within half a turn of its zero, and switch it on; or confirm the position with `motorctl fault clear JOINT`.",
        ForeignMaster = 33 "foreign-master" "Another program or device commands a motor of the group: the daemon's log names the id.",
        ImuLost = 34 "imu-lost" "An IMU delivers no samples, and the configuration stops for that: the daemon's log names it.",
        Unread = 35 "unread" "A motor of the group has not reported its registers since it answered first or again: try again; the daemon's log names a motor that does not report them.",
        SupplyLow = 38 "supply-low" "Most motors of the group report a supply below the configured voltage, or none reports one: charge or replace the battery.",
    }
}

impl Operation {
    /// Returns the range of the argument, both ends included, in the unit that the operation's
    /// sentence names; `None` without an argument.
    #[must_use]
    pub const fn argument(self) -> Option<RangeInclusive<f64>> {
        match self {
            Self::Claim
            | Self::Release
            | Self::ForceRelease
            | Self::Enable
            | Self::Disable
            | Self::Reset
            | Self::EmergencyStop
            | Self::SetZero
            | Self::ClearFault
            | Self::Exclude
            | Self::Include
            | Self::Describe
            | Self::Telemetry
            | Self::ResetTelemetry => None,
            Self::Histograms => Some(0.0..=HISTOGRAMS_MAX as f64),
        }
    }
}

/// The meaning of `AdminReply::detail` with a refusal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// None; it is 0.
    Nothing,
    /// Index of the joint that the refusal is about.
    Joint,
    /// Process id of the group's owner.
    Process,
    /// `Cause` code that is latched.
    Cause,
    /// The number in the request that is no operation, group or joint.
    Unknown,
}

impl Refusal {
    /// Returns the meaning of `AdminReply::detail` with this refusal.
    #[must_use]
    pub const fn detail(self) -> Detail {
        match self {
            Self::UnknownOperation | Self::UnknownGroup | Self::UnknownJoint => Detail::Unknown,
            Self::Owned => Detail::Process,
            Self::Latched => Detail::Cause,
            Self::MotorOffline
            | Self::MotorFault
            | Self::StateStale
            | Self::SetpointTooFar
            | Self::OutsideLimits
            | Self::NotDisarmed
            | Self::BusDown
            | Self::Busy
            | Self::NotConfirmed
            | Self::DuplicateId
            | Self::ForeignMaster
            | Self::Moving
            | Self::TooSoon
            | Self::TurnLost
            | Self::Mismatch
            | Self::Unread
            | Self::Excluded => Detail::Joint,
            Self::NotOwner
            | Self::NoOwner
            | Self::EmergencyStopActive
            | Self::NoSetpoint
            | Self::NotNeutral
            | Self::ShuttingDown
            | Self::NoLease
            | Self::ImuLost
            | Self::SupplyLow
            | Self::Malformed => Detail::Nothing,
        }
    }

    /// Returns `true` if the same request may be granted later without a reset, a cleared fault or
    /// a corrected mistake. For example, power returns, a bus works again, an owner leaves, or the
    /// daemon's successor starts.
    #[must_use]
    pub const fn is_transient(self) -> bool {
        match self {
            Self::Owned
            | Self::NotOwner
            | Self::MotorOffline
            | Self::StateStale
            | Self::NoSetpoint
            | Self::NotDisarmed
            | Self::NotNeutral
            | Self::BusDown
            | Self::Busy
            | Self::NotConfirmed
            | Self::ShuttingDown
            | Self::TooSoon
            | Self::ForeignMaster
            | Self::ImuLost
            | Self::SupplyLow
            | Self::Unread
            | Self::Moving => true,
            Self::UnknownOperation
            | Self::UnknownGroup
            | Self::UnknownJoint
            | Self::NoOwner
            | Self::Latched
            | Self::EmergencyStopActive
            | Self::MotorFault
            | Self::SetpointTooFar
            | Self::OutsideLimits
            | Self::TurnLost
            | Self::NoLease
            | Self::Malformed
            | Self::DuplicateId
            | Self::Mismatch
            | Self::Excluded => false,
        }
    }
}

codes! {
    /// The reason why a whole setpoint message was rejected.
    Rejection {
        NotFinite = 0 "not-finite" "A value was not a finite number.",
        WrongLease = 1 "wrong-lease" "The lease does not own the group.",
        Sequence = 2 "sequence" "The sequence number did not rise, or rose by more than 2^32.",
        FromFuture = 3 "from-future" "Its time lies in the future.",
        Stale = 4 "stale" "It was older than the setpoint timeout when it arrived.",
        JointCount = 5 "joint-count" "It did not have exactly the joints of the group.",
        Mode = 6 "mode" "A joint's mode is unknown, or its motor does not support it.",
        Negative = 7 "negative" "A stiffness or damping was negative.",
        Horizon = 8 "horizon" "Its horizon was longer than `setpoint-horizon-max-ms`.",
    }
}

impl Rejection {
    /// Number of reasons.
    pub const COUNT: usize = Self::ALL.len();
}

codes! {
    /// A quantity that a native motor measures (GIM document, table 10).
    Indicator {
        BusVoltage = 0 "bus-voltage" "Voltage of the supply.",
        BoardTemperature = 1 "board-temperature" "Temperature of the driver board.",
        MotorTemperature = 2 "motor-temperature" "Temperature of the motor.",
        Power = 3 "power" "Electrical power.",
        Ia = 4 "ia" "Current of phase A.",
        Ib = 5 "ib" "Current of phase B.",
        Ic = 6 "ic" "Current of phase C.",
        Ialpha = 7 "ialpha" "Current along the alpha axis.",
        Ibeta = 8 "ibeta" "Current along the beta axis.",
        Iq = 9 "iq" "Current along the q axis.",
        Id = 10 "id" "Current along the d axis.",
        IqTarget = 11 "iq-target" "Target of the current along the q axis.",
        IdTarget = 12 "id-target" "Target of the current along the d axis.",
        Vq = 13 "vq" "Voltage along the q axis.",
        Vd = 14 "vd" "Voltage along the d axis.",
        Valpha = 15 "valpha" "Voltage along the alpha axis.",
        Vbeta = 16 "vbeta" "Voltage along the beta axis.",
        RotorElectricalAngle = 17 "rotor-electrical-angle" "Electrical angle of the rotor.",
        RotorMechanicalAngle = 18 "rotor-mechanical-angle" "Mechanical angle of the rotor.",
        ShaftAngle = 19 "shaft-angle" "Angle of the output shaft.",
        ShaftSpeed = 20 "shaft-speed" "Speed of the output shaft.",
        OutputPower = 21 "output-power" "Mechanical power.",
    }
}

impl Indicator {
    /// Returns the unit of its value.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::BusVoltage | Self::Vq | Self::Vd | Self::Valpha | Self::Vbeta => "V",
            Self::BoardTemperature | Self::MotorTemperature => "°C",
            Self::Power | Self::OutputPower => "W",
            Self::Ia
            | Self::Ib
            | Self::Ic
            | Self::Ialpha
            | Self::Ibeta
            | Self::Iq
            | Self::Id
            | Self::IqTarget
            | Self::IdTarget => "A",
            Self::RotorElectricalAngle | Self::RotorMechanicalAngle | Self::ShaftAngle => "rad",
            Self::ShaftSpeed => "rpm",
        }
    }
}

codes! {
    /// The control mode of a joint's setpoint.
    SetpointMode {
        Impedance = 0 "impedance" "Position, velocity, stiffness, damping and torque.",
        Torque = 1 "torque" "Torque only (native motors).",
        Speed = 2 "speed" "Velocity only (native motors).",
        Position = 3 "position" "Position only (native motors).",
    }
}

codes! {
    /// A limit that changed a setpoint before it was sent; the number is its bit in
    /// `JointState::limits`.
    Limit {
        Position = 0 "position" "The position was clamped.",
        Velocity = 1 "velocity" "The velocity was clamped.",
        Kp = 2 "kp" "The stiffness was clamped.",
        Kd = 3 "kd" "The damping was clamped.",
        Torque = 4 "torque" "The torque was clamped.",
        PositionSlew = 5 "position-slew" "The position changed too fast.",
        KpSlew = 6 "kp-slew" "The stiffness changed too fast.",
        KdSlew = 7 "kd-slew" "The damping changed too fast.",
        TorqueSlew = 8 "torque-slew" "The torque changed too fast.",
        TotalTorque = 9 "total-torque" "Stiffness, damping and torque together asked for too much torque.",
        Temperature = 10 "temperature" "The motor is hot: its torque is derated.",
        StartRamp = 11 "start-ramp" "The gains are still rising after the start.",
        Overload = 12 "overload" "The motor gave more than its rated torque for too long: its torque is derated.",
    }
}

impl Limit {
    /// The bits of the limits that clamp a value of a setpoint to the range of its joint.
    pub const CLAMPS: u32 =
        Self::Position.bit() | Self::Velocity.bit() | Self::Kp.bit() | Self::Kd.bit() | Self::Torque.bit();

    /// Returns the bit of this limit in `JointState::limits`.
    #[must_use]
    pub const fn bit(self) -> u32 {
        1 << self.code()
    }
}

codes! {
    /// A convention of an IMU's driver that contradicts gravity while the body rests; the number is
    /// its bit in `ImuState::contradictions`. Several bits at once are one finding: all of them
    /// together make orientation and acceleration agree.
    ImuContradiction {
        QuaternionXyzw = 0 "quaternion-xyzw" "Read as x, y, z, w, the quaternion would agree: send w, x, y, z.",
        QuaternionInverse = 1 "quaternion-inverse" "Read as world to body, the quaternion would agree: send body to world, the conjugate.",
        QuaternionNed = 2 "quaternion-ned" "Read in axes with z down (NED), the quaternion would agree: negate its y and z.",
        ZDown = 3 "z-down" "The acceleration points down: send the specific force, 9.81 m/s² upwards at rest, or turn all axes from z down (NED) to z up.",
        AccelerationAxes = 4 "acceleration-axes" "In other axes, the acceleration would agree: send quaternion and acceleration in the axes of one sensor.",
        AccelerationInG = 5 "acceleration-in-g" "Read in g, the acceleration would agree: send m/s², 9.80665 for each g.",
        WithoutGravity = 6 "without-gravity" "The acceleration is without gravity: send the specific force, 9.81 m/s² upwards at rest.",
        Direction = 7 "direction" "Quaternion and acceleration disagree about up in every known convention: check the driver and the calibration.",
        Size = 8 "size" "The acceleration is neither 9.81 m/s² nor 1 g: check its unit, its range and the calibration.",
    }
}

impl ImuContradiction {
    /// Returns the bit of this convention in `ImuState::contradictions`.
    #[must_use]
    pub const fn bit(self) -> u32 {
        1 << self.code()
    }

    /// Returns the conventions whose bits are set. Other bits are ignored.
    pub fn of_bits(bits: u32) -> impl Iterator<Item = Self> {
        Self::ALL.iter().copied().filter(move |convention| bits & convention.bit() != 0)
    }
}

codes! {
    /// The state of a bus, as far as the daemon knows.
    BusCondition {
        Active = 0 "active" "The controller takes full part in the bus.",
        Warning = 1 "warning" "The controller counted many errors.",
        Passive = 2 "passive" "The controller counted many errors, and may no longer interrupt other nodes.",
        Off = 3 "off" "The controller left the bus.",
        Down = 4 "down" "The interface is down.",
        Gone = 5 "gone" "The interface does not exist.",
        Exchanged = 6 "exchanged" "Another adapter has the name of the interface, and is not used.",
        Held = 7 "held" "No motor answers: the bus gets only probes until every motor has answered one.",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_turns_into_its_code_and_back() {
        for cause in Cause::ALL {
            assert_eq!(Cause::try_from(cause.code()), Ok(*cause));
        }
        assert_eq!(Refusal::try_from(0), Err(UnknownCode(0)), "0 is success, never a refusal");
        assert_eq!(MotorMode::try_from(u32::MAX), Err(UnknownCode(u32::MAX)));
    }

    #[test]
    fn limit_bits_are_distinct_and_fit_their_word() {
        let bits = Limit::ALL.iter().fold(0, |bits, limit| bits | limit.bit());
        assert_eq!(bits.count_ones() as usize, Limit::ALL.len());
    }
}
