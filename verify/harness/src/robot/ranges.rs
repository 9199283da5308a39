//! The protocol of a motor and the ranges of its codes, for the invariant checker.

use motord_checker::protocol::Protocol;
use motord_checker::protocol::cansimple::Axis;
use motord_checker::protocol::odrive::RotorAxis;
use motord_checker::protocol::ranges::Ranges;
use motord_checker::vendor::Vendor;
use motord_settings::settings::MotorSettings;

/// Returns the protocol of a motor.
pub(super) fn protocol(settings: &MotorSettings) -> Protocol {
    let gear_ratio = settings.constants.map_or(1.0, |constants| constants.gear_ratio);
    match settings.protocol.name() {
        "cansimple" => Protocol::CanSimple(Axis { ranges: ranges(settings), gear_ratio }),
        "odrive" => Protocol::Odrive(RotorAxis { gear_ratio }),
        other => Protocol::named(other, ranges(settings), Vendor::named(settings.profile.name).reply),
    }
}

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
