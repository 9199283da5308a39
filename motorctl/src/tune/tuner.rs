//! The order of the motions of `motorctl tune`, and what is computed between them.

use crate::exit_status::INTERRUPTED;
use crate::failure::Failure;
use crate::hold::Printer;
use crate::identify::session::{FIRST_SHARE, limits};
use crate::tune::arguments::Arguments;
use crate::tune::failure::TuneFailure;
use crate::tune::known::Known;
use crate::tune::report::{Loop, Measured, Report};
use crate::tune::session::{Recording, Session};
use crate::tune::timing::{Site, Timing};
use motord_client::JointDescription;
use motord_identify::{
    Applied, Bound, Bounds, BusTiming, Gains, Limits, Plan, Plant, Proposal, Response, Sample, Shape,
    StepError, Steps, Wanted, identify, propose,
};
use std::thread;

/// Duration of the identification, s.
const IDENTIFY: f64 = 12.0;
/// Gains of the identification, as those of `motorctl identify`.
const SOFT: Gains = Gains { kp: 20.0, kd: 0.3 };
/// Highest bandwidth of the gains for a rotor alone, Hz.
const ROTOR_BANDWIDTH: f64 = 100.0;
/// Least phase margin of given gains, degrees.
const GIVEN_MARGIN: f64 = 10.0;

/// A joint to tune, and what is known of it before it moves.
pub(crate) struct Tuner<'a> {
    arguments: &'a Arguments,
    joint: &'a JointDescription,
    limits: Limits,
    site: Site,
    wire: BusTiming,
    timing: Timing,
    known: Option<Known>,
    /// Gains of the identification.
    soft: Gains,
    /// The identification, where the mechanics are not known.
    plan: Option<Plan>,
}

impl<'a> Tuner<'a> {
    /// Plans the motion of a joint at `position`, rad, whose replies had this `timing`, and checks
    /// that it fits.
    ///
    /// # Errors
    ///
    /// The limits of the joint leave too little, or its mechanics cannot be read.
    pub(crate) fn new(
        arguments: &'a Arguments,
        joint: &'a JointDescription,
        wire: BusTiming,
        position: f64,
        timing: Timing,
    ) -> Result<Self, TuneFailure> {
        let known = arguments.identified.as_deref().map(|path| Known::read(path, &joint.name)).transpose()?;
        let site = Site::of(joint);
        let limits = limits(joint);
        let mut tuner = Self { arguments, joint, limits, site, wire, timing, known, soft: SOFT, plan: None };
        tuner.soft = tuner.soft_gains()?;
        let first = match &known {
            Some(known) => tuner.first(known)?,
            None => arguments.given(&limits).unwrap_or(tuner.soft),
        };
        tuner.check(&arguments.steps(position, tuner.soft, first))?;
        if known.is_none() {
            let Gains { kp, kd } = tuner.soft;
            let plan = Plan::new(limits, position, Shape { amplitude: None, seconds: IDENTIFY, kp, kd });
            tuner.plan = Some(plan.map_err(|reason| TuneFailure::identification(&joint.name, reason))?);
        }
        Ok(tuner)
    }

    /// Gains of the first motion.
    pub(crate) fn soft(&self) -> Gains {
        self.soft
    }

    /// The question before the motion.
    pub(crate) fn warning(&self) -> String {
        let Arguments { step_rad, seconds, repetitions, .. } = self.arguments;
        let runs = if self.arguments.is_tried { 3.0 } else { 1.0 };
        let steps = runs * (1.0 + (1.0 + 4.0 * f64::from(*repetitions)) * seconds);
        let (motion, identification) = self.plan.as_ref().map_or((String::new(), 0.0), |plan| {
            (
                format!("by setpoints of ±{:.2} rad for {:.0} s, then ", plan.amplitude(), plan.seconds()),
                plan.seconds(),
            )
        });
        format!(
            "This moves {} {motion}in steps of ±{step_rad} rad, {:.0} s in all; it may swing to twice that; the other joints of its group are damped. Hang the robot up \
             or free the joint, keep people away, and keep a hand on the switch that cuts the power.",
            self.joint.name,
            steps + identification
        )
    }

    /// Moves the joint, and computes the proposal. `None`: the output cannot be written.
    ///
    /// # Errors
    ///
    /// A signal, a limit or the daemon ended the motion, or the joint is not one that can be tuned.
    pub(crate) fn tune(
        &mut self,
        session: &mut Session<'_>,
        printer: &Printer,
    ) -> Result<Option<Report>, Failure> {
        let name = &self.joint.name;
        let is_read = |text: String| printer.print_text(vec![format!("{name}: {text}")]);
        let steps = |Gains { kp, kd }: Gains| is_read(format!("steps with kp {kp}, kd {kd}"));
        let mut from = Gains { kp: FIRST_SHARE * self.soft.kp, kd: FIRST_SHARE * self.soft.kd };
        if let Some(plan) = self.plan.take() {
            if !is_read(format!("moves for {:.0} s to be identified", plan.seconds())) {
                return Ok(None);
            }
            self.known = Some(self.identified(session, &plan)?);
            from = self.soft;
        }
        let known = self.known.ok_or_else(|| self.unknown(String::new()))?;
        let gains = self.first(&known)?;
        if !self.bounded(gains).is_none_or(is_read) || !steps(gains) {
            return Ok(None);
        }
        let (recording, before) = self.stepped(session, from, gains, false)?;
        self.timing = recording.timing;
        let plant = self.plant(&known)?;
        let bounds = Bounds { velocity_code: self.site.damped(recording.velocity_code), ..self.bounds() };
        let proposal = self.propose(&plant, self.arguments.bandwidth, &bounds)?;
        let found = Loop { site: self.site, known, plant, bounds };
        let report = |after| Report::new(self.joint, self.arguments.wanted(), found, proposal, before, after);
        if !self.arguments.is_tried {
            return Ok(Some(report(None)));
        }
        let half = self.half(&plant, &proposal, &bounds)?.gains;
        match self.tried(session, [gains, half, proposal.gains], steps) {
            Ok(after) => Ok(after.map(|after| report(Some(after)))),
            Err(Failure::Command(failure)) if failure.status() != INTERRUPTED => {
                Ok(Some(report(None).untried(failure)))
            }
            Err(failure) => Err(failure),
        }
    }

    /// Steps with the gains of half the bandwidth, then with the proposed ones, after the first
    /// ones. `None`: the output cannot be written.
    fn tried(
        &self,
        session: &mut Session<'_>,
        [first, half, full]: [Gains; 3],
        announce: impl Fn(Gains) -> bool,
    ) -> Result<Option<Measured>, Failure> {
        for gains in [half, full] {
            let joint = || self.joint.name.clone();
            let steps = self.arguments.steps(session.centre, first, gains);
            self.fit(&steps).map_err(|reason| TuneFailure::Untried { joint: joint(), reason })?;
        }
        if !announce(half) {
            return Ok(None);
        }
        self.stepped(session, first, half, true)?;
        if !announce(full) {
            return Ok(None);
        }
        Ok(Some(self.stepped(session, half, full, true)?.1))
    }

    /// The sentence about given gains that the limits make `gains`.
    fn bounded(&self, gains: Gains) -> Option<String> {
        let given = self.arguments.kp.zip(self.arguments.kd);
        let Gains { kp, kd } = gains;
        let is_bounded = given.is_some_and(|given| given != (kp, kd));
        is_bounded.then(|| format!("the configuration limits the gains to kp {kp}, kd {kd}"))
    }

    /// Steps the joint with `gains`.
    fn stepped(
        &self,
        session: &mut Session<'_>,
        from: Gains,
        gains: Gains,
        is_strict: bool,
    ) -> Result<(Recorded, Measured), Failure> {
        let steps = self.arguments.steps(session.centre, from, gains);
        self.check(&steps)?;
        let recording = session.step(&steps, is_strict)?;
        self.must_be_complete(&recording, steps.duration())?;
        // The daemon stops a group whose setpoints are missing while they are evaluated.
        let evaluation = thread::spawn(move || evaluated(recording, gains));
        let evaluated = session.hold(gains, evaluation)?.flatten();
        Ok(evaluated.ok_or_else(|| self.lost("its states show no whole step"))?)
    }

    /// Moves the joint along `plan`, and holds it while another thread computes.
    fn identified(&mut self, session: &mut Session<'_>, plan: &Plan) -> Result<Known, Failure> {
        let recording = session.excite(plan)?;
        self.must_be_complete(&recording, plan.seconds())?;
        self.timing.clone_from(&recording.timing);
        let (samples, wire) = (self.by_torque(recording), self.wire);
        let fit = thread::spawn(move || identify(&samples, wire));
        let found = session.hold(self.soft, fit)?.ok_or_else(|| self.unknown(String::new()))?;
        Ok(Known::found(&found, &self.joint.name)?)
    }

    /// The samples for the fit. A native motor applies a torque that the cycle computed, and has no
    /// gains.
    fn by_torque(&self, recording: Recording) -> Vec<Sample> {
        let mut samples = recording.samples;
        if self.site == Site::Cycle {
            samples
                .iter_mut()
                .for_each(|sample| sample.applied = Applied { torque: sample.torque, ..Applied::default() });
        }
        samples
    }

    /// The gains of the first steps: the given ones, or those of half the possible bandwidth.
    fn first(&self, known: &Known) -> Result<Gains, TuneFailure> {
        let plant = self.plant(known)?;
        let Some(given) = self.arguments.given(&self.limits) else {
            let full = self.propose(&plant, self.arguments.bandwidth, &self.bounds())?;
            return Ok(self.half(&plant, &full, &self.bounds())?.gains);
        };
        let degrees = plant.margins(given).phase.to_degrees();
        let Gains { kp, kd } = given;
        let (joint, least) = (self.joint.name.clone(), GIVEN_MARGIN);
        // A margin that is not a number is none.
        if (least..).contains(&degrees) {
            return Ok(given);
        }
        let advice = steadier(&plant, kd);
        Err(TuneFailure::Margin { joint, kp, kd, degrees, least, advice })
    }

    /// Gains that suit the joint whatever its load: for a loop in the cycle those of its rotor alone.
    fn soft_gains(&self) -> Result<Gains, TuneFailure> {
        let Gains { kp, kd } = self.bounds().gains;
        if self.site == Site::Drive {
            return Ok(Gains { kp: kp.min(SOFT.kp), kd: kd.min(SOFT.kd) });
        }
        let least =
            self.known.map(|known| known.inertia).or_else(|| motord_twin::armature(&self.joint.model));
        let inertia = least.ok_or_else(|| self.unknown(String::new()))?;
        let lag = self.known.map_or(0.0, |known| known.lag);
        let plant = self.plant(&Known { inertia, viscous: 0.0, lag, is_read: false })?;
        let bounds = Bounds { gains: Gains { kp: kp.min(SOFT.kp), kd }, ..self.bounds() };
        let wanted = Wanted { bandwidth: ROTOR_BANDWIDTH, damping_ratio: 1.0 };
        Ok(propose(&plant, wanted, &bounds).map_err(|bound| self.forbidden(bound))?.gains)
    }

    /// The proposal for half the bandwidth of `full`, which a bound may have lowered.
    fn half(&self, plant: &Plant, full: &Proposal, bounds: &Bounds) -> Result<Proposal, TuneFailure> {
        self.propose(plant, 0.5 * full.bandwidth, bounds)
    }

    /// The proposal for at most this bandwidth, Hz.
    fn propose(&self, plant: &Plant, bandwidth: f64, bounds: &Bounds) -> Result<Proposal, TuneFailure> {
        let wanted = Wanted { bandwidth, ..self.arguments.wanted() };
        propose(plant, wanted, bounds).map_err(|bound| self.forbidden(bound))
    }

    fn plant(&self, known: &Known) -> Result<Plant, TuneFailure> {
        let delay = self.timing.delay(self.site);
        let delay = delay.ok_or_else(|| TuneFailure::silent(&self.joint.name))? + known.lag;
        Ok(Plant { inertia: known.inertia, viscous: known.viscous, delay })
    }

    fn bounds(&self) -> Bounds {
        let Limits { torque, kp, kd, .. } = self.limits;
        Bounds { gains: Gains { kp, kd }, torque, velocity_code: 0.0 }
    }

    fn check(&self, steps: &Steps) -> Result<(), TuneFailure> {
        self.fit(steps).map_err(|reason| TuneFailure::Steps { joint: self.joint.name.clone(), reason })
    }

    /// Checks that steps fit the limits. The speed is checked once the inertia is known.
    fn fit(&self, steps: &Steps) -> Result<(), StepError> {
        steps.check(&self.limits, self.known.map(|known| known.inertia))
    }

    fn must_be_complete(&self, recording: &Recording, seconds: f64) -> Result<(), TuneFailure> {
        recording.excess(seconds).map_or(Ok(()), |reason| Err(self.lost(&reason)))
    }

    fn lost(&self, reason: &str) -> TuneFailure {
        TuneFailure::Lost { joint: self.joint.name.clone(), reason: reason.to_owned() }
    }

    fn forbidden(&self, bound: Option<Bound>) -> TuneFailure {
        let Gains { kp, kd } = self.bounds().gains;
        let reason = match bound {
            Some(Bound::Kp) => format!("`kp-max` or the motor permits kp {kp}"),
            Some(Bound::Kd) => format!("`kd-max` or the motor permits kd {kd}"),
            Some(Bound::Delay) => "the delay of its loop leaves too little phase margin".to_owned(),
            Some(Bound::Noise) => "a code of its velocity is noise of the torque".to_owned(),
            None => "no stiffness suits its inertia".to_owned(),
        };
        TuneFailure::Forbidden { joint: self.joint.name.clone(), reason }
    }

    fn unknown(&self, why: String) -> TuneFailure {
        TuneFailure::Inertia { joint: self.joint.name.clone(), why }
    }
}

/// Gains with more margin than those with the damping `kd`: more damping helps up to a bound, which
/// the delay sets.
fn steadier(plant: &Plant, kd: f64) -> String {
    let most = plant.inertia / (2.0 * plant.delay);
    if kd > most {
        format!("a lower --kd, below {most:.3} (inertia by twice the delay)")
    } else {
        format!("a lower --kp, or a larger --kd below {most:.3} (inertia by twice the delay)")
    }
}

/// The response to steps with `gains`; `None` without a whole step. Takes milliseconds: it sorts the states.
fn evaluated(recording: Recording, gains: Gains) -> Option<(Recorded, Measured)> {
    let response = Response::of(&recording.samples, recording.timing.turn().unwrap_or(0.0))?;
    let measured = Measured::new(gains, response, &recording.limits);
    let velocity_code = recording.velocity_code();
    Some((Recorded { timing: recording.timing, velocity_code }, measured))
}

/// Properties of the loop that the steps show.
struct Recorded {
    timing: Timing,
    velocity_code: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_follows_cause_of_small_margin() {
        let plant = Plant { inertia: 0.03, viscous: 0.0, delay: 5e-3 };
        let damped = Gains { kp: 5.0, kd: 10.0 };
        assert!(plant.margins(damped).phase < 0.0);
        assert_eq!(steadier(&plant, damped.kd), "a lower --kd, below 3.000 (inertia by twice the delay)");
        assert!(plant.margins(Gains { kd: 2.9, ..damped }).phase > 0.5);
        assert!(steadier(&plant, 0.1).starts_with("a lower --kp, or a larger --kd below 3.000"));
    }
}
