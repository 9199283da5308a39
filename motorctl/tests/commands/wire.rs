//! `motorctl` on a bus: native motors on an RS485 line, which is a pseudo terminal here.

use crate::line::{self, Calls, Line, motor, text};
use motord_bus::Duration;
use motord_harness::tmux::Tmux;
use motord_protocol::gim::{CONFIGURATION, INDICATORS, PARAMETERS};
use motord_simulator::{Behaviour, DurationEnd, MotorSettings};
use serde_json::Value;
use std::process::Stdio;

#[test]
fn scan_of_line_finds_motors_and_host_ids() {
    let line = Line::new(vec![motor("knee", 3), motor("ankle", 4), motor("hip", 9)]);
    let scanned = line.json("scan --bus LINE --ids 1-12");
    let motors: Vec<_> = scanned["motors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|m| (m["id"].clone(), m["host_id"].clone()))
        .collect();
    let expected = [(3, 0x43), (4, 0x44), (9, 0x49)].map(|(id, host)| (Value::from(id), Value::from(host)));
    assert_eq!(motors, expected);
    assert_eq!(scanned["motors"][0]["protocol"], "gim");
    let printed = line.good("scan --bus LINE --ids 3");
    assert!(printed.contains("0x043") && printed.contains("SDC101"), "{printed}");
}

#[test]
fn ping_shows_version_and_address() {
    let line = Line::knee();
    assert_eq!(line.json("ping @")["host_id"], 0x43);
    assert_eq!(line.json("version @")["version"], 0x0001_0203);
    assert_eq!(line.json("id @")["host_id"], 0x43);
    let silent = line.bad("ping --bus LINE --id 7", 69);
    assert!(silent.contains("no motor answers as id 7"), "{silent}");
}

#[test]
fn every_indicator_is_read_with_its_unit() {
    let line = Line::knee();
    let readings = line.json("indicator @");
    for (row, reading) in INDICATORS.iter().zip(readings.as_array().unwrap()) {
        assert_eq!((reading["name"].as_str(), reading["unit"].as_str()), (Some(row.name), Some(row.unit)));
        assert!(reading["value"].is_number(), "{reading}");
        assert_eq!(line.json(&format!("indicator {} @", row.name))[0]["name"], row.name);
    }
    assert_eq!(line.json("indicator 0x00 @")[0]["value"], 48.0);
    line.bad("indicator nonsense @", 64);
}

#[test]
fn every_parameter_is_written_and_read_back() {
    let line = Line::knee();
    for (index, row) in PARAMETERS.iter().enumerate() {
        let printed = line.good(&format!("parameter set {} {} @ --yes", row.name, 500 + index));
        assert!(printed.contains(&format!("reads {} now", 500 + index)), "{printed}");
    }
    let stored = line.json("parameter get @");
    for (index, row) in PARAMETERS.iter().enumerate() {
        assert_eq!(
            (&stored[index]["name"], &stored[index]["value"]),
            (&row.name.into(), &(500 + index).into())
        );
    }
    line.bad("parameter set position-kp -1 @ --yes", 64);
}

#[test]
fn every_configuration_item_is_listed_in_full() {
    let line = Line::knee();
    let rows = line.json("config list @");
    assert_eq!(rows.as_array().unwrap().len(), CONFIGURATION.len());
    for (item, row) in CONFIGURATION.iter().zip(rows.as_array().unwrap()) {
        assert_eq!((row["name"].as_str(), row["unit"].as_str()), (Some(item.name), Some(item.unit)));
        assert!(row["value"].is_number(), "{row}");
        assert_eq!(line.json(&format!("config get {} @", item.name))["name"], item.name);
    }
    let of = |name: &str| rows.as_array().unwrap().iter().find(|row| row["name"] == name).unwrap().clone();
    assert_eq!(of("power-off-position")["access"], "read");
    assert_eq!(of("pwm-frequency")["effective"], "after a reboot");
    assert_eq!(of("torque-constant")["type"], "float");
}

#[test]
fn item_is_written_read_back_or_refused() {
    let line = Line::knee();
    let printed = line.good("config set over-voltage 52 @ --yes");
    assert!(printed.contains("was 56, reads 52 now"), "{printed}");
    let printed = line.good("config set torque-constant 0.1 @ --yes");
    assert!(printed.contains("reads 0.1 now"), "{printed}");
    assert_eq!(line.json("config get torque-constant @")["value"], 0.1);
    let printed = line.good("config set pwm-frequency 16000 @ --yes");
    assert!(printed.contains("powered off and on"), "{printed}");
    for (line_of, expected) in [
        ("gear-ratio 0", "gear-ratio 0 is not written: a motor has 1 to 500"),
        ("over-voltage 5200", "over-voltage 5200 V is not written: a motor has 6 to 120 V; did you mean 52?"),
        ("torque-constant 100", "100 N·m/A is not written: a motor has 0.001 to 10 N·m/A; did you mean 0.1?"),
    ] {
        let refused = line.bad(&format!("config set {line_of} @ --yes"), 1);
        assert!(refused.contains(expected), "{refused}");
    }
    assert_eq!(line.json("config get over-voltage @")["value"], 52);
    for wrong in [
        "config set power-off-position 3 @ --yes",
        "config set gear-ratio 6.5 @ --yes",
        "config set nonsense 1 @ --yes",
        "config set torque-constant inf @ --yes",
    ] {
        line.bad(wrong, 64);
    }
}

#[test]
fn every_writable_item_is_set_by_name() {
    let line = Line::knee();
    line::write_every_item(&line);
    line::write_every_address(&line);
    for (item, value) in
        [("can-baud-rate", 5), ("can-baud-rate", 10), ("can-protocol", 1), ("can-protocol", 0)]
    {
        line.good(&format!("config set {item} {value} @ --yes"));
        assert_eq!(line.json(&format!("config get {item} @"))["value"], value);
    }
}

#[test]
fn every_documented_fault_is_named_and_cleared() {
    line::read_and_clear_every_fault(&Line::knee(), "gim");
}

#[test]
fn every_result_code_is_shown_in_words() {
    line::refuse_with_every_result_code(&Line::knee());
}

#[test]
fn motor_moves_for_bounded_time_and_stops() {
    let line = Line::knee();
    line.good("start @ --yes");
    line.good("stop @ --control");
    line.good("stop @");
    let printed = line.good("torque 0.3 --seconds 0.3 --max-travel-rad 9 --max-rad-s 40 @ --yes");
    assert!(printed.contains("stopped; last at"), "{printed}");
    line.good("speed -0.5 --seconds 0.3 @ --yes");
    let at = line.json("indicator shaft-angle @")[0]["value"].as_f64().unwrap();
    line.good(&format!("position {:.3} --seconds 0.6 @ --yes", at + 0.2));
    let after = line.json("indicator shaft-angle @")[0]["value"].as_f64().unwrap();
    assert!((after - at - 0.2).abs() < 0.05, "{at} {after}");
    line.good("jog --seconds 0.3 --backward @ --yes");
    let back = line.json("indicator shaft-angle @")[0]["value"].as_f64().unwrap();
    assert!(back < after - 0.03, "{after} {back}");
}

#[test]
fn a_write_survives_a_loss_of_power() {
    line::lose_power_after_every_write(&Line::knee());
}

#[test]
fn a_motor_whose_start_nobody_confirms_is_stopped() {
    line::lose_the_answer_to_a_start(&Line::knee(), "300ms");
}

/// Goal: after the kill of motorctl during a motion, a motor stops soon if its drive ends a command
/// after its duration. Otherwise it continues until `stop`.
#[test]
fn killed_motorctl_leaves_motor_to_command_duration() {
    let motions = [
        "torque 0.2 --seconds 20 --max-travel-rad 90 --max-rad-s 60 @ --yes",
        "speed 0.5 --seconds 20 --max-travel-rad 90 @ --yes",
        "jog --seconds 9 --rad-s 0.5 --max-travel-rad 12 @ --yes",
    ];
    let goes_limp = |motion| {
        let [moved, speed] = line::kill_in_motion(&Line::knee(), motion);
        assert!(moved > 0.2, "{motion}: {moved}");
        assert!(speed.abs() < 0.05, "{motion}: {speed}");
    };
    let goes_on = |motion| {
        let holds = Behaviour { duration_end: DurationEnd::HoldsCommand, ..Behaviour::default() };
        let line = Line::new(vec![MotorSettings { behaviour: holds, ..motor("knee", 3) }]);
        let [_, speed] = line::kill_in_motion(&line, motion);
        assert!(speed > 0.3, "{motion}: {speed}");
        line.good("stop @");
    };
    std::thread::scope(|scope| {
        for motion in motions {
            scope.spawn(move || goes_limp(motion));
            scope.spawn(move || goes_on(motion));
        }
    });
}

#[test]
fn host_id_is_refused_on_a_line() {
    let refused = Line::knee().bad("ping @ --host-id 0x43", 64);
    assert!(refused.contains("leave --host-id out"), "{refused}");
}

#[test]
fn motion_beyond_bounds_is_refused_or_stopped() {
    let line = Line::knee();
    line.bad("speed 9 --seconds 1 @ --yes", 64);
    line.bad("position 3 --seconds 1 @ --yes", 64);
    line.bad("torque nan --seconds 1 @ --yes", 64);
    line.bad("torque 1 --seconds 0 @ --yes", 64);
    let stopped = line.bad("torque 2 --seconds 5 @ --yes", 1);
    assert!(stopped.contains("stopped at a bound"), "{stopped}");
    std::thread::sleep(Duration::from_millis(800));
    let speed = line.json("indicator shaft-speed @")[0]["value"].as_f64().unwrap();
    assert!(speed.abs() < 40.0, "limp since, {speed} rpm");
}

#[test]
fn zero_is_moved_to_angle_and_checked() {
    let line = Line::knee();
    let printed = line.good("zero @ --at 0.5 --yes");
    assert!(printed.contains("reports 0.500 rad now"), "{printed}");
    line.good("zero @ --yes");
    let at = line.json("indicator shaft-angle @")[0]["value"].as_f64().unwrap();
    assert!(at.abs() < 0.01, "{at}");
    line.bad("zero @ --at 9 --yes", 64);
    line.bad("zero knee @ --yes", 64);
}

#[test]
fn a_fault_is_read_in_words_and_cleared() {
    let line = Line::knee();
    assert!(line.good("fault get @").contains("no fault"));
    line.inject("knee fault 0x42");
    // This motor reports only its fault: it cannot be identified.
    line.bad("ping @", 69);
    let fault = line.json("fault get @ --protocol gim");
    let names: Vec<_> =
        fault["faults"].as_array().unwrap().iter().map(|fault| fault["name"].clone()).collect();
    assert_eq!(names, ["over-voltage", "over-current"]);
    assert!(line.good("fault clear @ --protocol gim").contains("cleared"));
    line.good("ping @");
}

#[test]
fn a_calibration_waits_for_its_end() {
    let line = Line::knee();
    for what in ["phase", "encoder"] {
        let output = line.motorctl(&format!("calibrate {what} @ --yes"));
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert!(text(&output.stderr).contains("1 s of at most 60 s"), "{}", text(&output.stderr));
    }
}

#[test]
fn ids_and_protocol_are_changed_and_confirmed() {
    let line = Line::new(vec![motor("knee", 3), motor("ankle", 4)]);
    let taken = line.bad("id @ --set-id 4 --yes", 1);
    assert!(taken.contains("id 4 is on this bus already"), "{taken}");
    std::fs::write(line.path("four.toml"), "[configuration]\ncan-id = 4\n").unwrap();
    for same in ["config set can-id 4 @ --yes", "config apply four.toml @ --yes"] {
        assert!(line.bad(same, 1).contains("id 4 is on this bus already"), "{same}");
    }
    line.good("id @ --set-id 5 --set-host-id 0x55 --yes");
    assert_eq!(line.json("id --bus LINE --id 5")["host_id"], 0x55);
    line.bad("ping @", 69);
    line.good("id --bus LINE --id 5 --set-bitrate 500000 --yes");
    assert_eq!(line.json("id --bus LINE --id 5")["can_baud_rate"], 5);
    let printed = line.good("protocol mit --bus LINE --id 5 --yes");
    assert!(printed.contains("can-protocol was 0, reads 1 now"), "{printed}");
    line.good("protocol gim --bus LINE --id 5 --yes");
    assert_eq!(line.json("id --bus LINE --id 5")["can_protocol"], "gim");
    line.bad("id @ --set-id 6 --set-host-id 6 --yes", 64);
}

#[test]
fn pts_control_is_refused_as_documented() {
    let refused = Line::knee().bad("pts", 64);
    assert!(refused.contains("\"Not supported.\"") && refused.contains("3.2.10"), "{refused}");
}

#[test]
fn a_motor_in_firmware_mode_is_silent() {
    let line = Line::knee();
    line.bad("firmware-mode @ --repeat-id 4 --yes", 64);
    line.bad("firmware-mode @ --yes", 64);
    assert!(line.good("firmware-mode @ --repeat-id 3 --yes").contains("in firmware mode"));
    line.bad("fault get @ --protocol gim", 69);
}

#[test]
fn moving_commands_need_terminal_or_yes() {
    let line = Line::knee();
    std::fs::write(line.path("knee.toml"), "[configuration]\npole-pairs = 7\n").unwrap();
    let before = line.good("config list @");
    for destructive in [
        "start @",
        "torque 0.1 --seconds 1 @",
        "speed 0.1 --seconds 1 @",
        "position 0.1 --seconds 1 @",
        "jog --seconds 1 @",
        "zero @",
        "parameter set position-kp 1 @",
        "config set pole-pairs 7 @",
        "config apply knee.toml @",
        "config reset @",
        "id @ --set-id 5",
        "protocol mit @",
        "calibrate encoder @",
        "firmware-mode @ --repeat-id 3",
    ] {
        let refused = line.bad(destructive, 64);
        assert!(refused.contains("This ") && refused.contains("--yes"), "{destructive}: {refused}");
    }
    assert_eq!(line.good("config list @"), before);
    assert_eq!(line.json("indicator shaft-speed @")[0]["value"], 0.0);
}

#[test]
fn wrong_arguments_are_refused_before_anybody_is_asked() {
    let line = Line::knee();
    std::fs::write(line.path("bad.toml"), "[configuration]\npole-pears = 7\n").unwrap();
    std::fs::write(line.path("lost.toml"), "[configuration]\ncan-id = 0\n").unwrap();
    for (wrong, status) in [
        ("speed 0.1 --seconds 1 --bus LINE --id 0", 64),
        ("speed 0.1 --seconds 1 --bus LINE --id 255", 64),
        ("speed 0.1 --seconds 1 --bus LINE", 64),
        ("start", 64),
        ("config set pole-pairs many @", 64),
        ("config set can-id 0 @", 64),
        ("config set can-id 255 @", 64),
        ("config set host-id 0x800 @", 64),
        ("config set can-protocol 2 @", 64),
        ("config set can-baud-rate 500 @", 1),
        ("config apply lost.toml @", 65),
        ("config apply bad.toml @", 65),
        ("config apply missing.toml @", 74),
        ("torque nan --seconds 1 @", 64),
        ("torque 1e39 --seconds 1 --max-nm 200 @", 64),
        ("torque 2.1 --seconds 1 @", 64),
        ("torque 0.1 --seconds -1 @", 64),
        ("position inf --seconds 1 @", 64),
        ("jog --kd many @", 64),
        ("zero @ --at nan", 64),
        ("parameter set position-kq 1 @", 64),
        ("parameter set position-kp many @", 64),
        ("id @ --set-id 0", 64),
        ("id @ --set-id 300", 64),
        ("protocol both @", 64),
        ("calibrate everything @", 64),
        ("firmware-mode @ --repeat-id 4", 64),
        ("config reset --bus LINE", 64),
        ("ping --bus can/0 --id 3", 69),
        ("ping --bus nosuchcan9 --id 3", 69),
        ("scan --bus LINE --ids 9-3", 64),
        ("scan --bus LINE --bus LINE", 64),
    ] {
        let printed = line.bad(wrong, status);
        assert!(!printed.contains("--yes"), "{wrong}: {printed}");
    }
}

/// Goal: dump, factory reset, apply and diff leave no difference, for three motors, one after the
/// other on its line.
#[test]
fn factory_reset_is_undone_by_dump_and_apply() {
    for id in [3, 17, 99] {
        let line = Line::new(vec![motor("knee", id)]);
        let here = format!("--bus LINE --id {id}");
        line.good(&format!("config set rated-current {id} {here} --yes"));
        line.good(&format!("config dump knee.toml {here}"));
        line.bad(&format!("config dump knee.toml {here}"), 74);
        let printed = line.good(&format!("config reset {here} --yes"));
        assert!(printed.contains("it answers as id 1"), "{printed}");
        let differing = line.bad("config diff knee.toml --bus LINE --id 1", 1);
        assert!(differing.contains("items differ"), "{differing}");
        line.good("config apply knee.toml --bus LINE --id 1 --yes");
        line.good(&format!("config diff knee.toml {here}"));
        let journal = std::fs::read_to_string(line.path("knee.toml.journal")).unwrap();
        assert!(journal.lines().last().unwrap().contains("\"done\""), "{journal}");
    }
}

#[test]
fn application_stops_at_first_refusal() {
    let line = Line::knee();
    std::fs::write(
        line.path("knee.toml"),
        "[configuration]\npole-pairs = 13\nzero-position = 100000\nunder-voltage = 13\n",
    )
    .unwrap();
    let refused = line.bad("config apply knee.toml @ --yes", 1);
    assert!(
        refused.contains("data format (RES 0x07); 1 of 3 items were written before it, none after"),
        "{refused}"
    );
    assert_eq!(line.json("config get pole-pairs @")["value"], 13);
    assert_eq!(line.json("config get under-voltage @")["value"], 12);
    let journal = std::fs::read_to_string(line.path("knee.toml.journal")).unwrap();
    let events: Vec<Value> = journal.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let noted: Vec<_> =
        events.iter().map(|event| (event["event"].as_str().unwrap(), event["item"].as_str())).collect();
    let expected = [
        ("begin", None),
        ("writing", Some("pole-pairs")),
        ("written", Some("pole-pairs")),
        ("writing", Some("zero-position")),
        ("end", None),
    ];
    assert_eq!(noted, expected);
}

#[test]
fn interrupted_application_leaves_a_journal() {
    line::cut_the_power_during_an_application(&Line::knee());
}

#[test]
fn held_bus_is_refused_with_process_id() {
    let line = Line::knee();
    let mut first =
        line.command("indicator @ --watch").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(400));
    let refused = line.bad("ping @", 75);
    assert!(refused.contains(&format!("process {}", first.id())), "{refused}");
    first.kill().unwrap();
    first.wait().unwrap();
    line.good("ping @");
}

#[test]
fn line_with_echo_and_losses_is_read() {
    let line = Line::knee();
    line.inject("line echo");
    line.good("ping @");
    assert_eq!(line.json("config get gear-ratio @")["value"], 8);
    line.good("config set over-voltage 51 @ --yes");
}

#[test]
fn configuration_gives_place_and_limits_of_zero() {
    let line = Line::knee();
    let config = format!(
        "[[bus]]\nname = \"line\"\ntype = \"serial\"\ndevice = \"{}\"\nevery = 10\n[[motor]]\nname = \"knee\"\nbus = \"line\"\nid = 3\n\
         host-id = 0x43\nprotocol = \"gim\"\nmodel = \"GIM8108-8\"\n[motor.limits]\nposition-rad = [0.2, 1.0]\n\
         velocity-rad-s = 3.0\ntorque-nm = 1.5\n",
        line.device()
    );
    std::fs::write(line.path("robot.toml"), config).unwrap();
    let knee = "--config robot.toml --joint knee";
    assert!(line.good(&format!("ping {knee}")).contains("knee (motor 3"));
    // Its position is now 0, below the limits; each of these values is beyond them, and within the
    // bounds of the command line.
    for beyond in [
        "position 0.1 --seconds 1",
        "speed 4 --seconds 1",
        "torque 1.9 --seconds 1",
        "torque -1.9 --seconds 1",
    ] {
        let refused = line.bad(&format!("{beyond} {knee} --yes"), 64);
        assert!(refused.contains("outside of the limits of the joint"), "{beyond}: {refused}");
    }
    let leaves = line.bad(&format!("speed -1 --seconds 1 {knee} --yes"), 1);
    assert!(leaves.contains("stopped at a bound"), "{leaves}");
    let printed = line.good("jog knee --config robot.toml --seconds 0.3 --yes");
    assert!(printed.contains("knee (motor 3") && printed.contains("stopped at"), "{printed}");
    line.bad("jog knee --bus LINE --id 3 --seconds 0.3 --yes", 64);
    let outside = line.bad(&format!("zero {knee} --yes"), 1);
    assert!(outside.contains("outside of its limits 0.200 to 1.000 rad"), "{outside}");
    line.good(&format!("zero {knee} --at 0.5 --yes"));
    line.good(&format!("zero {knee} --force --yes"));
    line.bad("ping --config robot.toml --joint elbow", 64);
}

// The commands on the wire at a terminal: their prompts, and keys that are held.

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
