//! `motorctl plot`: draws joints and IMUs of a recording.

use crate::failure::RecorderFailure;
use crate::picture::{self, Curve, Layout, Mark, Panel, Row};
use crate::recording::{Recording, concerns, is_mark};
use motord_client::{
    CycleRecord, Field, JointState, Kind, MotorMode, RobotDescription, Setpoint, SetpointMode, State,
};
use motord_mcap::{Event, Events};
use motord_terminal::{FileError, printable, within};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Largest number of stops and faults that are drawn.
const MARKS_MAX: usize = 24;

/// The arguments of the command.
#[derive(Debug, Clone, clap::Args)]
pub struct PlotArguments {
    /// The recording.
    file: PathBuf,
    /// Names of joints and IMUs; each is a row of the picture.
    #[arg(value_name = "JOINT|IMU", required = true, num_args = 1..=16)]
    names: Vec<String>,
    /// Another recording, whose joints and IMUs are drawn below those of the first; can be given several times.
    #[arg(long, value_name = "FILE")]
    with: Vec<PathBuf>,
    /// The picture as an SVG; `-` is the standard output.
    #[arg(long, value_name = "FILE", default_value = "-")]
    svg: PathBuf,
    /// The picture as a PNG instead; `-` is the standard output.
    #[arg(long, value_name = "FILE", conflicts_with = "svg")]
    png: Option<PathBuf>,
    /// Start at this time after the first cycle, s.
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = parse_time)]
    from: f64,
    /// End at this time after the first cycle, s. The default is the end of the recording.
    #[arg(long, value_name = "S", value_parser = parse_time)]
    to: Option<f64>,
}

fn parse_time(text: &str) -> Result<f64, String> {
    within(text, 0.0, 1e6)
}

/// Draws the picture.
///
/// # Errors
///
/// The recording cannot be read or lacks a joint, or the picture cannot be written.
pub fn run(arguments: &PlotArguments) -> Result<(), RecorderFailure> {
    let files: Vec<&Path> =
        [&arguments.file].into_iter().chain(&arguments.with).map(PathBuf::as_path).collect();
    let recordings = files.iter().map(|file| read(file, arguments)).collect::<Result<Vec<_>, _>>()?;
    let rows = beside(recordings);
    if rows.iter().flat_map(|row| &row.panels).all(Panel::is_empty) {
        return Err(RecorderFailure::Empty);
    }
    let (file, picture) = match &arguments.png {
        Some(file) => (file, picture::png(&rows, Layout::WIDE).map_err(RecorderFailure::Picture)?),
        None => (
            &arguments.svg,
            picture::svg(&rows, Layout::WIDE).map_err(RecorderFailure::Picture)?.into_bytes(),
        ),
    };
    match file.as_os_str() == "-" {
        true => Ok(io::stdout().lock().write_all(&picture)?),
        false => Ok(std::fs::write(file, picture).map_err(FileError::unwritable(file))?),
    }
}

/// The subject of a row: an index of the robot.
#[derive(Debug, Clone, Copy)]
enum Subject {
    Joint(usize),
    Imu(usize),
}

/// Returns the rows of all recordings, those of the same subject one below the other.
fn beside(recordings: Vec<Vec<Row>>) -> Vec<Row> {
    let mut recordings: Vec<_> = recordings.into_iter().map(Vec::into_iter).collect();
    let mut rows = Vec::new();
    loop {
        let next: Vec<Row> = recordings.iter_mut().filter_map(Iterator::next).collect();
        if next.is_empty() {
            return rows;
        }
        rows.extend(next);
    }
}

/// Returns a row for each subject.
fn read(file: &Path, arguments: &PlotArguments) -> Result<Vec<Row>, RecorderFailure> {
    let mut recording = Recording::open(file)?;
    let robot = recording.robot().clone();
    let subjects = subjects(&robot, &arguments.names)?;
    let suffix = if arguments.with.is_empty() { String::new() } else { format!(" ({})", file.display()) };
    let titled = arguments.names.iter().map(|name| format!("{name}{suffix}")).zip(&subjects);
    let mut rows: Vec<Vec<Panel>> = titled.map(|(title, subject)| panels(&title, *subject)).collect();
    let to = arguments.to.unwrap_or(f64::INFINITY);
    let (mut first, mut events, mut marks) = (None, Events::default(), Vec::new());
    while let Some(record) = recording.next_cycle() {
        let first = *first.get_or_insert(record.state.tick_ns);
        let time = record.state.tick_ns.saturating_sub(first) as f64 / 1e9;
        if time > to {
            break;
        }
        let changes = events.of(&record.state, &robot);
        if time >= arguments.from {
            for (subject, row) in subjects.iter().zip(&mut rows) {
                match *subject {
                    Subject::Joint(joint) => take_joint(row, time, record, joint),
                    Subject::Imu(imu) => take_imu(row, time, record, imu),
                }
            }
            let concern = changes.iter().filter(|event| is_drawn(event, &robot, &subjects));
            marks.extend(concern.map(|event| Mark { time, name: event.to_string() }));
        }
    }
    if let Some(damage) = recording.damage() {
        warn(&format!("{} is cut off or damaged, and was read up to there: {damage}", recording.name()));
    }
    if marks.len() > MARKS_MAX {
        warn(&format!(
            "{}: the first {MARKS_MAX} of {} stops and faults are drawn",
            recording.name(),
            marks.len()
        ));
        marks.truncate(MARKS_MAX);
    }
    Ok(rows.into_iter().map(|panels| Row { panels, marks: marks.clone() }).collect())
}

fn warn(text: &str) {
    eprintln!("motorctl: {}", printable(text));
}

fn subjects(robot: &RobotDescription, names: &[String]) -> Result<Vec<Subject>, RecorderFailure> {
    let joint = |name: &String| robot.joints.iter().position(|joint| joint.name == *name).map(Subject::Joint);
    let imu = |name: &String| robot.imus.iter().position(|imu| imu.name == *name).map(Subject::Imu);
    let unknown = |name: &String| {
        let joints = robot.joints.iter().map(|joint| joint.name.as_str());
        let known: Vec<&str> = joints.chain(robot.imus.iter().map(|imu| imu.name.as_str())).collect();
        RecorderFailure::NoSubject { name: name.clone(), known: known.join(", ") }
    };
    names.iter().map(|name| joint(name).or_else(|| imu(name)).ok_or_else(|| unknown(name))).collect()
}

/// Returns whether an event is a stop or a fault of one of the subjects.
fn is_drawn(event: &Event, robot: &RobotDescription, subjects: &[Subject]) -> bool {
    let joint = |subject: &Subject| if let Subject::Joint(index) = subject { Some(*index) } else { None };
    let joints: Vec<usize> = subjects.iter().filter_map(joint).collect();
    let is_imu = |subject: &Subject| matches!(subject, Subject::Imu(index) if robot.imus[*index].name == event.subject);
    concerns(event, robot, &joints) || is_mark(event) && subjects.iter().any(is_imu)
}

fn panels(name: &str, subject: Subject) -> Vec<Panel> {
    match subject {
        Subject::Joint(_) => joint_panels(name),
        Subject::Imu(_) => imu_panels(name),
    }
}

/// Creates a panel for each measured quantity of a joint: the setpoint, the applied command and the
/// reported value.
fn joint_panels(joint: &str) -> Vec<Panel> {
    let fields = JointState::FIELDS.iter().filter(|field| field.kind == Kind::Measured);
    let panel = |field: &Field| Panel {
        title: format!("{joint}: {}, {}", field.name, field.unit),
        curves: ["setpoint", "applied", "reported"].map(Curve::new),
    };
    fields.map(panel).collect()
}

/// Creates a panel for the orientation, the angular velocity and the acceleration of the body.
fn imu_panels(imu: &str) -> Vec<Panel> {
    let quantities = [
        ("orientation, rad", ["roll", "pitch", "yaw"]),
        ("angular velocity, rad/s", ["x", "y", "z"]),
        ("acceleration, m/s²", ["x", "y", "z"]),
    ];
    let panel = |(quantity, curves): (&str, [&'static str; 3])| Panel {
        title: format!("{imu}: {quantity}"),
        curves: curves.map(Curve::new),
    };
    quantities.into_iter().map(panel).collect()
}

/// A lost IMU leaves a gap.
fn take_imu(row: &mut [Panel], time: f64, record: &CycleRecord, index: usize) {
    let Some(imu) = State::from(&record.state).imu(index) else { return };
    let known = |values: Option<[f32; 3]>| values.filter(|_| !imu.lost);
    let quantities = [imu.roll_pitch_yaw(), imu.angular_velocity(), imu.acceleration()].map(known);
    for (panel, values) in row.iter_mut().zip(quantities) {
        let values: [Option<f32>; 3] = values.map_or([None; 3], |values| values.map(Some));
        panel.curves.iter_mut().zip(values).for_each(|(curve, value)| curve.take(time, value));
    }
}

fn take_joint(row: &mut [Panel], time: f64, record: &CycleRecord, index: usize) {
    let Some(joint) = State::from(&record.state).joint(index) else { return };
    let receives_commands =
        matches!(joint.mode, Some(MotorMode::Starting | MotorMode::Active | MotorMode::Damping));
    let applied = receives_commands.then_some(joint.applied);
    let setpoint = record.setpoint(index).map(Setpoint::from);
    for (panel, (field, reported)) in row.iter_mut().zip(joint.quantities()) {
        let asked = setpoint.as_ref().and_then(|asked| commanded(field, asked));
        // The applied command has the mode of the setpoint, and impedance without one.
        let mode = setpoint.map_or(SetpointMode::Impedance, |asked| asked.mode);
        let sent = applied.and_then(|sent| {
            let sent = Setpoint::impedance(sent.position, sent.velocity, sent.kp, sent.kd, sent.torque);
            commanded(field, &Setpoint { mode, ..sent })
        });
        for (curve, value) in panel.curves.iter_mut().zip([asked, sent, reported]) {
            curve.take(time, value);
        }
    }
}

/// Returns what `command` demands of a quantity. A position without stiffness and a velocity without damping demand nothing.
fn commanded(field: &Field, command: &Setpoint) -> Option<f32> {
    let mode = command.mode;
    let is_impedance = mode == SetpointMode::Impedance;
    let (value, is_demanded) = match field.name {
        "position" => (command.position, mode == SetpointMode::Position || is_impedance && command.kp > 0.0),
        "velocity" => (command.velocity, mode == SetpointMode::Speed || is_impedance && command.kd > 0.0),
        "torque" => (command.torque, mode == SetpointMode::Torque || is_impedance),
        _ => return None,
    };
    is_demanded.then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A joint that is only damped has no position to follow: drawn as 0 rad it looked like a jump.
    #[test]
    fn position_without_stiffness_is_a_gap() {
        let command = Setpoint::impedance(1.0, 2.0, 0.0, 0.5, 3.0);
        let of = |name, command: &Setpoint| {
            let field = JointState::FIELDS.iter().find(|field| field.name == name).unwrap();
            commanded(field, command)
        };
        let all = |command: &Setpoint| ["position", "velocity", "torque"].map(|name| of(name, command));
        assert_eq!(all(&command), [None, Some(2.0), Some(3.0)]);
        let stiff = Setpoint { kp: 5.0, kd: 0.0, ..command };
        assert_eq!(all(&stiff), [Some(1.0), None, Some(3.0)]);
        let speed = Setpoint { mode: SetpointMode::Speed, ..stiff };
        assert_eq!(all(&speed), [None, Some(2.0), None]);
    }
}
