//! `motorctl setup --guide` at a pseudo terminal, with new motors on an RS485 line.

use crate::line::terminal::Terminal;
use crate::line::{Calls, Line, motor};
use motord_simulator::MotorSettings;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::fs;
use std::process::Stdio;

const JOINTS: [&str; 4] = ["hip", "thigh", "knee", "ankle"];
const GUIDE: &str = "setup --guide --config robot.toml";

/// Four motors as from the factory, without power, and the configuration of their joints. The first
/// joint has the id of new motors.
fn robot() -> Line {
    // Their friction stops them where the hand lets go.
    let new = |name: &&str| MotorSettings {
        is_new: true,
        has_power: false,
        viscous_friction: 0.5,
        coulomb_friction: 0.1,
        ..motor(name, 1)
    };
    let line = Line::new(JOINTS.iter().map(new).collect());
    let motor = |(index, name): (usize, &&str)| {
        format!(
            "\n[[motor]] # the {name}\nname = '{name}'\nbus = 'line'\nid = {}\nhost-id = {}\nprotocol = 'gim'\nmodel = 'GIM8108-8'\n\
             direction = 1 # not known yet\nlimits = {{ position-rad = [-0.5, 0.5], torque-nm = 2.0 }} # cautious\n",
            index + 1,
            0x41 + index
        )
    };
    let motors: String = JOINTS.iter().enumerate().map(motor).collect();
    let bus = format!(
        "# My robot.\n[[bus]]\nname = 'line'\ntype = 'serial'\ndevice = '{}'\nevery = 10\n",
        line.device()
    );
    fs::write(line.path("robot.toml"), format!("{bus}{motors}")).unwrap();
    line
}

fn file(line: &Line) -> String {
    fs::read_to_string(line.path("robot.toml")).unwrap()
}

fn give_power(line: &Line, joint: &str) {
    line.inject(&format!("{joint} on"));
}

/// Turns the joint by hand until the number after `label` fits.
fn turn(
    line: &Line,
    terminal: &mut Terminal,
    joint: &str,
    torque: f64,
    label: &str,
    fits: impl Fn(f64) -> bool,
) {
    line.inject(&format!("{joint} load {torque}"));
    terminal.until(label, fits);
    line.inject(&format!("{joint} load 0"));
}

fn take_direction(line: &Line, terminal: &mut Terminal, joint: &str, sign: f64) {
    terminal.expect("in its positive direction");
    turn(line, terminal, joint, 0.3 * sign, "turned by ", |degrees| degrees * sign > 12.0);
    terminal.enter("");
}

/// Turns the joint further, and back beyond its begin.
fn take_range(line: &Line, terminal: &mut Terminal, joint: &str, sign: f64) {
    terminal.expect("to one end and to the other");
    turn(line, terminal, joint, 0.3 * sign, " to ", |degrees| degrees > 30.0);
    turn(line, terminal, joint, -0.3 * sign, "from ", |degrees| degrees < -30.0);
    turn(line, terminal, joint, 0.3 * sign, "now at ", |degrees| degrees > -10.0);
    terminal.enter("");
}

/// Answers every question of a joint from its id on.
fn set_up(line: &Line, terminal: &mut Terminal, joint: &str, sign: f64) {
    terminal.answer("write id", "");
    terminal.answer("to its mark", "zero");
    take_direction(line, terminal, joint, sign);
    take_range(line, terminal, joint, sign);
    terminal.answer("first motion", "move");
    terminal.answer("Did ", "y");
    terminal.expect(&format!("{joint} is done"));
}

/// Goal: four new motors end as a configuration that agrees with its motors, keeps the comments, and
/// has directions and ranges as the hand has shown them. One joint is mounted the other way round.
#[test]
fn new_motors_become_complete_configuration() {
    let line = robot();
    let mut terminal = Terminal::start(&line, GUIDE);
    for (joint, sign) in JOINTS.into_iter().zip([1.0, -1.0, 1.0, 1.0]) {
        terminal.expect("Give power to one motor");
        give_power(&line, joint);
        terminal.answer("Which joint is it", joint);
        set_up(&line, &mut terminal, joint, sign);
        // New motors have the id of the first joint.
        line.inject("hip power-off");
    }
    let printed = terminal.expect("motord run --config robot.toml");
    assert!(printed.contains("motord accepts robot.toml"), "{printed}");
    assert!(terminal.end().0.success());
    give_power(&line, "hip");
    std::thread::sleep(std::time::Duration::from_millis(600));
    line.good("setup --config robot.toml");
    let text = file(&line);
    for kept in ["# My robot.", "[[motor]] # the knee", "# not known yet", "# cautious", "torque-nm = 2.0"] {
        assert!(text.contains(kept), "{kept}: {text}");
    }
    let settings: toml::Table = text.parse().unwrap();
    for (motor, direction) in settings["motor"].as_array().unwrap().iter().zip([1, -1, 1, 1]) {
        assert_eq!(motor["direction"].as_integer(), Some(direction), "{text}");
        let range: Vec<f64> = motor["limits"]["position-rad"]
            .as_array()
            .unwrap()
            .iter()
            .filter_map(toml::Value::as_float)
            .collect();
        assert!((-1.5..-0.4).contains(&range[0]) && (0.4..1.5).contains(&range[1]), "{text}");
    }
    let lock = fs::read_to_string(line.path("robot.lock.toml")).unwrap();
    assert_eq!(lock.matches("[[motor]]").count(), 4, "{lock}");
    let (status, printed) = Terminal::start(&line, GUIDE).end();
    assert!(status.success() && printed.contains("All joints are done"), "{printed}");
}

/// Goal: an answer that cannot be meant gets a sentence, and the question again.
#[test]
fn wrong_answers_are_caught() {
    let line = robot();
    let mut terminal = Terminal::start(&line, GUIDE);
    give_power(&line, "hip");
    give_power(&line, "thigh");
    terminal.expect("several motors answer as id 1: take the power from all but one");
    line.inject("thigh power-off");
    terminal.answer("Which joint is it", "elbow");
    terminal.expect("no joint elbow is to do");
    terminal.answer("Which joint is it", "?");
    terminal.expect("The motor gets the id of this joint");
    terminal.enter("");
    terminal.answer("write id 1 and host id 0x041", "yes");
    terminal.expect("`yes` is no answer here");
    terminal.answer("write id", "");
    terminal.answer("to its mark", "");
    terminal.expect("only `zero` goes on");
    terminal.answer("to its mark", "zero");
    terminal.answer("in its positive direction", "");
    terminal.expect("° only");
    take_direction(&line, &mut terminal, "hip", 1.0);
    terminal.answer("to one end and to the other", "");
    terminal.expect("° only");
    take_range(&line, &mut terminal, "hip", 1.0);
    terminal.answer("first motion", "");
    terminal.expect("only `move` goes on");
    terminal.answer("first motion", "move");
    terminal.answer("Did ", "maybe");
    terminal.expect("type y or n");
    terminal.enter("y");
    terminal.expect("hip is done");
    terminal.expect("the motor of hip answers and needs nothing: give power to the next motor");
    give_power(&line, "knee");
    terminal.expect("several motors answer as id 1, which is that of hip");
    line.inject("hip power-off");
    terminal.answer("Which joint is it", "hip");
    terminal.expect("hip is done already");
    terminal.answer("Which joint is it", "q");
    terminal.expect("Go on with:\r\n  motorctl setup --guide --config robot.toml");
    assert!(terminal.end().0.success());
}

/// Goal: the guide goes on at the question at which it was killed, with the motor's power cycled.
#[test]
fn killed_guide_goes_on_at_each_step() {
    let line = robot();
    let restart = |terminal: Terminal| {
        terminal.kill();
        line.inject("knee power-cycle");
        Terminal::start(&line, GUIDE)
    };
    give_power(&line, "knee");
    let mut terminal = Terminal::start(&line, GUIDE);
    terminal.expect("Which joint is it");
    terminal = restart(terminal);
    terminal.answer("Which joint is it", "knee");
    terminal.expect("write id 3");
    terminal = restart(terminal);
    terminal.answer("Which joint is it", "knee");
    terminal.answer("write id 3", "");
    for _ in 0..2 {
        terminal.expect("to its mark");
        terminal = restart(terminal);
        terminal.expect("begun: id");
        terminal.expect("knee: its motor answers");
    }
    terminal.answer("to its mark", "zero");
    terminal.expect("in its positive direction");
    terminal = restart(terminal);
    terminal.expect("begun: id, zero");
    take_direction(&line, &mut terminal, "knee", -1.0);
    terminal.expect("to one end and to the other");
    terminal = restart(terminal);
    take_range(&line, &mut terminal, "knee", -1.0);
    terminal.expect("first motion");
    terminal = restart(terminal);
    terminal.answer("first motion", "move");
    terminal.expect("Did ");
    terminal = restart(terminal);
    terminal.answer("first motion", "move");
    terminal.answer("Did ", "y");
    terminal.expect("knee is done");
    terminal = restart(terminal);
    terminal.expect("the motor of knee answers and needs nothing");
    assert!(file(&line).contains("direction = -1 # not known yet"), "{}", file(&line));
    kill(Pid::from_raw(terminal.process().cast_signed()), Signal::SIGINT).unwrap();
    terminal.expect("Go on with");
    assert!(terminal.end().0.success());
}

/// Goal: each step is undone, in the motor and in the file, up to the state from the factory.
#[test]
fn each_step_is_undone_in_motor_and_file() {
    let line = robot();
    let [before, text] = [line.path("robot.toml"), line.path("before")];
    fs::copy(&before, &text).unwrap();
    let mut terminal = Terminal::start(&line, GUIDE);
    give_power(&line, "knee");
    terminal.answer("Which joint is it", "knee");
    terminal.expect("write id 3");
    // Away from its zero.
    line.inject("knee load 0.3");
    std::thread::sleep(std::time::Duration::from_millis(300));
    line.inject("knee load 0");
    terminal.enter("");
    terminal.answer("to its mark", "zero");
    take_direction(&line, &mut terminal, "knee", -1.0);
    take_range(&line, &mut terminal, "knee", -1.0);
    terminal.answer("first motion", "move");
    terminal.answer("Did ", "n");
    terminal.expect("range: undone");
    terminal.expect("direction: undone");
    for step in ["zero: undone", "id: undone"] {
        terminal.expect("\n> ");
        terminal.enter("b");
        terminal.expect(step);
    }
    terminal.expect("write id 3");
    assert_eq!(fs::read_to_string(&text).unwrap(), file(&line));
    terminal.enter("b");
    terminal.answer("Which joint is it", "q");
    assert!(terminal.end().0.success());
    let address = line.json("id --bus LINE --id 1");
    assert_eq!((address["id"].as_i64(), address["host_id"].as_i64()), (Some(1), Some(0)));
    assert_eq!(line.json("config get zero-position --bus LINE --id 1")["value"], 0);
}

#[test]
fn guide_needs_terminal_and_configuration() {
    let line = robot();
    let refused = line.command(GUIDE).stdin(Stdio::null()).output().unwrap();
    assert_eq!(refused.status.code(), Some(64));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("needs a terminal"), "{refused:?}");
    let (status, printed) = Terminal::start(&line, "setup --guide --config other.toml").end();
    assert_eq!(status.code(), Some(64));
    assert!(printed.contains("`motord init --file other.toml` writes it"), "{printed}");
}
