//! The codes of an impedance in the common frame, for every family that has it.

use super::{ControlCodes, Feedback};
use crate::Scales;
use crate::drive::{Impedance, MotorSide};

/// Returns the codes of an impedance, clamped to the ranges of the codes. With `feedback` the mean of
/// the codes of velocity and torque is the wanted one. `None` where a value is not finite.
///
/// Without stiffness the position has no effect, so it is sent as zero: 0x80, the first byte of zero,
/// is no GIM command, if a motor has left MIT mode (protocol note 1.3).
#[inline(always)]
pub(crate) fn control_codes(
    wanted: &Impedance<MotorSide>,
    feedback: Option<&mut Feedback>,
    scales: &Scales,
) -> Option<ControlCodes> {
    let Impedance { position, velocity, kp, kd, torque, .. } = *wanted;
    let position = if kp > 0.0 { position } else { 0.0 };
    let wanted = super::Impedance { position, velocity, kp, kd, torque };
    let codes = match feedback {
        Some(feedback) => {
            ControlCodes::nearest_with(&wanted, scales, |wanted| feedback.quantise(wanted, scales))
        }
        None => ControlCodes::nearest(&wanted, scales),
    };
    codes.ok()
}
