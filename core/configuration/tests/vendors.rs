//! The user's files of vendors, beside a configuration.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_configuration::vendors::{FOLDER, register_beside};
use motord_configuration::{Problem, Wrong};
use std::fs;
use std::os::unix::fs::PermissionsExt;

const MOTOR: &str = include_str!("../../../motors/protocol/tests/acme.toml");

const ROBOT: &str = r#"[[bus]]
name = "b"
type = "simulated"
[[motor]]
name = "m"
bus = "b"
id = 1
protocol = "mit"
model = "A-10"
"#;

/// Writes a configuration, and a folder with these files, and returns what is reported.
fn report(files: &[(&str, String)]) -> Result<Vec<String>, Vec<String>> {
    let directory = tempfile::tempdir().unwrap();
    let (robot, folder) = (directory.path().join("robot.toml"), directory.path().join(FOLDER));
    fs::write(&robot, ROBOT).unwrap();
    fs::create_dir(&folder).unwrap();
    for (name, text) in files {
        fs::write(folder.join(name), text).unwrap();
    }
    let name = |problem: &Problem| {
        let text = problem.to_string();
        text.replace(&format!("{}/", folder.display()), "")
    };
    match motord_configuration::load(&robot) {
        Ok(loaded) => Ok(loaded.settings.motors.iter().map(|motor| motor.model.clone()).collect()),
        Err(error) => Err(error.problems.iter().map(name).collect()),
    }
}

#[test]
fn file_beside_configuration_makes_its_motors_known() {
    assert_eq!(report(&[("acme.toml", MOTOR.into()), ("README", "no TOML".into())]).unwrap(), ["A-10"]);
    assert_eq!(report(&[("same.toml", MOTOR.into())]).unwrap(), ["A-10"], "it is known already");
}

#[test]
fn problems_of_every_file_are_reported() {
    let spoiled = MOTOR.replace("largest = 0x3F", "largest = 0").replace("acme", "bad");
    let taken = MOTOR.replace("\"acme\"", "\"damiao\"");
    let gim = MOTOR.replace("[ids]", "protocols = [\"gin\"]\n[ids]").replace("acme", "gin-motors");
    let files = [("1.toml", spoiled), ("2.toml", taken), ("3.toml", gim)];
    let expected = [
        "1.toml:5:11: ids.largest: 0 is out of range; give an integer from 1 to 255",
        "2.toml:2:10: there is a vendor `damiao` already; give this one another name",
        "3.toml:4:14: unknown protocol `gin`; did you mean `gim`?",
    ];
    assert_eq!(report(&files).unwrap_err(), expected);
}

#[test]
fn folder_that_everybody_may_change_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path().join(FOLDER);
    fs::create_dir(&folder).unwrap();
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o777)).unwrap();
    let problems = register_beside(&directory.path().join("robot.toml")).unwrap_err();
    assert!(matches!(problems[0].wrong, Wrong::WorldWritable), "{}", problems[0]);
}
