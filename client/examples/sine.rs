//! Moves one joint, or all joints of a group, along a sine around where they are.
//!
//! With `--persist` it continues after a stop and after a restart of the daemon: for simulated
//! robots and robots on a stand.

use clap::Parser;
use motord_client::{Claim, Client, DEFAULT_INSTANCE, Error, Phase, Setpoint, Slot};
use std::f32::consts::TAU;
use std::process::ExitCode;
use std::time::Duration;

/// Move one joint, or all joints of a group, along a sine around where they are.
#[derive(Parser)]
struct Options {
    /// Group of joints.
    #[arg(long, default_value = "all")]
    group: String,
    /// The joint to move; the others of the group hold still. All of them, unless given.
    #[arg(long)]
    joint: Option<String>,
    /// Amplitude, rad.
    #[arg(long, default_value_t = 0.2)]
    amplitude_rad: f32,
    /// Frequency, Hz.
    #[arg(long, default_value_t = 0.5)]
    hz: f32,
    /// End after this many seconds of motion.
    #[arg(long)]
    seconds: Option<f32>,
    /// Stiffness, N·m/rad.
    #[arg(long, default_value_t = 20.0)]
    kp: f32,
    /// Damping, N·m·s/rad.
    #[arg(long, default_value_t = 0.5)]
    kd: f32,
    /// Send setpoints every this many cycles: at 1 kHz, 20 is a controller of 50 Hz.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=500))]
    every: u32,
    /// After a stop or a restart of the daemon, reset, claim and enable again.
    #[arg(long)]
    persist: bool,
    /// Instance of motord.
    #[arg(long, env = "MOTORD_INSTANCE", default_value = DEFAULT_INSTANCE)]
    instance: String,
}

/// Longer than a shared machine stalls.
const TIMEOUT: Duration = Duration::from_secs(1);
/// Longer than motors take to start or to stop.
const CHANGE: Duration = Duration::from_secs(5);
/// Pause before another attempt.
const PAUSE: Duration = Duration::from_millis(500);

fn main() -> ExitCode {
    let options = Options::parse();
    loop {
        match sine(&options) {
            Ok(()) => return ExitCode::SUCCESS,
            Err(error) if options.persist && passes(&error) => println!("{error}"),
            Err(error) => {
                eprintln!("sine: {error}");
                return ExitCode::from(error.exit_status());
            }
        }
        std::thread::sleep(PAUSE);
    }
}

/// Returns `true` if the error is temporary. With a reset, a stop and a refusal are temporary as
/// well.
fn passes(error: &Error) -> bool {
    error.is_transient() || matches!(error, Error::Stopped { .. } | Error::Refused { .. })
}

fn sine(options: &Options) -> Result<(), Error> {
    let client = Client::connect(&options.instance)?;
    let mut claim = client.claim(&options.group)?;
    let start = client.wait(TIMEOUT)?;
    if options.persist && start.of(&claim)?.stop().is_some() {
        claim.wait_for(Phase::Disarmed, CHANGE)?;
        claim.reset()?;
    }
    claim.hold(&start, options.kp, options.kd)?;
    claim.commit()?;
    claim.enable()?;
    claim.wait_for(Phase::Active, CHANGE)?;
    let names: Vec<String> = match &options.joint {
        Some(joint) => vec![joint.clone()],
        None => claim.names().map(str::to_owned).collect(),
    };
    let moved = claim.slots(&names)?;
    let centres =
        moved.iter().map(|&slot| Ok(claim.setpoint(slot)?.position)).collect::<Result<Vec<_>, Error>>()?;
    println!("moving {names:?}");
    let begun = client.wait(TIMEOUT)?.time();
    loop {
        let state = client.wait_cycles(options.every, TIMEOUT)?;
        state.of(&claim)?.must_be_active()?;
        let time = (state.time() - begun).as_secs_f32();
        if options.seconds.is_some_and(|seconds| time >= seconds) {
            claim.disable()?;
            return claim.wait_for(Phase::Disarmed, CHANGE);
        }
        for (&slot, centre) in moved.iter().zip(&centres) {
            swing(&mut claim, slot, *centre, time, options)?;
        }
        claim.commit()?;
    }
}

/// Sets the setpoint of the joint at `time`, s after the motion began.
fn swing(claim: &mut Claim, slot: Slot, centre: f32, time: f32, options: &Options) -> Result<(), Error> {
    let omega = TAU * options.hz;
    let (sin, cos) = (omega * time).sin_cos();
    let position = claim.limits(slot)?.clamp_position(centre + options.amplitude_rad * sin);
    let velocity = options.amplitude_rad * omega * cos;
    claim.set(slot, Setpoint::impedance(position, velocity, options.kp, options.kd, 0.0))
}
