//! The curves on large terminals.

use super::super::view::View;
use super::robot::{picture, stopped, trotting};
use super::{buffer, drawn};
use crossterm::event::KeyCode;

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
