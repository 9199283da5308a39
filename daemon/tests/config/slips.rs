//! Values in other units and bases, and slips of the form: what is written instead keeps the
//! meaning.

use crate::document::{GOOD, machine, shipped, validate};
use crate::messages::ROBOT;
use crate::shipped::shipped_names;
use motord_configuration::{Loaded, parse};
use proptest::prelude::*;
use std::fs;
use std::path::Path;
use std::time::Duration;

/// A part of [`ROBOT`], what is written instead, the line of the message and a part of it.
type Slip<'s> = (&'s str, &'s str, usize, &'s str);

/// Returns every message about `text`.
fn printed(text: &str) -> String {
    validate(text).map_or_else(
        |error| error.to_string(),
        |loaded| {
            let warnings: Vec<_> = loaded.warnings.iter().map(ToString::to_string).collect();
            format!("is accepted; {}", warnings.join("\n"))
        },
    )
}

/// Asserts that each slip has a message in its line with this part.
fn assert_printed(slips: &[Slip<'_>]) {
    let wrong: Vec<_> = slips
        .iter()
        .filter_map(|(part, instead, line, expected)| {
            assert!(ROBOT.contains(part), "nothing to damage: {part}");
            let printed = printed(&ROBOT.replacen(part, instead, 1));
            let location = format!("robot.toml:{line}:");
            let is_printed = printed.lines().any(|one| one.contains(&location) && one.contains(expected));
            (!is_printed)
                .then(|| format!("{instead}\n  said:     {printed}\n  expected: {location} … {expected}"))
        })
        .collect();
    assert!(wrong.is_empty(), "{} of {} differ:\n{}", wrong.len(), slips.len(), wrong.join("\n"));
}

const MOTOR: &str = "model = \"GIM8108-8\"";
const RATE: &str = "rate-hz = 1000";
const TIMEOUT: &str = "setpoint-timeout-ms = 20.0";
const LIMITS: &str = "velocity-rad-s = 25.0";
const BUS: &str = "type = \"simulated\"";

#[test]
fn value_in_another_unit_is_converted() {
    assert_printed(&[
        (BUS, "type = \"simulated\"\nbitrate = 1M", 13, "write bitrate = 1000000, without a unit"),
        (BUS, "type = \"simulated\"\nbitrate = 500k", 13, "write bitrate = 500000, without a unit"),
        (BUS, "type = \"simulated\"\nbitrate = \"500 kbit/s\"", 13, "write bitrate = 500000, without quotes"),
        (TIMEOUT, "setpoint-timeout-ms = 1s", 8, "write setpoint-timeout-ms = 1000, without a unit"),
        (TIMEOUT, "setpoint-timeout-ms = 0.06 s", 8, "write setpoint-timeout-ms = 60, without a unit"),
        (TIMEOUT, "setpoint-timeout-ms = \"60ms\"", 8, "write setpoint-timeout-ms = 60, without quotes"),
        (LIMITS, "torque-nm = 500mNm", 20, "write torque-nm = 0.5, without a unit"),
        (LIMITS, "velocity-rad-s = 30rpm", 20, "write velocity-rad-s = 3.1416, without a unit"),
        (RATE, "reply-deadline-percent = 80%", 5, "write reply-deadline-percent = 80, without a unit"),
        ("[-1.0, 1.0]", "[-45deg, 45°]", 20, "write position-rad = [-0.7854, 0.7854], without units"),
        ("[-1.0, 1.0]", "[-pi/2, pi]", 20, "write position-rad = [-1.5708, 3.1416], without units"),
        (
            TIMEOUT,
            "setpoint-timeout-ms = 5furlongs",
            8,
            "`furlongs` is no unit of time; write a number in ms",
        ),
        (TIMEOUT, "setpoint-timeout-ms = \"5 Nm\"", 8, "`Nm` is no unit of time; write a number in ms"),
        ("id = 1", "id = 3q", 17, "`q` is no part of a number; write an integer"),
    ]);
}

/// Without its base a number would be another id, which is accepted.
#[test]
fn id_in_another_base_keeps_its_value() {
    assert_printed(&[
        ("id = 1", "id = 10h", 17, "write id = 0x10"),
        ("id = 1", "id = 1\nhost-id = 103h", 18, "write host-id = 0x103"),
        ("id = 1", "id = \"10h\"", 17, "write id = 0x10"),
        ("id = 1", "id = \"0b11\"", 17, "write id = 3, without quotes"),
        ("id = 1", "id = \"0o17\"", 17, "write id = 15, without quotes"),
        ("id = 1", "id = \"each\"", 17, "write an integer, such as id = 1"),
        ("id = 1", "id = 0h", 17, "write id = 0x0"),
        ("id = 1", "id = \"3 or 4\"", 17, "write an integer, such as id = 1"),
    ]);
}

#[test]
fn key_with_another_unit_is_converted() {
    let imu = |key: &str| format!("{MOTOR}\n[[imu]]\nname = \"body\"\ntype = \"simulated\"\n{key}\n");
    let imu = imu("mount-rpy-rad = [0, 0, 1.57]");
    assert_printed(&[
        (
            MOTOR,
            &format!("{MOTOR}\noffset-deg = 3"),
            20,
            "`offset-rad` is in rad; 3° is 0.0524 rad: write offset-rad = 0.0524",
        ),
        (MOTOR, &format!("{MOTOR}\noffset_deg = 3"), 20, "write offset-rad = 0.0524"),
        ("position-rad = [", "position-deg = [", 20, "write position-rad = [-0.0175, 0.0175]"),
        (
            LIMITS,
            "velocity-rpm = 30",
            20,
            "`velocity-rad-s` is in rad/s; 30 rpm is 3.1416 rad/s: write velocity-rad-s = 3.1416",
        ),
        (LIMITS, "velocity-deg-s = 90", 20, "write velocity-rad-s = 1.5708"),
        (LIMITS, "torque-mnm = 500", 20, "write torque-nm = 0.5"),
        (TIMEOUT, "setpoint-timeout-s = 0.1", 8, "write setpoint-timeout-ms = 100"),
        (TIMEOUT, "setpoint-timeout-s = \"short\"", 8, "`setpoint-timeout-ms` is in ms, and not in s"),
        (TIMEOUT, "damp-ms = 500", 8, "write damp-seconds = 0.5"),
        (TIMEOUT, "setpoint_timeout_ms = 50", 8, "did you mean `setpoint-timeout-ms`?"),
        (
            MOTOR,
            &imu,
            23,
            "`mount-rpy-deg` is in °; [0, 0, 1.57] rad is [0, 0, 89.9544]°: write mount-rpy-deg = [0, 0, 89.9544]",
        ),
    ]);
}

#[test]
fn mount_that_looks_like_radians_warns() {
    let imu = |value: &str| {
        format!("{ROBOT}[[imu]]\nname = \"body\"\ntype = \"simulated\"\nmount-rpy-deg = {value}\n")
    };
    for value in ["[0, 0, 1.5708]", "[3.14, 0, -1.57]", "[0, 4.7124, 0.1]"] {
        let printed = printed(&imu(value));
        assert!(
            printed.contains("is accepted") && printed.contains("looks like radians"),
            "{value}: {printed}"
        );
    }
    for value in ["[0, 0, 0]", "[0, 0, 90]", "[0, 1.5, 2]", "[180, 0, 1.57]"] {
        let printed = printed(&imu(value));
        assert!(!printed.contains("looks like radians"), "{value}: {printed}");
    }
}

#[test]
fn direction_in_words_offers_both() {
    let expected = "write 1 or -1 (reversed is -1)";
    assert_printed(&[
        (MOTOR, &format!("{MOTOR}\ndirection = \"reversed\""), 20, expected),
        (MOTOR, &format!("{MOTOR}\ndirection = reversed"), 20, expected),
        (MOTOR, &format!("{MOTOR}\ndirection = true"), 20, expected),
    ]);
}

#[test]
fn slip_of_form_proposes_the_line() {
    assert_printed(&[
        (
            "[cycle]\nrate-hz = 1000",
            "[cycle] rate-hz = 500",
            4,
            "write [cycle] in one line, and rate-hz = 500 in the next",
        ),
        (RATE, "rate hz = 500", 5, "write rate-hz = 500"),
        (RATE, "rate-hz := 500", 5, "write rate-hz = 500"),
        (RATE, "rate–hz = 500", 5, "has the dash U+2013 here; write `-`"),
        (RATE, "busy-poll-us = −5", 5, "has the dash U+2212 here; write `-`"),
        ("[-1.0, 1.0]", "[−2.0, −0.2]", 20, "has the dash U+2212 here; write `-`"),
        ("name = \"hip\"", "name = \"\"\"hip", 15, "`\"\"\"` has no end; write name = \"hip\""),
        ("name = \"hip\"", "name = `hip`", 15, "write name = \"hip\""),
        (RATE, "rate-hz = 500;", 5, "write rate-hz = 500, without the semicolon"),
        (LIMITS, "velocity-rad-s = 1e300", 20, "1e300 is beyond"),
        ("\"robot\"", "\"my robot\"", 2, "cannot be an instance; use only a-z, 0-9 and `-`, 1 to 32"),
    ]);
}

#[test]
fn misplaced_table_is_named() {
    let limits = "[motor.limits]\nposition-rad = [-1.0, 1.0]\n\n[[motor]]";
    let tables = ROBOT.find("[daemon]").expect("it has one");
    let first = format!("rate-hz = 500\n{}", &ROBOT[tables..]);
    assert!(printed(&first).contains("it belongs in [cycle] or [[imu]]"), "{}", printed(&first));
    let joints = format!("joints = ['hip']\n{}", &ROBOT[tables..]);
    assert!(printed(&joints).contains("it belongs in [[group]]"), "{}", printed(&joints));
    let deep = ROBOT.replace("[[motor]]", "[[bus.motor]]");
    let deep = printed(&deep);
    assert!(deep.contains("write [[motor]], and in it bus = \"desk\""), "{deep}");
    assert_eq!(deep.lines().count(), 1, "{deep}");
    assert_printed(&[("[[motor]]", limits, 14, "move it below the [[motor]] that it belongs to")]);
}

/// The first line is one of the same motor, not of an earlier one.
#[test]
fn key_twice_names_the_line_of_its_table() {
    let second =
        GOOD.replace("limits = { position-rad = [-2, 2] }", "limits.kp-max = 9\n[motor.limits]\nkd-max = 1");
    let first = 1 + second.lines().position(|line| line.starts_with("limits.kp-max")).expect("it has one");
    let printed = printed(&second);
    assert!(
        printed.contains(&format!("`limits` is there twice, first in line {first}; keep one")),
        "{printed}"
    );
    let next = GOOD.replace("id = 2\n", "id = 2\nname = 'knee'\n");
    let name = 1 + next.lines().position(|line| line == "name = 'knee'").expect("it has one");
    let printed = crate::slips::printed(&next);
    assert!(printed.contains(&format!("`name` is there twice, first in line {name}")), "{printed}");
}

#[test]
fn list_with_semicolons_gets_commas() {
    let (joints, cure) = ("joints = [\"hip\"]", "found `;`; write joints = [\"hip\", \"knee\"]");
    assert_printed(&[
        (joints, "joints = [hip; knee]", 24, cure),
        (joints, "joints = [\"hip\"; \"knee\"]", 24, cure),
        ("[-1.0, 1.0]", "[-1.0; 1.0]", 20, "write position-rad = [-1.0, 1.0]"),
    ]);
}

#[test]
fn key_of_other_word_order_is_suggested() {
    assert_printed(&[
        (LIMITS, "max-torque = 5.0", 20, "unknown key `max-torque`; did you mean `torque-nm`?"),
        (LIMITS, "max_velocity = 5.0", 20, "did you mean `velocity-rad-s`?"),
        (LIMITS, "max-temperature = 80.0", 20, "did you mean `temperature-max-celsius`?"),
        (LIMITS, "max = 5.0", 20, "known are"),
    ]);
}

/// `motorctl hold NAME` takes a joint or a group.
#[test]
fn group_shares_no_name_of_another_joint() {
    let knee =
        "[[motor]]\nname = \"knee\"\nbus = \"desk\"\nid = 2\nprotocol = \"mit\"\nmodel = \"GIM8108-8\"\n";
    let alone = ROBOT.replace("name = \"legs\"", "name = \"hip\"");
    assert!(printed(&alone).contains("is accepted"), "{}", printed(&alone));
    let both =
        alone.replace("[[group]]", &format!("{knee}[[group]]")).replace("[\"hip\"]", "[\"hip\", \"knee\"]");
    let printed = printed(&both);
    assert!(printed.contains("group.name: \"hip\" is the name of a motor too"), "{printed}");
}

#[test]
fn imu_shares_no_name_of_another() {
    for (name, what) in [("hip", "motor"), ("desk", "bus"), ("legs", "group")] {
        let text = format!("{ROBOT}[[imu]]\nname = \"{name}\"\ntype = \"simulated\"\n");
        let printed = printed(&text);
        let expected = format!("imu.name: {name:?} is the name of a {what} too");
        assert!(printed.contains(&expected), "{printed}");
    }
}

#[test]
fn file_that_is_no_configuration_is_named() {
    for foreign in [
        "version = 4\n[[package]]\nname = \"libc\"\nversion = \"0.2\"\n",
        "[[package]]\nname = \"numpy\"\n[metadata]\nlock-version = \"2.0\"\n",
        "[workspace]\nmembers = []\n",
    ] {
        let printed = printed(foreign);
        assert_eq!(printed.lines().count(), 1, "{printed}");
        assert!(printed.starts_with("robot.toml: is no configuration of motord"), "{printed}");
    }
    let lock = printed("form = 1\n[[motor]]\nname = \"hip\"\nbus = \"desk\"\nid = 1\nfirmware = \"2\"\n");
    assert!(lock.starts_with("robot.toml: is a lock file of `motorctl setup`"), "{lock}");
    assert_eq!(lock.lines().count(), 1, "{lock}");
}

#[test]
fn bytes_that_are_no_text_are_named() {
    let printed = |bytes: &[u8]| {
        let path = std::path::Path::new("robot.toml");
        let machine = crate::document::machine();
        motord_configuration::parse(path, bytes, &machine).expect_err("no text").to_string()
    };
    for bytes in [&b"\x7fELF\x02\x01\x01\0\0\0\xff\xfe"[..], b"\x1f\x8b\x08\0\0\0\0\0\0\x03\xcb"] {
        assert!(printed(bytes).contains("is no text"), "{}", printed(bytes));
    }
    assert!(printed(b"name = \"h\xfcfte\"\n").contains("is not UTF-8 here"));
}

#[test]
fn equal_errors_are_listed_once() {
    let (head, _) = ROBOT.split_once("[[group]]").expect("it has one");
    let motor = |id: usize| {
        format!(
            "[[motor]]\nname = \"m{id}\"\nbus = \"desk\"\nid = {id}\nprotocol = \"mit\"\nmodel = \"GIM8108-8\"\nfirmware = 2\n"
        )
    };
    let motors: String = (2..12).map(motor).collect();
    let printed = printed(&format!("{head}{motors}[[group]]\nname = \"legs\"\njoints = [\"hip\"]\n"));
    let of = |part: &str| printed.lines().filter(|line| line.contains(part)).collect::<Vec<_>>();
    assert_eq!(of("unknown key `firmware`").len(), 1, "{printed}");
    assert!(of("firmware")[0].ends_with("; 10 times, also in lines 35, 42, 49 and 6 more"), "{printed}");
    assert_eq!(of("in no group").len(), 1, "{printed}");
    assert!(
        of("in no group")[0].contains("10 motors are in no group, so no client could move them"),
        "{printed}"
    );
}

#[test]
fn known_names_have_the_order_of_the_file() {
    let text = ROBOT.replace("[[motor]]", "[[bus]]\nname = 'aft'\ntype = 'simulated'\n[[motor]]");
    let text = text.replace("bus = \"desk\"", "bus = \"xyz\"");
    for _ in 0..20 {
        assert!(
            printed(&text).contains("there is no bus \"xyz\"; known are desk, aft"),
            "{}",
            printed(&text)
        );
    }
}

// Arbitrary and damaged files.

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = parse(Path::new("robot.toml"), &bytes, &machine());
    }

    /// Text of any language, with what begins and ends the parts of a file.
    #[test]
    fn arbitrary_text_never_panics(parts in prop::collection::vec("\\PC{0,6}|[\\[\\]{}=\"'#,.\\\\ \t\r\n-]{1,3}|rate-hz = |\n\\[cycle\\]\n|limits = \\{", 0..40)) {
        let text = parts.concat();
        if let Err(error) = parse(Path::new("robot.toml"), text.as_bytes(), &machine()) {
            for problem in &error.problems {
                prop_assert!(!problem.to_string().contains(char::is_control), "{:?}", problem.to_string());
            }
        }
    }

    /// Damage to a shipped file reaches more checks than random bytes do: a part of it moves to
    /// another position, or is replaced.
    #[test]
    fn damaged_shipped_file_never_panics_and_names_line(
        (file, at, removed) in (prop::sample::select(shipped_names()), any::<prop::sample::Index>(), 0_usize..40),
        moved in prop::option::of(any::<prop::sample::Index>()),
        inserted in "[-0-9.e'\"\\[\\]{}=,a-z\n#]{0,12}|\\[\\[?(bus|motor|group|cycle|ipc|exchange)\\]\\]?\n|nan|-inf|1e400",
    ) {
        let text = fs::read(shipped(&file)).unwrap();
        let at = at.index(text.len());
        let end = (at + removed).min(text.len());
        let mut damaged = [&text[..at], inserted.as_bytes(), &text[end..]].concat();
        if let Some(location) = moved {
            let location = location.index(damaged.len() + 1);
            damaged.splice(location..location, text[at..end].iter().copied());
        }
        if let Err(error) = parse(Path::new("robot.toml"), &damaged, &machine()) {
            prop_assert!(!error.problems.is_empty());
            let lines = 1 + damaged.iter().filter(|byte| **byte == b'\n').count();
            for problem in &error.problems {
                let location = problem.location.as_ref();
                prop_assert!(location.is_some_and(|location| (1..=lines).contains(&location.line)), "{}", problem);
                prop_assert!(!problem.to_string().contains(char::is_control), "{:?}", problem.to_string());
            }
        }
    }

    /// Damage to a good file reaches more checks than random bytes do.
    #[test]
    fn damaged_file_never_panics_and_names_line(
        at in 0..GOOD.len(),
        removed in 0_usize..20,
        inserted in "[-0-9.e'\\[\\]=a-z\n#]{0,12}",
    ) {
        let end = (at + removed).min(GOOD.len());
        let text = format!("{}{inserted}{}", &GOOD[..at], &GOOD[end..]);
        if let Err(error) = validate(&text) {
            prop_assert!(!error.problems.is_empty());
            prop_assert!(error.problems.iter().all(|problem| problem.location.is_some()));
        }
    }

    /// Any number replaces any other: settings are finite, positive where required, and durations
    /// never panic.
    #[test]
    fn whatever_numbers_are_accepted_make_sane_settings(value in any::<f64>(), nth in 0_usize..12) {
        let numbers: Vec<_> = GOOD.match_indices("= ").filter(|(at, _)| GOOD.as_bytes()[at + 2].is_ascii_digit()).collect();
        let at = numbers[nth % numbers.len()].0 + 2;
        let line_end = at + GOOD[at..].find('\n').unwrap();
        let text = format!("{}{value:?}{}", &GOOD[..at], &GOOD[line_end..]);
        if let Ok(Loaded { settings, .. }) = validate(&text) {
            prop_assert!(settings.cycle.period >= Duration::from_micros(250));
            for motor in settings.motors {
                let (torque, kp) = (motor.limits.torque, motor.limits.kp);
                prop_assert!(torque > 0.0 && torque <= motor.winding.peak_torque && kp.is_finite());
            }
        }
    }
}
