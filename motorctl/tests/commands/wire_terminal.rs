//! The commands on the wire at a terminal: their prompts, and keys that are held.

use crate::line::Line;
use motord_harness::tmux::Tmux;

/// Enters a call of motorctl with the knee of `line`; `done STATUS` is on the screen when it has
/// ended.
fn enter(terminal: &Tmux, line: &Line, call: &str) {
    let motorctl = env!("CARGO_BIN_EXE_motorctl");
    terminal.enter(&format!("clear; {motorctl} {call} --bus {} --id 3; echo done $?", line.device()));
}

/// Opens a terminal whose commands use a separate directory for locks.
fn terminal(line: &Line) -> Option<Tmux> {
    let runtime = line.path("runtime");
    Tmux::start(&[("MOTORD_RUNTIME_DIR", &runtime.display().to_string())])
}

/// The positions that `jog` has shown so far, rad.
fn positions(screen: &str) -> Vec<f64> {
    let shown = screen.lines().filter_map(|line| line.trim().strip_suffix(" rad"));
    shown.filter_map(|position| position.trim().parse().ok()).collect()
}

#[test]
fn only_yes_at_terminal_lets_motor_turn() {
    let line = Line::knee();
    let Some(terminal) = terminal(&line) else { return };
    for (answer, outcome) in [("y", "not done"), ("", "not done"), ("yes", "done 0")] {
        enter(&terminal, &line, "calibrate encoder");
        // Excludes the prompt of the previous call, which stays on the screen until it is cleared.
        let is_asked = |screen: &str| screen.contains("Type yes to go on:") && !screen.contains("\ndone ");
        terminal.until("the question", is_asked);
        terminal.enter(answer);
        let screen = terminal.until("the end", |screen| screen.contains("\ndone "));
        assert!(screen.contains(outcome), "{answer:?}: {screen}");
    }
    terminal.assert_given_back();
}

/// Goal: a joint moves while a key is held, and stops when it is released.
/// Method: keys of a real terminal; `jog` shows the position that the motor reports.
#[test]
fn jog_moves_while_keys_arrive_and_restores_terminal() {
    let line = Line::knee();
    let Some(terminal) = terminal(&line) else { return };
    enter(&terminal, &line, "jog --yes");
    let screen = terminal.until("a position", |screen| !positions(screen).is_empty());
    assert!(screen.contains("hold + or - to move, q to stop"), "{screen}");
    let position = |screen: &str| positions(screen).last().copied().unwrap_or(f64::NAN);
    let begin = position(&screen);
    let is_moved = |screen: &str| {
        terminal.press(&["+"]);
        position(screen) > begin + 0.1
    };
    let moved = position(&terminal.until("a motion forward", is_moved));
    let is_back = |screen: &str| {
        terminal.press(&["-"]);
        position(screen) < moved - 0.1
    };
    terminal.until("a motion backward", is_back);
    let mut last = f64::NAN;
    let stands = |screen: &str| {
        let now = position(screen);
        let before = std::mem::replace(&mut last, now);
        (now - before).abs() < 0.001
    };
    terminal.until("a joint that stands", stands);
    terminal.press(&["q"]);
    let screen = terminal.until("the end", |screen| screen.contains("\ndone "));
    assert!(screen.contains("stopped at") && screen.contains("done 0"), "{screen}");
    terminal.assert_given_back();
}
