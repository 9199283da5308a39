//! `motorctl tune`: the response of a joint to small steps, and stiffness and damping for a
//! bandwidth.
//!
//! ```text
//! confirm -> claim -> enable -> identify -> steps -> propose -> steps with the proposal -> disable -> report
//! ```

mod arguments;
pub(crate) mod failure;
mod known;
mod picture;
mod report;
mod session;
mod timing;
mod tuner;

use crate::advice::motorctl;
use crate::failure::Failure;
use crate::hold::failure::HoldFailure;
use crate::hold::{Printer, SILENCE, Target, refuse_latched};
use crate::identify::wire;
pub(crate) use crate::tune::arguments::Arguments;
use crate::tune::failure::TuneFailure;
use crate::tune::report::Report;
use crate::tune::session::Session;
use crate::tune::timing::Timing;
use crate::tune::tuner::Tuner;
use motord_client::{Client, Error, JointDescription};
use motord_terminal::Interrupt;
use std::io;

/// States that show the delay of a motor at rest.
const WATCHED: u32 = 50;

/// Steps the joint, stops its group, and prints the responses and the proposal.
///
/// # Errors
///
/// Nothing moves: no daemon answers, the joint is unknown, the steps do not fit its limits, its group is owned or stopped,
/// consent is missing. Later: the identified joint would be too fast or have too little margin, or a signal, a limit, or the
/// daemon ends the motion. The group is stopped first. A trial of the proposed gains that fails follows the report.
pub(crate) fn run(instance: &str, arguments: &Arguments) -> Result<(), Failure> {
    arguments.check()?;
    let client = Client::connect(instance)?;
    client.set_silence(SILENCE);
    let robot = client.description();
    let joint = &robot.joints[client.joint_named(&arguments.joint)?];
    let target = Target::find(&robot, Some(&joint.name))?;
    refuse_latched(&client, instance, &target.group)?;
    let (position, timing) = watch(&client, instance, joint)?;
    let mut tuner = Tuner::new(arguments, joint, wire(&robot, joint), position, timing)?;
    arguments.confirm.ask(&tuner.warning())?;
    let interrupt = Interrupt::register();
    let mut session = Session::claim(client, instance, &target, joint, &interrupt)?;
    let printer = Printer::start(arguments.json || arguments.draws_on_stdout())?;
    let tuned = session.start(tuner.soft()).and_then(|()| tuner.tune(&mut session, &printer));
    let stopped = session.stop(matches!(tuned, Err(Failure::Client(Error::Stopped { .. }))));
    let printed = printer.end();
    // A motor that may still move matters more than why the motion ended.
    stopped?;
    let report = tuned?;
    printed?;
    let Some(report) = report else { return Ok(()) };
    if !arguments.draws_on_stdout() {
        report.print(&mut io::stdout().lock(), arguments.json)?;
    }
    write_picture(&report, arguments)?;
    report.untried.map_or(Ok(()), |failure| Err(Failure::Command(failure)))
}

fn write_picture(report: &Report, arguments: &Arguments) -> Result<(), Failure> {
    let (path, picture) = match (&arguments.svg, &arguments.png) {
        (Some(path), _) => (path, picture::svg(report)),
        (None, Some(path)) => (path, picture::png(report)),
        (None, None) => return Ok(()),
    };
    let picture = picture.map_err(TuneFailure::Picture)?;
    let written = match path.as_os_str() == "-" {
        true => io::Write::write_all(&mut io::stdout().lock(), &picture),
        false => std::fs::write(path, picture),
    };
    Ok(written.map_err(|source| TuneFailure::Output { path: path.clone(), source })?)
}

/// Returns the position of a joint at rest, rad, and the times of its replies.
fn watch(client: &Client, instance: &str, joint: &JointDescription) -> Result<(f64, Timing), Failure> {
    let index = client.joint_named(&joint.name)?;
    let (mut position, mut timing) = (None, Timing::default());
    for _ in 0..WATCHED {
        let state = client.wait(SILENCE)?;
        let Some(found) = state.joint(index) else { continue };
        if found.is_excluded() {
            let include = format!("{} include {}", motorctl(instance), joint.name);
            return Err(HoldFailure::Excluded { joint: joint.name.clone(), include }.into());
        }
        position = found.position();
        timing.record(&found);
    }
    let position = position.ok_or_else(|| TuneFailure::silent(&joint.name))?;
    Ok((position.into(), timing))
}
