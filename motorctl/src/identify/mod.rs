//! `motorctl identify`: inertia, friction and delay of one joint, by moving it through the daemon.
//!
//! ```text
//! confirm -> claim -> enable -> rise -> multisine -> slow sweeps -> return -> disable -> fit -> report
//! ```

pub(crate) mod failure;
pub(crate) mod known;
pub(crate) mod losses;
mod report;
pub(crate) mod session;

use crate::failure::Failure;
use crate::hold::{Printer, SILENCE, Target, refuse_latched};
use crate::identify::failure::IdentifyFailure;
use crate::identify::known::Known;
use crate::identify::losses::Losses;
use crate::identify::report::{Report, outcome};
use crate::identify::session::Session;
use motord_client::{Client, Error, JointDescription, RobotDescription};
use motord_direct::Confirm;
use motord_identify::{BusTiming, Identified, Plan, Shape, identify};
use motord_terminal::{Interrupt, within};
use std::io;
use std::path::PathBuf;

/// The options of `motorctl identify`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Name of the joint.
    #[arg(value_name = "JOINT")]
    joint: String,
    /// Largest distance from where the joint is, rad, 0.05 to 2. The default is 0.3, or what its limits leave.
    #[arg(long, value_name = "RAD", value_parser = |text: &str| within(text, 0.05, 2.0))]
    amplitude_rad: Option<f64>,
    /// Duration of the motion, s, 10 to 600. A longer one gives closer intervals.
    #[arg(long, value_name = "S", default_value_t = 40.0, value_parser = |text: &str| within(text, 10.0, 600.0))]
    seconds: f64,
    /// Stiffness, N·m/rad, 1 to 200. The configuration may limit it.
    #[arg(long, value_name = "KP", default_value_t = 20.0, value_parser = |text: &str| within(text, 1.0, 200.0))]
    kp: f64,
    /// Damping, N·m·s/rad, 0 to 5. The configuration may limit it. More calms a heavy joint, and hides the inertia of a light one.
    #[arg(long, value_name = "KD", default_value_t = 0.3, value_parser = |text: &str| within(text, 0.0, 5.0))]
    kd: f64,
    /// A load that is mounted now and was not in `--without`: its mass, kg, and the distance from the axis, m. It gives the
    /// scale of the torque.
    #[arg(long, value_name = "KG@M", value_parser = known::parse_load, requires = "without")]
    known_load: Option<f64>,
    /// Output of `motorctl identify --json` without the known load.
    #[arg(long, value_name = "FILE", requires = "known_load")]
    without: Option<PathBuf>,
    /// Also write the lines for the configuration into this new file.
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print the result as one JSON object.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    confirm: Confirm,
}

impl Arguments {
    fn shape(&self) -> Shape {
        Shape { amplitude: self.amplitude_rad, seconds: self.seconds, kp: self.kp, kd: self.kd }
    }
}

/// Moves the joint, stops its group, and prints what its motion says.
///
/// # Errors
///
/// Nothing moves: no daemon answers, the joint is unknown or cannot be moved so, its group is owned or stopped, consent is
/// missing. Later: a signal, a limit, or the daemon ends the motion. The group is stopped first.
pub(crate) fn run(instance: &str, arguments: &Arguments) -> Result<(), Failure> {
    let known = Known::read(arguments.known_load, arguments.without.as_deref(), &arguments.joint)?;
    let client = Client::connect(instance)?;
    client.set_silence(SILENCE);
    let robot = client.description();
    let joint = &robot.joints[client.joint_named(&arguments.joint)?];
    let target = Target::find(&robot, Some(&joint.name))?;
    refuse_native(joint)?;
    refuse_latched(&client, instance, &target.group)?;
    let plan = plan(&client, joint, arguments)?;
    arguments.confirm.ask(&warning(joint, &plan))?;
    let interrupt = Interrupt::register();
    let wire = wire(&robot, joint);
    let mut session = Session::claim(client, instance, &target, &plan)?;
    let (found, losses) = excite(&mut session, arguments, &interrupt, wire)?;
    let report = Report::new(joint, &found, known.as_ref(), losses);
    if let Some(path) = &arguments.output {
        report.write_lines(path).map_err(|source| IdentifyFailure::Output { path: path.clone(), source })?;
    }
    report.print(&mut io::stdout().lock(), arguments.json)?;
    Ok(outcome(&joint.name, &found)?)
}

/// Moves the joint and stops its group, then fits, unless too much of the motion is missing.
fn excite(
    session: &mut Session,
    arguments: &Arguments,
    interrupt: &Interrupt,
    wire: BusTiming,
) -> Result<(Identified, Losses), Failure> {
    let printer = Printer::start(arguments.json)?;
    let moved = session.start().and_then(|()| session.follow(interrupt, &printer));
    let is_stopped = matches!(moved, Err(Failure::Client(Error::Stopped { .. })));
    let stopped = if is_stopped { Ok(()) } else { session.stop(interrupt) };
    let printed = printer.end();
    if is_stopped {
        session.refuse_latched()?;
    }
    // A motor that may still move matters more than why the motion ended.
    stopped.and(moved).and(printed)?;
    let losses = session.losses();
    losses.check(&arguments.joint, arguments.seconds)?;
    Ok((identify(session.samples(), wire), losses))
}

/// The plan from where the joint is, for the question. The session moves its centre to where the motor begins to follow.
fn plan(client: &Client, joint: &JointDescription, arguments: &Arguments) -> Result<Plan, Failure> {
    let state = client.wait(SILENCE)?;
    let position = state.joint(client.joint_named(&joint.name)?).and_then(|joint| joint.position());
    let position = position.ok_or_else(|| IdentifyFailure::Silent(joint.name.clone()))?;
    session::plan(joint, position.into(), arguments.shape())
}

/// A native motor has its own loops, and no stiffness.
fn refuse_native(joint: &JointDescription) -> Result<(), IdentifyFailure> {
    if joint.protocol == "mit" { Ok(()) } else { Err(IdentifyFailure::Native(joint.name.clone())) }
}

fn warning(joint: &JointDescription, plan: &Plan) -> String {
    let ([kp, kd], amplitude, seconds) = (plan.gains(), plan.amplitude(), plan.seconds());
    format!(
        "This moves {} by ±{amplitude:.2} rad for {seconds:.0} s, with kp {kp:.1}, kd {kd:.2}; the other joints of its group are damped. \
         Hang the robot up or free the joint, keep people away, and keep a hand on the switch that cuts the power.",
        joint.name
    )
}

/// The wire of the joint's motor. An interface has a name, a serial line a path.
pub(crate) fn wire(robot: &RobotDescription, joint: &JointDescription) -> BusTiming {
    let bus = robot.buses.iter().position(|bus| *bus == joint.bus);
    let frame = bus.and_then(|bus| robot.frame_times.get(bus).copied()).unwrap_or(0.0);
    let device = bus.and_then(|bus| robot.devices.get(bus)).map_or("", String::as_str);
    let on_bus = robot.joints.iter().filter(|other| other.bus == joint.bus).count();
    BusTiming { frame, others: on_bus.saturating_sub(1), is_can: frame > 0.0 && !device.starts_with('/') }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wire_counts_motors_of_its_bus() {
        let joint = |name: &str, bus: &str| JointDescription {
            name: name.into(),
            bus: bus.into(),
            ..JointDescription::default()
        };
        let robot = RobotDescription {
            joints: vec![joint("a", "left"), joint("b", "right"), joint("c", "right")],
            buses: vec!["left".into(), "right".into()],
            devices: vec!["/dev/ttyUSB0".into(), "can0".into()],
            frame_times: vec![1e-3, 135e-6],
            ..RobotDescription::default()
        };
        assert_eq!(wire(&robot, &robot.joints[0]), BusTiming { frame: 1e-3, others: 0, is_can: false });
        assert_eq!(wire(&robot, &robot.joints[1]), BusTiming { frame: 135e-6, others: 1, is_can: true });
    }
}
