//! Enumerations of `motord.h`, from the tables of a joint's state and of codes. Generated:
//! `MOTORD_WRITE_DOCS=1 cargo test -p motord-house generated` writes it.

/// A quantity of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub enum Quantity {
    /// Position, rad.
    Position = 0,
    /// Velocity, rad/s.
    Velocity = 1,
    /// Torque, N·m.
    Torque = 2,
    /// Temperature of the motor, °C.
    Temperature = 3,
    /// Position of the applied command, rad.
    AppliedPosition = 4,
    /// Velocity of the applied command, rad/s.
    AppliedVelocity = 5,
    /// Torque of the applied command, N·m.
    AppliedTorque = 6,
    /// Stiffness of the applied command, N·m/rad.
    AppliedKp = 7,
    /// Damping of the applied command, N·m·s/rad.
    AppliedKd = 8,
    /// Time from the motor's last reply to now, s; NaN before its first.
    Age = 9,
    /// Voltage of the supply as the motor last reported it, V.
    SupplyVoltage = 10,
    /// Current from the supply as the motor last reported it, A.
    SupplyCurrent = 11,
}

impl Quantity {
    /// All, in the order of their numbers.
    pub(crate) const ALL: &[Self] = &[
        Self::Position,
        Self::Velocity,
        Self::Torque,
        Self::Temperature,
        Self::AppliedPosition,
        Self::AppliedVelocity,
        Self::AppliedTorque,
        Self::AppliedKp,
        Self::AppliedKd,
        Self::Age,
        Self::SupplyVoltage,
        Self::SupplyCurrent,
    ];
}

/// A fault that a motor reports: a bit of `faults` of a `motord_joint`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub enum FaultBit {
    /// The current loop could not keep its rate (FOC frequency too high).
    FocFrequency = 1 << 0,
    /// The bus voltage is above the driver's threshold.
    OverVoltage = 1 << 1,
    /// The bus voltage is below the driver's threshold.
    UnderVoltage = 1 << 2,
    /// The motor or its driver is hotter than the driver's threshold.
    OverTemperature = 1 << 3,
    /// The motor could not be started.
    StartFailure = 1 << 4,
    /// The current was above what the driver allows.
    OverCurrent = 1 << 6,
    /// The driver's software met a condition it could not handle (software exception).
    Software = 1 << 7,
    /// The driver's transistors are hotter than its threshold.
    DriverOverTemperature = 1 << 8,
    /// The motor's winding is hotter than the driver's threshold.
    MotorOverTemperature = 1 << 9,
    /// The driver received no command for longer than its timeout.
    HostSilent = 1 << 10,
    /// The motor was overloaded or stalled for too long.
    Overload = 1 << 11,
    /// The driver's gate driver chip reports a fault.
    DriverChip = 1 << 12,
    /// The encoder is not calibrated, or does not work.
    Encoder = 1 << 13,
    /// The driver does not recognise its own hardware.
    Hardware = 1 << 14,
    /// The driver could not find the motor's position at its start.
    Position = 1 << 15,
    /// The motor reports a fault that is in no document: look at the number in the highest byte.
    Unrecognised = 1 << 23,
}

/// A limit that changed a command: a bit of `limits` of a `motord_joint`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub enum LimitBit {
    /// The position was clamped.
    Position = 1 << 0,
    /// The velocity was clamped.
    Velocity = 1 << 1,
    /// The stiffness was clamped.
    Kp = 1 << 2,
    /// The damping was clamped.
    Kd = 1 << 3,
    /// The torque was clamped.
    Torque = 1 << 4,
    /// The position changed too fast.
    PositionSlew = 1 << 5,
    /// The stiffness changed too fast.
    KpSlew = 1 << 6,
    /// The damping changed too fast.
    KdSlew = 1 << 7,
    /// The torque changed too fast.
    TorqueSlew = 1 << 8,
    /// Stiffness, damping and torque together asked for too much torque.
    TotalTorque = 1 << 9,
    /// The motor is hot: its torque is derated.
    Temperature = 1 << 10,
    /// The gains are still rising after the start.
    StartRamp = 1 << 11,
    /// The motor gave more than its rated torque for too long: its torque is derated.
    Overload = 1 << 12,
}
