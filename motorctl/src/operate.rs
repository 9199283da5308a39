//! The commands of an operator: one request each, and a sentence about its effect.

use crate::advice::motorctl;
use crate::failure::Failure;
use crate::status::{self, PATIENCE};
use motord_client::{Client, Error, Joint, JointDescription, MotorMode, Phase, Refusal};
use motord_direct::Confirm;
use motord_terminal::printable;
use std::io::{self, Write};
use std::time::Duration;

/// No configuration holds or damps for longer than 30 s.
const STOPPED: Duration = Duration::from_secs(60);

/// `motorctl enable`: starts the motors of a group that has an owner.
pub(crate) fn enable(instance: &str, group: Option<&str>) -> Result<(), Failure> {
    for_groups(instance, group, |client, group| match client.enable(group) {
        Err(Error::Refused { refusal: Refusal::NotDisarmed, .. }) if is_running(client, group)? => {
            Ok("is active already")
        }
        outcome => outcome.map(|()| "enabled"),
    })
}

/// Whether the motors of the group follow their owner, or are about to.
fn is_running(client: &Client, group: &str) -> Result<bool, Error> {
    let index = client.group_named(group)?;
    let phase = client.wait(PATIENCE)?.group(index).and_then(|group| group.phase);
    Ok(matches!(phase, Some(Phase::Starting | Phase::Active)))
}

/// `motorctl disable`: damps and stops the motors of a group.
pub(crate) fn disable(instance: &str, group: Option<&str>) -> Result<(), Failure> {
    for_groups(instance, group, |client, group| {
        client.disable(group).map(|()| "stopped, after damping what moves")
    })
}

/// `motorctl reset`: clears the cause of a stop; no motor moves. With `wait`, once the motors are stopped.
pub(crate) fn reset(instance: &str, group: Option<&str>, wait: bool) -> Result<(), Failure> {
    let request = if wait { reset_stopped } else { Client::reset };
    for_groups(instance, group, |client, group| request(client, group).map(|()| "reset"))
}

fn reset_stopped(client: &Client, group: &str) -> Result<(), Error> {
    client.wait_for(group, Phase::Disarmed, STOPPED)?;
    client.reset(group)
}

/// `motorctl estop`: damps and stops every motor.
pub(crate) fn estop(instance: &str) -> Result<(), Failure> {
    motord_client::emergency_stop(instance).map_err(Failure::NotStopped)?;
    let reset = format!("{} reset", motorctl(instance));
    say(&format!(
        "confirmed: every motor is being damped, then stopped; `{reset}` clears the emergency stop"
    ));
    // Only now it looks: nothing that it may wait for kept the stop from the motors.
    if let Some(warning) = unheard(instance) {
        let _nobody_reads = writeln!(io::stderr(), "motorctl: {warning}");
    }
    Ok(())
}

/// The motors of which nobody knows whether they heard a stop.
fn unheard(instance: &str) -> Option<String> {
    let seen =
        status::connect(instance).and_then(|client| Ok((client.description(), client.wait(PATIENCE)?)));
    let (robot, state) = match seen {
        Ok(seen) => seen,
        Err(error) => return Some(format!("the motors were not looked at: {error}")),
    };
    let offline = |(joint, state): (&JointDescription, Joint)| {
        (state.mode == Some(MotorMode::Offline)).then(|| joint.name.clone())
    };
    let silent: Vec<String> = robot.joints.iter().zip(state.joints()).filter_map(offline).collect();
    let text = format!("not heard, and so perhaps not stopped: {}", silent.join(", "));
    (!silent.is_empty()).then_some(text)
}

/// `motorctl release --force`: removes the owner of a group.
pub(crate) fn release(instance: &str, group: &str) -> Result<(), Failure> {
    Client::connect(instance)?.force_release(group)?;
    say(&format!("{group}: has no owner any more"));
    Ok(())
}

/// `motorctl fault clear`: clears a motor's fault.
pub(crate) fn clear_fault(instance: &str, joint: &str) -> Result<(), Failure> {
    Client::connect(instance)?.clear_fault(joint)?;
    let status = format!("{} status", motorctl(instance));
    say(&format!("{joint}: the fault was cleared; `{status}` shows it again if its cause remains"));
    Ok(())
}

/// `motorctl exclude`: leaves a joint out of its group.
pub(crate) fn exclude(instance: &str, joint: &str) -> Result<(), Failure> {
    Client::connect(instance)?.exclude(joint)?;
    let include = format!("{} include {joint}", motorctl(instance));
    say(&format!("{joint}: is excluded until `{include}`, or until the daemon starts again"));
    Ok(())
}

/// `motorctl include`: ends the exclusion of a joint.
pub(crate) fn include(instance: &str, joint: &str) -> Result<(), Failure> {
    Client::connect(instance)?.include(joint)?;
    say(&format!("{joint}: is looked for again"));
    Ok(())
}

/// `motorctl zero`: stores the present position of a stopped joint as its zero.
pub(crate) fn zero(instance: &str, joint: &str, confirm: Confirm) -> Result<(), Failure> {
    let client = status::connect(instance)?;
    let index = client.joint_named(joint)?;
    let robot = client.description();
    let position = client.wait(PATIENCE)?.joint(index).and_then(|joint| joint.position());
    confirm.ask(&effect_of_zero(&robot.joints[index], position))?;
    client.set_zero(joint)?;
    say(&format!("{joint}: the present position is now zero"));
    Ok(())
}

/// The angle that a joint at `position`, rad, will have once its motor is at zero, against its limits.
fn effect_of_zero(joint: &JointDescription, position: Option<f32>) -> String {
    let JointDescription { name, zero, limits, .. } = joint;
    let before = position.map_or_else(String::new, |position| format!(" ({position:.2} rad)"));
    let [lower, upper] = limits.position;
    let verdict = match limits.allow(*zero) {
        true => format!("within its limits, {lower:.2} to {upper:.2}"),
        false => {
            format!(
                "OUTSIDE its limits, {lower:.2} to {upper:.2}: its group cannot be enabled where it stands"
            )
        }
    };
    format!(
        "This permanently stores the present position of {name}{before} as its motor's zero. It will be at {zero:.2} rad, \
         {verdict}."
    )
}

/// Sends `request` for `group`, or for every group without a name. After a refusal the other groups are still asked: a robot
/// that is to be stopped is stopped as far as possible. The first refusal is the outcome.
fn for_groups(
    instance: &str,
    group: Option<&str>,
    request: impl Fn(&Client, &str) -> Result<&'static str, Error>,
) -> Result<(), Failure> {
    let client = Client::connect(instance)?;
    let groups: Vec<String> = match group {
        Some(group) => vec![group.to_owned()],
        None => client.description().groups.iter().map(|group| group.name.clone()).collect(),
    };
    let mut outcome = Ok(());
    for group in groups {
        match request(&client, &group) {
            Ok(done) => say(&format!("{group}: {done}")),
            Err(refusal) => outcome = outcome.and(Err(refusal)),
        }
    }
    Ok(outcome?)
}

/// Says what the robot has done. When nobody can read it, the robot has done it all the same: an error of the output is no error
/// of the command, and the other groups are still asked.
fn say(sentence: &str) {
    if let Err(error) = writeln!(io::stdout(), "{}", printable(sentence)) {
        let _nobody_reads =
            writeln!(io::stderr(), "motorctl: done, but standard output takes no text: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_client::JointLimits;

    #[test]
    fn a_new_zero_is_told_against_the_limits() {
        let limits = JointLimits { position: [-2.7, -0.5], ..JointLimits::default() };
        let knee =
            |zero| JointDescription { name: "knee".into(), zero, limits, ..JointDescription::default() };
        let outside = effect_of_zero(&knee(0.0), Some(-1.2));
        assert!(
            outside.contains("(-1.20 rad)")
                && outside.contains("at 0.00 rad, OUTSIDE its limits, -2.70 to -0.50")
        );
        assert!(effect_of_zero(&knee(-1.5), None).contains("at -1.50 rad, within its limits"));
    }
}
