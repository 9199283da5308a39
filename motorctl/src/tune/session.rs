//! The motion of `motorctl tune`: a claimed group of which one joint moves.

use crate::failure::Failure;
use crate::hold::{SILENCE, START, Target, disable, owned, refuse_latched};
use crate::identify::losses::Counter;
use crate::identify::session::{FIRST_SHARE, damp_others, sample};
use crate::tune::failure::TuneFailure;
use crate::tune::timing::{Site, Timing};
use motord_client::{Claim, Client, Error, Joint, JointDescription, Limit, Phase, Setpoint, Slot};
use motord_identify::{Command, Gains, Guard, Plan, Sample, Steps};
use motord_terminal::Interrupt;
use std::collections::BTreeSet;
use std::thread::JoinHandle;
use std::time::Duration;

/// Longest time in which a signal is not seen.
const SLICE: Duration = Duration::from_millis(50);
/// Limits whose action makes a response that of the limit.
const SHAPING: [Limit; 6] = [
    Limit::Position,
    Limit::PositionSlew,
    Limit::TotalTorque,
    Limit::Temperature,
    Limit::Overload,
    Limit::StartRamp,
];

/// The states of a motion.
#[derive(Debug, Default)]
pub(crate) struct Recording {
    /// Every answered command.
    pub(crate) samples: Vec<Sample>,
    /// Names of the limits that acted during steps.
    pub(crate) limits: BTreeSet<&'static str>,
    /// Times of the replies.
    pub(crate) timing: Timing,
    /// Reported velocities, rad/s.
    velocities: Vec<f64>,
    counter: Counter,
}

impl Recording {
    fn with_capacity(seconds: f64, rate: f64) -> Self {
        let states = ((seconds + 1.0) * rate) as usize;
        Self {
            samples: Vec::with_capacity(states),
            velocities: Vec::with_capacity(states),
            ..Self::default()
        }
    }

    /// Records a state, if it is a new one.
    fn record(&mut self, joint: &Joint) {
        if self.timing.record(joint) {
            self.samples.push(sample(joint));
            self.velocities.extend(joint.velocity().map(f64::from));
        }
    }

    /// Returns what is lost of a motion of `seconds`, if it is too much.
    pub(crate) fn excess(&self, seconds: f64) -> Option<String> {
        self.counter.losses(0.0).excess(seconds)
    }

    /// Distance of two codes of the velocity, rad/s; 0 where it does not change.
    pub(crate) fn velocity_code(&self) -> f64 {
        let mut velocities = self.velocities.clone();
        velocities.sort_by(f64::total_cmp);
        let steps = velocities.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 1e-5);
        let code = steps.fold(f64::INFINITY, f64::min);
        if code.is_finite() { code } else { 0.0 }
    }
}

/// A claimed group of which one joint moves.
pub(crate) struct Session<'a> {
    client: Client,
    instance: &'a str,
    claim: Claim,
    slot: Slot,
    joint: &'a JointDescription,
    interrupt: &'a Interrupt,
    rate: f64,
    /// Where the joint was when its motor began to follow, rad.
    pub(crate) centre: f64,
}

impl<'a> Session<'a> {
    /// Claims the group of `joint`. Nothing moves.
    pub(crate) fn claim(
        client: Client,
        instance: &'a str,
        target: &Target,
        joint: &'a JointDescription,
        interrupt: &'a Interrupt,
    ) -> Result<Self, Failure> {
        let claim = client.claim(&target.group);
        let mut claim = claim.map_err(|error| owned(error, &client, instance, &target.group))?;
        damp_others(&client, &mut claim, &joint.name)?;
        let (slot, rate) = (claim.slot(&joint.name)?, client.description().rate_hz);
        Ok(Self { client, instance, claim, slot, joint, interrupt, rate, centre: 0.0 })
    }

    fn position(&self) -> Result<f32, Failure> {
        Ok(self.client.wait(SILENCE)?.of(&self.claim)?.position(self.slot)?)
    }

    /// Starts the motors. The joint is held softly where it is, with a share of `gains`.
    pub(crate) fn start(&mut self, gains: Gains) -> Result<(), Failure> {
        let (kp, kd) = (FIRST_SHARE * gains.kp, FIRST_SHARE * gains.kd);
        let soft = Setpoint::hold(self.position()?, kp as f32, kd as f32);
        self.claim.set(self.slot, soft)?;
        self.claim.commit()?;
        self.claim.enable()?;
        self.wait_until_active()?;
        self.centre = self.position()?.into();
        Ok(())
    }

    /// Waits until the motors follow, or a signal ends that.
    fn wait_until_active(&mut self) -> Result<(), Failure> {
        for _ in 0..START.as_millis() / SLICE.as_millis() {
            if self.interrupt.is_raised() {
                return Err(TuneFailure::Interrupted(self.joint.name.clone()).into());
            }
            match self.claim.wait_for(Phase::Active, SLICE) {
                Err(Error::NotReached { .. }) => {}
                outcome => return Ok(outcome?),
            }
        }
        Ok(self.claim.wait_for(Phase::Active, SLICE)?)
    }

    /// Answers each state with the setpoint that `next` returns for it, until there is none.
    fn follow(
        &mut self,
        recording: &mut Recording,
        mut next: impl FnMut(f64, &Joint, &mut Recording) -> Result<Option<Command>, Failure>,
    ) -> Result<(), Failure> {
        let mut begun = None;
        loop {
            if self.interrupt.is_raised() {
                return Err(TuneFailure::Interrupted(self.joint.name.clone()).into());
            }
            let state = self.client.wait(SILENCE)?;
            let view = state.of(&self.claim)?;
            view.must_be_active()?;
            let joint = view.joint(self.slot)?;
            let time = (state.time() - *begun.get_or_insert(state.time())).as_secs_f64();
            recording.counter.record(&state, &joint);
            let Some(command) = next(time, &joint, recording)? else { return Ok(()) };
            let [position, velocity, kp, kd] =
                [command.position, command.velocity, command.kp, command.kd].map(|value| value as f32);
            self.claim.set(self.slot, Setpoint::impedance(position, velocity, kp, kd, 0.0))?;
            self.claim.commit()?;
        }
    }

    /// Moves the joint along the excitation of `plan`, from where it is.
    pub(crate) fn excite(&mut self, plan: &Plan) -> Result<Recording, Failure> {
        let name = &self.joint.name;
        let ended = |reason| TuneFailure::identification(name, reason);
        let plan = plan.around(self.centre).map_err(ended)?;
        let mut recording = Recording::with_capacity(plan.seconds(), self.rate);
        self.follow(&mut recording, |time, joint, recording| {
            let [position, velocity] = measured(joint);
            plan.check(position, velocity).map_err(ended)?;
            recording.record(joint);
            Ok(plan.command(time, position, velocity))
        })?;
        Ok(recording)
    }

    /// Holds the joint until a thread has its result; `None` if it panicked.
    pub(crate) fn hold<T>(&mut self, gains: Gains, thread: JoinHandle<T>) -> Result<Option<T>, Failure> {
        let held = Command { position: self.centre, velocity: 0.0, kp: gains.kp, kd: gains.kd };
        self.follow(&mut Recording::default(), |_, _, _| Ok((!thread.is_finished()).then_some(held)))?;
        Ok(thread.join().ok())
    }

    /// Moves the joint in `steps`. With `is_strict`, a limit of the torque ends the motion.
    pub(crate) fn step(&mut self, steps: &Steps, is_strict: bool) -> Result<Recording, Failure> {
        let mut recording = Recording::with_capacity(steps.duration(), self.rate);
        let (name, site) = (&self.joint.name, Site::of(self.joint));
        let (mut guard, Gains { kp, kd }) =
            (Guard::new(*steps, self.joint.limits.torque.into()), steps.gains);
        self.follow(&mut recording, |time, joint, recording| {
            let [position, _] = measured(joint);
            let swung = |reason| TuneFailure::Swung { joint: name.clone(), reason, kp, kd, site };
            guard.check(time, position).map_err(swung)?;
            if is_strict && joint.limits.contains(Limit::TotalTorque) {
                return Err(TuneFailure::Torque { joint: name.clone(), kp, kd }.into());
            }
            // The hold before the first step belongs to it.
            if time >= steps.begin() - 0.5 * steps.seconds {
                recording.record(joint);
                recording.limits.extend(
                    SHAPING.iter().filter(|limit| joint.limits.contains(**limit)).map(|limit| limit.name()),
                );
            }
            Ok(steps.command(time))
        })?;
        Ok(recording)
    }

    /// Damps and stops the motors. A group that the daemon has stopped is refused with its cause.
    pub(crate) fn stop(&mut self, is_stopped: bool) -> Result<(), Failure> {
        if is_stopped {
            return refuse_latched(&self.client, self.instance, self.claim.group());
        }
        disable(&mut self.claim, self.interrupt)
    }
}

/// Position and velocity; NaN where they are not reported.
fn measured(joint: &Joint) -> [f64; 2] {
    [joint.position(), joint.velocity()].map(|value| value.unwrap_or(f32::NAN).into())
}
