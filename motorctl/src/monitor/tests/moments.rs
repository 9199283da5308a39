//! The moments that matter, at three sizes. A snapshot has the text, then the styles of each row:
//! the first column, the number of columns, and the style.

use super::super::events::StopOutcome;
use super::super::request::{Notice, Question, Tone};
use super::super::view::View;
use super::robot::{picture, put_in_fault, put_off, stopped, stopped_by, trotting};
use super::{Loss, Picture, buffer, check, drawn, noticed, text};
use crate::report::FirstStopReport;
use crossterm::event::KeyCode;
use motord_client::{Cause, FirstStop};
use motord_terminal::Palette;
use ratatui::buffer::{Buffer, Cell};
use ratatui::style::{Color, Modifier, Style};
use std::time::{Duration, Instant};

const SMALL: [(u16, u16); 2] = [(60, 20), (80, 24)];
const ALL: [(u16, u16); 3] = [SMALL[0], SMALL[1], (200, 60)];

/// Compares a moment with its snapshots, and returns its text on one line for each size.
fn moment(name: &str, sizes: &[(u16, u16)], picture: &Picture, notice: &Notice) -> Vec<String> {
    let one = |(width, height): &(u16, u16)| {
        let buffer = noticed(*width, *height, picture, &mut View::default(), notice);
        assert_colours_hold_everywhere(&buffer);
        let text = text(&buffer);
        check(&format!("{name}-{width}x{height}"), &format!("{text}{}", styles(&buffer)));
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    sizes.iter().map(one).collect()
}

/// Only colours that are legible on a dark and on a light background, and white on red. Red has too
/// little contrast on black.
fn assert_colours_hold_everywhere(buffer: &Buffer) {
    for cell in &buffer.content {
        let colours = (cell.fg, cell.bg);
        let is_safe =
            matches!(colours, (Color::Reset | Color::Magenta, Color::Reset) | (Color::White, Color::Red));
        assert!(is_safe, "{colours:?} of {:?}", cell.symbol());
    }
}

fn styles(buffer: &Buffer) -> String {
    let line = |(row, cells): (usize, &[Cell])| {
        let mut column = 0;
        let mut styles = String::new();
        for run in cells.chunk_by(|a, b| a.style() == b.style()) {
            let style = style_name(run[0].style());
            if !style.is_empty() {
                styles.push_str(&format!(" {column}+{} {style}", run.len()));
            }
            column += run.len();
        }
        if styles.is_empty() { styles } else { format!("{row}:{styles}\n") }
    };
    buffer.content.chunks(buffer.area.width.into()).enumerate().map(line).collect()
}

fn style_name(style: Style) -> String {
    let modifiers = [(Modifier::BOLD, "bold"), (Modifier::DIM, "dim"), (Modifier::REVERSED, "reversed")];
    let modifiers = modifiers.iter().filter(|(modifier, _)| style.add_modifier.contains(*modifier));
    let colour = |colour: Option<Color>, name: &str| {
        let colour = colour.filter(|colour| *colour != Color::Reset);
        colour.map(|colour| format!("{name}{colour}").to_lowercase())
    };
    let colours = [colour(style.fg, ""), colour(style.bg, "on-")].into_iter().flatten();
    let names: Vec<String> = modifiers.map(|(_, name)| (*name).to_owned()).chain(colours).collect();
    names.join(",")
}

fn assert_has(screens: &[String], expected: &[&str]) {
    for screen in screens {
        expected
            .iter()
            .for_each(|expected| assert!(screen.contains(expected), "{expected} is not in\n{screen}"));
    }
}

#[test]
fn healthy_robot_shows_all_joints() {
    let screens = moment("trotting", &ALL, &picture(trotting()), &Notice::default());
    assert_has(&screens[1..], &["fl-knee", "fr-knee", "rl-knee", "rr-knee"]);
    assert_has(&screens, &["owner trot (4711)", "setpoint 214 µs old", "SPACE e-stop"]);
}

#[test]
fn first_screen_shows_cause_owner_and_advice() {
    let screens = moment("stopped", &ALL, &picture(stopped()), &Notice::default());
    let expected = [
        "EMERGENCY STOP",
        "not real-time",
        "3 missed ticks",
        "STOPPED 4 s ago, legs: An emergency stop was requested. (by pid 4815, motorctl)",
        "owner trot (4711)",
        "setpoint 12.3 s old",
        "Bus rear-right is off. Check the wiring",
        "fr-knee reports over-voltage.",
        "motorctl --instance demo fault clear fr-knee",
        "motorctl --instance demo reset legs",
        "rear-right off",
        "errors 258",
        "SPACE e-stop",
    ];
    assert_has(&screens, &expected);
    assert!(!screens.concat().contains("-0.00"), "{screens:?}");
}

/// Bus, motor and fault: what the stop and its cause both advise stands once.
#[test]
fn advice_is_said_once_and_bus_named() {
    let off = |mut reading| (put_off(&mut reading), reading).1;
    let faulty = |mut reading| (put_in_fault(&mut reading, 4), reading).1;
    let mut lost = stopped_by(Cause::MotorLost, Some(4));
    lost.report.joints[4].mode = "offline";
    let moments = [
        (
            "bus-off",
            off(stopped_by(Cause::BusOff, Some(9))),
            "many errors. (bus rear-right)",
            "Check the wiring",
        ),
        (
            "motor-fault",
            faulty(stopped_by(Cause::MotorFault, Some(4))),
            "reported a fault. (fr-thigh)",
            "cause",
        ),
        ("motor-lost", lost, "stopped answering. (fr-thigh)", "Check the motor's power"),
    ];
    for (name, reading, origin, advice) in moments {
        let screens = moment(name, &SMALL, &picture(reading), &Notice::default());
        assert_has(
            &screens,
            &[origin, advice, "Then paste, or press r: motorctl --instance demo reset legs"],
        );
        for screen in &screens {
            assert_eq!(screen.matches(advice).count(), 1, "{advice} in {screen}");
        }
    }
}

#[test]
fn status_advises_once_for_bus_that_is_off() {
    let mut report = trotting().report;
    let mut status = |is_off: bool| {
        report.buses[3].condition = if is_off { "off" } else { "active" };
        for joint in report.joints.iter_mut().filter(|joint| joint.bus == "rear-right") {
            joint.advice = Some(format!("{} does not answer: check its power.", joint.name));
        }
        let mut text = Vec::new();
        report.write(&mut text, Palette::of_stdout()).unwrap();
        let text = String::from_utf8(text).unwrap();
        ["does not answer", "Bus rear-right is off. Check the wiring"]
            .map(|advice| text.matches(advice).count())
    };
    assert_eq!((status(false), status(true)), ([3, 0], [0, 1]));
}

#[test]
fn question_names_cause_and_who_stopped() {
    let picture = picture(stopped());
    let mut notice = Notice::default();
    let report = &picture.reading.as_ref().unwrap().report;
    notice.question = Question::about(report, &["legs".to_owned()], Instant::now());
    let screens = moment("question", &SMALL, &picture, &notice);
    assert_has(
        &screens,
        &[
            "Clear the stop of legs? An emergency stop was requested. (by pid 4815, motorctl) Press y to clear it",
        ],
    );
}

#[test]
fn unheard_stop_and_pasted_text_are_shown() {
    let mut notice = Notice::default();
    notice.stop_done(StopOutcome::MotorsSilent(vec![
        "rr-hip".to_owned(),
        "rr-thigh".to_owned(),
        "rr-knee".to_owned(),
    ]));
    notice.show(Tone::Warning, "Pasted text was ignored.");
    let screens = moment("not-heard", &SMALL, &picture(stopped()), &notice);
    assert_has(
        &screens,
        &["may still move, so cut the power: rr-hip, rr-thigh, rr-knee", "Pasted text was ignored."],
    );
}

#[test]
fn lost_daemon_is_shown_above_last_state() {
    let mut picture = picture(trotting());
    let reason = "no motord runs instance \"demo\" in /run/motord: start it with `motord run`".to_owned();
    picture.loss = Some(Loss { lasting: Duration::from_secs(7), reason });
    let screens = moment("lost", &SMALL, &picture, &Notice::default());
    assert_has(
        &screens,
        &["NO CONTACT for 7 s: no motord runs instance \"demo\"", "start it with `motord run`", "fl-hip"],
    );
    let buffer = noticed(80, 24, &picture, &mut View::default(), &Notice::default());
    let rows = buffer
        .content
        .chunks(80)
        .filter(|row| row[..3].iter().map(Cell::symbol).collect::<String>() == "fl-");
    let is_old = |cell: &Cell| cell.modifier == Modifier::DIM && cell.fg == Color::Reset;
    assert!(rows.flatten().all(is_old), "old values look alive");
}

/// State is never in colour alone: without colours a background is reverse video.
#[test]
fn no_color_shows_the_same_in_reverse() {
    let picture = picture(stopped());
    let drawn = |is_colourless| {
        let mut view = View { is_colourless, ..View::default() };
        noticed(80, 24, &picture, &mut view, &Notice::default())
    };
    let (coloured, plain) = (drawn(false), drawn(true));
    assert_eq!(text(&coloured), text(&plain));
    for (coloured, plain) in coloured.content.iter().zip(&plain.content) {
        assert_eq!((plain.fg, plain.bg), (Color::Reset, Color::Reset));
        assert!(coloured.bg == Color::Reset || plain.modifier.contains(Modifier::REVERSED));
    }
}

/// Goal: many stops at once leave each cause, the troubles and the joints on the smallest screen,
/// and what does not fit is counted.
#[test]
fn several_causes_fit_the_small_terminal() {
    let mut reading = stopped_by(Cause::EmergencyStop, None);
    let robot = std::sync::Arc::make_mut(&mut reading.robot);
    for (name, cause, joint) in [("arm", Cause::MotorLost, Some(4)), ("tail", Cause::OwnerDied, None)] {
        let mut other = stopped_by(cause, joint).report.groups.remove(0);
        name.clone_into(&mut other.name);
        reading.report.groups.push(other);
        robot.groups.push(motord_client::GroupDescription { name: name.to_owned(), joints: Vec::new() });
        reading.telemetry.groups.push(reading.telemetry.groups[0].clone());
    }
    put_in_fault(&mut reading, 5);
    put_off(&mut reading);
    let screens = moment("several", &SMALL, &picture(reading), &Notice::default());
    let expected = [
        "legs: An emergency stop was requested. (by pid 4815, motorctl)",
        "arm: A motor stopped answering. (fr-thigh)",
        "tail: The owner's process ended",
        "Bus rear-right is off. Check the wiring",
        "fr-knee",
        "SPACE e-stop",
    ];
    assert_has(&screens, &expected);
    assert_has(&screens[..1], &["more lines: `motorctl --instance demo status`"]);
    assert_has(&screens[1..], &["fault clear fr-knee", "reset legs", "reset arm", "reset tail"]);
}

/// A small terminal cuts the notes of a row: the joint at the cursor has them all.
#[test]
fn joint_at_cursor_has_all_its_details() {
    let mut reading = stopped();
    let joint = &mut reading.report.joints[4];
    (joint.missed, joint.late, joint.age_cycles) = (80, 7, 3222);
    let name = joint.name.clone();
    let picture = picture(reading);
    let mut view = View::default();
    noticed(60, 20, &picture, &mut view, &Notice::default());
    for _ in 0..20 {
        view.press(&KeyCode::Right.into());
        let text = text(&noticed(60, 20, &picture, &mut view, &Notice::default()));
        if view.selection.cursor() == Some(name.as_str()) {
            let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(text.contains("N·m,") && text.contains("age 3222"), "{text}");
            assert!(text.contains("80 missed") && text.contains("7 late"), "{text}");
            return;
        }
    }
    panic!("the cursor never reaches {name}");
}

/// A person who presses the emergency stop because of a fault must still find the fault.
#[test]
fn first_cause_stands_beside_emergency_stop() {
    let mut reading = stopped();
    let lost = FirstStop { cause: Cause::MotorLost.code(), joint: Some(4), ..FirstStop::default() };
    let first = FirstStopReport::new(&lost, &reading.robot);
    reading.report.groups[0].stop.as_mut().unwrap().first = Some(first);
    let screens = moment("first-cause", &SMALL, &picture(reading), &Notice::default());
    assert_has(&screens, &["motorctl) The first cause: A motor stopped answering. (fr-thigh)"]);
}

// The curves on large terminals.

fn press(view: &mut View, code: KeyCode) {
    assert_eq!(view.press(&code.into()), None);
}

/// Returns the joints of the panels.
fn joints(drawn: &str) -> Vec<&str> {
    let titles = drawn.lines().filter(|line| line.contains(" velocity "));
    titles.filter_map(|line| line.split_whitespace().next()).collect()
}

#[test]
fn free_rows_show_curves_limits_and_marks() {
    let drawn = drawn(200, 60, &picture(stopped()), &mut View::default());
    assert_eq!(joints(&drawn), ["fr-knee", "rr-hip"], "faults first:\n{drawn}");
    for expected in [
        "fr-knee position -1.31 rad  limits -2.70 to -0.50",
        "fr-knee velocity 0.00 rad/s  limits -12.00 to 12.00, key l",
        "rr-hip position - rad",
        "a 4.0 s ago: legs is stopped: emergency-stop",
        "b 3.0 s ago: fr-knee reports over-voltage (0x2)",
    ] {
        assert!(drawn.contains(expected), "{expected} is not in\n{drawn}");
    }
    for drawing in ['┊', '┄', '⡇'] {
        assert!(drawn.contains(drawing), "{drawing} is not in\n{drawn}");
    }
}

#[test]
fn keys_choose_joints_time_and_scale() {
    let picture = picture(trotting());
    let mut view = View::default();
    let mut screen = |codes: &[KeyCode]| {
        codes.iter().for_each(|code| press(&mut view, *code));
        drawn(200, 60, &picture, &mut view)
    };
    assert_eq!(joints(&screen(&[])), ["fl-hip", "fl-thigh", "fl-knee"]);
    assert_eq!(joints(&screen(&[KeyCode::Left])), ["rr-hip", "rr-thigh", "rr-knee"], "the last row");
    assert_eq!(joints(&screen(&[KeyCode::Char('c')])), ["rr-knee"]);
    assert!(screen(&[KeyCode::Char('-')]).contains("-30 s"));
    assert!(screen(&[KeyCode::Char('+')]).contains("-15 s"));
    let limits = screen(&[]).matches('┄').count();
    assert!(screen(&[KeyCode::Char('l')]).matches('┄').count() > limits);
}

#[test]
fn curves_need_a_large_terminal() {
    let picture = picture(trotting());
    let has_curves = |width, height| drawn(width, height, &picture, &mut View::default()).contains('└');
    assert!(!has_curves(80, 24) && !has_curves(60, 20) && !has_curves(50, 200));
    assert!(has_curves(100, 40) && has_curves(80, 60), "one below the other");
}

#[test]
fn no_size_crashes_the_curves() {
    let picture = picture(stopped());
    for (width, height) in [(60, 60), (96, 34), (97, 300), (400, 31), (1000, 100)] {
        for key in ['l', 'c', '+', '-'] {
            let mut view = View::default();
            buffer(width, height, &picture, &mut view);
            press(&mut view, KeyCode::Char(key));
            buffer(width, height, &picture, &mut view);
        }
    }
}

/// Goal: the horizon is right of the joints where there is room, and a lost IMU has none.
#[test]
fn horizon_needs_room_and_samples() {
    let horizon = |width, lost| {
        let mut reading = trotting();
        reading.report.imus[0].lost = lost;
        let drawn = drawn(width, 60, &picture(reading), &mut View::default());
        let beside =
            |line: &&str| line.starts_with("fr-") || line.starts_with("rl-") || line.starts_with("joint");
        let lines = drawn.lines().filter(beside).map(|line| line.chars().skip(100).collect::<String>());
        lines.take_while(|line| !line.contains("velocity")).collect::<String>()
    };
    let shown = horizon(200, false);
    assert!(shown.contains("base roll 8.6°") && shown.contains('○') && shown.contains('⣀'), "{shown}");
    let lost = horizon(200, true);
    assert!(lost.contains("base lost") && lost.contains('○') && !lost.contains('⣀'), "{lost}");
    assert!(!horizon(120, false).contains('○'));
}
