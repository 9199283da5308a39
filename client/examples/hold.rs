//! Holds every joint of a group where it is, until the group is stopped or this program ends.

use clap::Parser;
use motord_client::{Cause, Claim, Client, DEFAULT_INSTANCE, Error, Phase, Setpoint, State};
use std::process::ExitCode;
use std::time::Duration;

/// Hold every joint of a group where it is.
#[derive(Parser)]
struct Options {
    /// Instance of motord.
    #[arg(long, default_value = DEFAULT_INSTANCE)]
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
const PATIENCE: Duration = Duration::from_secs(1);

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
    let setpoints = present_pose(&claim, &client.wait(PATIENCE)?, options);
    claim.send(&setpoints)?;
    claim.enable()?;
    println!("holding {} joints of group {}", setpoints.len(), claim.group());
    let mut active = false;
    loop {
        let state = client.wait(PATIENCE)?;
        claim.send(&setpoints)?;
        let Some(group) = state.group(claim.index()) else { return Ok(()) };
        active |= group.phase == Some(Phase::Active);
        if group.latched || active && group.phase == Some(Phase::Disarmed) {
            println!("stopped: {}", group.cause.map_or("The group was disabled.", Cause::sentence));
            return Ok(());
        }
    }
}

fn present_pose(claim: &Claim, state: &State, options: &Options) -> Vec<Setpoint> {
    let joints = claim.joints().iter().filter_map(|&joint| state.joint(joint));
    let hold = |position| Setpoint::impedance(position, 0.0, options.kp, options.kd, 0.0);
    joints.filter_map(|joint| joint.position()).map(hold).collect()
}
