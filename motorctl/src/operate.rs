//! The commands of an operator: one request each, and a sentence about its effect.

use crate::failure::Failure;
use motord_client::{Client, Error};
use motord_wire::Confirm;
use std::io::{self, Write};

/// `motorctl enable`: starts the motors of a group that has an owner.
pub(crate) fn enable(instance: &str, group: Option<&str>) -> Result<(), Failure> {
    for_groups(instance, group, "enabled", Client::enable)
}

/// `motorctl disable`: damps and stops the motors of a group.
pub(crate) fn disable(instance: &str, group: Option<&str>) -> Result<(), Failure> {
    for_groups(instance, group, "being damped, then stopped", Client::disable)
}

/// `motorctl reset`: clears the cause of a stop; no motor moves.
pub(crate) fn reset(instance: &str, group: Option<&str>) -> Result<(), Failure> {
    for_groups(instance, group, "reset", Client::reset)
}

/// `motorctl estop`: damps and stops every motor.
pub(crate) fn estop(instance: &str) -> Result<(), Failure> {
    Client::connect_to_stop(instance)?.emergency_stop()?;
    say("every motor is being damped, then stopped; `motorctl reset` clears the emergency stop")
}

/// `motorctl release --force`: removes the owner of a group.
pub(crate) fn release(instance: &str, group: &str) -> Result<(), Failure> {
    Client::connect(instance)?.force_release(group)?;
    say(&format!("{group}: has no owner any more"))
}

/// `motorctl fault clear`: clears a motor's fault.
pub(crate) fn clear_fault(instance: &str, joint: &str) -> Result<(), Failure> {
    Client::connect(instance)?.clear_fault(joint)?;
    say(&format!("{joint}: the fault was cleared; `motorctl status` shows it again if its cause remains"))
}

/// `motorctl exclude`: leaves a joint out of its group.
pub(crate) fn exclude(instance: &str, joint: &str) -> Result<(), Failure> {
    Client::connect(instance)?.exclude(joint)?;
    say(&format!("{joint}: is excluded until `motorctl include {joint}`, or until the daemon starts again"))
}

/// `motorctl include`: ends the exclusion of a joint.
pub(crate) fn include(instance: &str, joint: &str) -> Result<(), Failure> {
    Client::connect(instance)?.include(joint)?;
    say(&format!("{joint}: is looked for again"))
}

/// `motorctl zero`: stores the present position of a stopped joint as its zero.
pub(crate) fn zero(instance: &str, joint: &str, confirm: Confirm) -> Result<(), Failure> {
    confirm.ask(&format!("This permanently stores the present position of {joint} as its zero."))?;
    Client::connect(instance)?.set_zero(joint)?;
    say(&format!("{joint}: the present position is now zero"))
}

/// Without a name the request goes to every group. A refusal does not keep it from the others: a robot that is to be
/// stopped is stopped as far as possible. The first refusal is the outcome.
fn for_groups(
    instance: &str,
    group: Option<&str>,
    done: &str,
    request: fn(&Client, &str) -> Result<(), Error>,
) -> Result<(), Failure> {
    let client = Client::connect(instance)?;
    let groups: Vec<String> = match group {
        Some(group) => vec![group.to_owned()],
        None => client.description().groups.iter().map(|group| group.name.clone()).collect(),
    };
    let mut outcome = Ok(());
    for group in groups {
        match request(&client, &group) {
            Ok(()) => say(&format!("{group}: {done}"))?,
            refusal => outcome = outcome.and(refusal),
        }
    }
    Ok(outcome?)
}

fn say(sentence: &str) -> Result<(), Failure> {
    Ok(writeln!(io::stdout(), "{sentence}")?)
}
