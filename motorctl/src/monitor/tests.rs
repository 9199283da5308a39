//! The pages as a person sees them, drawn into a buffer. The pictures stand in `snapshots/`; after a change on purpose
//! `MOTORD_WRITE_DOCS=1 cargo test -p motorctl monitor` writes them anew.

use super::draw;
use super::picture::{Loss, Picture, Reading, Sample};
use super::request::Notice;
use super::view::{Order, Page, View};
use crate::advice::Advice;
use crate::joint_report::JointReport;
use crate::report::{BusReport, GroupReport, RobotReport, StopReport};
use motord_client::{
    Cause, GroupDescription, GroupHistory, Percentiles, Process, RobotDescription, Telemetry,
};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::{Buffer, Cell};
use ratatui::style::{Color, Modifier};
use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

const LEGS: [(&str, &str); 4] =
    [("fl", "front-left"), ("fr", "front-right"), ("rl", "rear-left"), ("rr", "rear-right")];

fn joint(leg: usize, part: usize) -> JointReport {
    let (prefix, bus) = LEGS[leg];
    let (name, range, position) =
        [("hip", [-0.9, 0.9], -0.0004), ("thigh", [-1.0, 2.6], 0.83), ("knee", [-2.7, -0.5], -1.62)][part];
    JointReport {
        name: format!("{prefix}-{name}"),
        bus: bus.to_owned(),
        mode: "active",
        position_rad: Some(position),
        velocity_rad_s: Some(0.4 * leg as f32 - 0.6),
        torque_nm: Some(1.5 * part as f32 - 2.0),
        position_range_rad: range,
        torque_max_nm: 20.0,
        temperature_celsius: Some(41.0 + part as f32),
        valid: true,
        ..JointReport::default()
    }
}

fn bus(name: &str) -> BusReport {
    BusReport {
        name: name.to_owned(),
        condition: "active",
        sent: 36_000,
        received: 36_000,
        ..BusReport::default()
    }
}

fn percentiles(p50: f64) -> Percentiles {
    Percentiles { count: 12_000, p50, p99: 4.0 * p50, p99_9: 20.0 * p50, max: 80.0 * p50 }
}

/// Twelve joints that trot.
fn trotting() -> Reading {
    let joints: Vec<JointReport> = (0..12).map(|index| joint(index / 3, index % 3)).collect();
    let robot = RobotDescription {
        instance: "demo".to_owned(),
        groups: vec![GroupDescription { name: "legs".to_owned(), joints: (0..12).collect() }],
        frame_times: vec![125e-6; 4],
        ..RobotDescription::default()
    };
    let legs = GroupReport {
        name: "legs".to_owned(),
        phase: "active",
        lease: Some(77),
        setpoint_age_us: Some(214.3),
        ..GroupReport::default()
    };
    let owner = Some(Process { pid: 4711, program: "trot".to_owned() });
    let telemetry = Telemetry {
        wake_latency_us: percentiles(27.0),
        reply_latency_us: percentiles(8.0),
        cycle_us: percentiles(9.0),
        setpoint_age_us: percentiles(3.0),
        control_latency_us: percentiles(11.0),
        publication_us: percentiles(2.0),
        joints: vec![percentiles(8.0); 12],
        groups: vec![GroupHistory { owner, phase_cycle: 300, ..GroupHistory::default() }],
        ..Telemetry::default()
    };
    let report = RobotReport {
        instance: "demo".to_owned(),
        version: "0.1.0".to_owned(),
        pid: 4242,
        rate_hz: 1000.0,
        cycle: 12_000,
        realtime: true,
        groups: vec![legs],
        joints,
        buses: LEGS.iter().map(|(_, name)| bus(name)).collect(),
        ..RobotReport::default()
    };
    Reading { robot: Arc::new(robot), report, telemetry, sample: Sample::default() }
}

/// The same robot: its emergency stop is latched, one motor is in fault, one bus is off.
fn stopped() -> Reading {
    let mut reading = trotting();
    let report = &mut reading.report;
    report.emergency_stop = true;
    report.realtime = false;
    report.overruns = 3;
    let steps = Advice::new(Some(Cause::EmergencyStop), "demo", "legs", None);
    report.groups[0].phase = "disarmed";
    report.groups[0].stop = Some(StopReport {
        cause: "emergency-stop",
        sentence: Cause::EmergencyStop.sentence(),
        advice: steps.to_string(),
        steps,
        ..StopReport::default()
    });
    reading.telemetry.groups[0].stop_cycle = Some(0);
    for joint in &mut report.joints {
        joint.mode = if joint.bus == "rear-right" { "offline" } else { "idle" };
        if joint.bus == "rear-right" {
            (joint.valid, joint.age_cycles, joint.missed) = (false, 11_000, 11_000);
            (joint.position_rad, joint.velocity_rad_s, joint.torque_nm) = (None, None, None);
        }
    }
    report.joints[5].mode = "fault";
    report.joints[5].faults = vec!["over-voltage".to_owned()];
    (report.buses[3].condition, report.buses[3].errors) = ("off", 258);
    reading
}

fn picture(reading: Reading) -> Picture {
    let mut picture = Picture::default();
    for step in 0..40_u32 {
        let mut reading = reading.clone();
        reading.report.cycle -= 4000 - 100 * u64::from(step + 1);
        for bus in &mut reading.report.buses {
            (bus.sent, bus.received) = (300 * step, 300 * step);
        }
        let wave = f64::from(step % 8);
        reading.sample = Sample { wake: 20.0 + wave, cycle: 700.0, reply: 100.0 * wave, age: 200.0 };
        picture.take(reading);
    }
    picture
}

fn buffer(width: u16, height: u16, picture: &Picture, view: &mut View) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw::draw(frame, picture, view, &Notice::default())).unwrap();
    terminal.backend().buffer().clone()
}

fn drawn(width: u16, height: u16, picture: &Picture, view: &mut View) -> String {
    let buffer = buffer(width, height, picture, view);
    let cells: Vec<&str> = buffer.content.iter().map(Cell::symbol).collect();
    let line = |line: &[&str]| format!("{}\n", line.concat().trim_end());
    cells.chunks(usize::from(width.max(1))).map(line).collect()
}

/// Compares a picture with the one in the repository.
fn check(name: &str, drawn: &str) {
    check_file(&format!("src/monitor/snapshots/{name}.txt"), drawn);
}

fn check_file(name: &str, drawn: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(name);
    if std::env::var_os("MOTORD_WRITE_DOCS").is_some() {
        std::fs::write(&path, drawn).unwrap();
    }
    let known = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(known == drawn, "{name} has changed:\n{drawn}");
}

#[test]
fn first_screen_shows_cause_owner_and_advice() {
    for (width, height) in [(80, 24), (60, 20)] {
        let drawn = drawn(width, height, &picture(stopped()), &mut View::default());
        let text = drawn.split_whitespace().collect::<Vec<_>>().join(" ");
        for expected in [
            "EMERGENCY STOP",
            "STOPPED 12 s ago, legs: An emergency stop was requested.",
            "owner trot (4711)",
            "Bus rear-right is off. Check the wiring",
            "motorctl --instance demo fault clear fr-knee",
            "motorctl --instance demo reset legs",
            "rear-right off",
            "errors 258",
            "over-voltage",
            "SPACE e-stop",
        ] {
            assert!(text.contains(expected), "{expected} is not in\n{drawn}");
        }
        assert!(!drawn.contains("-0.00"), "{drawn}");
        check(&format!("stopped-{width}x{height}"), &drawn);
    }
}

/// Size of a character in the picture of the README, pixels.
const CHARACTER: (usize, usize) = (8, 17);

/// A screen as SVG, a text for each run of cells that look alike.
fn svg(buffer: &Buffer) -> String {
    let (width, height) = (usize::from(buffer.area.width), usize::from(buffer.area.height));
    let (right, bottom) = ((width + 2) * CHARACTER.0, (height + 1) * CHARACTER.1);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {right} {bottom}\" font-family=\"monospace\" \
         font-size=\"13\">\n<rect width=\"{right}\" height=\"{bottom}\" rx=\"6\" fill=\"#1d2021\"/>\n"
    );
    for (y, line) in buffer.content.chunks(width).enumerate() {
        let mut x = 0;
        for run in line.chunk_by(|a, b| (a.fg, a.bg, a.modifier) == (b.fg, b.bg, b.modifier)) {
            draw_run(&mut svg, x, y, run);
            x += run.len();
        }
    }
    svg + "</svg>\n"
}

fn draw_run(svg: &mut String, x: usize, y: usize, run: &[Cell]) {
    let first = &run[0];
    let text: String = run.iter().map(Cell::symbol).collect();
    let (left, top) = ((x + 1) * CHARACTER.0, y * CHARACTER.1 + CHARACTER.1 / 2);
    let width = run.len() * CHARACTER.0;
    let is_reversed = first.modifier.contains(Modifier::REVERSED);
    if is_reversed || first.bg != Color::Reset {
        let fill = if is_reversed { "#ebdbb2" } else { colour(first.bg) };
        writeln!(
            svg,
            "<rect x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{}\" fill=\"{fill}\"/>",
            CHARACTER.1
        )
        .unwrap();
    }
    if text.trim().is_empty() {
        return;
    }
    let fill = if is_reversed { "#1d2021" } else { colour(first.fg) };
    let weight = if first.modifier.contains(Modifier::BOLD) { " font-weight=\"bold\"" } else { "" };
    let opacity = if first.modifier.contains(Modifier::DIM) { " opacity=\"0.6\"" } else { "" };
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    let base = top + CHARACTER.1 - 4;
    writeln!(
        svg,
        "<text x=\"{left}\" y=\"{base}\" textLength=\"{width}\" xml:space=\"preserve\" fill=\"{fill}\"{weight}{opacity}>{text}</text>"
    )
    .unwrap();
}

fn colour(colour: Color) -> &'static str {
    match colour {
        Color::Red => "#fb4934",
        Color::Yellow => "#fabd2f",
        Color::Green => "#b8bb26",
        Color::White => "#ffffff",
        _ => "#ebdbb2",
    }
}

#[test]
fn readme_picture_is_the_current_monitor() {
    check_file("../docs/monitor.svg", &svg(&buffer(80, 24, &picture(stopped()), &mut View::default())));
}

#[test]
fn healthy_robot_shows_all_joints_on_small_terminal() {
    let drawn = drawn(80, 24, &picture(trotting()), &mut View::default());
    for (prefix, _) in LEGS {
        assert!(drawn.contains(&format!("{prefix}-knee")), "{drawn}");
    }
    check("trotting-80x24", &drawn);
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
    let mut view = View { filter: "rear-left".to_owned(), order: Order::Torque, ..View::default() };
    assert_eq!(rows(&mut view), ["rl-hip", "rl-knee", "rl-thigh"]);
}

/// Goal: no name of another process can move the cursor, ring, or write over what a person must see.
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
