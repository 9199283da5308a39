//! The pages as a person sees them, drawn into a buffer. The pictures stand in `pictures.txt`; after
//! a change on purpose `MOTORD_WRITE_DOCS=1 cargo test -p motorctl monitor` writes them anew.

mod moments;
mod robot;
mod svg;

use super::draw;
use super::picture::{Loss, Picture, Reading};
use super::request::Notice;
use super::view::{Page, SortOrder, View};
use motord_client::{GroupDescription, RobotDescription, Telemetry};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::{Buffer, Cell};
use robot::{bus, picture, stopped, trotting};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

fn buffer(width: u16, height: u16, picture: &Picture, view: &mut View) -> Buffer {
    noticed(width, height, picture, view, &Notice::default())
}

fn noticed(width: u16, height: u16, picture: &Picture, view: &mut View, notice: &Notice) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw::draw(frame, picture, view, notice)).unwrap();
    terminal.backend().buffer().clone()
}

fn drawn(width: u16, height: u16, picture: &Picture, view: &mut View) -> String {
    text(&buffer(width, height, picture, view))
}

fn text(buffer: &Buffer) -> String {
    let cells: Vec<&str> = buffer.content.iter().map(Cell::symbol).collect();
    let line = |line: &[&str]| format!("{}\n", line.concat().trim_end());
    cells.chunks(usize::from(buffer.area.width.max(1))).map(line).collect()
}

/// The pictures as text, each below a line with [`TITLE`] and its title.
const TEXTS: &str = "src/monitor/tests/pictures.txt";
const TITLE: &str = "==== ";

/// Compares a picture with the one of this title in the repository.
fn check(title: &str, drawn: &str) {
    // Tests run at the same time, and each writes the whole file.
    static FILE: Mutex<()> = Mutex::new(());
    let guard = FILE.lock().unwrap_or_else(PoisonError::into_inner);
    let text = std::fs::read_to_string(path(TEXTS)).unwrap_or_default();
    let mut pictures: BTreeMap<&str, &str> =
        text.split(TITLE).filter_map(|picture| picture.split_once('\n')).collect();
    if writes() {
        pictures.insert(title, drawn);
        let text: String = pictures.iter().map(|(title, drawn)| format!("{TITLE}{title}\n{drawn}")).collect();
        std::fs::write(path(TEXTS), text).unwrap();
    }
    drop(guard);
    assert!(pictures.get(title) == Some(&drawn), "{title} in {TEXTS} has changed:\n{drawn}");
}

fn check_file(name: &str, drawn: &str) {
    if writes() {
        std::fs::write(path(name), drawn).unwrap();
    }
    let known = std::fs::read_to_string(path(name)).unwrap_or_default();
    assert!(known == drawn, "{name} has changed:\n{drawn}");
}

/// Returns whether this run writes the pictures.
fn writes() -> bool {
    std::env::var_os("MOTORD_WRITE_DOCS").is_some()
}

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

#[test]
fn every_page_has_its_picture() {
    for (name, page) in [("buses", Page::Buses), ("latencies", Page::Latencies), ("help", Page::Help)] {
        let mut view = View { page, ..View::default() };
        check(&format!("{name}-80x24"), &drawn(80, 24, &picture(trotting()), &mut view));
    }
}

#[test]
fn help_fits_the_small_terminal() {
    let mut view = View { page: Page::Help, ..View::default() };
    let drawn = drawn(60, 20, &picture(trotting()), &mut view);
    assert!(
        drawn.contains("SPACE     emergency stop") && drawn.contains("latency   since the start"),
        "{drawn}"
    );
}

#[test]
fn lost_daemon_is_shown_above_last_state() {
    let mut picture = picture(trotting());
    let reason = "no motord runs instance \"demo\" in /run/motord: start it with `motord run`".to_owned();
    picture.loss = Some(Loss { lasting: Duration::from_secs(7), reason });
    let drawn = drawn(80, 24, &picture, &mut View::default());
    assert!(drawn.contains("NO CONTACT for 7 s: no motord runs instance \"demo\""), "{drawn}");
    assert!(drawn.contains("fl-hip"), "{drawn}");
}

#[test]
fn a_filter_and_an_order_choose_the_rows() {
    let rows = |view: &mut View| -> Vec<String> {
        let drawn = drawn(80, 24, &picture(trotting()), view);
        let names = drawn.lines().filter(|line| line.contains("active  "));
        names
            .filter_map(|line| line.split_whitespace().next())
            .filter(|name| name.contains('-'))
            .map(str::to_owned)
            .collect()
    };
    let mut view = View { filter: "knee".to_owned(), ..View::default() };
    assert_eq!(rows(&mut view), ["fl-knee", "fr-knee", "rl-knee", "rr-knee"]);
    let mut view = View { filter: "rear-left".to_owned(), order: SortOrder::Torque, ..View::default() };
    assert_eq!(rows(&mut view), ["rl-knee", "rl-thigh", "rl-hip"]);
}

/// Goal: no name of another process can move the cursor, ring, or write over what a person must
/// see.
#[test]
fn a_name_with_escapes_reaches_no_cell() {
    let hostile = "\x1b[2J\u{9b}31m\x07\r\nx\u{202e}y\u{200b}";
    let mut reading = stopped();
    reading.report.instance = hostile.to_owned();
    reading.report.version = hostile.to_owned();
    reading.report.groups[0].name = hostile.to_owned();
    reading.report.groups[0].stop.as_mut().unwrap().joint = Some(hostile.to_owned());
    reading.telemetry.groups[0].owner.as_mut().unwrap().program = hostile.to_owned();
    reading.report.joints.iter_mut().for_each(|joint| joint.name = hostile.to_owned());
    reading.report.buses.iter_mut().for_each(|bus| bus.name = hostile.to_owned());
    let mut picture = picture(reading);
    picture.loss = Some(Loss { lasting: Duration::ZERO, reason: hostile.to_owned() });
    for page in [Page::Joints, Page::Buses, Page::Latencies] {
        let drawn = drawn(80, 24, &picture, &mut View { page, ..View::default() });
        let is_obeyed = |letter: char| letter != '\n' && letter.is_control() || letter == '\u{202e}';
        assert!(!drawn.contains(is_obeyed), "{drawn:?}");
    }
}

#[test]
fn no_size_and_no_state_crash_monitor() {
    let mut lying = stopped();
    lying.report.rate_hz = f64::NAN;
    lying.telemetry = Telemetry::default();
    lying.report.joints.iter_mut().for_each(|joint| {
        (joint.position_rad, joint.torque_max_nm, joint.position_range_rad) =
            (Some(f32::NAN), 0.0, [f32::INFINITY; 2]);
    });
    for reading in [trotting(), stopped(), lying, Reading::default()] {
        let picture = picture_of(reading);
        for (width, height) in (0..90).step_by(3).flat_map(|width| (0..26).map(move |height| (width, height)))
        {
            for page in [Page::Joints, Page::Buses, Page::Latencies, Page::Help] {
                drawn(width, height, &picture, &mut View { page, scroll: 99, ..View::default() });
            }
        }
    }
}

fn picture_of(reading: Reading) -> Picture {
    let mut picture = Picture::default();
    picture.take(reading);
    picture
}

/// Goal: a robot of the largest size leaves the cause, the owner and the keys on a small screen.
#[test]
fn many_groups_and_buses_leave_joints_visible() {
    let mut reading = stopped();
    let mut robot = RobotDescription::clone(&reading.robot);
    for index in 1..8 {
        let mut group = reading.report.groups[0].clone();
        group.name = format!("arm{index}");
        reading.report.groups.push(group);
        robot.groups.push(GroupDescription { name: format!("arm{index}"), joints: Vec::new() });
        reading.telemetry.groups.push(reading.telemetry.groups[0].clone());
    }
    reading.report.buses = (0..16).map(|index| bus(&format!("bus{index}"))).collect();
    reading.robot = Arc::new(robot);
    let drawn = drawn(80, 24, &picture_of(reading), &mut View::default());
    assert!(drawn.contains("every group: An emergency stop was requested."), "{drawn}");
    assert!(drawn.contains("motorctl --instance demo reset") && drawn.contains("fr-knee"), "{drawn}");
    assert!(drawn.contains("SPACE"), "{drawn}");
}
