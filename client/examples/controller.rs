//! A controller template: copy it, and insert your control law into `law`.
//!
//! It enables its group once, at its start. After a stop, or a restart of the daemon, it sends the
//! positions of the joints and waits: a person inspects the robot, then runs `motorctl reset GROUP`
//! and `motorctl enable GROUP`. A signal ends it with the motors stopped.

use clap::Parser;
use motord_client::{Claim, Client, DEFAULT_INSTANCE, Error, Phase, Setpoint, Slot, State};
use signal_hook::consts::{SIGINT, SIGTERM};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

#[derive(Parser)]
struct Options {
    #[arg(long, default_value = "all")]
    group: String,
    #[arg(long, env = "MOTORD_INSTANCE", default_value = DEFAULT_INSTANCE)]
    instance: String,
}

/// A turn every second cycle: 500 Hz when the daemon runs at 1 kHz.
const EVERY: u32 = 2;
/// Stiffness, N·m/rad, and damping, N·m·s/rad.
const KP: f32 = 40.0;
const KD: f32 = 1.0;
/// Time without a state after which the connection counts as lost. Shorter stalls are tolerated.
const TIMEOUT: Duration = Duration::from_secs(1);
/// Longer than the motors take to be damped and stopped.
const STOP: Duration = Duration::from_secs(5);

/// Sets the setpoints at `time` after the group became active: each joint swings around its
/// `start`, rad.
fn law(claim: &mut Claim, joints: &[Slot], start: &[f32], time: Duration) -> Result<(), Error> {
    for (&joint, start) in joints.iter().zip(start) {
        let position = start + 0.1 * (3.0 * time.as_secs_f32()).sin();
        let position = claim.limits(joint)?.clamp_position(position);
        claim.set(joint, Setpoint::hold(position, KP, KD))?;
    }
    Ok(())
}

/// Sets the setpoints to the positions of the joints, and returns these positions, rad.
fn rest(claim: &mut Claim, joints: &[Slot], state: &State) -> Result<Vec<f32>, Error> {
    claim.hold(state, KP, KD)?;
    joints.iter().map(|&joint| Ok(claim.setpoint(joint)?.position)).collect()
}

/// Runs one connection to the daemon: from the claim to the first error, or to the `end`.
fn control(options: &Options, may_enable: &mut bool, end: &AtomicBool) -> Result<(), Error> {
    let client = Client::connect(&options.instance)?;
    client.set_silence(TIMEOUT);
    let mut claim = client.claim(&options.group)?;
    let joints = claim.slots(claim.names())?;
    let mut start = rest(&mut claim, &joints, &client.wait_cycles(EVERY, TIMEOUT)?)?;
    claim.commit()?;
    if std::mem::take(may_enable) {
        claim.enable()?;
    }
    let (mut begun, mut stop) = (None, None);
    while !end.load(Ordering::Relaxed) {
        let state = client.wait_cycles(EVERY, TIMEOUT)?;
        let group = state.of(&claim)?;
        if group.stop() != stop {
            stop = group.stop();
            println!("{}", stop.as_ref().map_or("reset".to_owned(), |stop| format!("the group {stop}")));
        }
        match group.phase() {
            Some(Phase::Active) => {
                let begun = *begun.get_or_insert(state.time());
                law(&mut claim, &joints, &start, state.time() - begun)?;
            }
            // The setpoints stay constant while the motors start.
            Some(Phase::Starting) => begun = None,
            // A lost motor has no position: wait for it.
            _ if group.is_heard() => start = rest(&mut claim, &joints, &state)?,
            _ => {}
        }
        // After a stop the setpoints keep the claim, until a person has reset the group.
        if let Err(error) = claim.commit()
            && !matches!(error, Error::Stopped { .. })
        {
            return Err(error);
        }
    }
    claim.disable()?;
    claim.wait_for(Phase::Disarmed, STOP)
}

fn main() -> ExitCode {
    let (options, end, mut may_enable) = (Options::parse(), Arc::new(AtomicBool::new(false)), true);
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&end)).expect("these signals may be handled");
    }
    while let Err(error) = control(&options, &mut may_enable, &end) {
        eprintln!("controller: {error}");
        // A group that was stopped for lateness is claimed anew, and waits for a person.
        let may_return = error.is_transient() || matches!(error, Error::Stopped { .. });
        if !may_return || end.load(Ordering::Relaxed) {
            return ExitCode::from(error.exit_status());
        }
        std::thread::sleep(Duration::from_millis(500));
    }
    ExitCode::SUCCESS
}
