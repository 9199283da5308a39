//! The monitor in real use: the real program in a terminal of tmux, with key presses, a real daemon
//! of simulated motors and a controller. Tests beside the drawing code check the screens in detail.

use motord_client::{Claim, Client, Error, Phase, Setpoint, State};
use motord_harness::daemon::{Daemon, slow_quadruped, until};
use motord_harness::tmux::Tmux;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// A terminal in which `motorctl` is the program of this test.
fn terminal(daemon: &Daemon) -> Option<Tmux> {
    let programs = Path::new(env!("CARGO_BIN_EXE_motorctl")).parent().unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let runtime = daemon.directory.path().to_str().unwrap();
    Tmux::start(&[("PATH", &path), ("MOTORD_RUNTIME_DIR", runtime)])
}

/// Holds the legs in position until `end`, and enables them when `enable` is set.
fn hold(client: &Client, end: &AtomicBool, enable: &AtomicBool, newest: &Mutex<Option<State>>) {
    let mut claim: Option<Claim> = None;
    while !end.load(Ordering::Relaxed) {
        let Ok(state) = client.wait(Duration::from_secs(1)) else { continue };
        *newest.lock().unwrap() = Some(state.clone());
        let positions = state.joints().map(|joint| joint.position().unwrap_or_default());
        let hold: Vec<_> =
            positions.map(|position| Setpoint::impedance(position, 0.0, 5.0, 0.5, 0.0)).collect();
        if claim.is_none() {
            claim = client.claim("legs").ok();
        }
        let Some(claim) = &mut claim else { continue };
        let sent: Result<(), Error> = claim.send(&hold);
        if sent.is_ok() && enable.load(Ordering::Relaxed) && claim.enable().is_ok() {
            enable.store(false, Ordering::Relaxed);
        }
    }
}

/// Goal: one screen shows who moves the robot, stops it with one key, and shows the cause and how
/// to continue.
/// Method: keys of tmux; the test checks the screen and the daemon's states.
#[test]
fn keys_stop_reset_and_disable_the_robot() {
    let daemon = Daemon::start(&slow_quadruped());
    let Some(tmux) = terminal(&daemon) else { return };
    let client = daemon.connect();
    let (end, enable, newest) = (AtomicBool::new(false), AtomicBool::new(true), Mutex::new(None));
    let phase = || newest.lock().unwrap().as_ref().and_then(|state: &State| state.group(0)?.phase);
    let is_stopped = || newest.lock().unwrap().as_ref().is_some_and(|state: &State| state.emergency_stop());
    std::thread::scope(|scope| {
        scope.spawn(|| hold(&client, &end, &enable, &newest));
        let all = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            until("motion", || (phase() == Some(Phase::Active)).then_some(()));
            tmux.enter("motorctl --instance demo monitor");
            let owner = format!("({})", std::process::id());
            let screen =
                tmux.until("the owner", |screen| screen.contains(&owner) && screen.contains("legs  active"));
            assert!(screen.contains("owner ") && !screen.contains("owner lease"), "{screen}");
            assert!(screen.contains("rr-knee") && screen.contains("front-left active"), "{screen}");

            tmux.press(&["Space"]);
            let screen = tmux.until("the stop", |screen| screen.contains("emergency stop confirmed"));
            assert!(is_stopped() && screen.contains(&owner), "{screen}");
            tmux.until("the cause", |screen| {
                screen.contains("STOPPED 0 s ago, legs: An emergency stop was requested.")
                    && screen.contains("motorctl --instance demo reset legs")
            });
            until("rest", || (phase() == Some(Phase::Disarmed)).then_some(()));
            tmux.press(&["r"]);
            let question = tmux.until("the question", |screen| screen.contains("Clear the stop of legs"));
            assert!(question.contains("An emergency stop was requested"), "{question}");
            std::thread::sleep(Duration::from_secs(1));
            assert!(is_stopped());
            tmux.press(&["y"]);
            tmux.until("the reset", |screen| screen.contains("legs: reset") && !screen.contains("STOPPED"));
            assert!(!is_stopped());

            enable.store(true, Ordering::Relaxed);
            until("motion", || (phase() == Some(Phase::Active)).then_some(()));
            tmux.press(&["d"]);
            tmux.until("the disabling", |screen| screen.contains("legs: stopped, after damping what moves"));
            until("rest", || (phase() == Some(Phase::Disarmed)).then_some(()));
        }));
        end.store(true, Ordering::Relaxed);
        all.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
    });
    tmux.press(&["q"]);
    tmux.until("the shell", |screen| screen.trim_end().ends_with('$'));
    tmux.assert_given_back();
}

/// Goal: text that is meant for another window does nothing here, also in a terminal without
/// bracketed paste.
#[test]
fn pasted_text_neither_stops_nor_clears_a_stop() {
    let daemon = Daemon::start(&slow_quadruped());
    let Some(tmux) = terminal(&daemon) else { return };
    let client = daemon.connect();
    let is_stopped = || client.wait(Duration::from_secs(5)).unwrap().emergency_stop();
    tmux.enter("motorctl --instance demo monitor");
    tmux.until("the robot", |screen| screen.contains("rr-knee"));
    tmux.paste("cargo run --yes\ny");
    tmux.until("the note", |screen| screen.contains("Pasted text was ignored"));
    assert!(!is_stopped());
    tmux.press(&["Space"]);
    tmux.until("the stop", |screen| screen.contains("STOPPED"));
    tmux.paste("cargo run --yes\ny");
    tmux.press(&["-l", "cry"]);
    tmux.until("the note", |screen| screen.contains("The stop was not cleared."));
    assert!(is_stopped());
    tmux.press(&["q"]);
    tmux.until("the shell", |screen| screen.trim_end().ends_with('$'));
    tmux.assert_given_back();
}

/// Goal: a terminal that loses the end mark of a paste does not take the stop key away.
#[test]
fn stop_key_works_after_unended_paste() {
    let daemon = Daemon::start(&slow_quadruped());
    let Some(tmux) = terminal(&daemon) else { return };
    let client = daemon.connect();
    tmux.enter("motorctl --instance demo monitor");
    tmux.until("the robot", |screen| screen.contains("rr-knee"));
    tmux.send(b"\x1b[200~cargo run --yes");
    std::thread::sleep(Duration::from_secs(1));
    assert!(!client.wait(Duration::from_secs(5)).unwrap().emergency_stop());
    tmux.press(&["Space"]);
    tmux.until("the stop", |screen| screen.contains("STOPPED"));
    tmux.press(&["q"]);
    tmux.until("the shell", |screen| screen.trim_end().ends_with('$'));
    tmux.assert_given_back();
}

/// At 80x24 and at 60x20.
fn the_first_screen_tells_everything(tmux: &Tmux) {
    let owner = format!("({})", std::process::id());
    let everything = [
        "EMERGENCY STOP",
        "legs disarmed owner ",
        &owner,
        "legs: An emergency stop was requested. (by pid ",
        "Bus rear-right is off. Check the wiring, the termination and the bit rate of the bus.",
        "fr-knee reports over-voltage. Remove its cause, then paste: motorctl --instance demo fault clear fr-knee",
        "Then paste, or press r: motorctl --instance demo reset legs",
        "rear-right off",
        "rr-hip",
        "SPACE e-stop",
    ];
    for (width, height) in [(80, 24), (60, 20)] {
        tmux.resize(width, height);
        tmux.until("everything at once", |screen| {
            let printed = screen.split_whitespace().collect::<Vec<_>>().join(" ");
            screen.lines().count() <= height.into() && everything.iter().all(|line| printed.contains(line))
        });
    }
}

/// Goal: with several faults, the first screen of a small terminal shows the cause of the stop, the
/// owner and the advice. The commands on the screen end the faults.
/// Method: the real program at 80x24 and at 60x20, with a motor fault, a bus that is off, and an
/// emergency stop. Then the test runs the lines of the screen in another shell, and presses the key
/// for the reset.
#[test]
fn three_simultaneous_troubles_fit_the_first_screen() {
    let daemon = Daemon::start(&slow_quadruped());
    let (Some(tmux), Some(shell)) = (terminal(&daemon), terminal(&daemon)) else { return };
    let client = daemon.connect();
    let (end, enable, newest) = (AtomicBool::new(false), AtomicBool::new(true), Mutex::new(None));
    let phase = || newest.lock().unwrap().as_ref().and_then(|state: &State| state.group(0)?.phase);
    std::thread::scope(|scope| {
        scope.spawn(|| hold(&client, &end, &enable, &newest));
        let all = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            until("motion", || (phase() == Some(Phase::Active)).then_some(()));
            tmux.enter("motorctl --instance demo monitor");
            tmux.until("the robot", |screen| screen.contains("legs  active"));
            tmux.press(&["Space"]);
            tmux.until("the stop", |screen| screen.contains("emergency stop confirmed"));
            until("rest", || (phase() == Some(Phase::Disarmed)).then_some(()));
            shell.enter("motorctl --instance demo sim fr-knee fault over-voltage");
            shell.enter("motorctl --instance demo sim rear-right bus-off; echo made");
            shell.until("the troubles", |screen| screen.contains("\nmade"));

            the_first_screen_tells_everything(&tmux);

            // Opens the page of the buses, and returns.
            tmux.press(&["Tab"]);
            tmux.until("the buses", |screen| screen.contains("rear-right") && !screen.contains("fl-hip "));
            tmux.press(&["1"]);
            shell.enter("motorctl --instance demo sim rear-right ok");
            shell.enter("motorctl --instance demo fault clear fr-knee; echo cleared");
            tmux.until("the end of both", |screen| {
                !screen.contains("rear-right is off")
                    && !screen.contains("over-voltage")
                    && !screen.contains("offline")
            });
            tmux.press(&["r"]);
            let question = tmux.until("the question", |screen| screen.contains("Clear the stop of legs"));
            assert!(question.contains("An emergency stop was requested"), "{question}");
            std::thread::sleep(Duration::from_secs(1));
            tmux.press(&["y"]);
            tmux.until("the reset", |screen| screen.contains("legs: reset") && !screen.contains("STOPPED"));
        }));
        end.store(true, Ordering::Relaxed);
        all.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
    });
    tmux.resize(80, 24);
    tmux.press(&["q"]);
    tmux.until("the shell", |screen| screen.trim_end().ends_with('$'));
    tmux.assert_given_back();
}

#[test]
fn pages_filters_and_sizes_follow_keys() {
    let daemon = Daemon::start(&slow_quadruped());
    let Some(tmux) = terminal(&daemon) else { return };
    let _client = daemon.connect();
    // On a terminal `watch` runs the monitor.
    tmux.enter("motorctl --instance demo watch");
    tmux.until("the joints", |screen| screen.contains("fl-hip"));
    tmux.press(&["/"]);
    tmux.press(&["-l", "knee"]);
    tmux.press(&["Enter"]);
    tmux.until("the knees", |screen| screen.contains("rr-knee") && !screen.contains("hip"));
    tmux.press(&["Escape"]);
    tmux.until("every joint", |screen| screen.contains("fl-hip"));
    tmux.press(&["Tab"]);
    tmux.until("the buses", |screen| screen.contains("malformed") && !screen.contains("fl-hip"));
    tmux.press(&["?"]);
    tmux.until("the help", |screen| screen.contains("SPACE     emergency stop"));
    tmux.press(&["1"]);
    tmux.resize(60, 20);
    tmux.until("the narrow joints", |screen| screen.contains("fl-hip") && !screen.contains("N·m"));
}

#[test]
fn signal_restores_terminal_and_restarted_daemon_is_found() {
    let mut daemon = Daemon::start(&slow_quadruped());
    let Some(tmux) = terminal(&daemon) else { return };
    drop(daemon.connect());
    tmux.enter("motorctl --instance demo monitor & echo $! >$MOTORD_RUNTIME_DIR/pid; fg");
    tmux.until("the joints", |screen| screen.contains("rr-knee"));
    daemon.kill();
    tmux.until("the loss", |screen| screen.contains("NO CONTACT for") && screen.contains("rr-knee"));
    daemon.restart();
    tmux.until("the next daemon", |screen| {
        screen.contains(&format!("({})", daemon.process.id())) && !screen.contains("NO CONTACT")
    });
    let pid = std::fs::read_to_string(daemon.directory.path().join("pid")).unwrap();
    let pid = nix::unistd::Pid::from_raw(pid.trim().parse().unwrap());
    nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGTERM).unwrap();
    tmux.until("the shell", |screen| !screen.contains("rr-knee"));
    tmux.assert_given_back();
}
