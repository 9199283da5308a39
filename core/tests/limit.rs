//! The limits, which are the last step before the wire.

use motord_core::control::{Applied, Circumstances, damp, limit};
use motord_protocol::MotorProtocol;
use motord_protocol::drive::{Impedance, JointSide, Measured, Setpoint};
use motord_settings::settings::{LimitSettings, MotorSettings};
use motord_shared::Limit;
use std::sync::LazyLock;

static LIMITS: LazyLock<LimitSettings> = LazyLock::new(|| LimitSettings {
    position: [-1.0, 1.0],
    velocity: 20.0,
    torque: 10.0,
    kp: 100.0,
    kd: 4.0,
    torque_slew: 100.0,
    kp_slew: 1000.0,
    kd_slew: 40.0,
    temperature_derate: 80.0,
    temperature: 100.0,
    ..MotorSettings::of_model("knee", 1, MotorProtocol::Mit, "GIM8108-8").expect("a known model").limits
});

fn limited(
    wanted: Impedance<JointSide>,
    previous: Impedance<JointSide>,
    temperature: Option<f32>,
    ramp: f32,
) -> Applied {
    let measured = Measured::new(0.0, 0.0, 0.0, temperature);
    limit(
        &Setpoint::impedance(wanted),
        &Circumstances {
            limits: &LIMITS,
            previous: &previous,
            measured: &measured,
            age: 0.0,
            elapsed: 0.001,
            ramp,
            winding_torque: LIMITS.torque,
        },
    )
}

#[test]
fn what_is_within_every_limit_passes_unchanged() {
    let wanted = Impedance::new(0.1, 1.0, 50.0, 1.0, 2.0);
    assert_eq!(
        limited(wanted, wanted, None, 1.0),
        Applied { setpoint: Setpoint::impedance(wanted), limits: 0 }
    );
}

#[test]
fn every_value_is_clamped_and_clamp_reported() {
    let far = Impedance::new(9.0, 90.0, 900.0, 9.0, 90.0);
    let Applied { setpoint, limits: acted } = limited(far, far, None, 1.0);
    let applied = setpoint.values;
    assert!(applied.position <= 1.0 + 9.0 && applied.velocity == 20.0);
    for limit in [Limit::Position, Limit::Velocity, Limit::Kp, Limit::Kd, Limit::Torque, Limit::TotalTorque] {
        assert!(acted & limit.bit() != 0, "{limit}");
    }
    assert!(applied.predicted_torque(0.0, 0.0).abs() <= 10.0 + 1e-3);
}

#[test]
fn a_step_becomes_a_slope() {
    let rest = Impedance::NEUTRAL;
    let Applied { setpoint, limits: acted } =
        limited(Impedance::new(0.5, 0.0, 100.0, 4.0, 10.0), rest, None, 1.0);
    let applied = setpoint.values;
    let Impedance { position, kp, kd, torque, .. } = applied;
    let close = |value: f32, expected: f32| (value - expected).abs() < 1e-5;
    assert!(close(position, 0.02) && close(kp, 1.0) && close(kd, 0.04) && close(torque, 0.1), "{applied:?}");
    for limit in [Limit::PositionSlew, Limit::KpSlew, Limit::KdSlew, Limit::TorqueSlew] {
        assert!(acted & limit.bit() != 0, "{limit}");
    }
}

#[test]
fn hot_motor_is_derated_to_zero_at_limit() {
    let wanted = Impedance::new(0.0, 0.0, 0.0, 0.0, 10.0);
    for (temperature, torque) in [(79.0, 10.0), (90.0, 5.0), (100.0, 0.0), (500.0, 0.0)] {
        let applied = limited(wanted, wanted, Some(temperature), 1.0).setpoint.values;
        assert!((applied.torque - torque).abs() < 1e-4, "{temperature} °C: {}", applied.torque);
    }
}

#[test]
fn torque_bound_keeps_sign_and_cause() {
    let wanted = Impedance::new(0.4, 0.0, 100.0, 0.0, -2.0);
    let applied = limited(wanted, wanted, None, 1.0).setpoint.values;
    assert!((applied.predicted_torque(0.0, 0.0) - 10.0).abs() < 1e-4);
    assert!((applied.kp / applied.torque - wanted.kp / wanted.torque).abs() < 1e-3, "scaled together");
}

#[test]
fn unheard_joint_is_pulled_with_less_torque() {
    let wanted = Impedance::new(0.1, 20.0, 90.0, 0.0, 0.0);
    let measured = Measured::new(0.0, 20.0, 0.0, None);
    let mut circumstances = Circumstances {
        limits: &LIMITS,
        previous: &wanted,
        measured: &measured,
        age: 0.0,
        elapsed: 0.001,
        ramp: 1.0,
        winding_torque: LIMITS.torque,
    };
    assert_eq!(
        limit(&Setpoint::impedance(wanted), &circumstances),
        Applied { setpoint: Setpoint::impedance(wanted), limits: 0 }
    );
    circumstances.age = 0.009;
    let applied = limit(&Setpoint::impedance(wanted), &circumstances).setpoint.values;
    for travelled in [-0.18, 0.0, 0.18] {
        assert!(applied.predicted_torque(travelled, 20.0).abs() <= LIMITS.torque + 1e-4, "{travelled}");
    }
}

#[test]
fn braking_a_fast_joint_stays_within_its_torque() {
    let measured = Measured::new(0.0, 30.0, 0.0, None);
    let applied = damp(2.0, &LIMITS, Some(&measured)).setpoint.values;
    assert!((applied.predicted_torque(0.0, 30.0) + 10.0).abs() < 1e-4);
}
