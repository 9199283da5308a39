//! `motorctl plot`: draws joints of a recording.

use crate::failure::RecorderFailure;
use crate::picture::{self, Curve, Panel};
use crate::recording::Recording;
use motord_client::{CycleRecord, Field, JointState, Kind, MotorMode, RobotDescription, State};
use motord_terminal::{printable, within};
use std::io::{self, Write};
use std::path::PathBuf;

/// The arguments of the command.
#[derive(Debug, Clone, clap::Args)]
pub struct PlotArguments {
    /// The recording.
    file: PathBuf,
    /// Names of joints; each is a row of the picture.
    #[arg(value_name = "JOINT", required = true, num_args = 1..=16)]
    joints: Vec<String>,
    /// The picture; `-` is the standard output.
    #[arg(long, value_name = "FILE", default_value = "-")]
    svg: PathBuf,
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
    let mut recording = Recording::open(&arguments.file)?;
    let joints = indices(recording.robot(), &arguments.joints)?;
    let mut rows: Vec<Vec<Panel>> = arguments.joints.iter().map(|name| panels(name)).collect();
    let to = arguments.to.unwrap_or(f64::INFINITY);
    let mut first = None;
    while let Some(record) = recording.next_cycle() {
        let first = *first.get_or_insert(record.state.tick_ns);
        let time = record.state.tick_ns.saturating_sub(first) as f64 / 1e9;
        if time > to {
            break;
        }
        if time >= arguments.from {
            for (joint, row) in joints.iter().zip(&mut rows) {
                take(row, time, record, *joint);
            }
        }
    }
    if let Some(damage) = recording.damage() {
        let text = format!("{} is cut off or damaged, and was read up to there: {damage}", recording.name());
        eprintln!("motorctl: {}", printable(&text));
    }
    if rows.iter().flatten().all(Panel::is_empty) {
        return Err(RecorderFailure::Empty);
    }
    let svg = picture::draw(&rows).map_err(RecorderFailure::Picture)?;
    match arguments.svg.as_os_str() == "-" {
        true => Ok(io::stdout().lock().write_all(svg.as_bytes())?),
        false => std::fs::write(&arguments.svg, svg)
            .map_err(|error| RecorderFailure::unwritable(&arguments.svg, error)),
    }
}

fn indices(robot: &RobotDescription, names: &[String]) -> Result<Vec<usize>, RecorderFailure> {
    let index = |name: &String| robot.joints.iter().position(|joint| joint.name == *name);
    let unknown = |name: &String| {
        let known: Vec<&str> = robot.joints.iter().map(|joint| joint.name.as_str()).collect();
        RecorderFailure::NoJoint { joint: name.clone(), known: known.join(", ") }
    };
    names.iter().map(|name| index(name).ok_or_else(|| unknown(name))).collect()
}

/// Creates a panel for each measured quantity of a joint: the setpoint, the applied command and the
/// reported value.
fn panels(joint: &str) -> Vec<Panel> {
    let fields = JointState::FIELDS.iter().filter(|field| field.kind == Kind::Measured);
    let panel = |field: &Field| Panel {
        title: format!("{joint}: {}, {}", field.name, field.unit),
        curves: ["setpoint", "applied", "reported"].map(Curve::new),
    };
    fields.map(panel).collect()
}

fn take(row: &mut [Panel], time: f64, record: &CycleRecord, index: usize) {
    let Some(joint) = State::from(&record.state).joint(index) else { return };
    let receives_commands =
        matches!(joint.mode, Some(MotorMode::Starting | MotorMode::Active | MotorMode::Damping));
    let applied = receives_commands.then_some(joint.applied);
    let setpoint = record.setpoint(index);
    for (panel, (field, reported)) in row.iter_mut().zip(joint.quantities()) {
        // Other quantities have no setpoint.
        let commanded = |position, velocity, torque| match field.name {
            "position" => Some(position),
            "velocity" => Some(velocity),
            "torque" => Some(torque),
            _ => None,
        };
        let asked = setpoint.and_then(|asked| commanded(asked.position, asked.velocity, asked.torque));
        let sent = applied.and_then(|sent| commanded(sent.position, sent.velocity, sent.torque));
        for (curve, value) in panel.curves.iter_mut().zip([asked, sent, reported]) {
            curve.take(time, value);
        }
    }
}
