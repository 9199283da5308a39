//! `motorctl hold`: a controller that holds joints where they are, for the first motion of a robot.
//!
//! ```text
//! claim -> enable -> gains rise -> hold, with a sine if one is given -> disable -> stopped
//! ```

pub(crate) mod failure;
mod motion;
mod printer;
mod report;

use crate::advice::{Advice, motorctl};
use crate::failure::Failure;
use crate::hold::failure::HoldFailure;
use crate::hold::motion::Motion;
pub(crate) use crate::hold::printer::Printer;
use crate::hold::report::{HeldJoint, Line, Report};
use motord_client::{
    About, Cause, Claim, Client, Error, JointLimits, Phase, Refusal, RobotDescription, Setpoint, Slot, State,
};
use motord_terminal::{Interrupt, Palette, within};
use std::io;
use std::time::Duration;

/// Time without a state after which the connection counts as lost. Shorter stalls are tolerated.
pub(crate) const SILENCE: Duration = Duration::from_secs(1);
/// Longer than motors take to start: the daemon gives up before.
pub(crate) const START: Duration = Duration::from_secs(60);
/// Longest wait for stopped motors. A configuration holds and damps for at most 30 s each.
const STOP: Duration = Duration::from_secs(60);

/// The options of `motorctl hold`.
#[derive(Debug, clap::Args)]
pub(crate) struct HoldArguments {
    /// Name of a group, or of a joint, whose group is claimed. The default is the only group.
    name: Option<String>,
    /// Stiffness, N·m/rad, 0 to 500. The configuration may limit it.
    #[arg(long, value_name = "KP", default_value_t = 5.0, value_parser = parse_kp)]
    kp: f64,
    /// Damping, N·m·s/rad, 0 to 5. The configuration may limit it.
    #[arg(long, value_name = "KD", default_value_t = 0.5, value_parser = parse_kd)]
    kd: f64,
    /// Amplitude of a sine around the position, rad, 0 to 0.5.
    #[arg(long, value_name = "RAD", default_value_t = 0.0, value_parser = parse_amplitude)]
    amplitude_rad: f64,
    /// Frequency of the sine, Hz, 0.05 to 1.
    #[arg(long, value_name = "HZ", default_value_t = 0.25, value_parser = parse_frequency)]
    frequency_hz: f64,
    /// End after this duration, s, 0.1 to 3600. The default is until Ctrl-C.
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    seconds: Option<f64>,
    /// Lines per second, 0.1 to 100.
    #[arg(long, value_name = "HZ", default_value_t = 1.0, value_parser = crate::watch::parse_hz)]
    hz: f64,
    /// Print one JSON object per line, with the position of each joint.
    #[arg(long)]
    json: bool,
}

fn parse_kp(text: &str) -> Result<f64, String> {
    within(text, 0.0, 500.0)
}

fn parse_kd(text: &str) -> Result<f64, String> {
    within(text, 0.0, 5.0)
}

fn parse_amplitude(text: &str) -> Result<f64, String> {
    within(text, 0.0, 0.5)
}

fn parse_frequency(text: &str) -> Result<f64, String> {
    within(text, 0.05, 1.0)
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    within(text, 0.1, 3600.0)
}

impl HoldArguments {
    fn motion(&self) -> Motion {
        Motion {
            kp: self.kp as f32,
            kd: self.kd as f32,
            amplitude: self.amplitude_rad as f32,
            frequency: self.frequency_hz as f32,
        }
    }
}

/// Holds the joints until the time is over or a signal arrives, then stops their motors.
///
/// # Errors
///
/// Nothing moves: no daemon answers, the name is unknown, the group is owned, stopped or not fit to
/// start, or the sine leaves the limits. Later: the daemon stops the group or ends, or the output
/// cannot be written.
pub(crate) fn run(instance: &str, arguments: &HoldArguments) -> Result<(), Failure> {
    let interrupt = Interrupt::register();
    let client = Client::connect(instance)?;
    client.set_silence(SILENCE);
    let target = Target::find(&client.description(), arguments.name.as_deref())?;
    let mut hold = Hold::claim(client, instance, &target, arguments.motion())?;
    let mut report = Report::new(arguments.json);
    let printer = Printer::start(arguments.json)?;
    let followed = hold.start().and_then(|()| hold.follow(&mut report, arguments, &interrupt, &printer));
    let is_stopped = matches!(followed, Err(Failure::Client(Error::Stopped { .. })));
    let stopped = if is_stopped { Ok(()) } else { disable(&mut hold.claim, &interrupt) };
    let printed = printer.end();
    let out = &mut io::stdout().lock();
    if is_stopped {
        report.summary(out, Palette::of_stdout())?;
        refuse_latched(&hold.client, instance, &target.group)?;
    }
    followed.and(stopped).and(printed)?;
    report.summary(out, Palette::of_stdout())?;
    Ok(report.print_text(out, &format!("{}: stopped, after damping what moves", hold.claim.group()))?)
}

/// The group to claim, and the joints of it to hold.
#[derive(Debug, PartialEq)]
pub(crate) struct Target {
    /// The group.
    pub(crate) group: String,
    /// The joint by name; `None` for all of the group.
    pub(crate) joint: Option<String>,
}

impl Target {
    /// Finds a joint or a group by name.
    ///
    /// # Errors
    ///
    /// There is none of this name, the joint is in no group, or there are several groups and no name.
    pub(crate) fn find(robot: &RobotDescription, name: Option<&str>) -> Result<Self, HoldFailure> {
        let groups = || robot.groups.iter().map(|group| group.name.as_str()).collect::<Vec<_>>().join(", ");
        let Some(name) = name else {
            let [group] = &robot.groups[..] else { return Err(HoldFailure::Ambiguous(groups())) };
            return Ok(Self { group: group.name.clone(), joint: None });
        };
        if robot.groups.iter().any(|group| group.name == name) {
            return Ok(Self { group: name.to_owned(), joint: None });
        }
        let Some(joint) = robot.joints.iter().position(|joint| joint.name == name) else {
            let joints = robot.joints.iter().map(|joint| joint.name.as_str()).collect::<Vec<_>>().join(", ");
            return Err(HoldFailure::Unknown { name: name.to_owned(), groups: groups(), joints });
        };
        let group = robot.groups.iter().find(|group| group.joints.contains(&joint));
        let group = group.ok_or_else(|| HoldFailure::Ungrouped(name.to_owned()))?.name.clone();
        Ok(Self { group, joint: Some(name.to_owned()) })
    }
}

/// A joint that is held.
#[derive(Debug)]
struct Held {
    name: String,
    slot: Slot,
    limits: JointLimits,
    /// Where it was when its motor began to follow, rad.
    centre: f32,
}

/// A claimed group of which some joints are held.
#[derive(Debug)]
struct Hold {
    client: Client,
    claim: Claim,
    held: Vec<Held>,
    motion: Motion,
}

impl Hold {
    /// Claims the group and checks that the motion fits its joints. Nothing moves.
    fn claim(client: Client, instance: &str, target: &Target, motion: Motion) -> Result<Self, Failure> {
        refuse_latched(&client, instance, &target.group)?;
        let claim =
            client.claim(&target.group).map_err(|error| owned(error, &client, instance, &target.group))?;
        let mut hold = Self { client, claim, held: Vec::new(), motion };
        let state = hold.client.wait(SILENCE)?;
        hold.held = hold.joints_of(target, &state, instance)?;
        hold.rest(&state)?;
        hold.set(0.0)?;
        Ok(hold)
    }

    /// Returns the joints to hold, at their positions in `state`.
    fn joints_of(&self, target: &Target, state: &State, instance: &str) -> Result<Vec<Held>, Failure> {
        let view = state.of(&self.claim)?;
        let names: Vec<&str> = self.claim.names().collect();
        let mut held = Vec::with_capacity(names.len());
        for name in
            names.into_iter().filter(|name| target.joint.as_deref().is_none_or(|joint| joint == *name))
        {
            let excluded = view.joint(name)?.is_excluded();
            if excluded && target.joint.is_some() {
                let include = format!("{} include {name}", motorctl(instance));
                return Err(HoldFailure::Excluded { joint: name.to_owned(), include }.into());
            }
            if excluded {
                continue;
            }
            let (limits, centre) = (self.claim.limits(name)?, view.position(name)?);
            self.motion.check(name, centre, &limits)?;
            held.push(Held { name: name.to_owned(), slot: self.claim.slot(name)?, limits, centre });
        }
        Ok(held)
    }

    /// Damps the joints that are not held.
    fn rest(&mut self, state: &State) -> Result<(), Error> {
        let names: Vec<String> = self.claim.names().map(str::to_owned).collect();
        for name in names.iter().filter(|name| self.held.iter().all(|held| held.name != **name)) {
            let excluded = state.of(&self.claim)?.joint(name)?.is_excluded();
            let limits = self.claim.limits(name)?;
            let setpoint = if excluded { Setpoint::torque(0.0) } else { self.motion.rest(&limits) };
            self.claim.set(name, setpoint)?;
        }
        Ok(())
    }

    /// Sets the setpoints of the held joints at `time`, s, after their motors follow.
    fn set(&mut self, time: f64) -> Result<(), Error> {
        for held in &self.held {
            self.claim.set(held.slot, self.motion.setpoint(time, held.centre, &held.limits))?;
        }
        Ok(())
    }

    /// Returns the sentences about which joints are held, and how.
    fn announcement(&self) -> Vec<String> {
        let Motion { kp, kd, amplitude, frequency } = self.motion;
        let (group, others) = (self.claim.group(), self.claim.joints().len() - self.held.len());
        let (held, rest) = match &self.held[..] {
            [held] if others > 0 => {
                (held.name.clone(), format!("; the other {others} joints of {group} are only damped"))
            }
            [_] => (format!("the 1 joint of {group}"), String::new()),
            held => (format!("the {} joints of {group}", held.len()), String::new()),
        };
        let sine =
            if amplitude > 0.0 { format!(", ±{amplitude} rad at {frequency} Hz") } else { String::new() };
        let end = "Ctrl-C damps and stops the motors";
        let first = format!("holds {held} with kp {kp}, kd {kd}{sine}{rest}. {end}.");
        let bounded = self.held.iter().filter_map(|held| {
            let [bound_kp, bound_kd] = self.motion.gains(&held.limits);
            let name = &held.name;
            ([bound_kp, bound_kd] != [kp, kd]).then(|| {
                format!("{name}: the configuration limits the gains to kp {bound_kp}, kd {bound_kd}")
            })
        });
        std::iter::once(first).chain(bounded).collect()
    }

    /// Starts the motors. They hold where they are when they begin to follow.
    fn start(&mut self) -> Result<(), Failure> {
        self.claim.commit()?;
        self.claim.enable()?;
        self.claim.wait_for(Phase::Active, START)?;
        let state = self.client.wait(SILENCE)?;
        let view = state.of(&self.claim)?;
        for held in &mut self.held {
            held.centre = view.position(held.slot)?;
        }
        Ok(())
    }

    /// Answers every state with setpoints, until the time is over, a signal arrives, or the output cannot be written.
    fn follow(
        &mut self,
        report: &mut Report,
        arguments: &HoldArguments,
        interrupt: &Interrupt,
        printer: &Printer,
    ) -> Result<(), Failure> {
        let (mut begun, mut due) = (None, 0.0);
        let mut is_printed = printer.print_text(self.announcement());
        while is_printed && !interrupt.is_raised() {
            let state = self.client.wait(SILENCE)?;
            state.of(&self.claim)?.must_be_active()?;
            let time = (state.time() - *begun.get_or_insert(state.time())).as_secs_f64();
            if arguments.seconds.is_some_and(|seconds| time >= seconds) {
                return Ok(());
            }
            self.set(time)?;
            self.claim.commit()?;
            let joints = self.measured(&state)?;
            report.count(&joints);
            if time >= due {
                due = (due + 1.0 / arguments.hz).max(time);
                is_printed =
                    printer.line(Line { time_s: time, group: self.claim.group().to_owned(), joints });
            }
        }
        Ok(())
    }

    /// Returns the held joints in `state`.
    fn measured(&self, state: &State) -> Result<Vec<HeldJoint>, Error> {
        let view = state.of(&self.claim)?;
        let one = |held: &Held| {
            let joint = view.joint(held.slot)?;
            Ok(HeldJoint {
                name: held.name.clone(),
                goal_rad: self.claim.setpoint(held.slot)?.position,
                position_rad: joint.position(),
                velocity_rad_s: joint.velocity(),
                torque_nm: joint.torque(),
            })
        };
        self.held.iter().map(one).collect()
    }
}

/// Damps and stops the motors of a claimed group. A group whose claim is lost was stopped by the daemon. A second signal ends the wait; the daemon then stops them without this program.
///
/// # Errors
///
/// The daemon refuses, ends, or does not confirm the stop in time.
pub(crate) fn disable(claim: &mut Claim, interrupt: &Interrupt) -> Result<(), Failure> {
    interrupt.is_raised_again();
    match claim.disable() {
        Err(Error::Refused { refusal: Refusal::NotOwner, .. }) => return Ok(()),
        outcome => outcome?,
    }
    for _ in 0..STOP.as_secs() {
        match claim.wait_for(Phase::Disarmed, Duration::from_secs(1)) {
            Err(Error::NotReached { .. }) if !interrupt.is_raised_again() => {}
            outcome => return Ok(outcome?),
        }
    }
    Ok(claim.wait_for(Phase::Disarmed, SILENCE)?)
}

/// Refuses a group whose stop is latched.
///
/// # Errors
///
/// The cause of the stop, and the commands that end it.
pub(crate) fn refuse_latched(client: &Client, instance: &str, group: &str) -> Result<(), Failure> {
    let state = client.wait(SILENCE)?;
    let stopped = state.group(client.group_named(group)?).filter(|group| group.latched);
    let Some(stopped) = stopped else { return Ok(()) };
    let robot = client.description();
    let joint =
        stopped.cause_joint.and_then(|joint| robot.joints.get(joint)).map(|joint| joint.name.as_str());
    let advice = Advice::new(stopped.cause, instance, group, joint, stopped.owned);
    Err(HoldFailure::Stopped {
        group: group.to_owned(),
        cause: stopped.cause.map_or("a cause that this program does not know", Cause::name).to_owned(),
        sentence: stopped.cause.map_or("", Cause::sentence).to_owned(),
        remedy: advice.remedy.into_owned(),
        commands: advice.commands.join("`, `"),
    }
    .into())
}

/// Adds to the refusal of a claim which process owns the group, and how to end that.
pub(crate) fn owned(error: Error, client: &Client, instance: &str, group: &str) -> Failure {
    let Error::Refused { refusal: Refusal::Owned, about, .. } = &error else { return error.into() };
    let About::Process(pid) = about else { return error.into() };
    let telemetry = client.telemetry().unwrap_or_default();
    let owner =
        telemetry.groups.iter().filter_map(|group| group.owner.as_ref()).find(|owner| owner.pid == *pid);
    let program = owner.map_or_else(String::new, |owner| format!(", {}", owner.program));
    let release = format!("{} release {group} --force", motorctl(instance));
    HoldFailure::Owned { group: group.to_owned(), owner: format!(" (pid {pid}{program})"), release }.into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_client::{GroupDescription, JointDescription};

    fn robot(groups: &[(&str, &[usize])]) -> RobotDescription {
        let joints =
            ["hip", "knee", "tail"].map(|name| JointDescription { name: name.into(), ..Default::default() });
        let group = |&(name, joints): &(&str, &[usize])| GroupDescription {
            name: name.into(),
            joints: joints.into(),
        };
        RobotDescription {
            joints: joints.into(),
            groups: groups.iter().map(group).collect(),
            ..Default::default()
        }
    }

    #[test]
    fn joint_is_found_with_its_group() {
        let robot = robot(&[("leg", &[0, 1]), ("arm", &[])]);
        let found = |name| Target::find(&robot, name).map(|target| (target.group, target.joint));
        assert_eq!(found(Some("knee")).unwrap(), ("leg".into(), Some("knee".into())));
        assert_eq!(found(Some("leg")).unwrap(), ("leg".into(), None));
        assert_eq!(
            found(None).unwrap_err().to_string(),
            "the robot has the groups leg, arm: name one of them, or a joint"
        );
        let unknown = found(Some("ankle")).unwrap_err().to_string();
        assert!(unknown.ends_with("The groups are leg, arm; the joints are hip, knee, tail"), "{unknown}");
        assert!(matches!(found(Some("tail")), Err(HoldFailure::Ungrouped(_))));
    }
}
