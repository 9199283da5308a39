//! The commands of an operator, against a running daemon with one simulated motor.

use crate::{started, text};
use motord_client::{Client, Error, Phase};
use motord_harness::daemon::{BENCH, Daemon};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tempfile::TempDir;

#[test]
fn status_shows_horizon_of_slow_controllers() {
    let daemon = started(BENCH);
    let client = daemon.connect();
    let mut claim = client.claim("all").unwrap();
    claim.hold(&client.wait(Duration::from_secs(1)).unwrap(), 5.0, 0.5).unwrap();
    claim.commit().unwrap();
    claim.enable().unwrap();
    let without = text(&daemon.motorctl(&["status"]).stdout);
    assert!(!without.contains("horizon ms"), "{without}");
    claim.wait_for(Phase::Active, Duration::from_secs(5)).unwrap();
    claim.set_horizon(Duration::from_millis(15)).unwrap();
    claim.commit().unwrap();
    // Also after the timeout that the next lines may cause.
    daemon.await_status(|status| status["groups"][0]["setpoint_horizon_us"] == 15_000.0);
    let with = text(&daemon.motorctl(&["status"]).stdout);
    assert!(with.contains("period ms  horizon ms") && with.contains("15.0"), "{with}");
}

#[test]
fn status_tells_people_and_scripts_the_same() {
    let daemon = started(BENCH);
    let status = daemon.status();
    assert_eq!(status["instance"], "bench");
    assert_eq!(status["pid"], daemon.process.id());
    assert_eq!(status["rate_hz"], 100.0);
    assert_eq!(status["groups"][0]["phase"], "disarmed");
    assert_eq!(status["groups"][0]["lease"], Value::Null);
    assert_eq!(status["joints"][0]["name"], "arm");
    assert_eq!(status["buses"][0]["condition"], "active");

    let printed = text(&daemon.motorctl(&["status"]).stdout);
    for word in ["bench: motord", "100 Hz", "disarmed", "arm", "idle", "desk", "active"] {
        assert!(printed.contains(word), "{word} in\n{printed}");
    }
    assert!(!printed.contains('\x1b'), "colour is for terminals:\n{printed}");
}

#[test]
fn emergency_stop_has_a_slot_when_full() {
    let daemon = started(BENCH);
    let mut idle = Vec::new();
    let full = loop {
        match Client::connect_in(daemon.directory.path(), "bench") {
            Ok(client) => idle.push(client),
            Err(error) => break error,
        }
    };
    assert!(idle.len() >= 20 && full.to_string().contains("slots are in use"), "{}: {full}", idle.len());
    assert!(!daemon.motorctl(&["enable"]).status.success(), "nobody else gets in");
    assert!(daemon.motorctl(&["estop"]).status.success());
    idle.truncate(1);
    assert_eq!(daemon.status()["emergency_stop"], true);
}

/// A successful stop must not be reported as failed when its output cannot be written.
#[test]
fn completed_action_succeeds_whatever_the_output_does() {
    let daemon = started(BENCH);
    for verb in ["estop", "reset", "disable"] {
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let output = daemon.command(&[verb]).stdout(full).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{verb}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains("done, but"), "{verb}: {}", text(&output.stderr));
    }
}

#[test]
fn emergency_stop_advises_and_reset_clears_it() {
    let daemon = started(BENCH);
    assert!(daemon.motorctl(&["estop"]).status.success());
    let status = daemon.status();
    assert_eq!(status["emergency_stop"], true);
    assert_eq!(status["groups"][0]["stop"]["cause"], "emergency-stop");
    let printed = text(&daemon.motorctl(&["status"]).stdout);
    assert!(printed.contains("`motorctl --instance bench reset all`"), "{printed}");

    assert!(daemon.motorctl(&["reset"]).status.success());
    let status = daemon.status();
    assert_eq!(status["emergency_stop"], false);
    assert_eq!(status["groups"][0]["stop"], Value::Null);
}

#[test]
fn what_the_daemon_refuses_fails_with_the_reason() {
    let daemon = started(BENCH);
    let refused = daemon.motorctl(&["enable", "all"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(text(&refused.stderr).contains("No process owns this group"), "{}", text(&refused.stderr));

    for unknown in [["enable", "legs"].as_slice(), &["zero", "leg", "--yes"], &["fault", "clear", "leg"]] {
        let output = daemon.motorctl(unknown);
        assert_eq!(output.status.code(), Some(64), "{unknown:?}");
        assert!(text(&output.stderr).contains("there is no"), "{}", text(&output.stderr));
    }
}

/// Sends the claim of a controller that holds the arm repeatedly, until the test ends it.
fn while_held(daemon: &Daemon, test: impl FnOnce()) {
    let (end, held) = (AtomicBool::new(false), AtomicBool::new(false));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let client = Client::connect_in(daemon.directory.path(), "bench").unwrap();
            let mut claim = client.claim("all").unwrap();
            while !end.load(Ordering::Relaxed) {
                let state = client.wait(Duration::from_secs(20)).unwrap();
                claim.hold(&state, 5.0, 0.5).unwrap();
                let sent = claim.commit();
                assert!(matches!(sent, Ok(()) | Err(Error::Stopped { .. })), "{sent:?}");
                held.store(true, Ordering::Relaxed);
            }
        });
        while !held.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(5));
        }
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(test));
        end.store(true, Ordering::Relaxed);
        outcome.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
    });
}

#[test]
fn active_group_counts_as_enabled_and_reset_waits() {
    let daemon = started(BENCH);
    while_held(&daemon, || {
        let until_enabled = Instant::now() + Duration::from_secs(20);
        while !daemon.motorctl(&["enable", "all"]).status.success() {
            assert!(Instant::now() < until_enabled, "the arm does not start");
        }
        let again = daemon.motorctl(&["enable"]);
        assert!(again.status.success(), "{}", text(&again.stderr));
        assert_eq!(text(&again.stdout), "all: is active already\n");
        let refused = text(&daemon.motorctl(&["reset"]).stderr);
        assert!(refused.contains("`--wait` waits for the end"), "{refused}");
        assert!(daemon.motorctl(&["estop"]).status.success());
        // The motor may still be damped: the reset waits for it.
        let reset = daemon.motorctl(&["reset", "--wait"]);
        assert!(reset.status.success(), "{}", text(&reset.stderr));
        assert_eq!(daemon.status()["groups"][0]["phase"], "disarmed");
    });
}

#[test]
fn status_states_period_of_slow_owner() {
    let daemon = Daemon::start(&BENCH.replace("setpoint-timeout-ms = 1000.0", "setpoint-timeout-ms = 100.0"));
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    let before = daemon.status();
    assert_eq!(before["groups"][0]["setpoint_period_us"], Value::Null);
    let timeout = Duration::from_secs_f64(before["setpoint_timeout_ms"].as_f64().unwrap() / 1e3);
    let client = Client::connect_in(daemon.directory.path(), "bench").unwrap();
    let mut claim = client.claim("all").unwrap();
    for _ in 0..5 {
        let state = client.wait(Duration::from_secs(20)).unwrap();
        claim.hold(&state, 5.0, 0.5).unwrap();
        claim.commit().unwrap();
        std::thread::sleep(timeout.mul_f64(0.6));
    }
    let status = daemon.motorctl(&["status"]);
    let report = daemon.status();
    let period = report["groups"][0]["setpoint_period_us"].as_f64().unwrap();
    assert!(period >= timeout.as_secs_f64() * 0.6e6, "{report}");
    assert!(text(&status.stdout).contains("all: Setpoints come every "), "{}", text(&status.stdout));
}

/// An operator needs the process that moves the robot: a lease does not identify it.
#[test]
fn status_names_the_process_that_owns_a_group() {
    let daemon = started(BENCH);
    assert_eq!(daemon.status()["groups"][0]["owner"], Value::Null);
    while_held(&daemon, || {
        let pid = std::process::id();
        let status = daemon.await_status(|status| status["groups"][0]["owner"]["pid"] == pid);
        let program = status["groups"][0]["owner"]["program"].as_str().unwrap();
        let printed = text(&daemon.motorctl(&["status"]).stdout);
        assert!(
            printed.contains(&format!("pid {pid}, {program}")) && !printed.contains("lease"),
            "{printed}"
        );
        let mut watch = daemon.command(&["watch", "--json"]).stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(watch.stdout.take().unwrap()).read_line(&mut line).unwrap();
        watch.kill().unwrap();
        watch.wait().unwrap();
        let watched: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(watched["groups"][0]["owner"], status["groups"][0]["owner"]);
    });
    daemon.await_status(|status| status["groups"][0]["owner"] == Value::Null);
}

#[test]
fn check_judges_robot_by_exit_status() {
    let daemon = started(BENCH);
    let check = || daemon.motorctl(&["status", "--check"]);
    assert_eq!((check().status.code(), text(&check().stdout)), (Some(0), String::new()));
    assert!(daemon.motorctl(&["estop"]).status.success());
    let printed = text(&check().stdout);
    assert_eq!(check().status.code(), Some(1), "{printed}");
    assert!(
        printed.contains("The emergency stop is latched.")
            && printed.contains("all is stopped for emergency-stop: "),
        "{printed}"
    );
    let report = daemon.motorctl(&["status", "--check", "--json"]);
    assert_eq!(report.status.code(), Some(1));
    assert!(serde_json::from_slice::<Value>(&report.stdout).unwrap()["groups"].is_array());
    let mut other = Command::new(env!("CARGO_BIN_EXE_motorctl"));
    other
        .args(["--instance", "other", "status", "--check"])
        .env("MOTORD_RUNTIME_DIR", daemon.directory.path());
    assert_eq!(other.output().unwrap().status.code(), Some(69));
}

#[test]
fn name_is_resolved_before_any_prompt() {
    let daemon = started(BENCH);
    // Without a terminal, a prompt would fail with advice to use `--yes`.
    let output = daemon.motorctl(&["zero", "leg"]);
    let complaint = text(&output.stderr);
    assert_eq!(output.status.code(), Some(64), "{complaint}");
    assert!(complaint.contains("there is no joint") && !complaint.contains("--yes"), "{complaint}");
    assert_eq!(text(&daemon.motorctl(&["fault"]).stdout), "bench: no motor reports a fault\n");
}

/// A running daemon reports its joints in the same form as `--bus` does on a wire without a daemon.
#[test]
fn joint_faults_and_indicators_are_read_through_daemon() {
    let daemon = Daemon::start(&BENCH.replace("\"mit\"", "\"gim\""));
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    let ask = |arguments: &[&str]| text(&daemon.motorctl(arguments).stdout);
    assert_eq!(ask(&["fault", "get", "arm"]), "arm: no fault\n");
    let faults = ask(&["fault", "get", "arm", "--json"]);
    assert_eq!(faults, "{\"name\":\"arm\",\"bits\":0,\"faults\":[],\"unknown_bits\":0}\n");
    let deadline = Instant::now() + Duration::from_secs(20);
    while !ask(&["indicator", "arm", "bus-voltage"]).contains("bus-voltage") {
        assert!(Instant::now() < deadline, "the daemon asks for it");
    }
    let voltage = ask(&["indicator", "arm", "0x00", "--json"]);
    assert!(voltage.starts_with("[{\"name\":\"bus-voltage\",\"value\":4"), "{voltage}");
    for (wrong, complaint) in [
        (&["indicator", "arm", "voltage"][..], "no indicator is `voltage`: expected one of"),
        (&["indicator", "leg"], "there is no joint"),
        (&["fault", "get", "arm", "--bus", "can0"], "JOINT selects the daemon"),
    ] {
        let output = daemon.motorctl(wrong);
        assert_eq!(output.status.code(), Some(64), "{wrong:?}");
        assert!(text(&output.stderr).contains(complaint), "{}", text(&output.stderr));
    }
    assert!(daemon.motorctl(&["sim", "arm", "fault", "over-voltage"]).status.success());
    while !ask(&["fault", "get", "arm"]).starts_with("arm: over-voltage: ") {
        assert!(Instant::now() < deadline, "the daemon asks for it");
    }
}

/// A terminal must not execute a file: its escape sequences arrive as letters.
#[test]
fn escape_sequences_of_a_file_are_spelled_out() {
    let directory = TempDir::new().unwrap();
    let path = directory.path().join("motord.toml");
    let name = "\\u001B[31mleg\\u0007";
    std::fs::write(&path, BENCH.replace("\"arm\"", &format!("\"{name}\""))).unwrap();
    let programs = Path::new(env!("CARGO_BIN_EXE_motorctl")).parent().unwrap();
    for (program, arguments) in [
        ("motord", ["check"].as_slice()),
        ("motord", &["run"]),
        ("motorctl", &["setup"]),
        ("motorctl", &["ping", "--joint", "x"]),
        ("motorctl", &["config", "diff"]),
    ] {
        let mut command = Command::new(programs.join(program));
        command.args(arguments).env("MOTORD_RUNTIME_DIR", directory.path());
        let command = if arguments == ["config", "diff"] {
            command.arg(&path).args(["--bus", "/dev/null", "--id", "1"])
        } else {
            command.arg("--config").arg(&path)
        };
        let output = command.output().unwrap();
        assert!(!output.status.success(), "{program} {arguments:?}");
        let printed = text(&output.stdout) + &text(&output.stderr);
        assert!(
            !printed.chars().any(|letter| letter.is_control() && letter != '\n'),
            "{program} {arguments:?}: {printed:?}"
        );
    }
}

#[test]
fn simulated_fault_is_seen_by_clients_and_ends() {
    let daemon = started(BENCH);
    let sim = |words: &[&str]| daemon.motorctl(&[&["sim"], words].concat());
    let mode = |mode: &'static str| move |status: &Value| status["joints"][0]["mode"] == mode;
    assert!(sim(&["arm", "off"]).status.success());
    daemon.await_status(mode("offline"));
    assert!(sim(&["arm", "ok"]).status.success());
    daemon.await_status(mode("idle"));
    let printed = text(&sim(&["arm", "fault", "over-voltage"]).stdout);
    assert!(printed.contains("`motorctl --instance bench sim arm ok` ends it"), "{printed}");
    daemon.await_status(mode("fault"));
    assert!(daemon.motorctl(&["fault", "clear", "arm"]).status.success());
    daemon.await_status(mode("idle"));
    // A bus whose adapter was unplugged reconnects with the same motors.
    for fault in ["bus-off", "down", "gone"] {
        assert!(sim(&["desk", fault]).status.success(), "{fault}");
        daemon.await_status(|status| status["buses"][0]["condition"] != "active");
        daemon.await_status(mode("offline"));
        assert!(sim(&["desk", "ok"]).status.success(), "{fault}");
        daemon.await_status(|status| status["buses"][0]["condition"] == "active");
        daemon.await_status(mode("idle"));
    }
}

#[test]
fn unknown_fault_suggests_the_nearest() {
    let daemon = started(BENCH);
    let refused = [
        (["arn", "off"].as_slice(), "did you mean `arm`?"),
        (&["arm", "of"], "did you mean `off`?"),
        (&["arm", "fault", "overvoltage"], "did you mean `over-voltage`?"),
        (&["arm", "delayed", "2"], "2ms"),
        (&["arm", "bus-off"], "only a bus"),
        (&["desk", "off"], "only a motor"),
        (&["desk", "echo"], "only a serial port"),
    ];
    for (words, reason) in refused {
        let output = daemon.motorctl(&[&["sim"], words].concat());
        assert_eq!(output.status.code(), Some(64), "{words:?}");
        assert!(text(&output.stderr).contains(reason), "{words:?}: {}", text(&output.stderr));
    }
    let mut command = daemon.command(&["sim", "arm", "off"]);
    let elsewhere = TempDir::new().unwrap();
    let missing = command.env("MOTORD_RUNTIME_DIR", elsewhere.path()).output().unwrap();
    assert_eq!(missing.status.code(), Some(69));
    assert!(text(&missing.stderr).contains("no motord runs"), "{}", text(&missing.stderr));
}

#[test]
fn latency_tells_every_percentile() {
    let daemon = started(BENCH);
    let latency: Value = serde_json::from_slice(&daemon.motorctl(&["latency", "--json"]).stdout).unwrap();
    for key in [
        "cycle_us",
        "wake_latency_us",
        "transmit_us",
        "delivery_us",
        "reply_latency_us",
        "setpoint_age_us",
        "control_latency_us",
        "publication_us",
    ] {
        for percentile in ["p50", "p99", "p99_9", "max"] {
            assert!(latency[key][percentile].is_number(), "{key}.{percentile} in {latency}");
        }
    }
    assert_eq!(latency["joints"][0]["name"], "arm");
    assert_eq!(latency["control"][0]["name"], "all");
    assert_eq!(latency["control"][0]["cycles"].as_array().map(Vec::len), Some(8));
}

#[test]
fn a_reset_of_the_latencies_begins_them_anew() {
    let daemon = started(BENCH);
    let latency =
        || -> Value { serde_json::from_slice(&daemon.motorctl(&["latency", "--json"]).stdout).unwrap() };
    let deadline = Instant::now() + Duration::from_secs(30);
    while latency()["cycles"].as_u64().unwrap() < 50 {
        assert!(Instant::now() < deadline, "the cycle stands still");
    }
    let (before, client) = (latency(), Client::connect_in(daemon.directory.path(), "bench").unwrap());
    client.reset_telemetry().unwrap();
    let after = client.telemetry().unwrap();
    assert!(after.cycles < before["cycles"].as_u64().unwrap(), "{after:?}");
    assert_eq!(after.resets, 1);
    assert!(after.wake_latency_us.count >= after.cycles);
    let reset = daemon.motorctl(&["latency", "--reset"]);
    assert_eq!(text(&reset.stdout), "the latencies were reset\n", "{}", text(&reset.stderr));
    assert_eq!(latency()["resets"], 2);
}

#[test]
fn latencies_round_trip_through_files() {
    let (daemon, directory) = (started(BENCH), TempDir::new().unwrap());
    let file = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let (log, percentiles, picture) = (file("run.hlog"), file("cycle.hgrm"), file("run.svg"));
    let run = |arguments: &[&str]| {
        let output = daemon.motorctl(&[&["latency"], arguments].concat());
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    };
    assert_eq!(
        run(&["--hlog", &log, "--interval", "0.2", "--seconds", "1"]),
        (Some(0), String::new(), String::new())
    );
    let (_, table, _) = run(&[&log]);
    for word in ["run", "wake_latency", "reply_latency/arm", "p99.9"] {
        assert!(table.contains(word), "{word} in {table}");
    }
    assert_eq!(run(&[&log, "--of", "cycle", "--hgrm", &percentiles]).0, Some(0));
    let written = std::fs::read_to_string(&percentiles).unwrap();
    assert!(written.contains("#[Mean    ="), "{written}");
    assert_eq!(run(&[&log, &percentiles, "--of", "cycle", "--svg", &picture]).0, Some(0));
    let drawn = std::fs::read_to_string(&picture).unwrap();
    assert!(drawn.contains("</svg>") && drawn.contains("run") && drawn.contains("cycle"), "{drawn}");
    assert_eq!(run(&["--of", "cycle", "--svg", &picture]).0, Some(0), "the daemon is a run, too");

    let (status, _, complaint) = run(&[&log, "--of", "cycles", "--hgrm", "-"]);
    assert!(status == Some(64) && complaint.contains("it has cycle, delivery"), "{complaint}");
    assert_eq!(run(&[&percentiles, "--hgrm", "-"]).0, Some(64), "it has no counts");
    assert_eq!(run(&[&file("none.hlog")]).0, Some(65));
    std::fs::write(&log, "Tag=a,0,1,2,HISTAAAA\n").unwrap();
    assert_eq!(run(&[&log]).0, Some(65));
    assert_eq!(run(&["--hlog", "/nowhere/run.hlog", "--seconds", "1"]).0, Some(74));
}

#[test]
fn a_closed_pipe_ends_a_watch_without_complaint() {
    let daemon = started(BENCH);
    let mut watch = daemon.command(&["watch"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(watch.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let output = watch.wait_with_output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{}", text(&output.stderr));
}

/// Goal: a running `watch` reports the death of its daemon, and continues with the next one without
/// input.
/// Method: kill the daemon during a watch, start another one, and continue reading.
#[test]
fn watch_outlives_daemon_and_finds_next() {
    let mut daemon = started(BENCH);
    let mut watch =
        daemon.command(&["watch", "--json"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(watch.stdout.take().unwrap()).lines();
    let mut pid = || -> u64 {
        let state: Value = serde_json::from_str(&lines.next().unwrap().unwrap()).unwrap();
        state["pid"].as_u64().unwrap()
    };
    let first = u64::from(daemon.process.id());
    assert_eq!(pid(), first);
    daemon.kill();
    let mut errors = BufReader::new(watch.stderr.take().unwrap());
    let mut complaint = String::new();
    errors.read_line(&mut complaint).unwrap();
    assert!(complaint.contains("no motord runs instance \"bench\""), "{complaint}");

    daemon.restart();
    let next = u64::from(daemon.process.id());
    while pid() != next {}
    kill(Pid::from_raw(watch.id().cast_signed()), Signal::SIGINT).unwrap();
    assert!(watch.wait().unwrap().success());
}

#[test]
fn changed_configuration_is_reported_and_not_used() {
    let daemon = started(BENCH);
    assert_eq!(daemon.status()["config_changed"], false);
    std::fs::write(daemon.directory.path().join("motord.toml"), "nonsense").unwrap();
    let deadline = Instant::now() + Duration::from_secs(20);
    while daemon.status()["config_changed"] != true {
        assert!(Instant::now() < deadline, "the change is not told");
    }
    assert_eq!(daemon.status()["joints"][0]["mode"], "idle");
}
