//! The controller process of the demo, an example of a robot's controller.
//!
//! ```text
//! stand (answer states with where the joints stand) -> enable -> trot -> disable -> stopped
//! ```
//!
//! It sleeps until the states of a cycle arrive, and answers them with setpoints. It reports its
//! progress to its parent, one JSON object per line on standard output.

use crate::demo::error::DemoError;
use crate::demo::gait::{BLEND, GROUP, Swing};
use crate::demo::tracking::Tracking;
use crate::failure::Failure;
use motord_client::{Claim, Client, Phase, Setpoint, State};
use motord_terminal::{Interrupt, json};
use serde::{Deserialize, Serialize};
use std::io::{self, Write};
use std::time::Duration;

/// Stiffness, N·m/rad.
const KP: f32 = 70.0;
/// Damping, N·m·s/rad.
const KD: f32 = 2.0;
/// Longest wait for a state. Then the daemon counts as unavailable.
const TIMEOUT: Duration = Duration::from_millis(500);
/// Longest time to find, start and stop the motors each, s.
const CHANGE_MAX: f64 = 8.0;
/// Time between two messages of progress, s.
const PROGRESS_PERIOD: f64 = 0.2;

/// A message from the controller to its parent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum ControllerMessage {
    /// The trot continues.
    TrotProgress(TrotProgress),
    /// The trot is over: the tracking of every joint, in the order of the description.
    Outcome(Vec<Tracking>),
}

/// The progress of the trot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct TrotProgress {
    /// Time since the trot began, s.
    pub(crate) time: f64,
    /// Cycle number.
    pub(crate) cycle: u64,
    /// Missed replies of all motors.
    pub(crate) missed: u64,
    /// Largest tracking error so far, rad.
    pub(crate) tracking_max: f64,
}

/// Trots for `seconds`, beginning and ending with stopped motors.
///
/// # Errors
///
/// The daemon ends, refuses a request or stops the group; a signal arrives; or standard output is
/// closed.
pub(crate) fn run(instance: &str, seconds: f64) -> Result<(), Failure> {
    let mut controller = Controller::connect(instance)?;
    controller.stand("ready", Controller::is_ready)?;
    controller.claim.enable()?;
    controller.stand("started", |controller, state| controller.phase(state) == Some(Phase::Active))?;
    let trot = controller.trot(seconds);
    // Also after a failure: stop the motors before the controller exits.
    controller.claim.disable()?;
    controller.stand("stopped", |controller, state| controller.phase(state) == Some(Phase::Disarmed))?;
    trot?;
    send_message(&ControllerMessage::Outcome(controller.tracking))
}

struct Controller {
    client: Client,
    claim: Claim,
    /// The motion of each joint of the group.
    swings: Vec<Swing>,
    /// Position of each joint of the group before the start, rad.
    origins: Vec<f32>,
    /// Sequence of the newest message.
    sequence: u64,
    /// Sequence of the first message with a measured position for each joint; 0 before.
    standing: u64,
    /// Reused in every cycle, to avoid an allocation.
    setpoints: Vec<Setpoint>,
    /// The tracking error of every joint of the robot.
    tracking: Vec<Tracking>,
    interrupt: Interrupt,
}

impl Controller {
    fn connect(instance: &str) -> Result<Self, Failure> {
        let interrupt = Interrupt::register();
        let client = Client::connect(instance)?;
        client.set_silence(TIMEOUT);
        let claim = client.claim(GROUP)?;
        let joints = &client.description().joints;
        let swings: Vec<Swing> = claim.joints().iter().map(|&joint| Swing::of(&joints[joint].name)).collect();
        Ok(Self {
            origins: vec![0.0; swings.len()],
            sequence: 0,
            standing: 0,
            setpoints: Vec::with_capacity(swings.len()),
            tracking: vec![Tracking::default(); joints.len()],
            swings,
            claim,
            client,
            interrupt,
        })
    }

    /// Answers every state with the positions of the joints, until `done`.
    fn stand(&mut self, change: &'static str, done: fn(&Self, &State) -> bool) -> Result<(), Failure> {
        let mut begun = None;
        loop {
            let state = self.next()?;
            if done(self, &state) {
                return Ok(());
            }
            if seconds_since(*begun.get_or_insert(state.tick_ns()), &state) > CHANGE_MAX {
                return Err(DemoError::Slow { change, seconds: CHANGE_MAX }.into());
            }
            // From the start on the setpoints stay constant: the motors hold their positions.
            if self.phase(&state) == Some(Phase::Disarmed) {
                self.measure_origins(&state);
            }
            self.send(0.0)?;
        }
    }

    /// Answers every state with the trot.
    fn trot(&mut self, seconds: f64) -> Result<(), Failure> {
        let mut begun = None;
        let mut progress_due = 0.0;
        loop {
            let state = self.next()?;
            let time = seconds_since(*begun.get_or_insert(state.tick_ns()), &state);
            if time >= seconds {
                return Ok(());
            }
            if self.phase(&state) != Some(Phase::Active) {
                let cause = state.group(self.claim.index()).and_then(|group| group.cause);
                return Err(DemoError::Stopped(cause).into());
            }
            self.send(time)?;
            self.track(time, &state);
            if time >= progress_due {
                progress_due += PROGRESS_PERIOD;
                send_message(&ControllerMessage::TrotProgress(self.progress(time, &state)))?;
            }
        }
    }

    fn next(&mut self) -> Result<State, Failure> {
        if self.interrupt.is_raised_again() {
            return Err(Failure::Interrupted);
        }
        Ok(self.client.wait(TIMEOUT)?)
    }

    fn phase(&self, state: &State) -> Option<Phase> {
        state.group(self.claim.index())?.phase
    }

    /// Returns true when the daemon has received setpoints that hold every joint where it is.
    fn is_ready(&self, state: &State) -> bool {
        let group = state.group(self.claim.index());
        self.standing > 0 && group.is_some_and(|group| group.sequence >= self.standing)
    }

    fn measure_origins(&mut self, state: &State) {
        let mut joints = self.claim.joints().iter().map(|&joint| state.joint(joint));
        if self.standing == 0 && joints.all(|joint| joint.is_some_and(|joint| joint.valid)) {
            self.standing = self.sequence + 1;
        }
        for (origin, &joint) in self.origins.iter_mut().zip(self.claim.joints()) {
            *origin = state.joint(joint).and_then(|joint| joint.position()).unwrap_or(*origin);
        }
    }

    fn send(&mut self, time: f64) -> Result<(), Failure> {
        self.setpoints.clear();
        self.setpoints.extend(self.origins.iter().zip(&self.swings).map(|(origin, swing)| {
            let (distance, velocity) = swing.at(time);
            Setpoint::impedance(origin + distance as f32, velocity as f32, KP, KD, 0.0)
        }));
        self.claim.send(&self.setpoints)?;
        self.sequence += 1;
        Ok(())
    }

    /// Compares the measured positions of a cycle with the commands of the same cycle.
    fn track(&mut self, time: f64, state: &State) {
        if time < BLEND {
            return;
        }
        for &index in self.claim.joints() {
            let joint = state.joint(index).filter(|joint| joint.fresh);
            if let Some((joint, position)) = joint.and_then(|joint| Some((joint, joint.position()?))) {
                self.tracking[index].count(position, joint.applied.position);
            }
        }
    }

    fn progress(&self, time: f64, state: &State) -> TrotProgress {
        TrotProgress {
            time,
            cycle: state.cycle(),
            missed: state.joints().map(|joint| u64::from(joint.missed)).sum(),
            tracking_max: self.tracking.iter().map(|tracking| tracking.max).fold(0.0, f64::max),
        }
    }
}

fn seconds_since(begun_ns: u64, state: &State) -> f64 {
    state.tick_ns().saturating_sub(begun_ns) as f64 * 1e-9
}

fn send_message(message: &ControllerMessage) -> Result<(), Failure> {
    let out = &mut io::stdout().lock();
    json::write_line(out, message)?;
    Ok(out.flush()?)
}
