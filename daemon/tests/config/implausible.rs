//! Settings that are permitted but are often mistakes: each causes a warning with its line and the
//! remedy.

use crate::document::{damaged, validate, warnings, with_serial};
use motord_configuration::{Problem, Wrong};

/// The warnings of this file's kinds.
pub(crate) fn implausible(warnings: &[Problem]) -> Vec<String> {
    use Wrong::{FasterThanModel, FasterThanMotor, NoPositionLimits, SlowMotors};
    let is_implausible = |wrong: &Wrong| {
        matches!(
            wrong,
            FasterThanModel { .. } | FasterThanMotor { .. } | NoPositionLimits { .. } | SlowMotors { .. }
        )
    };
    warnings.iter().filter(|problem| is_implausible(&problem.wrong)).map(ToString::to_string).collect()
}

/// The warnings of a configuration with `instead` in place of `line`.
fn warned(line: &str, instead: &str) -> Vec<String> {
    warnings(&damaged(line, instead))
}

#[test]
fn rate_too_slow_for_a_stop_is_warned() {
    let slow = damaged("rate-hz = 1000", "rate-hz = 1").replace("setpoint-timeout-ms = 20", "");
    assert_eq!(
        warnings(&slow),
        [
            "robot.toml:5:11: cycle.rate-hz: at 1 Hz a stop reaches the motors up to 1000 ms late, and the loss of a controller \
          is noticed after 2000 ms; give at least 50 Hz"
        ]
    );
    assert_eq!(warnings(&slow.replace("rate-hz = 1\n", "rate-hz = 50\n")), [""; 0]);
}

#[test]
fn line_of_rare_turns_is_warned() {
    let turns = with_serial().replacen("every = 2", "every = 40", 1);
    assert_eq!(
        warnings(&turns),
        [
            "robot.toml:17:9: bus.every: at 25 Hz a stop reaches the motors up to 40 ms late, and the loss of a controller is \
          noticed after 20 ms; give at least 50 Hz"
        ]
    );
}

#[test]
fn joint_without_position_limits_is_warned() {
    let all = damaged("position-rad = [-1.2, 1.2]\n", "");
    let expected = "is not given, so the joint may turn from -12 to 12 rad; write the ends of its travel, such as \
                    position-rad = [-0.5, 0.5]";
    assert_eq!(warnings(&all), [format!("robot.toml:23:1: motor.limits.position-rad: {expected}")]);
}

#[test]
fn velocity_beyond_the_motor_is_warned() {
    let printed = warned("velocity-rad-s = 30.0", "velocity-rad-s = 34.0");
    let expected = "robot.toml:25:18: motor.limits.velocity-rad-s: 34 rad/s is more than the 33.5 rad/s that the motor reaches \
                    without load, so it limits nothing; lower it, or give max-velocity-rad-s as it is at your supply voltage";
    assert_eq!(printed, [expected]);
    assert!(warned("velocity-rad-s = 30.0", "velocity-rad-s = 33.5").is_empty());
    let faster = damaged("damping-kd = 2.0", "max-velocity-rad-s = 40.0");
    assert!(
        validate(&faster.replace("velocity-rad-s = 30.0", "velocity-rad-s = 36.0"))
            .unwrap()
            .warnings
            .is_empty()
    );
}

/// A native motor has no velocity codes that would end below the written velocity.
#[test]
fn velocity_far_beyond_the_model_is_warned() {
    let written = |velocity: &str| {
        let faster = format!("model = 'GIM8108-8'\nmax-velocity-rad-s = {velocity}");
        warnings(&with_serial().replacen("model = 'GIM3505-8'", &faster, 1))
    };
    let [warning] = &written("300.0")[..] else { panic!("{:?}", written("300.0")) };
    assert!(
        warning.contains("motor.max-velocity-rad-s: 300 rad/s is 9.0 times the 33.5 rad/s that a GIM8108-8"),
        "{warning}"
    );
    assert_eq!(written("48.0"), [""; 0]);
}
