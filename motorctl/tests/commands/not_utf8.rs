//! Arguments and environment variables that are not UTF-8.

use crate::programs::program;
use crate::text;
use motord_harness::daemon::{BENCH, Daemon};
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::process::{Command, Output};
use tempfile::TempDir;

/// A letter of ISO 8859-1, and no UTF-8.
fn latin() -> &'static OsStr {
    OsStr::from_bytes(b"caf\xe9")
}

/// Checks that a program ended with a sentence.
fn assert_is_refused(line: &str, output: &Output) {
    let printed = text(&[&output.stdout[..], &output.stderr].concat());
    assert!(!printed.contains("panicked") && !printed.is_empty(), "{line}: {printed}");
    assert!(output.status.code().is_some_and(|status| (64..=80).contains(&status)), "{line}: {output:?}");
}

fn output(program: &mut Command) -> Output {
    let empty = TempDir::new().unwrap();
    program.env_remove("MOTORD_INSTANCE").env("MOTORD_RUNTIME_DIR", empty.path()).output().unwrap()
}

#[test]
fn argument_that_is_not_utf8_is_error() {
    for (name, lines) in [
        (
            "motord",
            &["", "check", "run", "run --plant", "deadman", "safe-stop", "--log", "init --file x --legs"][..],
        ),
        (
            "motorctl",
            &["", "status", "--instance", "explain", "frame decode", "sim", "plot", "replay", "latency"],
        ),
        ("motord-sim", &["", "--config", "--seed"]),
    ] {
        for line in lines {
            let mut command = program(name);
            command.args(line.split_whitespace()).arg(latin());
            assert_is_refused(&format!("{name} {line}"), &output(&mut command));
        }
    }
}

#[test]
fn variable_that_is_not_utf8_is_error() {
    for (name, line, variable) in
        [("motorctl", "status", "MOTORD_INSTANCE"), ("motord", "check x.toml", "MOTORD_LOG")]
    {
        let mut command = program(name);
        command.args(line.split(' ')).env_remove("MOTORD_INSTANCE").env(variable, latin());
        assert_is_refused(name, &command.output().unwrap());
    }
}

#[test]
fn text_that_is_not_utf8_costs_no_stop() {
    let daemon = Daemon::start(BENCH);
    let stopped_by = |command: &mut Command| {
        daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
        let output = command.output().unwrap();
        assert!(output.status.success(), "{command:?}: {output:?}");
        assert!(text(&output.stderr).contains("UTF-8") || text(&output.stderr).contains("unexpected"));
        assert_eq!(daemon.status()["emergency_stop"], true, "{command:?}");
        assert!(daemon.motorctl(&["reset", "--wait"]).status.success());
    };
    stopped_by(daemon.command(&["estop"]).arg(latin()));
    stopped_by(daemon.command(&["e-stop", "--config"]).arg(latin()));
    stopped_by(daemon.command(&["estop"]).env("MOTORD_INSTANCE", latin()).arg(latin()));
}

#[test]
fn mistyped_stop_beside_latin_names_the_command() {
    let output = output(program("motorctl").arg("stop").arg(latin()));
    assert_eq!(output.status.code(), Some(64), "{output:?}");
    assert!(text(&output.stderr).ends_with("NOTHING WAS STOPPED: type `motorctl estop`\n"), "{output:?}");
}
