//! Holds every joint of the simulated robot in position. The instance `demo` and the group `legs`
//! come from config/quadruped-simulated.toml; other robots use other names.

use motord_client::{Client, Error, Phase};
use std::time::Duration;

fn main() -> Result<(), Error> {
    let timeout = Duration::from_secs(1);
    let client = Client::connect("demo")?;
    let mut claim = client.claim("legs")?;

    // The daemon starts motors only for an owner that sends setpoints near the positions of the
    // joints.
    claim.hold(&client.wait(timeout)?, 20.0, 0.5)?;
    claim.commit()?;
    claim.enable()?;
    claim.wait_for(Phase::Active, 5 * timeout)?;
    loop {
        let state = client.wait(timeout)?;
        state.of(&claim)?.must_be_active()?; // The error says why the group was stopped, and what to do.
        claim.commit()?;
    }
}
