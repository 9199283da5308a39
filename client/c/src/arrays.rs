//! Values of all joints of a group, in the order of a claim.

use crate::generated::Quantity;
use crate::status::Failure;
use motord_client::{Claim, Error, Imu, Joint, Setpoint, State};

impl Quantity {
    /// Returns the quantity with this number. A caller in C may pass any.
    ///
    /// # Errors
    ///
    /// There is none.
    pub fn numbered(number: u32) -> Result<Self, Failure> {
        numbered(Self::ALL, number, "motord_quantity")
    }

    /// Returns the value in `joint`; NaN while it is unknown.
    fn of(self, joint: &Joint) -> f32 {
        let known = match self {
            Self::Temperature => joint.temperature,
            Self::SupplyVoltage => joint.supply_voltage,
            Self::SupplyCurrent => joint.supply_current,
            Self::AppliedPosition => Some(joint.applied.position),
            Self::AppliedVelocity => Some(joint.applied.velocity),
            Self::AppliedTorque => Some(joint.applied.torque),
            Self::AppliedKp => Some(joint.applied.kp),
            Self::AppliedKd => Some(joint.applied.kd),
            Self::Age => joint.age().map(|age| age.as_secs_f32()),
            measured => {
                let mut quantities = joint.quantities();
                quantities
                    .find(|(field, _)| field.quantity == Some(measured as u32))
                    .and_then(|(_, value)| value)
            }
        };
        known.unwrap_or(f32::NAN)
    }
}

/// Returns the entry with this number of an enumeration.
///
/// # Errors
///
/// There is none.
pub fn numbered<T: Copy>(all: &[T], number: u32, name: &str) -> Result<T, Failure> {
    let entry = all.get(number as usize).copied();
    entry.ok_or_else(|| Failure::bad_argument(format!("{number} is no {name}")))
}

/// A number of the caller's arrays.
pub trait Number: Copy {
    /// From a value of the robot.
    fn of(value: f32) -> Self;
    /// To a value of the robot.
    fn value(self) -> f32;
}

impl Number for f32 {
    fn of(value: f32) -> Self {
        value
    }
    fn value(self) -> f32 {
        self
    }
}

impl Number for f64 {
    fn of(value: f32) -> Self {
        value.into()
    }
    fn value(self) -> f32 {
        self as f32
    }
}

/// Writes a quantity of the joints with these indices to `values`. Does not allocate.
///
/// # Errors
///
/// The number of values differs from that of the joints.
pub fn read<N: Number>(
    state: &State,
    joints: &[usize],
    quantity: Quantity,
    values: &mut [N],
) -> Result<(), Failure> {
    check_count(joints.len(), values.len())?;
    for (value, index) in values.iter_mut().zip(joints) {
        *value = N::of(state.joint(*index).map_or(f32::NAN, |joint| quantity.of(&joint)));
    }
    Ok(())
}

/// The setpoints of a group; a missing array is zero.
#[derive(Debug, Clone, Copy)]
pub struct Setpoints<'a, N> {
    /// Position, velocity, stiffness, damping and torque.
    pub values: [Option<&'a [N]>; 5],
}

impl<N: Number> Setpoints<'_, N> {
    /// Returns the setpoint of the joint at this place.
    #[must_use]
    pub fn at(&self, index: usize) -> Setpoint {
        let [position, velocity, kp, kd, torque] = self
            .values
            .map(|values| values.and_then(|values| values.get(index)).map_or(0.0, |value| value.value()));
        Setpoint::impedance(position, velocity, kp, kd, torque)
    }
}

impl<N: Number> Setpoints<'_, N> {
    /// Sends the setpoints of a group of `count` joints. Does not allocate.
    ///
    /// # Errors
    ///
    /// Those of [`Claim::send`].
    pub fn send(&self, claim: &mut Claim, count: usize) -> Result<(), Error> {
        let mut all = [Setpoint::torque(0.0); JOINTS_MAX];
        let sent = all
            .get_mut(..count)
            .ok_or(Error::SetpointCount { expected: claim.joints().len(), received: count })?;
        sent.iter_mut().enumerate().for_each(|(index, setpoint)| *setpoint = self.at(index));
        claim.send(sent)
    }
}

/// Limit on the joints of a robot.
const JOINTS_MAX: usize = 64;

/// Checks the number of values of a caller.
///
/// # Errors
///
/// It is not that of the joints.
pub fn check_count(joints: usize, values: usize) -> Result<(), Failure> {
    match joints == values {
        true => Ok(()),
        false => Err(Error::SetpointCount { expected: joints, received: values }.into()),
    }
}

/// An IMU after a cycle. Values are NaN before the first sample.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct ImuValues {
    /// Orientation of the body in the world: a unit quaternion w, x, y, z.
    pub orientation: [f64; 4],
    /// Angular velocity of the body, rad/s.
    pub angular_velocity: [f64; 3],
    /// Specific force on the body, m/s²: at rest 9.81 upwards.
    pub acceleration: [f64; 3],
    /// Direction of gravity in the frame of the body, a unit vector: 0, 0, -1 for a level body.
    pub projected_gravity: [f64; 3],
    /// Temperature of the sensor, °C; NaN where it reports none.
    pub temperature: f64,
    /// Time from the receipt of the sample to now, s.
    pub age: f64,
    /// Samples received since the daemon started.
    pub sequence: u64,
    /// A sample was received since the previous states were published.
    pub fresh: bool,
    /// No sample for longer than `lost-after-ms`, or the device is disconnected.
    pub lost: bool,
    /// Bits of the conventions in which orientation and acceleration would agree about gravity, while they contradict each other at
    /// rest; 0 while they agree: 1 `quaternion-xyzw`, 2 `quaternion-inverse`, 4 `quaternion-ned`, 8 `z-down`, 16 `acceleration-axes`,
    /// 32 `acceleration-in-g`, 64 `without-gravity`, 128 `direction`, 256 `size`. `motorctl explain` has their meaning.
    pub contradictions: u32,
}

impl From<&Imu> for ImuValues {
    fn from(imu: &Imu) -> Self {
        let wide = |values: Option<[f32; 3]>| values.map_or([f64::NAN; 3], |values| values.map(f64::from));
        Self {
            orientation: imu.orientation().map_or([f64::NAN; 4], |values| values.map(f64::from)),
            angular_velocity: wide(imu.angular_velocity()),
            acceleration: wide(imu.acceleration()),
            projected_gravity: wide(imu.projected_gravity()),
            temperature: imu.temperature.map_or(f64::NAN, f64::from),
            age: imu.age().map_or(f64::NAN, |age| age.as_secs_f64()),
            sequence: imu.sequence,
            fresh: imu.fresh,
            lost: imu.lost,
            contradictions: imu.contradiction_bits,
        }
    }
}
