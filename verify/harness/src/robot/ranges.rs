//! The ranges of a motor's codes, for the invariant checker.

use motord_checker::protocol::ranges::Ranges;
use motord_settings::settings::MotorSettings;

/// Returns the ranges of a motor's codes.
pub fn ranges(settings: &MotorSettings) -> Ranges {
    let scales = &settings.scales;
    Ranges {
        position: scales.position.max(),
        velocity: scales.velocity.max(),
        kp: scales.kp.max(),
        kd: scales.kd.max(),
        torque: scales.torque.max(),
    }
}
