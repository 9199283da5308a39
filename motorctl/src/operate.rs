//! The commands of an operator: one request each, and a word about what follows from it.

use crate::failure::Failure;
use motord_client::{Client, Error};
use std::io::{self, Write};

/// `motorctl enable`: starts the motors of a group that has an owner.
pub(crate) fn enable(instance: &str, group: Option<&str>) -> Result<(), Failure> {
    for_groups(instance, group, "enabled", Client::enable)
}

/// `motorctl disable`: damps and stops the motors of a group.
pub(crate) fn disable(instance: &str, group: Option<&str>) -> Result<(), Failure> {
    for_groups(instance, group, "damped, and stopped once slow", Client::disable)
}

/// `motorctl reset`: takes back the cause of a stop; moves nothing.
pub(crate) fn reset(instance: &str, group: Option<&str>) -> Result<(), Failure> {
    for_groups(instance, group, "reset", Client::reset)
}

/// `motorctl estop`: damps and stops every motor.
pub(crate) fn estop(instance: &str) -> Result<(), Failure> {
    Client::connect_to_stop(instance)?.emergency_stop()?;
    say("every motor is damped, and stopped once slow; `motorctl reset` takes the emergency stop back")
}

/// `motorctl release --force`: takes a group from its owner.
pub(crate) fn release(instance: &str, group: &str) -> Result<(), Failure> {
    Client::connect(instance)?.force_release(group)?;
    say(&format!("{group}: taken from its owner"))
}

/// `motorctl fault clear`: acknowledges a motor's fault.
pub(crate) fn clear_fault(instance: &str, joint: &str) -> Result<(), Failure> {
    Client::connect(instance)?.clear_fault(joint)?;
    say(&format!("{joint}: fault acknowledged; `motorctl status` shows whether it is gone"))
}

/// `motorctl zero`: makes the position where a stopped joint stands its zero.
pub(crate) fn zero(instance: &str, joint: &str, confirmed: bool) -> Result<(), Failure> {
    if !confirmed {
        return Err(Failure::Unconfirmed { joint: joint.to_owned() });
    }
    Client::connect(instance)?.set_zero(joint)?;
    say(&format!("{joint}: zero is where it stands now"))
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
