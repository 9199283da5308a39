//! The shipped configurations and the reference of every key.

use crate::document::{JSON, TEXT, shipped, write};
use crate::mistakes::implausible;
use motord::commands::check::{Wanted, check};
use motord_configuration::{load, reference};
use std::fs;
use tempfile::TempDir;

/// The names of the files that we ship, in order.
pub(crate) fn shipped_names() -> Vec<String> {
    let files = fs::read_dir(shipped("")).expect("it is there").map(|entry| entry.expect("it can be read"));
    let mut names: Vec<_> = files.map(|file| file.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn every_shipped_configuration_passes_check() {
    let names = shipped_names();
    for known in
        ["arm-gim.toml", "arm-native.toml", "minimal.toml", "quadruped-simulated.toml", "quadruped.toml"]
    {
        assert!(names.contains(&known.to_owned()), "{known} is among {names:?}");
    }
    for name in names {
        let mut out = Vec::new();
        assert_eq!(check(&shipped(&name), JSON, &mut out).unwrap(), 0, "{}", String::from_utf8_lossy(&out));
        assert_eq!(implausible(&load(&shipped(&name)).unwrap().warnings), [""; 0], "{name}");
    }
}

#[test]
fn simulated_quadruped_plan_is_three_quarters_per_bus() {
    let mut out = Vec::new();
    assert_eq!(check(&shipped("quadruped-simulated.toml"), JSON, &mut out).unwrap(), 0);
    let report: serde_json::Value = serde_json::from_slice(&out).unwrap();
    let bus = |name| {
        serde_json::json!({
            "name": name, "motors": 3, "rate_hz": 1000.0, "every": 1, "worst_case_utilisation": 0.75,
            "unstuffed_utilisation": 0.618, "fault_poll_utilisation": 1.0, "rate_hz_max": 1085.0,
        })
    };
    let buses = ["front-left", "front-right", "rear-left", "rear-right"].map(bus);
    let imus = [serde_json::json!({ "name": "base", "type": "simulated", "rate_hz": 500.0 })];
    assert_eq!(report, serde_json::json!({ "errors": [], "warnings": [], "buses": buses, "imus": imus }));
}

#[test]
fn check_says_the_same_to_people() {
    let mut out = Vec::new();
    assert_eq!(check(&shipped("quadruped-simulated.toml"), TEXT, &mut out).unwrap(), 0);
    let text = String::from_utf8(out).unwrap();
    let row = text.lines().find(|line| line.starts_with("rear-left")).unwrap();
    assert_eq!(
        row.split_whitespace().collect::<Vec<_>>().join(" "),
        "rear-left 3 75.0 % 61.8 % 100.0 % 1085 Hz fits"
    );
    for column in ["worst case", "unstuffed", "fault poll", "highest"] {
        let explained = text.lines().filter(|line| line.starts_with(column)).count();
        assert_eq!(explained, 1, "{column} is explained once:\n{text}");
    }
    assert!(text.lines().last().unwrap().ends_with("quadruped-simulated.toml may run"), "{text}");
}

/// A motor whose limits come from everywhere.
const ORIGINS: &str = "[cycle]
rate-hz = 500
[[bus]]
name = 'desk'
type = 'simulated'
[[motor]]
name = 'hip'
bus = 'desk'
id = 1
protocol = 'mit'
model = 'GIM8108-8'
[[motor]]
name = 'knee'
bus = 'desk'
id = 2
protocol = 'mit'
model = 'GIM8108-8'
offset-rad = 0.5
max-velocity-rad-s = 9.0
rated-torque-nm = 3.0
[motor.limits]
position-rad = [-1.0, 2.0]
kp-max = 60.0
temperature-max-celsius = 75.0
[[motor]]
name = 'wheel'
bus = 'desk'
id = 3
protocol = 'mit'
model = 'GIM8108-8'
peak-torque-nm = 2.0
[[motor]]
name = 'claw'
bus = 'desk'
id = 4
protocol = 'mit'
model = 'GIM8108-8'
torque-constant-nm-per-a = 0.001
";

/// Goal: the report names the line that changes a limit, or states that no line does.
/// Method: the limits of four motors, as text and as JSON, against their file.
#[test]
fn every_effective_limit_says_where_it_comes_from() {
    let folder = TempDir::new().unwrap();
    let file = write(&folder, ORIGINS);
    let (mut json, mut printed) = (Vec::new(), Vec::new());
    assert_eq!(check(&file, Wanted { joints: true, ..JSON }, &mut json).unwrap(), 0);
    assert_eq!(check(&file, Wanted { joints: true, ..TEXT }, &mut printed).unwrap(), 0);
    let report: serde_json::Value = serde_json::from_slice(&json).unwrap();
    let printed = String::from_utf8(printed).unwrap();
    let line = |key: &str| 1 + ORIGINS.lines().position(|line| line.starts_with(key)).unwrap();
    let limit = |joint: usize, key: &str| {
        let limits = report["joints"][joint]["limits"].as_array().unwrap();
        limits.iter().find(|limit| limit["key"] == key).unwrap().clone()
    };
    for (joint, key, from) in [
        (0, "position-rad", "default".to_owned()),
        (0, "torque-nm", "rated torque of the model".to_owned()),
        (0, "kp-max", "default".to_owned()),
        (0, "torque-slew-nm-per-s", "50 · torque-nm".to_owned()),
        (0, "temperature-derate-celsius", "default".to_owned()),
        (0, "following-error-rad", "default".to_owned()),
        (1, "position-rad", format!("line {}", line("position-rad"))),
        (1, "velocity-rad-s", format!("max-velocity-rad-s in line {}", line("max-velocity"))),
        (1, "torque-nm", format!("rated-torque-nm in line {}", line("rated-torque"))),
        (1, "rated-torque-nm", format!("line {}", line("rated-torque"))),
        (1, "kp-max", format!("line {}", line("kp-max"))),
        (1, "temperature-derate-celsius", "10 below temperature-max-celsius".to_owned()),
        (2, "rated-torque-nm", format!("peak-torque-nm in line {}", line("peak-torque"))),
        (2, "torque-nm", format!("peak-torque-nm in line {}", line("peak-torque"))),
        (3, "torque-nm", "end of the protocol's scale".to_owned()),
    ] {
        assert_eq!(limit(joint, key)["from"], from.as_str(), "{key} of {joint}: {}", limit(joint, key));
        let row = |line: &&str| line.trim_start().starts_with(key) && line.ends_with(&from);
        assert!(printed.lines().any(|line| row(&line)), "{key}: {from} in\n{printed}");
    }
    assert_documented_limits_have_origins(&report["joints"][0]);
    let settings = load(&file).expect("is good").settings;
    for (joint, motor) in settings.motors.iter().enumerate() {
        let number = |key: &str| limit(joint, key)["max"].as_f64().map(|max| max as f32);
        assert_eq!(number("torque-nm"), Some(motor.limits.torque));
        assert_eq!(number("velocity-rad-s"), Some(motor.limits.velocity));
        assert_eq!(number("position-rad"), Some(motor.limits.position[1]));
        assert_eq!(number("following-error-rad"), motor.limits.following_error);
    }
    assert!(printed.contains("following-error-rad         half a turn"), "{printed}");
}

/// Goal: a robot of equal legs is read in a page.
#[test]
fn joints_with_equal_limits_share_a_table() {
    let mut out = Vec::new();
    check(&shipped("quadruped.toml"), Wanted { joints: true, ..TEXT }, &mut out).unwrap();
    let printed = String::from_utf8(out).unwrap();
    let heads: Vec<_> = printed.lines().filter(|line| line.contains(": GIM")).collect();
    let text = fs::read_to_string(shipped("quadruped.toml")).unwrap();
    let of = |joint: &str, first: usize| {
        let legs = ["fl", "fr", "rl", "rr"].iter().enumerate();
        let names = legs.map(|(leg, name)| {
            let name = format!("{name}-{joint}");
            let written = text.lines().position(|line| line == format!("name = {name:?}")).unwrap();
            // The line before it is that of [[motor]].
            format!("{name} id {} (line {written})", first + 3 * leg)
        });
        format!("{}: GIM8108-8, mit", names.collect::<Vec<_>>().join(", "))
    };
    assert_eq!(heads, [of("hip", 1), of("thigh", 2), of("knee", 3)], "{printed}");
    let row = printed.lines().find(|line| line.trim_start().starts_with("position-rad")).unwrap();
    let lines =
        row.rsplit("lines ").next().unwrap().split(", ").filter(|line| line.parse::<usize>().is_ok()).count();
    assert_eq!(lines, 4, "{row}");
}

#[expect(clippy::unwrap_used, reason = "a test may panic")]
fn assert_documented_limits_have_origins(joint: &serde_json::Value) {
    let keys: Vec<_> = joint["limits"].as_array().unwrap().iter().map(|limit| &limit["key"]).collect();
    let written = fs::read_to_string(shipped("../docs/configuration.md")).unwrap();
    let section = written.split("\n## ").find(|section| section.starts_with("[motor.limits]")).unwrap();
    for row in section.lines().filter_map(|line| line.strip_prefix("| `")) {
        let key = row.split('`').next().unwrap();
        assert!(keys.contains(&&serde_json::json!(key)), "{key} is a limit without an origin");
    }
}

/// With `MOTORD_WRITE_DOCS` set, writes the tables of the reference instead.
#[test]
fn the_reference_is_current() {
    let path = shipped("../docs/configuration.md");
    let written = fs::read_to_string(&path).expect("the reference is there");
    let current = reference(&written);
    if std::env::var_os("MOTORD_WRITE_DOCS").is_some() {
        fs::write(&path, current).expect("the reference can be written");
    } else {
        let stale = current.lines().zip(written.lines()).find(|(now, then)| now != then);
        let advice = "MOTORD_WRITE_DOCS=1 cargo test -p motord --test config reference";
        assert!(current == written, "docs/configuration.md is not current, see {stale:#?}; {advice}");
    }
}
