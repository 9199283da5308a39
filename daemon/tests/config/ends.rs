//! The ends of a motor's codes: from its model or by keys, and never beyond what the file says of
//! the motor.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use crate::document::machine;
use motord_configuration::parse;
use motord_protocol::Ends;
use motord_settings::settings::MotorSettings;
use std::path::Path;

/// Returns the motor of a robot with these keys, or the errors.
fn motor(keys: &str) -> Result<MotorSettings, String> {
    let text = format!(
        "[[bus]]\nname = 'arm'\ntype = 'socketcan'\ninterface = 'can0'\n\
         [[motor]]\nname = 'hip'\nbus = 'arm'\nid = 1\n{keys}\nlimits = {{ position-rad = [-1.0, 1.0] }}\n"
    );
    let loaded = parse(Path::new("robot.toml"), text.as_bytes(), &machine());
    loaded.map(|loaded| loaded.settings.motors[0].clone()).map_err(|error| error.to_string())
}

fn ends(keys: &str) -> Ends {
    motor(keys).unwrap().scales.ends()
}

/// RobStride's manuals of 2026-04-28.
#[test]
fn models_have_the_ends_of_their_manuals() {
    for (model, [velocity, torque, kp, kd]) in [
        ("RS02", [44.0, 17.0, 500.0, 5.0]),
        ("RS03", [20.0, 60.0, 5000.0, 100.0]),
        ("RS04", [15.0, 120.0, 5000.0, 100.0]),
        ("RS05", [50.0, 5.5, 500.0, 5.0]),
        ("RS06", [50.0, 36.0, 5000.0, 100.0]),
    ] {
        let expected = Ends { position: 12.57, velocity, torque, kp, kd };
        assert_eq!(ends(&format!("protocol = 'mit'\nmodel = '{model}'")), expected, "{model}");
    }
    for model in [
        "DM-J4310P-2EC",
        "DM-J4340P-2EC",
        "DM-J8009P-2EC",
        "DM-J3507-2EC",
        "DM-J6248P-2EC",
        "DM-H3510",
        "DM-J10010-2EC",
    ] {
        assert!(motor(&format!("protocol = 'mit'\nmodel = '{model}'")).is_ok(), "{model}");
    }
}

#[test]
fn written_ends_replace_those_of_the_model() {
    let keys = "protocol = 'mit'\nmodel = 'RS01'\nposition-end-rad = 12.5\nvelocity-end-rad-s = 20\ntorque-end-nm = 60\n\
                kp-end = 5000\nkd-end = 100";
    let expected = Ends { position: 12.5, velocity: 20.0, torque: 60.0, kp: 5000.0, kd: 100.0 };
    assert_eq!(ends(keys), expected);
    let shorter =
        motor("protocol = 'mit'\nmodel = 'RS01'\nvelocity-end-rad-s = 20\ntorque-end-nm = 10").unwrap();
    assert_eq!((shorter.winding.peak_torque, shorter.max_velocity), (10.0, 20.0));
}

/// An RS03 that is described as an RS01 makes 3.5 times the torque that it is sent.
#[test]
fn peak_or_velocity_beyond_ends_is_an_error() {
    let error = motor("protocol = 'mit'\nmodel = 'RS01'\npeak-torque-nm = 60").unwrap_err();
    for part in
        ["motor.peak-torque-nm: 60 N·m is beyond ±17 N·m", "RS01", "torque-end-nm", "lower this to 17"]
    {
        assert!(error.contains(part), "{part}: {error}");
    }
    let error = motor("protocol = 'mit'\nmodel = 'DM-J4340-2EC'\nmax-velocity-rad-s = 10").unwrap_err();
    assert!(error.contains("10 rad/s is beyond ±8 rad/s") && error.contains("velocity-end-rad-s"), "{error}");
    let error = motor("protocol = 'mit'\nmodel = 'GIM8108-8'\npeak-torque-nm = 300").unwrap_err();
    assert!(error.contains("beyond ±225 N·m") && error.contains("torque-constant-nm-per-a"), "{error}");
    assert!(
        motor("protocol = 'mit'\nmodel = 'DM-J4340-2EC'\nmax-velocity-rad-s = 10\nvelocity-end-rad-s = 10")
            .is_ok()
    );
}

/// A motor in GIM mode takes velocities as floats. In MIT mode the velocity codes of every
/// SteadyWin motor end at 65 rad/s.
#[test]
fn velocity_end_is_that_of_the_protocol() {
    let keys =
        |protocol: &str| format!("protocol = '{protocol}'\nmodel = 'GIM8108-8'\nmax-velocity-rad-s = 70");
    assert_eq!(motor(&keys("gim")).unwrap().max_velocity, 70.0);
    let error = motor(&keys("mit")).unwrap_err();
    assert!(error.contains("70 is beyond ±65") && error.contains("use at most 65"), "{error}");
    assert!(!error.contains("torque-constant") && !error.contains("gear-ratio"), "{error}");
    let error = motor("protocol = 'gim'\nmodel = 'GIM8108-8'\npeak-torque-nm = 300").unwrap_err();
    assert!(error.contains("beyond ±225 N·m"), "{error}");
}

#[test]
fn motor_without_ends_takes_no_such_key() {
    for keys in [
        "protocol = 'mit'\nmodel = 'GIM8108-8'\ntorque-end-nm = 60",
        "protocol = 'gim'\nmodel = 'GIM8108-8'\nkp-end = 600",
    ] {
        let error = motor(keys).unwrap_err();
        assert!(error.contains("has no effect on a GIM8108-8"), "{error}");
    }
}

#[test]
fn limits_reach_as_far_as_the_codes() {
    let rs03 = "protocol = 'mit'\nmodel = 'RS03'\ndamping-kd = 20.0";
    let limits = "torque-nm = 59.0, kp-max = 4900.0, kd-max = 99.0, velocity-rad-s = 19.0";
    let text = |model: &str| rs03.replace("RS03", model) + "\n";
    let with_limits = |model: &str| {
        let text = format!(
            "[[bus]]\nname = 'arm'\ntype = 'socketcan'\ninterface = 'can0'\n[[motor]]\nname = 'hip'\nbus = 'arm'\nid = 1\n{}\
             limits = {{ position-rad = [-1.0, 1.0], {limits} }}\n",
            text(model)
        );
        parse(Path::new("robot.toml"), text.as_bytes(), &machine()).map_err(|error| error.to_string())
    };
    assert!(with_limits("RS03").is_ok());
    let error = with_limits("RS00").unwrap_err();
    for part in ["torque-nm: 59 is beyond ±14", "kp-max: 4900 is beyond ±500", "kd-max: 99 is beyond ±5"] {
        assert!(error.contains(part), "{part}: {error}");
    }
}

/// V4.2 has 24 N·m, a driver for V4.3 18 N·m.
#[test]
fn torque_end_of_myactuator_must_be_written() {
    let keys = "protocol = 'myactuator'\nmodel = 'X8-20'\n";
    let error = motor(keys).unwrap_err().to_string();
    for part in ["torque-end-nm: is missing", "24 N·m", "18 N·m", "vendor's tool"] {
        assert!(error.contains(part), "{part}: {error}");
    }
    let written = motor(&format!("{keys}torque-end-nm = 18")).unwrap();
    let expected = Ends { position: 12.5, velocity: 45.0, torque: 18.0, kp: 500.0, kd: 5.0 };
    assert_eq!((written.scales.ends(), written.winding.peak_torque), (expected, 18.0));
    let error = motor("protocol = 'mit'\nmodel = 'X8-20'\ntorque-end-nm = 18").unwrap_err().to_string();
    assert!(error.contains("use protocol = \"myactuator\""), "{error}");
}

/// The vendor's SDK has the same ends for every model; the torque is disputed.
#[test]
fn ends_of_cansimple_do_not_follow_the_model() {
    let expected = Ends { position: 12.5, velocity: 65.0, torque: 50.0, kp: 500.0, kd: 5.0 };
    for model in ["GIM6010-8", "GIM8108-8"] {
        let motor = motor(&format!("protocol = 'cansimple'\nmodel = '{model}'")).unwrap();
        assert_eq!(motor.scales.ends(), expected, "{model}");
        assert_eq!(motor.drive(true).gear_ratio, 8.0, "{model}");
    }
    let written =
        motor("protocol = 'cansimple'\nmodel = 'GIM6010-8'\ntorque-end-nm = 400\ngear-ratio = 9").unwrap();
    assert_eq!((written.scales.ends().torque, written.drive(true).gear_ratio), (400.0, 9.0));
    let constant = "protocol = 'cansimple'\nmodel = 'GIM6010-8'\ntorque-constant-nm-per-a = 0.1";
    assert!(motor(constant).is_err(), "no code of it is a current");
}
