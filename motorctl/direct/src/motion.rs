//! `motorctl torque`, `speed`, `position` and `jog`: motion within bounds and for a bounded time.
//!
//! A torque or speed command has a duration of ten periods and is sent again in every period. So
//! the motor may stop by itself when this process dies; no document promises that. The command
//! stops the motor at the end, at Ctrl-C, beyond a bound and after an error.

use crate::failure::DirectFailure;
use crate::guard::{Stop, StopOnDrop};
use crate::output::{Confirm, print_line};
use crate::target::{Protocol, Session, Target};
use motord_protocol::Scales;
use motord_protocol::commissioning::{Error, Native};
use motord_protocol::gim::{ExecutionTime, Finite, Indicator, RPM, State};
use motord_protocol::mit::{self, Feedback, Impedance};
use motord_terminal::Interrupt;
use std::time::{Duration, Instant};

/// Time between two commands.
pub(crate) const PERIOD: Duration = Duration::from_millis(20);
/// Duration of a torque or speed command in the motor.
const LASTS: ExecutionTime = ExecutionTime::from_millis(200).expect("fits in 24 bits");

/// Distance beyond the limits of the joint at which a motion is stopped, rad.
const BEYOND: f64 = 0.05;

/// The bounds of a motion, and the consent to it.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Bounds {
    /// Duration of the motion, s: above 0, up to 60.
    #[arg(long, value_name = "S", value_parser = |text: &str| ranged(text, 0.0, 60.0))]
    seconds: f64,
    /// Stop when the shaft has turned this far from its start, rad.
    #[arg(long, value_name = "RAD", default_value_t = 0.5, value_parser = |text: &str| ranged(text, 0.0, 100.0))]
    max_travel_rad: f64,
    /// Stop when the shaft is faster, rad/s.
    #[arg(long, value_name = "RAD/S", default_value_t = 5.0, value_parser = |text: &str| ranged(text, 0.0, 65.0))]
    max_rad_s: f64,
    #[command(flatten)]
    confirm: Confirm,
}

/// Reads a number above `least`, up to `most`.
pub(crate) fn ranged(text: &str, least: f64, most: f64) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "expected a number".to_owned())?;
    if value > least && value <= most {
        Ok(value)
    } else {
        Err(format!("expected above {least}, up to {most}"))
    }
}

/// Reads a number that a frame can hold: not NaN or infinite, also in single precision.
pub(crate) fn finite(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "expected a number".to_owned())?;
    if (value as f32).is_finite() { Ok(value) } else { Err("expected a finite number".to_owned()) }
}

/// The goal of a motion, SI.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Goal {
    /// N·m.
    Torque(f64),
    /// rad/s.
    Speed(f64),
    /// rad.
    Position(f64),
}

impl Goal {
    fn describe(self) -> String {
        match self {
            Self::Torque(torque) => format!("a torque of {torque} N·m"),
            Self::Speed(speed) => format!("a speed of {speed} rad/s"),
            Self::Position(position) => format!("the position {position} rad"),
        }
    }
}

/// `motorctl torque`. Rejects a torque above `most`, N·m.
pub(crate) fn torque(target: &Target, torque: f64, most: f64, bounds: &Bounds) -> Result<(), DirectFailure> {
    if torque.abs() > most {
        return Err(DirectFailure::Usage(format!("a torque of {torque} N·m is beyond --max-nm {most}")));
    }
    run(target, Goal::Torque(torque), bounds)
}

/// `motorctl torque`, `speed` and `position`.
pub(crate) fn run(target: &Target, goal: Goal, bounds: &Bounds) -> Result<(), DirectFailure> {
    if let Goal::Speed(speed) = goal
        && speed.abs() > bounds.max_rad_s
    {
        let usage = format!("a speed of {speed} rad/s is beyond --max-rad-s {}", bounds.max_rad_s);
        return Err(DirectFailure::Usage(usage));
    }
    let mut session = target.open_gim()?;
    check_limits(&session, goal)?;
    let (name, allowed) = (session.name(), session.allowed());
    let state = follow(session.gim(), &name, goal, bounds, allowed)?;
    let [position, velocity, torque] = state;
    let torque = if torque.is_nan() { String::new() } else { format!(", {torque:.2} N·m") };
    print_line(&format!("{name}: stopped; last at {position:.3} rad, {velocity:.2} rad/s{torque}"))
}

/// Rejects a goal outside the limits of the joint. Without a configuration there are no limits.
fn check_limits(session: &Session, goal: Goal) -> Result<(), DirectFailure> {
    let Some(limits) = session.settings.as_ref().map(|settings| &settings.limits) else { return Ok(()) };
    let (value, [low, high]) = match goal {
        Goal::Torque(torque) => (torque, [-f64::from(limits.torque), f64::from(limits.torque)]),
        Goal::Speed(speed) => (speed, [-f64::from(limits.velocity), f64::from(limits.velocity)]),
        Goal::Position(position) => (position, session.allowed()),
    };
    if (low..=high).contains(&value) {
        return Ok(());
    }
    let goal = goal.describe();
    Err(DirectFailure::Usage(format!("{goal} is outside of the limits of the joint, {low:.3} to {high:.3}")))
}

impl Bounds {
    /// Describes the bound that `state` exceeds, if there is one, for a motion from `begin` within `allowed`, rad.
    fn exceeded(&self, [position, velocity, _]: [f64; 3], begin: f64, allowed: [f64; 2]) -> Option<String> {
        let (travel, speed) = ((position - begin).abs(), velocity.abs());
        let leaves = !(allowed[0]..=allowed[1]).contains(&position);
        (travel > self.max_travel_rad || speed > self.max_rad_s || leaves).then(|| {
            format!("stopped at a bound: turned {travel:.3} rad, {speed:.2} rad/s, at {position:.3} rad")
        })
    }
}

/// Asks for consent, starts the motor, follows `goal`, and stops it. Returns the last state.
fn follow(
    mut motor: Native<'_>,
    name: &str,
    goal: Goal,
    bounds: &Bounds,
    allowed: [f64; 2],
) -> Result<[f64; 3], DirectFailure> {
    let [constant, ratio] = motor.read_scales()?;
    let begin = f64::from(motor.indicator(Indicator::SHAFT_ANGLE)?);
    if let Goal::Position(position) = goal
        && (position - begin).abs() > bounds.max_travel_rad
    {
        let far = format!(
            "{position} rad is more than --max-travel-rad {} away from {begin:.3} rad",
            bounds.max_travel_rad
        );
        return Err(DirectFailure::Usage(far));
    }
    bounds.confirm.ask(&format!(
        "This starts {name} (torque constant {constant} N·m/A, gear ratio {ratio}, at {begin:.3} rad) and commands {} for {} s.\n\
         The shaft turns. Make sure that it is clear, and that no person is near.",
        goal.describe(),
        bounds.seconds
    ))?;
    // A joint outside its limits may move back into them.
    let allowed = [allowed[0].min(begin) - BEYOND, allowed[1].max(begin) + BEYOND];
    let interrupt = Interrupt::register();
    let mut motor = StopOnDrop::new(motor);
    motor.start()?;
    let end = Instant::now() + Duration::from_secs_f64(bounds.seconds);
    let mut state = command(&mut motor, goal, bounds.seconds)?;
    while Instant::now() < end && !interrupt.is_raised() {
        if let Some(reason) = bounds.exceeded(state, begin, allowed) {
            return Err(DirectFailure::Unfit { id: motor.address().id, reason });
        }
        interrupt.pause_until(Instant::now() + PERIOD);
        state = match goal {
            // A repeated position command would restart its duration.
            Goal::Position(_) => observe(&mut motor)?,
            Goal::Torque(_) | Goal::Speed(_) => command(&mut motor, goal, bounds.seconds)?,
        };
    }
    motor.stop()?;
    if interrupt.is_raised() { Err(Error::Interrupted.into()) } else { Ok(state) }
}

/// Sends the goal. Returns position, rad, velocity, rad/s, and torque, N·m, from the answer. A
/// position command gets half of the time: no document says whether the motor must arrive within it
/// or holds the position for it.
fn command(motor: &mut Native<'_>, goal: Goal, seconds: f64) -> Result<[f64; 3], DirectFailure> {
    let finite = |value: f64| {
        Finite::new(value as f32)
            .ok_or_else(|| DirectFailure::Usage(format!("{value} does not fit into a frame")))
    };
    let half = ExecutionTime::from_millis((seconds * 500.0) as u32).unwrap_or(LASTS);
    let State { position, velocity, torque, .. } = match goal {
        Goal::Torque(torque) => motor.torque(finite(torque)?, LASTS)?,
        Goal::Speed(speed) => motor.speed(finite(speed * f64::from(RPM))?, LASTS)?,
        Goal::Position(position) => motor.position(finite(position)?, half)?,
    };
    Ok([position, velocity, torque].map(f64::from))
}

/// Reads position and velocity without a new command. Torque is not an indicator: NaN.
fn observe(motor: &mut Native<'_>) -> Result<[f64; 3], DirectFailure> {
    let position = motor.indicator(Indicator::SHAFT_ANGLE)?;
    let velocity = motor.indicator(Indicator::SHAFT_SPEED)? / RPM;
    Ok([f64::from(position), f64::from(velocity), f64::NAN])
}

/// A motor that follows a slow speed with low stiffness.
pub(crate) struct Jogged<'s> {
    session: &'s mut Session,
    kd: f32,
    /// Neither velocity nor torque has a code for zero: the nearest one in every frame would move a joint at rest.
    feedback: Feedback,
}

impl<'s> Jogged<'s> {
    /// Wraps the motor of a session. Sends nothing.
    pub(crate) fn new(session: &'s mut Session, kd: f32) -> Self {
        let feedback = Feedback::within([f32::INFINITY; 2], &session.scales());
        Self { session, kd, feedback }
    }

    /// Starts the motor at rest. Returns its position, rad. A motor in MIT mode may remember a
    /// control frame, so it receives a neutral one first. After an error the motor may be running.
    pub(crate) fn start(&mut self) -> Result<f64, Error> {
        let position = match self.session.protocol {
            Protocol::Mit => {
                self.session.read_ends()?;
                let mut motor = self.session.mit();
                let at = motor.stop()?.position;
                motor.control(Impedance { position: at, ..Impedance::default() })?;
                motor.start()?.position
            }
            Protocol::RobStride => {
                let scales = self.session.wide_scales();
                let mut motor = self.session.private();
                let [at, ..] = motor.stop()?.scaled(&scales);
                motor.control([at, 0.0, 0.0, 0.0, 0.0], &scales)?;
                let [at, ..] = motor.start()?.scaled(&scales);
                at
            }
            Protocol::CanSimple => {
                let (ratio, scales) = (self.session.gear_ratio(), self.session.scales());
                let mut motor = self.session.axis();
                motor.stop()?;
                let [at, _] = motor.estimates()?.at_output(ratio);
                motor.start(&scales)?;
                at
            }
            Protocol::MyActuator => {
                let scales = self.session.configured_scales()?;
                let mut motor = self.session.rmd();
                motor.stop()?;
                let [at, ..] = motor.start(&scales)?.scaled(&scales);
                at
            }
            Protocol::ODrive => {
                let reason = "motorctl moves no ODrive, because it does not read the torque that an obstacle would show";
                return Err(Error::Protocol { id: self.session.id, reason });
            }
            Protocol::Gim => {
                let mut motor = self.session.gim();
                motor.read_scales()?;
                let at = motor.indicator(Indicator::SHAFT_ANGLE)?;
                motor.start()?;
                at
            }
        };
        Ok(f64::from(position))
    }

    /// Follows `velocity`, rad/s. Returns position, rad, and velocity, rad/s.
    pub(crate) fn follow(&mut self, velocity: f64) -> Result<[f64; 2], Error> {
        match self.session.protocol {
            Protocol::Mit | Protocol::RobStride | Protocol::CanSimple | Protocol::MyActuator => {
                self.control(&Impedance { velocity: velocity as f32, kd: self.kd, ..Impedance::default() })
            }
            Protocol::Gim | Protocol::ODrive => self.speed(velocity),
        }
        .map(|[position, velocity, _]| [position, velocity])
    }

    /// Pulls to `position`, rad. A motor in MIT mode does so with the stiffness `kp`, N·m/rad, and
    /// holds that position if no further command arrives. A GIM motor follows `velocity`, rad/s,
    /// with any torque. Returns position, rad, velocity, rad/s, and torque, N·m.
    pub(crate) fn pull(&mut self, position: f64, velocity: f64, kp: f32) -> Result<[f64; 3], Error> {
        match self.session.protocol {
            Protocol::Mit | Protocol::RobStride | Protocol::CanSimple | Protocol::MyActuator => {
                let (position, kd) = (position as f32, self.kd);
                self.control(&Impedance { position, kp, kd, ..Impedance::default() })
            }
            Protocol::Gim | Protocol::ODrive => self.speed(velocity),
        }
    }

    /// Commands a speed, rad/s, of a GIM motor. Returns position, rad, velocity, rad/s, and torque, N·m.
    fn speed(&mut self, velocity: f64) -> Result<[f64; 3], Error> {
        let speed = Finite::new(velocity as f32 * RPM).unwrap_or_default();
        let State { position, velocity, torque, .. } = self.session.gim().speed(speed, LASTS)?;
        Ok([position, velocity, torque].map(f64::from))
    }

    /// Commands an impedance. Returns position, rad, velocity, rad/s, and torque, N·m.
    fn control(&mut self, wanted: &Impedance) -> Result<[f64; 3], Error> {
        if self.session.protocol == Protocol::RobStride {
            let scales = self.session.wide_scales();
            let Impedance { position, velocity, kp, kd, torque } = *wanted;
            let state = self.session.private().control([position, velocity, kp, kd, torque], &scales)?;
            return Ok(state.scaled(&scales).map(f64::from));
        }
        if self.session.protocol == Protocol::CanSimple {
            let scales = self.session.scales();
            let sent = nearest(wanted, &mut self.feedback, &scales);
            return Ok(self.session.axis().control(&sent, &scales)?.scaled(&scales).map(f64::from));
        }
        if self.session.protocol == Protocol::MyActuator {
            let scales = self.session.configured_scales()?;
            let sent = nearest(wanted, &mut self.feedback, &scales);
            return Ok(self.session.rmd().control(&sent, &scales)?.scaled(&scales).map(f64::from));
        }
        let scales = self.session.scales();
        let sent = nearest(wanted, &mut self.feedback, &scales);
        let mit::State { position, velocity, torque, .. } = self.session.mit().control(sent)?;
        Ok([position, velocity, torque].map(f64::from))
    }

    /// The motor's protocol.
    pub(crate) fn protocol(&self) -> Protocol {
        self.session.protocol
    }

    /// The motor's id.
    pub(crate) fn id(&self) -> u8 {
        self.session.id
    }
}

/// Returns `wanted` with the velocity and torque of codes, the mean of which is the wanted one.
fn nearest(wanted: &Impedance, feedback: &mut Feedback, scales: &Scales) -> Impedance {
    let [velocity, torque] = feedback.quantise(wanted, scales);
    let (velocity, torque) = (scales.velocity.decode(velocity) as f32, scales.torque.decode(torque) as f32);
    Impedance { velocity, torque, ..*wanted }
}

impl Stop for Jogged<'_> {
    fn stop(&mut self) -> Result<(), Error> {
        self.session.stop()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_bus::{Instant as BusInstant, VirtualClock};
    use motord_protocol::Field;
    use motord_protocol::commissioning::Link;
    use motord_simulator::{BusSettings, Dialect, Mode, MotorSettings, SharedBus, SimulatedBus};

    /// Runs a motion of a simulated motor. Returns its outcome, and the motor's mode afterwards.
    fn run(goal: Goal, bounds: &Bounds) -> (Result<[f64; 3], DirectFailure>, Mode) {
        let knee = MotorSettings {
            name: "knee".into(),
            id: 3,
            host_id: 0x103,
            dialect: Dialect::Gim,
            ..Default::default()
        };
        let bus = SharedBus::new(SimulatedBus::new(BusSettings::default(), vec![knee], 1));
        let mut link = Link::can(bus.clone(), VirtualClock::new(BusInstant::ZERO));
        let everywhere = [f64::NEG_INFINITY, f64::INFINITY];
        let outcome = follow(Native::new(&mut link, 3, None), "knee", goal, bounds, everywhere);
        let mode = bus.lock().motor("knee").unwrap().mode();
        (outcome, mode)
    }

    fn bounds(seconds: f64) -> Bounds {
        let confirm = Confirm { yes: true };
        Bounds { seconds, max_travel_rad: 1e30, max_rad_s: f64::MAX, confirm }
    }

    #[test]
    fn started_motor_is_stopped_after_any_error() {
        // In rpm this speed has no single precision, which is noticed after the start.
        let (outcome, mode) = run(Goal::Speed(1e38), &bounds(1.0));
        assert!(matches!(outcome, Err(DirectFailure::Usage(_))), "{outcome:?}");
        assert_eq!(mode, Mode::Stopped);
    }

    #[test]
    fn motion_beyond_its_bound_ends_stopped() {
        let bounds = Bounds { max_rad_s: 1e-9, ..bounds(5.0) };
        let (outcome, mode) = run(Goal::Torque(1.0), &bounds);
        assert!(matches!(outcome, Err(DirectFailure::Unfit { .. })), "{outcome:?}");
        assert_eq!(mode, Mode::Stopped);
    }

    /// Goal: a jogged joint does not creep while no key is held. Method: the mean of a second of frames to a GIM8108-8.
    #[test]
    fn jogged_joint_at_rest_is_not_pushed() {
        let scales = Scales::by_current(0.125, 8.0).unwrap();
        type Of = fn(&mut Impedance) -> &mut f32;
        let quantities: [(&Field, Of); 2] = [
            (&scales.velocity, |values| &mut values.velocity),
            (&scales.torque, |values| &mut values.torque),
        ];
        for (field, of) in quantities {
            for wanted in [0.0, 0.3, -0.3] {
                let mut feedback = Feedback::within([f32::INFINITY; 2], &scales);
                let mut setpoint = Impedance::default();
                *of(&mut setpoint) = wanted;
                let mut sent = || f64::from(*of(&mut nearest(&setpoint, &mut feedback, &scales)));
                let mean = (0..50).map(|_| field.decode(field.encode(sent()).unwrap())).sum::<f64>() / 50.0;
                assert!((mean - f64::from(wanted)).abs() <= field.step() / 50.0, "{wanted}: {mean}");
            }
        }
    }

    /// The ends of the codes may be another motor's: the configuration has them.
    #[test]
    fn node_is_jogged_by_the_configured_ends() {
        let text = "[[bus]]\nname = 'leg'\ntype = 'socketcan'\ninterface = 'can0'\n[[motor]]\nname = 'knee'\nbus = 'leg'\nid = 3\n\
                    protocol = 'cansimple'\nmodel = 'GIM6010-8'\nposition-end-rad = 25.0\n";
        let loaded = motord_configuration::parse(
            std::path::Path::new("robot.toml"),
            text.as_bytes(),
            &motord_configuration::Machine::here(),
        );
        let configured = loaded.unwrap().settings.motors[0].clone();
        let knee = MotorSettings {
            name: "knee".into(),
            id: 3,
            dialect: Dialect::CanSimple,
            ends: Some([25.0, 65.0, 50.0]),
            ..Default::default()
        };
        let bus = SharedBus::new(SimulatedBus::new(BusSettings::default(), vec![knee], 1));
        let link = Link::can(bus.clone(), VirtualClock::new(BusInstant::ZERO));
        let line = crate::target::OpenLine::simulated(link, None);
        let (protocol, settings) = (Protocol::CanSimple, Some(configured));
        let mut session = Session { line, id: 3, host_id: None, protocol, settings };
        let mut motor = Jogged::new(&mut session, 2.0);
        let begin = motor.start().unwrap();
        let end = begin + 0.5;
        for _ in 0..3000 {
            motor.pull(end, 0.0, 30.0).unwrap();
        }
        let truth = bus.lock().motors()[0].position();
        assert!((truth - end).abs() < 0.02, "{truth} {end}");
    }

    #[test]
    fn finished_motion_ends_stopped() {
        let (outcome, mode) = run(Goal::Speed(0.1), &bounds(0.05));
        assert!(outcome.is_ok(), "{outcome:?}");
        assert_eq!(mode, Mode::Stopped);
    }
}
