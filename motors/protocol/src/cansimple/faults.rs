//! The errors of a driver, in terms that all vendors share.

use super::Heartbeat;
use crate::fault::Faults;

/// An error of the axis that only points to the errors of the motor.
const MOTOR_FAILED: u32 = 1 << 6;

/// Bits of the errors of an axis: ODrive 0.5, `Axis.Error`. Those below 6 are of 0.5.1.
const AXIS_ERRORS: [(u64, Faults); 12] = [
    (1 << 0, Faults::START_FAILURE),
    (1 << 1, Faults::UNDER_VOLTAGE),
    (1 << 2, Faults::OVER_VOLTAGE),
    (1 << 3, Faults::HARDWARE),
    (1 << 4, Faults::OVER_VOLTAGE),
    (1 << 7, Faults::ENCODER),
    (1 << 8, Faults::ENCODER),
    (1 << 9, Faults::SOFTWARE),
    (1 << 11, Faults::HOST_SILENT),
    (1 << 17, Faults::POSITION),
    (1 << 18, Faults::OVER_TEMPERATURE),
    (1 << 19, Faults::POSITION),
];

/// Bits of the errors of a motor: ODrive 0.5, as a published driver of this motor lists them.
const MOTOR_ERRORS: [(u64, Faults); 23] = [
    (1 << 0, Faults::HARDWARE),
    (1 << 1, Faults::HARDWARE),
    (1 << 4, Faults::FOC_FREQUENCY),
    (1 << 7, Faults::SOFTWARE),
    (1 << 10, Faults::OVER_CURRENT),
    (1 << 12, Faults::OVER_CURRENT),
    (1 << 17, Faults::MOTOR_OVER_TEMPERATURE),
    (1 << 18, Faults::DRIVER_OVER_TEMPERATURE),
    (1 << 19, Faults::FOC_FREQUENCY),
    (1 << 20, Faults::HARDWARE),
    (1 << 21, Faults::SOFTWARE),
    (1 << 22, Faults::OVER_CURRENT),
    (1 << 23, Faults::OVER_VOLTAGE),
    (1 << 25, Faults::FOC_FREQUENCY),
    (1 << 26, Faults::ENCODER),
    (1 << 27, Faults::ENCODER),
    (1 << 28, Faults::ENCODER),
    (1 << 29, Faults::SOFTWARE),
    (1 << 30, Faults::SOFTWARE),
    (1 << 31, Faults::SOFTWARE),
    (1 << 32, Faults::SOFTWARE),
    (1 << 33, Faults::SOFTWARE),
    (1 << 35, Faults::HARDWARE),
];

/// The errors that a driver has reported.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Errors {
    /// The last heartbeat.
    heartbeat: Option<Heartbeat>,
    /// The errors of the motor since the axis has one.
    motor: Option<u64>,
}

impl Errors {
    /// Takes a heartbeat.
    pub fn beat(&mut self, heartbeat: Heartbeat) {
        self.heartbeat = Some(heartbeat);
        if !self.has_axis_error() {
            self.motor = None;
        }
    }

    /// Takes the errors of the motor.
    pub fn record_motor(&mut self, errors: u64) {
        self.motor = Some(errors);
    }

    /// Returns whether the last heartbeat reports an error.
    fn has_axis_error(&self) -> bool {
        let reports = |beat: Heartbeat| beat.axis_errors != 0 || beat.motor_failed || beat.encoder_failed;
        self.heartbeat.is_some_and(reports)
    }

    /// Returns whether the motor has errors whose names it has not reported.
    #[must_use]
    pub fn is_unnamed(&self) -> bool {
        let fails = |beat: Heartbeat| beat.axis_errors & MOTOR_FAILED != 0 || beat.motor_failed;
        self.heartbeat.is_some_and(fails) && self.motor.is_none()
    }

    /// Returns the faults. Of the bits without a name, the lowest is reported by its index.
    #[must_use]
    pub fn faults(&self) -> Faults {
        let of_motor = Faults::of_bits(&MOTOR_ERRORS, self.motor.unwrap_or(0));
        let Some(beat) = self.heartbeat else { return of_motor };
        let by_flag = [(beat.encoder_failed, 1 << 8), (beat.motor_failed, MOTOR_FAILED)];
        let flags = by_flag.iter().filter(|(is_set, _)| *is_set).fold(0, |flags, (_, bit)| flags | bit);
        let axis = beat.axis_errors | flags;
        // Once its cause has a name, this bit has nothing to add.
        let pointer = if of_motor.is_none() { 0 } else { MOTOR_FAILED };
        of_motor.and(Faults::of_bits(&AXIS_ERRORS, u64::from(axis & !pointer)))
    }
}
