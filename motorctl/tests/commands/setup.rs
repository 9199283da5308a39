//! `motorctl setup`: it names each motor of a line that differs from the configuration, and stores
//! the motor's report.

use crate::line::{Calls, Line, motor};
use motord_simulator::MotorSettings;
use serde_json::Value;
use std::fs;
use std::process::{Command, Output, Stdio};

/// The line's motors as they are configured: `knee` with id 3 and `hip` with id 4.
fn configuration(line: &Line) -> String {
    let device = line.device();
    let motor = |name: &str, id: u16| {
        format!(
            "[[motor]]\nname = '{name}'\nbus = 'line'\nid = {id}\nhost-id = {}\nprotocol = 'gim'\nmodel = 'GIM8108-8'\n",
            0x40 + id
        )
    };
    let bus = format!("[[bus]]\nname = 'line'\ntype = 'serial'\ndevice = '{device}'\nevery = 5\n");
    format!("{bus}{}{}", motor("knee", 3), motor("hip", 4))
}

fn setup(line: &Line, options: &[&str]) -> Output {
    let config = line.path("motord.toml");
    fs::write(&config, configuration(line)).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_motorctl"));
    command.env("MOTORD_RUNTIME_DIR", line.path("run")).stdin(Stdio::null());
    command.args(["setup", "--config", config.to_str().unwrap()]).args(options).output().unwrap()
}

/// Returns the finding by motor and value, of a call that ends with `status`.
fn findings(line: &Line, status: i32) -> Vec<(String, String, String)> {
    let output = setup(line, &["--json"]);
    assert_eq!(output.status.code(), Some(status), "{}", String::from_utf8_lossy(&output.stderr));
    let reported: Value = serde_json::from_slice(&output.stdout).unwrap();
    let text = |finding: &Value, key: &str| finding[key].as_str().unwrap().to_owned();
    let findings = reported["findings"].as_array().unwrap().iter();
    findings
        .map(|finding| (text(finding, "motor"), text(finding, "value"), text(finding, "verdict")))
        .collect()
}

fn differing(line: &Line) -> Vec<(String, String)> {
    let differs =
        |(motor, value, verdict): (String, String, String)| (verdict == "differs").then_some((motor, value));
    findings(line, 1).into_iter().filter_map(differs).collect()
}

fn robot(change: impl FnOnce(&mut [MotorSettings; 2])) -> Line {
    let mut motors = [motor("knee", 3), motor("hip", 4)];
    change(&mut motors);
    Line::new(motors.into())
}

#[test]
fn configured_motors_agree_and_lock_stores_reports() {
    let line = robot(|_| {});
    let findings = findings(&line, 0);
    assert!(findings.iter().all(|(_, _, verdict)| verdict == "agrees"), "{findings:?}");
    let lock = fs::read_to_string(line.path("motord.lock.toml")).unwrap();
    for printed in ["name = \"knee\"", "torque-constant = 0.125", "firmware = 66051", "over-voltage"] {
        assert!(lock.contains(printed), "{printed}: {lock}");
    }
}

#[test]
fn wrong_constants_and_swapped_ids_are_named() {
    let line = robot(|[knee, hip]| (knee.torque_constant, hip.gear_ratio) = (0.2, 36.0));
    let pairs = [("knee", "torque-constant"), ("hip", "gear-ratio")];
    assert_eq!(differing(&line), pairs.map(|(motor, value)| (motor.to_owned(), value.to_owned())));

    let line = robot(|[knee, hip]| {
        // The hip is another model: its constants identify it.
        (hip.gear_ratio, hip.torque_constant) = (36.0, 0.154);
        (knee.id, hip.id) = (4, 3);
    });
    let named = differing(&line);
    assert!(named.contains(&("knee".into(), "gear-ratio".into())), "{named:?}");
}

#[test]
fn silent_motor_is_unknown_and_fails_command() {
    let line = robot(|[_, hip]| hip.id = 9);
    let findings = findings(&line, 1);
    assert!(findings.contains(&("hip".into(), "answer".into(), "unknown".into())), "{findings:?}");
    let output = setup(&line, &[]);
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(
        printed.contains("motorctl scan --bus") && printed.contains("1 of 2 motors answered"),
        "{printed}"
    );
    assert!(printed.contains("\n1 does not answer: hip (id 4)\n"), "{printed}");
}

#[test]
fn silent_motors_are_counted_and_named() {
    let line = robot(|[knee, hip]| (knee.id, hip.id) = (8, 9));
    let printed = String::from_utf8(setup(&line, &[]).stdout).unwrap();
    assert!(printed.contains("\n2 do not answer: knee (id 3), hip (id 4)\n"), "{printed}");
}

/// Goal: `setup` distinguishes two motors with one id from a motor without power.
/// Method: both receive each request and answer at once, so that the line carries damaged bytes.
#[test]
fn two_motors_with_one_id_are_suspected() {
    let line = robot(|[_, hip]| hip.id = 3);
    let asked = setup(&line, &["--joint", "knee"]);
    let suspicion = "bytes arrive, but no frame: two motors with one id?";
    let printed = String::from_utf8_lossy(&asked.stderr).into_owned();
    assert!(printed.contains(&format!("knee: while it is asked, {suspicion}")), "{printed}");
    let pinged = line.bad("ping @", 69);
    assert!(pinged.contains("no motor answers as id 3") && pinged.contains(suspicion), "{pinged}");
    let alone = setup(&robot(|_| {}), &[]);
    assert!(!String::from_utf8_lossy(&alone.stderr).contains("bytes arrive"), "{alone:?}");
}

#[test]
fn constants_are_written_with_consent_only() {
    let line = robot(|[knee, _]| knee.gear_ratio = 36.0);
    let refused = setup(&line, &["--write"]);
    assert_eq!(refused.status.code(), Some(64));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("permanently writes gear-ratio into knee"));
    assert_eq!(differing(&line).len(), 1, "nothing was written");
    let written = setup(&line, &["--write", "--yes"]);
    assert!(written.status.success(), "{}", String::from_utf8_lossy(&written.stderr));
    assert!(findings(&line, 0).iter().all(|(_, _, verdict)| verdict == "agrees"));
}

/// Goal: motors that differ from the configuration are named, corrected with consent, and keep the
/// values without power. The host id is reported with the command that corrects it.
#[test]
fn wrong_values_are_named_corrected_and_kept() {
    let line = robot(|[knee, hip]| {
        (knee.torque_constant, knee.gear_ratio, knee.pole_pairs) = (0.2, 36.0, 14);
        (hip.torque_constant, hip.host_id) = (0.3, 0x50);
    });
    let named = |motor: &str, values: &[&str]| {
        values.iter().map(|value| (motor.into(), (*value).into())).collect::<Vec<(String, String)>>()
    };
    let knee = named("knee", &["torque-constant", "gear-ratio", "pole-pairs"]);
    let hip = named("hip", &["host-id", "torque-constant"]);
    assert_eq!(differing(&line), [knee, hip].concat());
    let written = setup(&line, &["--write", "--yes"]);
    let printed = String::from_utf8(written.stdout).unwrap();
    assert_eq!(written.status.code(), Some(1), "{printed}");
    for name in ["knee", "hip"] {
        line.inject(&format!("{name} power-cycle"));
    }
    std::thread::sleep(std::time::Duration::from_millis(600));
    assert_eq!(differing(&line), named("hip", &["host-id"]));
    let cure = format!("motorctl config set host-id 68 --bus {} --id 4", line.device());
    assert!(printed.contains(&cure), "{printed}");
    let mut cured = Command::new(env!("CARGO_BIN_EXE_motorctl"));
    cured.env("MOTORD_RUNTIME_DIR", line.path("run")).args(cure.split(' ').skip(1)).arg("--yes");
    assert!(cured.output().unwrap().status.success());
    findings(&line, 0);
}

#[test]
fn refused_constant_shows_the_motors_words() {
    let line = robot(|[knee, _]| knee.gear_ratio = 36.0);
    line.inject("knee refuse 0x04");
    let refused = setup(&line, &["--write", "--yes"]);
    assert_eq!(refused.status.code(), Some(1));
    let printed = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        printed.contains("modify configuration: the motor refused: read-only register (RES 0x04)"),
        "{printed}"
    );
}

#[test]
fn one_motor_is_asked_and_others_keep_reports() {
    let line = robot(|_| {});
    assert!(setup(&line, &[]).status.success());
    line.inject("hip power-off");
    assert!(setup(&line, &["--joint", "knee"]).status.success());
    assert!(fs::read_to_string(line.path("motord.lock.toml")).unwrap().contains("hip"));
    assert_eq!(setup(&line, &["--joint", "elbow"]).status.code(), Some(64));
}
