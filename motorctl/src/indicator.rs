//! `motorctl indicator JOINT`: the values that motors have told the daemon.

use crate::failure::Failure;
use crate::status;
use motord_client::Indicator;
use motord_direct::{DirectFailure, Indicators};

/// Prints the indicators of a joint that are known.
///
/// # Errors
///
/// When no daemon answers, it has no such joint or no indicators of it, or the output cannot be written.
pub(crate) fn run(instance: &str, asked: &Indicators) -> Result<(), Failure> {
    let joint = asked.joint().unwrap_or_default();
    let client = status::connect(instance)?;
    let index = client.joint_named(joint)?;
    asked.print(|number| {
        let state = client.wait(status::PATIENCE)?;
        let known = state.indicators(index).ok_or_else(|| none_of(joint))?;
        Ok(Indicator::try_from(u32::from(number)).ok().and_then(|indicator| known.get(indicator)))
    })
}

fn none_of(joint: &str) -> DirectFailure {
    DirectFailure::Usage(format!(
        "the daemon knows no indicators of {joint}: it asks native motors, the first 16 of them, where `indicator-hz` is not 0"
    ))
}
