//! Ids that two motors of a bus must not share.

use crate::document::{shipped, validate, warnings};
use crate::shipped::shipped_names;
use motord_configuration::load;

/// GIM8108-8: 0x100 + id. DM-J4340-2EC: 0x10 + id; its 0x100 + id is a command to the motor itself.
#[test]
fn wrong_reply_id_suggests_vendor_default() {
    for (model, default) in [("GIM8108-8", "0x102"), ("DM-J4340-2EC", "0x012")] {
        let text = format!(
            "[[bus]]\nname = 'leg'\ntype = 'simulated'\n[[motor]]\nname = 'knee'\nbus = 'leg'\nid = 2\nhost-id = 2\n\
             protocol = 'mit'\nmodel = '{model}'\n[motor.limits]\nposition-rad = [-1, 1]\nvelocity-rad-s = 5\n\
             torque-nm = 5\ntorque-slew-nm-per-s = 50\n"
        );
        let error = validate(&text).expect_err("it is a command id").to_string();
        assert!(error.contains(&format!("the default of this motor is {default}")), "{error}");
    }
}

/// A RobStride motor 1 reads and writes its parameters at 0x301 and 0x401 (RS01 manual of
/// 2026-04-28, section 6).
#[test]
fn reply_that_writes_a_parameter_is_refused() {
    let text = |host_id: &str| {
        let of = |name: &str, rest: &str| {
            format!(
                "[[motor]]\nname = '{name}'\nbus = 'leg'\nprotocol = 'mit'\n{rest}\n[motor.limits]\nposition-rad = [-1, 1]\n\
                velocity-rad-s = 5\ntorque-nm = 5\ntorque-slew-nm-per-s = 50\n"
            )
        };
        let [hip, knee] = [
            of("hip", "id = 1\nmodel = 'RS01'"),
            of("knee", &format!("id = 2\nmodel = 'GIM8108-8'\n{host_id}")),
        ];
        format!("[[bus]]\nname = 'leg'\ntype = 'simulated'\n{hip}{knee}")
    };
    assert!(validate(&text("")).is_ok());
    for host_id in ["0x101", "0x201", "0x301", "0x401"] {
        let error = validate(&text(&format!("host-id = {host_id}"))).expect_err(host_id).to_string();
        assert!(error.contains("command id on the same bus"), "{error}");
    }
}

/// All motors in RobStride's private protocol answer to one host, with ids of 29 bits.
#[test]
fn private_motors_share_host_that_is_no_motor() {
    let motor = |name: &str, rest: &str| {
        format!(
            "[[motor]]\nname = '{name}'\nbus = 'leg'\n{rest}\n[motor.limits]\nposition-rad = [-1, 1]\nvelocity-rad-s = 5\n\
             torque-nm = 5\ntorque-slew-nm-per-s = 50\n"
        )
    };
    let text = |knee: &str| {
        let hip = motor("hip", "id = 1\nprotocol = 'robstride'\nmodel = 'RS02'");
        let knee = motor("knee", knee);
        format!("[[bus]]\nname = 'leg'\ntype = 'simulated'\n{hip}{knee}")
    };
    for good in [
        "id = 2\nprotocol = 'robstride'\nmodel = 'CyberGear'",
        "id = 2\nprotocol = 'mit'\nmodel = 'GIM8108-8'",
        "id = 2\nprotocol = 'mit'\nmodel = 'RS02'\nhost-id = 0xFD",
    ] {
        validate(&text(good)).unwrap_or_else(|error| panic!("{good}: {error}"));
    }
    for (bad, expected) in [
        ("id = 1\nprotocol = 'robstride'\nmodel = 'RS02'", "id 1 is used by \"hip\""),
        ("id = 1\nprotocol = 'mit'\nmodel = 'GIM8108-8'", "id 1 is used by \"hip\""),
        ("id = 2\nprotocol = 'robstride'\nmodel = 'RS02'\nhost-id = 1", "the default of this motor is 0x0fd"),
        ("id = 2\nprotocol = 'robstride'\nmodel = 'RS02'\nhost-id = 0x100", "out of range"),
        ("id = 128\nprotocol = 'robstride'\nmodel = 'RS02'", "out of range"),
        ("id = 2\nprotocol = 'robstride'\nmodel = 'GIM8108-8'", "do not speak the protocol \"robstride\""),
    ] {
        let error = validate(&text(bad)).expect_err(bad).to_string();
        assert!(error.contains(expected), "{error}");
    }
}

/// A Damiao motor takes frames with the id 0x7FF for writes to its registers (DM_CAN.py), a HiPNUC
/// IMU those with 0x000 and 0x600 + node for commands (CiA 301).
#[test]
fn reply_that_another_device_obeys_is_refused() {
    let text = |other: &str, host_id: &str| {
        let motor = |name: &str, id: u8, rest: &str| {
            format!(
                "[[motor]]\nname = '{name}'\nbus = 'leg'\nprotocol = 'mit'\nid = {id}\n{rest}\n[motor.limits]\n\
                 position-rad = [-1, 1]\nvelocity-rad-s = 5\ntorque-nm = 5\ntorque-slew-nm-per-s = 50\n"
            )
        };
        let knee = motor("knee", 2, &format!("model = 'GIM8108-8'\n{host_id}"));
        let other = match other {
            "damiao" => motor("hip", 1, "model = 'DM-J4310-2EC'"),
            _ => "[[imu]]\nname = 'base'\ntype = 'hipnuc-can'\nbus = 'leg'\n".to_owned(),
        };
        format!("[cycle]\nrate-hz = 500\n[[bus]]\nname = 'leg'\ntype = 'simulated'\n{knee}{other}")
    };
    for (other, host_id, expected) in [
        ("damiao", "0x7FF", "command id on the same bus"),
        ("hipnuc", "0x000", "\"knee\" replies with the id 0x000"),
        ("hipnuc", "0x608", "\"knee\" replies with the id 0x608"),
    ] {
        validate(&text(other, "")).unwrap_or_else(|error| panic!("{other}: {error}"));
        let error = validate(&text(other, &format!("host-id = {host_id}"))).expect_err(host_id).to_string();
        assert!(error.contains(expected), "{error}");
    }
}

/// Motors that obey the commands of another bus, after adapters or cables were exchanged, answer as
/// the expected ones.
#[test]
fn ids_on_two_buses_are_a_warning() {
    let bus = |name: &str, kind: &str| format!("[[bus]]\nname = '{name}'\n{kind}\nevery = 5\n");
    let motor = |bus: &str, id: u8| {
        format!(
            "[[motor]]\nname = '{bus}-{id}'\nbus = '{bus}'\nid = {id}\nprotocol = 'gim'\nmodel = 'GIM8108-8'\n[motor.limits]\n\
             position-rad = [-1, 1]\nvelocity-rad-s = 5\ntorque-nm = 5\n"
        )
    };
    let shared = |kinds: [&str; 2], ids: [u8; 2]| {
        let buses = [bus("left", kinds[0]), bus("right", kinds[1])].concat();
        let text = buses + &motor("left", ids[0]) + &motor("right", ids[1]);
        warnings(&text).into_iter().filter(|warning| warning.contains("exchanged")).collect::<Vec<_>>()
    };
    let can = ["type = 'socketcan'\ninterface = 'nocan7'", "type = 'socketcan'\ninterface = 'nocan8'"];
    let warned = shared(can, [3, 3]);
    assert_eq!(warned.len(), 1, "{warned:?}");
    assert!(warned[0].contains("bus \"left\" has motors with the ids 3 of this bus"), "{warned:?}");
    assert_eq!(shared(can, [3, 4]), [""; 0]);
    assert_eq!(shared(["type = 'simulated'"; 2], [3, 3]), [""; 0]);
    assert_eq!(shared([can[0], "type = 'serial'\ndevice = '/dev/null'"], [3, 3]), [""; 0], "no cable fits");
}

#[test]
fn no_shipped_robot_uses_an_id_twice() {
    for name in shipped_names() {
        let warned = load(&shipped(&name)).expect("is good").warnings;
        assert!(
            !warned.iter().any(|warning| warning.to_string().contains("exchanged")),
            "{name}: {warned:?}"
        );
    }
}

/// A robot on one bus with a CANSimple node, and this other motor.
fn with_node(node: u8, other: &str) -> String {
    let motor = |name: &str, rest: &str| {
        format!(
            "[[motor]]\nname = '{name}'\nbus = 'leg'\n{rest}\n[motor.limits]\nposition-rad = [-1, 1]\nvelocity-rad-s = 5\n\
             torque-nm = 5\ntorque-slew-nm-per-s = 50\n"
        )
    };
    let knee = motor("knee", &format!("id = {node}\nprotocol = 'cansimple'\nmodel = 'GIM6010-8'"));
    format!("[[bus]]\nname = 'leg'\ntype = 'simulated'\n{knee}{}", motor("hip", other))
}

/// Node n uses the ids from 32 n to 32 n + 31. A SteadyWin motor replies with 0x100 + id; a Damiao motor
/// also obeys 0x100 + id, and its registers are at 0x7FF.
#[test]
fn node_whose_ids_another_motor_uses_is_refused() {
    for (node, other, used) in [
        (0, "id = 1\nprotocol = 'mit'\nmodel = 'GIM8108-8'", "0x001 is for commands"),
        (1, "id = 0x25\nprotocol = 'mit'\nmodel = 'GIM8108-8'", "0x025 is for commands"),
        (8, "id = 2\nprotocol = 'mit'\nmodel = 'GIM8108-8'", "0x102 is for replies"),
        (8, "id = 3\nprotocol = 'mit'\nmodel = 'DM-J4310-2EC'", "0x103 is for commands"),
        (63, "id = 3\nprotocol = 'mit'\nmodel = 'DM-J4310-2EC'", "0x7ff is for requests to the registers"),
        (5, "id = 5\nprotocol = 'cansimple'\nmodel = 'GIM6010-8'", "id 5 is used by"),
        (5, "id = 5\nprotocol = 'mit'\nmodel = 'GIM8108-8'", "id 5 is used by"),
        (64, "id = 1\nprotocol = 'mit'\nmodel = 'GIM8108-8'", "out of range"),
        (2, "id = 0\nprotocol = 'mit'\nmodel = 'GIM8108-8'", "out of range"),
    ] {
        let error = validate(&with_node(node, other)).expect_err(other).to_string();
        assert!(error.contains(used), "{node}: {error}");
    }
    for (node, other) in [
        (0, "id = 1\nprotocol = 'cansimple'\nmodel = 'GIM6010-8'"),
        (1, "id = 2\nprotocol = 'mit'\nmodel = 'GIM8108-8'"),
        (63, "id = 3\nprotocol = 'mit'\nmodel = 'GIM8108-8'"),
        (8, "id = 3\nprotocol = 'robstride'\nmodel = 'RS02'"),
    ] {
        validate(&with_node(node, other)).unwrap_or_else(|error| panic!("{node} {other}: {error}"));
    }
}

/// A MyActuator motor with id 1 is commanded at 0x141 and 0x401, and by all motors' ids 0x280 and 0x300.
/// It answers at 0x241 and 0x501.
#[test]
fn ids_of_myactuator_motor_are_its_own() {
    let rmd = |id: u8| format!("id = {id}\nprotocol = 'myactuator'\nmodel = 'X8-20'\ntorque-end-nm = 24");
    let mit = |ids: &str| format!("{ids}\nprotocol = 'mit'\nmodel = 'GIM8108-8'");
    let robot = |one: &str, other: &str| {
        with_node(5, other).replace("id = 5\nprotocol = 'cansimple'\nmodel = 'GIM6010-8'", one)
    };
    for (other, part) in [
        (mit("id = 2\nhost-id = 0x141"), "0x141 is a motor's command id"),
        (mit("id = 2\nhost-id = 0x401"), "0x401 is a motor's command id"),
        (mit("id = 2\nhost-id = 0x280"), "0x280 is a motor's command id"),
        (mit("id = 2\nhost-id = 0x300"), "0x300 is a motor's command id"),
        (mit("id = 2\nhost-id = 0x241"), "0x241 is the reply id of"),
        (mit("id = 2\nhost-id = 0x501"), "0x501 is the reply id of"),
        (mit("id = 1"), "id 1 is used by"),
        ("id = 10\nprotocol = 'cansimple'\nmodel = 'GIM6010-8'".to_owned(), "0x141 is for commands"),
        (rmd(1), "id 1 is used by"),
        (rmd(33), "from 1 to 32"),
    ] {
        let error = validate(&robot(&rmd(1), &other)).expect_err(&other).to_string();
        assert!(error.contains(part), "{other}: {error}");
    }
    for other in [rmd(32), mit("id = 2"), "id = 3\nprotocol = 'mit'\nmodel = 'DM-J4310-2EC'".to_owned()] {
        validate(&robot(&rmd(1), &other)).unwrap_or_else(|error| panic!("{other}: {error}"));
    }
}

/// A simulated bus empties itself.
#[test]
fn motor_without_enable_is_a_warning() {
    let rmd = "id = 1\nprotocol = 'myactuator'\nmodel = 'X8-20'\ntorque-end-nm = 24";
    let mit = "id = 1\nprotocol = 'mit'\nmodel = 'GIM8108-8'";
    for (motor, is_real, count) in [(rmd, true, 1), (rmd, false, 0), (mit, true, 0)] {
        let bus = if is_real { "'socketcan'\ninterface = 'can0'" } else { "'simulated'" };
        let text = with_node(5, motor).replace("'simulated'", bus);
        let warned = super::document::warnings(&text);
        let needs_none = warned.iter().filter(|warning| warning.contains("needs no enable"));
        assert_eq!(needs_none.count(), count, "{warned:?}");
        assert!(!warned.iter().any(|warning| warning.contains("outrank")), "{warned:?}");
    }
}
