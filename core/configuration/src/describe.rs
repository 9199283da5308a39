//! The description of the robot that clients get, made of the configuration.

use motord_settings::plan::BusPlan;
use motord_settings::sensor::imu::ImuSettings;
use motord_settings::settings::{BusSettings, Settings};
use motord_shared::description::{
    GroupDescription, ImuDescription, JointDescription, JointLimits, RobotDescription,
};

/// Names and limits, in the order of the configuration.
#[must_use]
pub fn describe(settings: &Settings, boot_id: u64) -> RobotDescription {
    let joints = settings.motors.iter().map(|motor| JointDescription {
        name: motor.name.clone(),
        bus: settings.buses[motor.bus].name.clone(),
        protocol: motor.protocol.name().to_owned(),
        model: motor.model.clone(),
        zero: motor.transmission.offset(),
        limits: JointLimits {
            position: motor.limits.position,
            velocity: motor.limits.velocity,
            torque: motor.limits.torque,
            kp: motor.limits.kp,
            kd: motor.limits.kd,
        },
    });
    let groups = settings
        .groups
        .iter()
        .map(|group| GroupDescription { name: group.name.clone(), joints: group.motors.clone() });
    RobotDescription {
        instance: settings.instance.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        pid: std::process::id(),
        boot_id,
        rate_hz: settings.cycle.rate_hz,
        setpoint_timeout: settings.safety.setpoint_timeout,
        setpoint_horizon_max: settings.safety.setpoint_horizon_max,
        joints: joints.collect(),
        groups: groups.collect(),
        imus: settings.sensors.imus.iter().map(imu).collect(),
        buses: settings.buses.iter().map(|bus| bus.name.clone()).collect(),
        devices: settings.buses.iter().map(device).collect(),
        frame_times: BusPlan::of(settings).iter().map(frame_time).collect(),
    }
}

fn imu(imu: &ImuSettings) -> ImuDescription {
    ImuDescription {
        name: imu.name.clone(),
        rate_hz: imu.rate_hz,
        source: imu.source.type_name().to_owned(),
        mount: imu.mount.parts(),
        lost_after: imu.lost_after.as_secs_f64(),
    }
}

fn device(bus: &BusSettings) -> String {
    bus.kind.address().unwrap_or_default().to_owned()
}

/// Half of the longest command and reply, s.
fn frame_time(plan: &BusPlan) -> f64 {
    plan.transaction_worst.as_secs_f64() / 2.0
}
