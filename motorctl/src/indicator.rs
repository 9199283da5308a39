//! `motorctl indicator JOINT`: the indicators that the daemon knows.

use crate::failure::Failure;
use crate::status;
use motord_client::Indicator;
use motord_direct::{DirectFailure, Indicators};

/// Prints the known indicators of a joint.
///
/// # Errors
///
/// No daemon answers, it has no such joint or no indicators of it, or the output cannot be written.
pub(crate) fn run(instance: &str, asked: &Indicators) -> Result<(), Failure> {
    let joint = asked.joint().unwrap_or_default();
    let client = status::connect(instance)?;
    let index = client.joint_named(joint)?;
    asked.print(|number| {
        let state = client.wait(status::TIMEOUT)?;
        let known = state.indicators(index).ok_or_else(|| none_of(joint))?;
        Ok(Indicator::try_from(u32::from(number)).ok().and_then(|indicator| known.get(indicator)))
    })
}

fn none_of(joint: &str) -> DirectFailure {
    DirectFailure::Usage(format!(
        "the daemon knows no indicators of {joint}: it reads those of the first 16 GIM motors, unless `indicator-hz` is 0"
    ))
}
