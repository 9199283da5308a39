//! Moves one joint, or all joints of a group, along a sine around where they are.
//!
//! With `--persist` it goes on after a stop and after a restart of the daemon: for a simulated robot, or one on a stand.

use clap::Parser;
use motord_client::{Cause, Claim, Client, DEFAULT_INSTANCE, Error, Group, Phase, Setpoint, State};
use std::f32::consts::TAU;
use std::process::ExitCode;
use std::time::Duration;

/// Move one joint, or all joints of a group, along a sine around where they are.
#[derive(Parser)]
struct Options {
    /// Instance of motord.
    #[arg(long, default_value = DEFAULT_INSTANCE)]
    instance: String,
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
    /// After a stop or a restart of the daemon, reset, claim and enable again.
    #[arg(long)]
    persist: bool,
}

/// Longer than a shared machine stalls.
const PATIENCE: Duration = Duration::from_secs(1);

/// Pause before another attempt.
const PAUSE: Duration = Duration::from_millis(500);

/// How a motion ended.
enum End {
    Finished,
    Stopped(&'static str),
}

fn main() -> ExitCode {
    let options = Options::parse();
    let client = match Client::connect(&options.instance) {
        Ok(client) => client,
        Err(error) => return failed(&error),
    };
    loop {
        match sine(&client, &options) {
            Ok(End::Finished) => return ExitCode::SUCCESS,
            Ok(End::Stopped(why)) => {
                println!("stopped: {why}");
                if !options.persist {
                    return ExitCode::SUCCESS;
                }
            }
            Err(error) if options.persist && passes(&error) => println!("{error}"),
            Err(error) => return failed(&error),
        }
        std::thread::sleep(PAUSE);
    }
}

fn failed(error: &Error) -> ExitCode {
    eprintln!("sine: {error}");
    ExitCode::from(error.exit_status())
}

/// Whether another attempt may succeed without anybody changing the command line.
fn passes(error: &Error) -> bool {
    use Error::{NoAnswer, NotRunning, Refused, Restarted, Silent, Timeout};
    matches!(
        error,
        NotRunning { .. } | Silent { .. } | Timeout { .. } | Restarted | Refused { .. } | NoAnswer { .. }
    )
}

fn sine(client: &Client, options: &Options) -> Result<End, Error> {
    let mut claim = client.claim(&options.group)?;
    let start = client.wait(PATIENCE)?;
    let motion = Motion::new(client, &claim, &start, options)?;
    if options.persist && start.group(claim.index()).is_some_and(|group| group.latched) {
        claim.reset()?;
    }
    claim.send(&motion.at(0.0))?;
    claim.enable()?;
    println!("moving {:?}", motion.names);
    let mut begun_ns = None;
    loop {
        let state = client.wait(PATIENCE)?;
        let Some(group) = state.group(claim.index()) else { return Ok(End::Stopped("The group is gone.")) };
        if group.phase == Some(Phase::Active) {
            begun_ns.get_or_insert(state.tick_ns());
        } else if let Some(why) = stopped(&group, begun_ns.is_some()) {
            return Ok(End::Stopped(why));
        }
        let elapsed_ns = begun_ns.map_or(0, |begun| state.tick_ns().saturating_sub(begun));
        let elapsed = Duration::from_nanos(elapsed_ns).as_secs_f32();
        if options.seconds.is_some_and(|seconds| elapsed >= seconds) {
            claim.disable()?;
            return Ok(End::Finished);
        }
        claim.send(&motion.at(elapsed))?;
    }
}

fn stopped(group: &Group, was_active: bool) -> Option<&'static str> {
    let disabled = was_active && group.phase == Some(Phase::Disarmed);
    let cause = group.cause.map(Cause::sentence);
    (group.latched || disabled).then(|| cause.unwrap_or("The group was disabled."))
}

/// Each joint's centre, amplitude and bounds, rad, and the gains.
struct Motion {
    names: Vec<String>,
    joints: Vec<(f32, f32, [f32; 2])>,
    hz: f32,
    kp: f32,
    kd: f32,
}

impl Motion {
    fn new(client: &Client, claim: &Claim, start: &State, options: &Options) -> Result<Self, Error> {
        let moved = options.joint.as_deref().map(|name| client.joint_named(name)).transpose()?;
        let mut motion =
            Self { names: vec![], joints: vec![], hz: options.hz, kp: options.kp, kd: options.kd };
        for &index in claim.joints() {
            let (description, centre) = (
                &client.description().joints[index],
                start.joint(index).and_then(|joint| joint.position()).unwrap_or(0.0),
            );
            let moves = moved.is_none_or(|moved| moved == index);
            motion.joints.push((
                centre,
                if moves { options.amplitude_rad } else { 0.0 },
                description.limits.position,
            ));
            if moves {
                motion.names.push(description.name.clone());
            }
        }
        Ok(motion)
    }

    /// The setpoints at `time`, s after the motion began.
    fn at(&self, time: f32) -> Vec<Setpoint> {
        let omega = TAU * self.hz;
        let (sin, cos) = (omega * time).sin_cos();
        let setpoint = |&(centre, amplitude, [lower, upper]): &(f32, f32, [f32; 2])| {
            let position = (centre + amplitude * sin).max(lower).min(upper);
            Setpoint::impedance(position, amplitude * omega * cos, self.kp, self.kd, 0.0)
        };
        self.joints.iter().map(setpoint).collect()
    }
}
