//! Holds every joint of a group where it is, until the group is stopped or this program ends.

use clap::Parser;
use motord_client::{Client, DEFAULT_INSTANCE, Error, Phase};
use std::process::ExitCode;
use std::time::Duration;

/// Hold every joint of a group where it is.
#[derive(Parser)]
struct Options {
    /// Instance of motord.
    #[arg(long, env = "MOTORD_INSTANCE", default_value = DEFAULT_INSTANCE)]
    instance: String,
    /// Group of joints.
    #[arg(long, default_value = "all")]
    group: String,
    /// Stiffness, N·m/rad.
    #[arg(long, default_value_t = 20.0)]
    kp: f32,
    /// Damping, N·m·s/rad.
    #[arg(long, default_value_t = 0.5)]
    kd: f32,
}

/// Longer than a shared machine stalls.
const TIMEOUT: Duration = Duration::from_secs(1);
/// Longer than motors take to start.
const START: Duration = Duration::from_secs(5);

fn main() -> ExitCode {
    match hold(&Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("hold: {error}");
            ExitCode::from(error.exit_status())
        }
    }
}

fn hold(options: &Options) -> Result<(), Error> {
    let client = Client::connect(&options.instance)?;
    let mut claim = client.claim(&options.group)?;
    claim.hold(&client.wait(TIMEOUT)?, options.kp, options.kd)?;
    claim.commit()?;
    claim.enable()?;
    claim.wait_for(Phase::Active, START)?;
    println!("holding {} joints of group {}", claim.joints().len(), claim.group());
    loop {
        let state = client.wait(TIMEOUT)?;
        // The error names the cause of the stop, and what to do.
        state.of(&claim)?.must_be_active()?;
        claim.commit()?;
    }
}
