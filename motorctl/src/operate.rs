//! The commands of an operator. Each sends a request and prints its effect.

use crate::advice::motorctl;
use crate::confirmation;
use crate::estop;
use crate::failure::Failure;
use crate::outcome::print_effect;
use crate::status::{self, TIMEOUT};
use clap::Subcommand;
use motord_client::{Client, Error, JointDescription, Phase, Refusal};
use motord_direct::Confirm;
use std::time::Duration;

/// Other names of `estop`.
pub(crate) const ESTOP_ALIASES: [&str; 2] = ["e-stop", "emergency-stop"];

/// Longest wait for stopped motors. A configuration holds and damps for at most 30 s each.
const STOPPED: Duration = Duration::from_secs(60);

/// The commands that the daemon carries out for an operator.
#[derive(Debug, Subcommand)]
pub(crate) enum Operate {
    /// Start the motors of a group. They then follow the setpoints of the group's owner. An active group stays active.
    #[command(after_help = "Example:\n  motorctl enable legs")]
    Enable(GroupArgument),
    /// Damp the motors of a group, then stop them. Waits until they are stopped.
    #[command(after_help = "Example:\n  motorctl disable legs")]
    Disable(GroupArgument),
    /// Clear the latched cause that stopped a group. No motor moves.
    #[command(
        after_help = "Examples:\n  motorctl reset legs && motorctl enable legs\n  motorctl disable legs && motorctl reset legs --wait"
    )]
    Reset {
        #[command(flatten)]
        group: GroupArgument,
        /// Wait until the motors are stopped, at most 60 s. Without it a group that is still being damped is refused.
        #[arg(long)]
        wait: bool,
    },
    /// Damp and stop every motor of every group now. The stop stays latched until a reset.
    ///
    /// The command sends the stop before every other step. It needs neither files nor a client
    /// slot: the daemon has a separate socket for stops. If the daemon does not confirm the stop
    /// within about a second, the exit status is 79; if it does, but motors do not answer, it is
    /// 80. In both cases: cut the power.
    ///
    /// If no daemon of this name runs here, but one of this user, of root or of the service runs in
    /// another runtime directory, that one is stopped; if several run, their lines are printed.
    /// Answers of other users' processes do not count, and the lines to stop these are printed.
    ///
    /// This is a software stop. It does not replace a switch that cuts the power.
    #[command(
        visible_aliases = ESTOP_ALIASES,
        after_help = "Examples:\n  motorctl estop || echo 'cut the power'\n  motorctl estop --all      # every robot of this computer"
    )]
    Estop {
        /// Stop the motors of every daemon of this computer.
        #[arg(long)]
        all: bool,
    },
    /// Remove the owner of a group. The motors of an active group stop.
    #[command(after_help = "Example:\n  motorctl release legs --force")]
    Release {
        /// Name of the group.
        group: String,
        /// Confirm that the owner loses the group without having released it.
        #[arg(long, required = true)]
        force: bool,
    },
    /// Leave a missing or broken joint out of its group while the group is disarmed.
    ///
    /// Its motor receives only stop frames, and its setpoints are ignored. The group can be enabled
    /// without the joint only if the configuration sets `may-be-excluded = true` for it.
    #[command(after_help = "Example:\n  motorctl exclude rr-knee")]
    Exclude {
        /// Name of the joint.
        joint: String,
    },
    /// End the exclusion of a joint while its group is disarmed.
    #[command(after_help = "Example:\n  motorctl include rr-knee")]
    Include {
        /// Name of the joint.
        joint: String,
    },
}

#[derive(Debug, clap::Args)]
pub(crate) struct GroupArgument {
    /// Name of the group. The default is all groups.
    group: Option<String>,
}

/// Runs a command of an operator.
pub(crate) fn run(instance: &str, command: Operate) -> Result<(), Failure> {
    match command {
        Operate::Enable(GroupArgument { group }) => enable(instance, group.as_deref()),
        Operate::Disable(GroupArgument { group }) => disable(instance, group.as_deref()),
        Operate::Reset { group, wait } => reset(instance, group.group.as_deref(), wait),
        Operate::Estop { all } => estop::run(instance, all),
        Operate::Release { group, .. } => release(instance, &group),
        Operate::Exclude { joint } => exclude(instance, &joint),
        Operate::Include { joint } => include(instance, &joint),
    }
}

/// `motorctl enable`: starts the motors of a group that has an owner.
fn enable(instance: &str, group: Option<&str>) -> Result<(), Failure> {
    for_groups(instance, group, |client, group| match client.enable(group) {
        Err(Error::Refused { refusal: Refusal::NotDisarmed, .. }) if is_running(client, group)? => {
            Ok("is active already")
        }
        outcome => outcome.map(|()| "enabled"),
    })
}

/// Returns true if the motors of the group follow their owner or are starting.
fn is_running(client: &Client, group: &str) -> Result<bool, Error> {
    let index = client.group_named(group)?;
    let phase = client.wait(TIMEOUT)?.group(index).and_then(|group| group.phase);
    Ok(matches!(phase, Some(Phase::Starting | Phase::Active)))
}

/// `motorctl disable`: damps and stops the motors of a group. Fails when some of them do not answer.
fn disable(instance: &str, group: Option<&str>) -> Result<(), Failure> {
    let client = status::connect(instance)?;
    let (mut silent, mut outcome) = (Vec::new(), Ok(()));
    for group in groups(&client, group) {
        let stopped = client.disable(&group).and_then(|()| client.wait_for(&group, Phase::Disarmed, STOPPED));
        let offline = stopped.map(|()| client.offline_joints(Some(&group), TIMEOUT));
        let done = format!("{group}: stopped, after damping what moves");
        match offline.map(|offline| confirmation::outcome(&done, offline)) {
            Ok(Ok(done)) => print_effect(&done),
            Ok(Err(offline)) => silent.extend(offline),
            Err(refusal) => outcome = outcome.and(Err(refusal)),
        }
    }
    outcome?;
    if silent.is_empty() { Ok(()) } else { Err(Failure::MotorsSilent(silent.join(", "))) }
}

/// Returns the names of `group`, or of all groups.
fn groups(client: &Client, group: Option<&str>) -> Vec<String> {
    let all = || client.description().groups.iter().map(|group| group.name.clone()).collect();
    group.map_or_else(all, |group| vec![group.to_owned()])
}

/// `motorctl reset`: clears the cause of a stop; no motor moves. `wait` first waits until the
/// motors are stopped.
fn reset(instance: &str, group: Option<&str>, wait: bool) -> Result<(), Failure> {
    let request = if wait { reset_stopped } else { Client::reset };
    let reset = for_groups(instance, group, |client, group| request(client, group).map(|()| "reset"));
    reset.map_err(|failure| match failure {
        Failure::Client(error @ Error::Refused { refusal: Refusal::NotNeutral, .. }) => {
            Failure::NotStoppedYet(error)
        }
        other => other,
    })
}

fn reset_stopped(client: &Client, group: &str) -> Result<(), Error> {
    client.wait_for(group, Phase::Disarmed, STOPPED)?;
    client.reset(group)
}

/// `motorctl release --force`: removes the owner of a group.
fn release(instance: &str, group: &str) -> Result<(), Failure> {
    status::connect(instance)?.force_release(group)?;
    print_effect(&format!("{group}: has no owner now"));
    Ok(())
}

/// `motorctl fault clear`: clears a motor's fault.
pub(crate) fn clear_fault(instance: &str, joint: &str) -> Result<(), Failure> {
    let client = status::connect(instance)?;
    let index = client.joint_named(joint)?;
    let reported = client.wait(status::TIMEOUT)?.joint(index).map(|joint| joint.faults).unwrap_or_default();
    client.clear_fault(joint)?;
    let status = format!("{} status", motorctl(instance));
    print_effect(&if reported.is_empty() {
        format!("{joint}: reported no fault before; the motor has cleared its faults")
    } else {
        format!("{joint}: the fault was cleared; `{status}` shows it again if its cause remains")
    });
    Ok(())
}

/// `motorctl exclude`: leaves a joint out of its group.
fn exclude(instance: &str, joint: &str) -> Result<(), Failure> {
    status::connect(instance)?.exclude(joint)?;
    let include = format!("{} include {joint}", motorctl(instance));
    print_effect(&format!("{joint}: is excluded until `{include}`, or until the daemon starts again"));
    Ok(())
}

/// `motorctl include`: ends the exclusion of a joint.
fn include(instance: &str, joint: &str) -> Result<(), Failure> {
    status::connect(instance)?.include(joint)?;
    print_effect(&format!("{joint}: is included again"));
    Ok(())
}

/// `motorctl zero`: stores the present position of a stopped joint as its zero.
pub(crate) fn zero(instance: &str, joint: &str, confirm: Confirm) -> Result<(), Failure> {
    let client = status::connect(instance)?;
    let index = client.joint_named(joint)?;
    let robot = client.description();
    let position = client.wait(TIMEOUT)?.joint(index).and_then(|joint| joint.position());
    confirm.ask(&effect_of_zero(&robot.joints[index], position))?;
    client.set_zero(joint)?;
    print_effect(&format!("{joint}: the present position is now zero"));
    Ok(())
}

/// Describes the angle of a joint after its motor was set to zero, with its limits.
fn effect_of_zero(joint: &JointDescription, position: Option<f32>) -> String {
    let JointDescription { name, zero, limits, .. } = joint;
    let before = position.map_or_else(String::new, |position| format!(" ({position:.2} rad)"));
    let [lower, upper] = limits.position;
    let verdict = match limits.allow(*zero) {
        true => format!("within its limits, {lower:.2} to {upper:.2}"),
        false => {
            format!("OUTSIDE its limits, {lower:.2} to {upper:.2}: its group cannot be enabled in this pose")
        }
    };
    format!(
        "This permanently stores the present position of {name}{before} as its motor's zero. It will be at {zero:.2} rad, \
         {verdict}."
    )
}

/// Sends `request` for `group`, or for every group. A refusal does not end the loop, so that as
/// many groups as possible are stopped. Returns the first refusal.
fn for_groups(
    instance: &str,
    group: Option<&str>,
    request: impl Fn(&Client, &str) -> Result<&'static str, Error>,
) -> Result<(), Failure> {
    let client = status::connect(instance)?;
    let mut outcome = Ok(());
    for group in groups(&client, group) {
        match request(&client, &group) {
            Ok(done) => print_effect(&format!("{group}: {done}")),
            Err(refusal) => outcome = outcome.and(Err(refusal)),
        }
    }
    Ok(outcome?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_client::JointLimits;

    #[test]
    fn new_zero_is_reported_against_the_limits() {
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
