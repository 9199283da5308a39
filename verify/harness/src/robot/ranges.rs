//! The protocol of a motor and the ranges of its codes, for the invariant checker.

use motord_checker::protocol::Protocol;
use motord_checker::protocol::cansimple::Axis;
use motord_checker::protocol::ranges::Ranges;
use motord_checker::vendor::Vendor;
use motord_settings::settings::MotorSettings;

/// Returns the protocol of a motor.
pub(super) fn protocol(settings: &MotorSettings) -> Protocol {
    if settings.protocol.name() == "cansimple" {
        let gear_ratio = settings.constants.map_or(1.0, |constants| constants.gear_ratio);
        return Protocol::CanSimple(Axis { ranges: ranges(settings), gear_ratio });
    }
    let reply = Vendor::named(settings.profile.name).reply;
    Protocol::named(settings.protocol.name(), ranges(settings), reply)
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
