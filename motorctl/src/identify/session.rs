//! The motion of `motorctl identify`: from the claim to the stopped group, with a record of every
//! cycle.

use crate::failure::Failure;
use crate::hold::{Printer, SILENCE, START, Target, disable, owned, refuse_latched};
use crate::identify::failure::IdentifyFailure;
use crate::identify::losses::{Counter, Losses};
use motord_client::{Claim, Client, Error, Joint, JointDescription, Phase, Setpoint, Slot};
use motord_identify::{Applied, Limits, Plan, PlanError, Sample, Shape, Stage};
use motord_terminal::Interrupt;

/// Time between two lines about the progress, s.
const PROGRESS: f64 = 5.0;
/// Damping of the other joints of the group, N·m·s/rad, where their limits permit it.
const DAMPING: f32 = 0.5;
/// Share of the gains before the motor follows. With a stiffness of 0 the daemon would not check
/// the pose.
pub(crate) const FIRST_SHARE: f64 = 0.05;

/// Plans the motion of a joint that is at `position`, rad.
///
/// # Errors
///
/// Its limits leave too little.
pub(crate) fn plan(joint: &JointDescription, position: f64, shape: Shape) -> Result<Plan, Failure> {
    Ok(Plan::new(limits(joint), position, shape).map_err(|reason| refused(joint, reason))?)
}

/// The same motion from `position`, rad.
fn around(plan: &Plan, joint: &JointDescription, position: f32) -> Result<Plan, IdentifyFailure> {
    plan.around(position.into()).map_err(|reason| refused(joint, reason))
}

fn refused(joint: &JointDescription, reason: PlanError) -> IdentifyFailure {
    IdentifyFailure::Plan { joint: joint.name.clone(), reason }
}

/// The bounds of the joint's setpoints.
pub(crate) fn limits(joint: &JointDescription) -> Limits {
    let of = &joint.limits;
    Limits {
        position: of.position.map(f64::from),
        velocity: of.velocity.into(),
        torque: of.torque.into(),
        kp: of.kp.into(),
        kd: of.kd.into(),
    }
}

/// A claimed group of which one joint moves.
pub(crate) struct Session {
    client: Client,
    instance: String,
    claim: Claim,
    slot: Slot,
    joint: JointDescription,
    plan: Plan,
    samples: Vec<Sample>,
    counter: Counter,
    /// Time that the plant of a simulated robot had lost before, µs.
    plant_lost_us: u64,
}

impl Session {
    /// Claims the group, for the motion of `plan` from where the joint is. Nothing moves.
    pub(crate) fn claim(
        client: Client,
        instance: &str,
        target: &Target,
        plan: &Plan,
    ) -> Result<Self, Failure> {
        let claim =
            client.claim(&target.group).map_err(|error| owned(error, &client, instance, &target.group))?;
        let name = target.joint.as_deref().unwrap_or_default();
        let slot = claim.slot(name)?;
        let robot = client.description();
        let joint = robot.joints[client.joint_named(name)?].clone();
        let position = client.wait(SILENCE)?.of(&claim)?.position(slot)?;
        let plan = around(plan, &joint, position)?;
        // Everything that is recorded has its place before the motion.
        let capacity = ((plan.seconds() + 1.0) * robot.rate_hz) as usize;
        let samples = Vec::with_capacity(capacity);
        let instance = instance.to_owned();
        let plant_lost_us = client.telemetry().map_or(0, |telemetry| telemetry.plant_lost_us);
        let counter = Counter::default();
        let mut session =
            Self { client, instance, claim, slot, joint, plan, samples, counter, plant_lost_us };
        damp_others(&session.client, &mut session.claim, name)?;
        session.hold(position)?;
        Ok(session)
    }

    /// Holds the joint softly until its motor follows.
    fn hold(&mut self, position: f32) -> Result<(), Error> {
        let [kp, kd] = self.plan.gains().map(|gain| (FIRST_SHARE * gain) as f32);
        self.claim.set(self.slot, Setpoint::hold(position, kp, kd))
    }

    /// Starts the motors, and plans from where the joint is when its motor begins to follow.
    pub(crate) fn start(&mut self) -> Result<(), Failure> {
        self.claim.commit()?;
        self.claim.enable()?;
        self.claim.wait_for(Phase::Active, START)?;
        let position = self.client.wait(SILENCE)?.of(&self.claim)?.position(self.slot)?;
        self.plan = around(&self.plan, &self.joint, position)?;
        Ok(())
    }

    /// Answers every state with the next setpoint and records it, until the end, a signal, or a
    /// limit.
    pub(crate) fn follow(&mut self, interrupt: &Interrupt, printer: &Printer) -> Result<(), Failure> {
        let (mut begun, mut due) = (None, 0.0);
        loop {
            if interrupt.is_raised() {
                return Err(IdentifyFailure::Interrupted(self.joint.name.clone()).into());
            }
            let state = self.client.wait(SILENCE)?;
            let view = state.of(&self.claim)?;
            view.must_be_active()?;
            let joint = view.joint(self.slot)?;
            let time = (state.time() - *begun.get_or_insert(state.time())).as_secs_f64();
            let Some(stage) = self.plan.stage(time) else { return Ok(()) };
            self.command(time, &joint)?;
            self.counter.record(&state, &joint);
            if joint.fresh && matches!(stage, Stage::Multisine | Stage::Sweeps) && self.is_free() {
                self.samples.push(sample(&joint));
            }
            if time >= due {
                due = (due + PROGRESS).max(time);
                let text = format!("{time:5.0} of {:.0} s  {stage}", self.plan.seconds());
                if !printer.print_text(vec![text]) {
                    return Ok(());
                }
            }
        }
    }

    /// The loop never allocates for what it records.
    fn is_free(&self) -> bool {
        self.samples.len() < self.samples.capacity()
    }

    /// Sends the setpoint of a time, from where the joint is.
    fn command(&mut self, time: f64, joint: &Joint) -> Result<(), Failure> {
        let (position, velocity) = (joint.position(), joint.velocity());
        let (position, velocity) =
            (f64::from(position.unwrap_or(f32::NAN)), f64::from(velocity.unwrap_or(f32::NAN)));
        self.plan.check(position, velocity).map_err(|reason| refused(&self.joint, reason))?;
        if let Some(command) = self.plan.command(time, position, velocity) {
            let [position, velocity, kp, kd] =
                [command.position, command.velocity, command.kp, command.kd].map(|value| value as f32);
            self.claim.set(self.slot, Setpoint::impedance(position, velocity, kp, kd, 0.0))?;
        }
        Ok(self.claim.commit()?)
    }

    /// Damps and stops the motors. A second signal ends the wait; the daemon then stops them
    /// without this program.
    pub(crate) fn stop(&mut self, interrupt: &Interrupt) -> Result<(), Failure> {
        disable(&mut self.claim, interrupt)
    }

    /// The cause of a stop that the daemon has latched.
    pub(crate) fn refuse_latched(&self) -> Result<(), Failure> {
        refuse_latched(&self.client, &self.instance, self.claim.group())
    }

    /// The losses of the motion so far. Asks the daemon.
    pub(crate) fn losses(&self) -> Losses {
        let before = self.plant_lost_us;
        let lost = self.client.telemetry().map_or(0, |after| after.plant_lost_us.saturating_sub(before));
        self.counter.losses(lost as f64 / 1e6)
    }

    /// The recorded samples.
    pub(crate) fn samples(&self) -> &[Sample] {
        &self.samples
    }
}

/// Damps all joints of a claimed group but `joint`, from the next commit on.
///
/// # Errors
///
/// The daemon is silent, or does not report them.
pub(crate) fn damp_others(client: &Client, claim: &mut Claim, joint: &str) -> Result<(), Error> {
    let state = client.wait(SILENCE)?;
    let names: Vec<String> = claim.names().map(str::to_owned).collect();
    for name in names.iter().filter(|name| *name != joint) {
        let excluded = state.of(claim)?.joint(name.as_str())?.is_excluded();
        let kd = DAMPING.min(claim.limits(name.as_str())?.kd);
        let setpoint = if excluded { Setpoint::torque(0.0) } else { Setpoint::damping(kd) };
        claim.set(name.as_str(), setpoint)?;
    }
    Ok(())
}

/// Returns the record of a cycle.
pub(crate) fn sample(joint: &Joint) -> Sample {
    let latency = joint.reply_latency.as_secs_f64();
    let of = &joint.applied;
    Sample {
        time: joint.receive_ns as f64 / 1e9 - latency,
        latency,
        position: joint.position().unwrap_or(f32::NAN).into(),
        torque: joint.torque().unwrap_or(f32::NAN).into(),
        applied: Applied {
            position: of.position.into(),
            velocity: of.velocity.into(),
            kp: of.kp.into(),
            kd: of.kd.into(),
            torque: of.torque.into(),
        },
    }
}
