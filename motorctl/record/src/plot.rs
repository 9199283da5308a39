//! `motorctl plot`: joints of a recording as a picture.

use crate::failure::RecorderFailure;
use crate::picture::{self, Curve, Panel};
use crate::recording::Recording;
use motord_client::{CycleRecord, MotorMode, RobotDescription, State};
use motord_terminal::{printable, within};
use std::io::{self, Write};
use std::path::PathBuf;

/// The arguments of the command.
#[derive(Debug, Clone, clap::Args)]
pub struct PlotArguments {
    /// The recording.
    file: PathBuf,
    /// Names of joints, each a row of the picture.
    #[arg(value_name = "JOINT", required = true, num_args = 1..=16)]
    joints: Vec<String>,
    /// The picture; `-` is the standard output.
    #[arg(long, value_name = "FILE", default_value = "-")]
    svg: PathBuf,
    /// Begin so many seconds after the first cycle.
    #[arg(long, value_name = "S", default_value_t = 0.0, value_parser = parse_time)]
    from: f64,
    /// End so many seconds after the first cycle. The default is the end of the recording.
    #[arg(long, value_name = "S", value_parser = parse_time)]
    to: Option<f64>,
}

fn parse_time(text: &str) -> Result<f64, String> {
    within(text, 0.0, 1e6)
}

/// Draws what the arguments say.
///
/// # Errors
///
/// When the recording cannot be read or has no such joint, or the picture cannot be written.
pub fn run(arguments: &PlotArguments) -> Result<(), RecorderFailure> {
    let mut recording = Recording::open(&arguments.file)?;
    let joints = indices(recording.robot(), &arguments.joints)?;
    let mut rows: Vec<[Panel; 3]> = arguments.joints.iter().map(|name| panels(name)).collect();
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

/// Position, velocity and torque, each with what was reported, asked for and sent.
fn panels(joint: &str) -> [Panel; 3] {
    ["position, rad", "velocity, rad/s", "torque, N·m"].map(|quantity| Panel {
        title: format!("{joint}: {quantity}"),
        curves: ["setpoint", "applied", "reported"].map(Curve::new),
    })
}

fn take(row: &mut [Panel; 3], time: f64, record: &CycleRecord, index: usize) {
    let Some(joint) = State::from(&record.state).joint(index) else { return };
    let setpoint = record.setpoint(index);
    let hears_commands =
        matches!(joint.mode, Some(MotorMode::Starting | MotorMode::Active | MotorMode::Damping));
    let applied = hears_commands.then_some(joint.applied);
    let values = [
        [setpoint.map(|asked| asked.position), applied.map(|sent| sent.position), joint.position()],
        [setpoint.map(|asked| asked.velocity), applied.map(|sent| sent.velocity), joint.velocity()],
        [setpoint.map(|asked| asked.torque), applied.map(|sent| sent.torque), joint.torque()],
    ];
    for (panel, values) in row.iter_mut().zip(values) {
        for (curve, value) in panel.curves.iter_mut().zip(values) {
            curve.take(time, value);
        }
    }
}
