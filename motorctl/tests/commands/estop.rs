//! `motorctl estop` where motors do not answer, and where the daemon is not the one that was named.

use crate::text;
use motord_harness::daemon::{BENCH, Daemon};
use motord_harness::programs::{directory, lacks};
use serde_json::Value;
use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

/// Runs a script of bash in network and mount namespaces of its own: it sees no daemon of another
/// test, and stops none. `start DIRECTORY INSTANCE` starts a daemon. `None` where the computer
/// allows no namespaces.
fn alone(script: &str) -> Option<Output> {
    alone_in(&["--user", "--map-root-user", "--net", "--mount"], script)
}

/// Like [`alone`], where `as_outsider COMMAND` runs a command as another user,
/// `start_outside DIRECTORY` a daemon of that user, and `listen_outside` a Python program of that
/// user, until it prints a line. `None` also where this user is not root.
fn beside_outsider(script: &str) -> Option<Output> {
    const OUTSIDER: &str = r#"
        as_outsider() { setpriv --reuid=65534 --regid=65534 --clear-groups "$@"; }
        chmod 755 .
        as_outsider motord --version >/dev/null 2>&1 || exit 43
        start_outside() {
            install -d -o 65534 -g 65534 -m 700 "$1"
            install -o 65534 -m 600 bench.toml "$1/robot.toml"
            sed -i 's/bench/robot/' "$1/robot.toml"
            MOTORD_RUNTIME_DIR=$PWD/$1 setpriv --reuid=65534 --regid=65534 --clear-groups motord run --config "$1/robot.toml" >"$1.log" 2>&1 &
            for attempt in $(seq 300); do grep -q ' ready ' "$1.log" && return; sleep 0.1; done
            exit 99
        }
        listen_outside() {
            # Python itself changes the user: the other user may not reach it.
            python3 -c "
import os, resource, socket, time
resource.setrlimit(resource.RLIMIT_NOFILE, (4096, 4096))
os.setgroups([])
os.setgid(65534)
os.setuid(65534)
$1" >listening.log &
            until grep -q . listening.log; do sleep 0.1; done
        }
        is_stopped_outside() {
            MOTORD_RUNTIME_DIR=$PWD/$1 as_outsider motorctl --instance robot status --json | grep -q '"emergency_stop": *true'
        }
    "#;
    if lacks(&["setpriv", "python3"]) {
        return None;
    }
    let output = alone_in(&["--net", "--mount"], &format!("{OUTSIDER}\n{script}"))?;
    if output.status.code() == Some(43) {
        println!("NOT TESTED: only root can run programs as another user, who must be able to reach them");
        return None;
    }
    Some(output)
}

/// Like [`beside_outsider`], beside a daemon of that user, whose directory is `other` and whose
/// process is `$other`.
fn beside_daemon_of_outsider(script: &str) -> Option<Output> {
    beside_outsider(&format!("start_outside other; other=$!\n{script}"))
}

fn alone_in(unshare: &[&str], script: &str) -> Option<Output> {
    const START: &str = r#"
        set -u
        trap 'kill $(jobs -p) 2>/dev/null; wait' EXIT
        start() {
            mkdir -m 700 "$1"
            sed "s/bench/$2/" bench.toml >"$1/robot.toml"
            MOTORD_RUNTIME_DIR=$PWD/$1 motord run --config "$1/robot.toml" >"$1/log" 2>&1 &
            for attempt in $(seq 300); do
                MOTORD_RUNTIME_DIR=$PWD/$1 motorctl --instance "$2" status 2>/dev/null | grep -q idle && return
                sleep 0.1
            done
            exit 99
        }
        is_stopped() { MOTORD_RUNTIME_DIR=$PWD/$1 motorctl --instance "$2" status --json | grep -q '"emergency_stop": *true'; }
        mkdir -m 700 here
        export MOTORD_RUNTIME_DIR=$PWD/here
    "#;
    if lacks(&["unshare", "bash"]) {
        return None;
    }
    if !Command::new("unshare").args(unshare).arg("true").status().is_ok_and(|status| status.success()) {
        println!("NOT TESTED: this computer allows no such namespaces");
        return None;
    }
    let work_directory = TempDir::new().unwrap();
    std::fs::write(work_directory.path().join("bench.toml"), BENCH).unwrap();
    let path = format!("{}:{}", directory().display(), std::env::var("PATH").unwrap());
    let mut inside = Command::new("unshare");
    inside.args(unshare).args(["bash", "-c", &format!("{START}\n{script}")]);
    inside.current_dir(work_directory.path()).env("PATH", path).env_remove("MOTORD_INSTANCE");
    Some(inside.output().unwrap())
}

#[test]
fn stop_that_motors_did_not_hear_fails() {
    let daemon = Daemon::start(BENCH);
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    assert!(daemon.motorctl(&["sim", "arm", "off"]).status.success());
    daemon.await_status(|status| status["joints"][0]["mode"] == "offline");
    let output = daemon.motorctl(&["estop"]);
    assert_eq!(output.status.code(), Some(80), "{output:?}");
    assert_eq!(text(&output.stdout), "");
    assert_eq!(
        text(&output.stderr),
        "motorctl: the stop is confirmed, but these motors do not answer and may still move, so cut the power: arm\n"
    );
    assert_eq!(daemon.status()["emergency_stop"], true);
}

/// A motor that was switched off a moment ago is not offline yet.
#[test]
fn stop_before_a_loss_is_noticed_fails() {
    let slow = BENCH.replacen("[safety]", "[safety]\nlost-cycles = 100", 1);
    let slow = if slow == BENCH { format!("{BENCH}\n[safety]\nlost-cycles = 100\n") } else { slow };
    let daemon = Daemon::start(&slow);
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    assert!(daemon.motorctl(&["sim", "arm", "off"]).status.success());
    let output = daemon.motorctl(&["estop"]);
    assert_eq!(output.status.code(), Some(80), "{output:?}");
    assert!(text(&output.stderr).ends_with("cut the power: arm\n"), "{output:?}");
}

#[test]
fn cause_of_stop_names_its_source() {
    let daemon = Daemon::start(BENCH);
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    let client = daemon.connect();
    let source_of = |stop: &dyn Fn()| {
        stop();
        let status =
            daemon.await_status(|status| status["groups"][0]["stop"]["asked_by"]["program"].is_string());
        assert!(daemon.motorctl(&["reset", "--wait"]).status.success());
        status["groups"][0]["stop"]["asked_by"]["program"]
            .as_str()
            .unwrap()
            .split_once(": ")
            .map(|(_, s)| s.to_owned())
    };
    let source = "the door\nof the cell";
    assert_eq!(
        source_of(&|| client.emergency_stop_for(source).unwrap()).as_deref(),
        Some("the doorof the cell")
    );
    assert_eq!(source_of(&|| client.emergency_stop().unwrap()), None, "another stop of the same process");
}

/// A person who presses the emergency stop because of a fault must still find the fault.
#[test]
fn first_cause_survives_emergency_stop() {
    let daemon = Daemon::start(BENCH);
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    let mut hold = daemon.command(&["hold"]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    daemon.await_status(|status| status["groups"][0]["phase"] == "active");
    assert!(daemon.motorctl(&["sim", "arm", "off"]).status.success());
    daemon.await_status(|status| status["groups"][0]["stop"]["cause"] == "motor-lost");
    hold.wait().unwrap();
    assert!(daemon.motorctl(&["sim", "arm", "ok"]).status.success());
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    let output = daemon.motorctl(&["estop"]);
    let cause = "all had been stopped for motor-lost before: A motor stopped answering. (arm)";
    assert!(output.status.success() && text(&output.stdout).contains(cause), "{output:?}");
    let status = daemon.await_status(|status| status["groups"][0]["stop"]["first"] != Value::Null);
    let stop = &status["groups"][0]["stop"];
    assert_eq!((&stop["cause"], &stop["first"]["cause"]), (&"emergency-stop".into(), &"motor-lost".into()));
    assert_eq!(stop["first"]["joint"], "arm");
    let printed = daemon.motorctl(&["status"]);
    assert!(text(&printed.stdout).contains("all was first stopped for motor-lost: "), "{printed:?}");
    assert!(daemon.motorctl(&["reset", "--wait"]).status.success());
    assert_eq!(daemon.status()["groups"][0]["stop"], Value::Null);
}

#[test]
fn mistyped_stop_says_that_nothing_stopped() {
    let daemon = Daemon::start(BENCH);
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    for line in [&["estop", "legs"][..], &["e_stop"], &["STOP"], &["--instance", "bench", "E-Stop"]] {
        let output = daemon.motorctl(line);
        assert_eq!(output.status.code(), Some(64), "{line:?}");
        let printed = text(&output.stderr);
        assert!(
            printed.ends_with("motorctl: NOTHING WAS STOPPED: type `motorctl estop`\n"),
            "{line:?}: {printed}"
        );
    }
    for line in ["e-stop", "emergency-stop"] {
        assert!(daemon.motorctl(&[line]).status.success(), "{line}");
        assert_eq!(daemon.status()["emergency_stop"], true);
    }
}

#[test]
fn disabling_that_motors_did_not_hear_fails() {
    let daemon = Daemon::start(BENCH);
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    assert!(daemon.motorctl(&["disable"]).status.success());
    assert!(daemon.motorctl(&["sim", "arm", "off"]).status.success());
    daemon.await_status(|status| status["joints"][0]["mode"] == "offline");
    let output = daemon.motorctl(&["disable"]);
    assert_eq!(output.status.code(), Some(80), "{output:?}");
    assert_eq!(text(&output.stdout), "");
    assert!(text(&output.stderr).ends_with("cut the power: arm\n"), "{output:?}");
}

#[test]
fn only_daemon_elsewhere_is_stopped() {
    let Some(output) = alone("start other robot && motorctl estop && is_stopped other robot") else { return };
    assert!(output.status.success(), "{output:?}");
    let printed = text(&output.stdout);
    assert!(printed.contains("confirmed: every motor of instance robot in /"), "{printed}");
    assert!(printed.contains("MOTORD_RUNTIME_DIR=/") && printed.contains("motorctl reset`"), "{printed}");
}

/// Goal: an operator who names the wrong instance sees the line of each running instance, and the
/// line that stops all.
#[test]
fn wrong_instance_prints_lines_that_stop() {
    let Some(output) = alone("start other arm; motorctl --instance leg estop") else { return };
    assert_eq!(output.status.code(), Some(69), "{output:?}");
    assert_eq!(text(&output.stdout), "");
    let printed = text(&output.stderr);
    let lines: Vec<&str> = printed.lines().collect();
    assert_eq!(lines[0], "motorctl: EMERGENCY STOP NOT CONFIRMED: cut the power");
    let these = lines.iter().position(|line| *line == "motorctl: these run:").unwrap();
    assert!(lines[these + 1].ends_with("/other motorctl --instance arm estop"), "{printed}");
    assert_eq!(lines[these + 2..], ["  motorctl estop --all"], "{printed}");
}

/// The motors of a killed daemon may still move: a stop of another one is no success.
#[test]
fn killed_instance_prints_lines_that_stop() {
    let script = "start killed robot; killed=$!; start other leg; kill -KILL $killed; wait $killed 2>/dev/null\n\
        export MOTORD_RUNTIME_DIR=$PWD/killed; motorctl estop; status=$?\n\
        is_stopped other leg && exit 97; exit $status";
    let Some(output) = alone(script) else { return };
    let printed = text(&output.stderr);
    assert_eq!(output.status.code(), Some(69), "{printed}");
    assert!(printed.contains("motorctl: EMERGENCY STOP NOT CONFIRMED: cut the power\n"), "{printed}");
    assert!(printed.contains("died without stopping its motors"), "{printed}");
    assert!(printed.contains("motorctl: these run:\n"), "{printed}");
    assert!(printed.contains("/other motorctl --instance leg estop\n"), "{printed}");
    assert!(printed.ends_with("  motorctl estop --all\n"), "{printed}");
}

#[test]
fn several_daemons_elsewhere_are_named() {
    let script = "start one robot; start two arm; motorctl estop && exit 98; status=$?\n\
        is_stopped one robot || is_stopped two arm && exit 97\n\
        motorctl --instance leg estop; motorctl estop --all && is_stopped one robot && is_stopped two arm && exit $status";
    let Some(output) = alone(script) else { return };
    assert_eq!(output.status.code(), Some(69), "{output:?}");
    let printed = text(&output.stderr);
    assert!(printed.starts_with("motorctl: EMERGENCY STOP NOT CONFIRMED: cut the power\n"), "{printed}");
    assert_eq!(printed.matches("/two motorctl --instance arm estop\n").count(), 2, "{printed}");
    assert_eq!(printed.matches("  motorctl estop --all\n").count(), 2, "{printed}");
    assert_eq!(text(&output.stdout).matches("confirmed: every motor of instance ").count(), 2, "{output:?}");
}

#[test]
fn one_alarm_precedes_daemons_that_are_not_confirmed() {
    let script = "start one robot; one=$!; start two arm; kill -STOP $one; motorctl estop --all; status=$?\n\
        kill -CONT $one; is_stopped two arm && exit $status";
    let Some(output) = alone(script) else { return };
    assert_eq!(output.status.code(), Some(79), "{output:?}");
    let printed = text(&output.stderr);
    assert!(
        printed.starts_with("motorctl: EMERGENCY STOP NOT CONFIRMED: cut the power\nmotorctl: robot: "),
        "{printed}"
    );
    assert_eq!(printed.matches("NOT CONFIRMED").count(), 1, "{printed}");
    assert!(text(&output.stdout).contains("confirmed: every motor of instance arm"), "{output:?}");
}

/// Goal: a client that finds no space is not told that files are damaged. The emergency stop needs
/// none.
#[test]
fn client_on_full_file_system_is_told_so() {
    let script = "mkdir small; mount -t tmpfs -o size=40m tmpfs small || exit 42\n\
        start small/robot robot; head -c 64m /dev/zero >small/full 2>/dev/null\n\
        export MOTORD_RUNTIME_DIR=$PWD/small/robot\n\
        motorctl --instance robot status; status=$?\n\
        motorctl --instance robot estop && rm small/full && is_stopped small/robot robot && exit $status";
    let Some(output) = alone(script) else { return };
    if output.status.code() == Some(42) {
        return println!("NOT TESTED: this computer allows no mount");
    }
    let printed = text(&output.stderr);
    assert!(printed.contains("no space for its files"), "{output:?}");
    assert!(text(&output.stdout).contains("confirmed: every motor"), "{output:?}");
}

/// Goal: files and sockets of another user end, delay and fake no emergency stop. Method: the files
/// of a daemon of that user are cut to nothing, and 20 of that user's sockets with names of daemons
/// take every connection and never answer.
#[test]
fn outsider_neither_ends_nor_delays_stop_of_all() {
    const SILENT: &str = r#"
taken = []
for number in range(20):
    taken.append(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
    taken[-1].bind(f"\0motord-stop:s{number}:/tmp".encode())
    taken[-1].listen(8)
print("listens", flush=True)
time.sleep(100)
"#;
    let script = format!(
        "start mine robot\n\
         until motorctl instances --all | grep -q foreign; do sleep 0.1; done; kill -STOP $other\n\
         find other -type f -size +0 ! -name '*.toml' -exec truncate -s 0 {{}} +\n\
         listen_outside '{SILENT}'\n\
         begun=${{EPOCHREALTIME/./}}; motorctl estop --all; status=$?\n\
         echo took $(((${{EPOCHREALTIME/./}} - begun) / 1000)) ms\n\
         kill -KILL $other; is_stopped mine robot || exit 97; exit $status"
    );
    let Some(output) = beside_daemon_of_outsider(&script) else { return };
    let (printed, errors) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{output:?}");
    assert_eq!(printed.matches("confirmed").count(), 1, "{printed}");
    assert!(
        printed.contains("confirmed: every motor of instance robot in /") && printed.contains("/mine "),
        "{printed}"
    );
    assert!(errors.contains("Their answers do not count") && errors.contains("and 18 more"), "{errors}");
    let elapsed: u64 =
        printed.split("took ").nth(1).and_then(|elapsed| elapsed.split(' ').next()).unwrap().parse().unwrap();
    assert!(elapsed < 5000, "20 silent sockets took 22 s: {elapsed} ms");
}

/// Goal: more names than this process may have descriptors keep the stop from no daemon, and a full
/// queue is mentioned. Method: 1500 sockets of an outsider, one of them with a full queue, have
/// names before that of the daemon. `estop` may have 1024 descriptors, then 64.
#[test]
fn more_names_than_descriptors_hide_no_daemon() {
    const CROWD: &str = r#"
taken = []
for number in range(1500):
    taken.append(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
    taken[-1].bind(f"\0motord-stop:a{number}:/tmp".encode())
    taken[-1].listen(64)
full, callers = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET), []
full.bind(b"\0motord-stop:full:/tmp")
full.listen(0)
try:
    while True:
        callers.append(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        callers[-1].setblocking(False)
        callers[-1].connect(b"\0motord-stop:full:/tmp")
except BlockingIOError:
    print("listens", flush=True)
time.sleep(100)
"#;
    let script = format!(
        "start mine zz; listen_outside '{CROWD}'\n\
         for limit in 1024 64; do\n\
             (ulimit -n $limit; motorctl estop --all) || exit 98\n\
             is_stopped mine zz || exit 97\n\
             MOTORD_RUNTIME_DIR=$PWD/mine motorctl --instance zz reset --wait >/dev/null || exit 96\n\
         done; motorctl instances --all --json"
    );
    let Some(output) = beside_outsider(&script) else { return };
    let (printed, errors) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{output:?}");
    assert_eq!(printed.matches("confirmed: every motor of instance zz in /").count(), 2, "{printed}");
    let full = "a process of user unknown, instance full in /tmp, NOT REACHED";
    assert_eq!(errors.matches(full).count(), 2, "{errors}");
    assert_eq!(errors.matches("and 1498 more").count(), 2, "{errors}");
    assert!(
        printed.contains("\"instance\":\"full\"") || printed.contains("\"instance\": \"full\""),
        "a full queue is listed"
    );
}

/// Goal: a lone process of another user is not the daemon that is meant, and confirms nothing. It
/// is sent the stop of all.
#[test]
fn lone_foreign_instance_confirms_no_stop() {
    let script = "motorctl estop && exit 98; is_stopped_outside other && exit 97\n\
        motorctl instances; motorctl instances --all\n\
        motorctl estop --all; status=$?; is_stopped_outside other || exit 96; exit $status";
    let Some(output) = beside_daemon_of_outsider(script) else { return };
    let (printed, errors) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(69), "{output:?}");
    assert!(!printed.contains("confirmed"), "{printed}");
    assert_eq!(errors.matches("EMERGENCY STOP NOT CONFIRMED: cut the power").count(), 2, "{errors}");
    assert!(
        errors.contains(" of user 65534, instance robot in /") && errors.contains("/other: `sudo kill "),
        "{errors}"
    );
    assert!(
        !errors.contains("sudo -u") && !errors.contains("RUNTIME_DIR=/"),
        "no line runs as the outsider: {errors}"
    );
    assert!(printed.contains("1 of other users, which may be no daemons"), "{printed}");
    assert_eq!(printed.matches("65534, foreign").count(), 1, "{printed}");
}

/// Goal: a user who runs a daemon and has become root stops it, and so does root who names its
/// directory.
#[test]
fn root_stops_daemon_of_its_user() {
    let script = "SUDO_UID=65534 motorctl estop || exit 98; is_stopped_outside other || exit 97\n\
        SUDO_UID=65534 motorctl estop --all || exit 96; MOTORD_RUNTIME_DIR=$PWD/other motorctl estop";
    let Some(output) = beside_daemon_of_outsider(script) else { return };
    assert!(output.status.success(), "{output:?}");
    assert_eq!(text(&output.stdout).matches("confirmed: every motor").count(), 3, "{output:?}");
}

/// Goal: an instance whose name no shell can print keeps no robot moving: it is taken for the
/// default name, which means any daemon.
#[test]
fn instance_that_is_not_utf8_stops_default() {
    let script = "start here/own robot; export MOTORD_RUNTIME_DIR=$PWD/here/own\n\
        for stop in 'motorctl estop' \"motorctl --instance $'caf\\xe9' estop\"; do\n\
            (export MOTORD_INSTANCE=$'caf\\xe9'; eval \"$stop\") || exit 98\n\
            is_stopped here/own robot || exit 97\n\
            motorctl reset --wait >/dev/null || exit 96\n\
        done";
    let Some(output) = alone(script) else { return };
    assert!(output.status.success(), "{output:?}");
    assert_eq!(text(&output.stderr).matches("\"caf\\xE9\" is not UTF-8").count(), 2, "{output:?}");
}
