//! `motorctl torque`, `speed`, `position` and `jog`: a motor moves, for a bounded time, within bounds.
//!
//! A torque or speed has a duration of a few periods, which the vendor's sample calls the time that the control lasts, and is sent
//! again in every period. So a motor may end it by itself when this process dies; no document promises that. At the end, at
//! Ctrl-C, and beyond a bound the motor is stopped.

use crate::confirm::Confirm;
use crate::failure::WireFailure;
use crate::say;
use crate::target::{Protocol, Session, Target};
use motord_commissioning::{Error, Native};
use motord_protocol::gim::{ExecutionTime, Finite, Indicator, RPM, State};
use motord_protocol::mit::{self, Impedance};
use motord_terminal::Interrupt;
use std::time::{Duration, Instant};

/// Between two commands.
pub(crate) const PERIOD: Duration = Duration::from_millis(20);
/// The time that a torque or speed command lasts in the motor.
const LASTS: ExecutionTime = ExecutionTime::from_millis(200).expect("fits in 24 bits");

/// The bounds of a motion, and the consent to it.
#[derive(Debug, Clone, clap::Args)]
pub struct Bounds {
    /// How long the motion lasts, s: above 0, up to 60.
    #[arg(long, value_name = "S", value_parser = |text: &str| ranged(text, 0.0, 60.0))]
    seconds: f64,
    /// Stop when the shaft has turned so far from where it began, rad.
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

/// Reads a number that is not NaN or infinite.
pub(crate) fn finite(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "expected a number".to_owned())?;
    if value.is_finite() { Ok(value) } else { Err("expected a finite number".to_owned()) }
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

/// `motorctl torque`, `speed` and `position`.
pub(crate) fn run(target: &Target, goal: Goal, bounds: &Bounds) -> Result<(), WireFailure> {
    if let Goal::Speed(speed) = goal
        && speed.abs() > bounds.max_rad_s
    {
        let usage = format!("a speed of {speed} rad/s is beyond --max-rad-s {}", bounds.max_rad_s);
        return Err(WireFailure::Usage(usage));
    }
    let mut session = target.open_native()?;
    let name = session.name();
    let motor = &mut session.native();
    let moved = follow(motor, &name, goal, bounds);
    let stopped = if matches!(
        moved,
        Err(WireFailure::Unconfirmed { .. } | WireFailure::Declined | WireFailure::Usage(_))
    ) {
        Ok(())
    } else {
        motor.stop()
    };
    let state = moved?;
    stopped?;
    let [position, velocity, torque] = state;
    let torque = if torque.is_nan() { String::new() } else { format!(", {torque:.2} N·m") };
    say(&format!("{name}: stopped; last at {position:.3} rad, {velocity:.2} rad/s{torque}"))
}

fn follow(motor: &mut Native<'_>, name: &str, goal: Goal, bounds: &Bounds) -> Result<[f64; 3], WireFailure> {
    let [constant, ratio] = motor.read_scales()?;
    let begin = f64::from(motor.indicator(Indicator::SHAFT_ANGLE)?);
    if let Goal::Position(position) = goal
        && (position - begin).abs() > bounds.max_travel_rad
    {
        let far = format!(
            "{position} rad is more than --max-travel-rad {} away from {begin:.3} rad",
            bounds.max_travel_rad
        );
        return Err(WireFailure::Usage(far));
    }
    bounds.confirm.ask(&format!(
        "This starts {name} (torque constant {constant} N·m/A, gear ratio {ratio}, at {begin:.3} rad) and commands {} for {} s.\n\
         The shaft turns. Make sure that it is clear, and that nobody is near.",
        goal.describe(),
        bounds.seconds
    ))?;
    let interrupt = Interrupt::register();
    motor.start()?;
    let end = Instant::now() + Duration::from_secs_f64(bounds.seconds);
    let mut state = command(motor, goal, bounds.seconds)?;
    while Instant::now() < end && !interrupt.came() {
        let [position, velocity, _] = state;
        let travel = (position - begin).abs();
        if travel > bounds.max_travel_rad || velocity.abs() > bounds.max_rad_s {
            let reason = format!("stopped at a bound: turned {travel:.3} rad, {:.2} rad/s", velocity.abs());
            return Err(WireFailure::Unfit { id: motor.address().id, reason });
        }
        interrupt.pause_until(Instant::now() + PERIOD);
        state = match goal {
            // Sent again, it would begin anew.
            Goal::Position(_) => observe(motor)?,
            Goal::Torque(_) | Goal::Speed(_) => command(motor, goal, bounds.seconds)?,
        };
    }
    if interrupt.came() { Err(Error::Interrupted.into()) } else { Ok(state) }
}

/// Position, rad, velocity, rad/s, and torque, N·m, from the answer. A position is to be reached in half of the time: whether its
/// duration means that, or how long it is held, is in no document.
fn command(motor: &mut Native<'_>, goal: Goal, seconds: f64) -> Result<[f64; 3], WireFailure> {
    let finite = |value: f64| {
        Finite::new(value as f32)
            .ok_or_else(|| WireFailure::Usage(format!("{value} does not fit into a frame")))
    };
    let half = ExecutionTime::from_millis((seconds * 500.0) as u32).unwrap_or(LASTS);
    let State { position, velocity, torque, .. } = match goal {
        Goal::Torque(torque) => motor.torque(finite(torque)?, LASTS)?,
        Goal::Speed(speed) => motor.speed(finite(speed * f64::from(RPM))?, LASTS)?,
        Goal::Position(position) => motor.position(finite(position)?, half)?,
    };
    Ok([position, velocity, torque].map(f64::from))
}

/// The same three, read without a new command. The torque is not among the indicators.
fn observe(motor: &mut Native<'_>) -> Result<[f64; 3], WireFailure> {
    let position = motor.indicator(Indicator::SHAFT_ANGLE)?;
    let velocity = motor.indicator(Indicator::SHAFT_SPEED)? / RPM;
    Ok([f64::from(position), f64::from(velocity), f64::NAN])
}

/// A motor that is jogged: it follows a slow speed, softly.
pub(crate) struct Jogged<'s> {
    session: &'s mut Session,
    kd: f32,
}

impl<'s> Jogged<'s> {
    /// Starts the motor, at rest. Neutral frames come before the start of a motor in MIT, which may remember one.
    pub(crate) fn start(session: &'s mut Session, kd: f32) -> Result<(Self, f64), Error> {
        let position = match session.protocol {
            Protocol::Mit => {
                let mut motor = session.mit();
                let at = motor.stop()?.position;
                motor.control(Impedance { position: at, ..Impedance::default() })?;
                motor.start()?.position
            }
            Protocol::Gim => {
                let mut motor = session.native();
                motor.read_scales()?;
                let at = motor.indicator(Indicator::SHAFT_ANGLE)?;
                motor.start()?;
                at
            }
        };
        Ok((Self { session, kd }, f64::from(position)))
    }

    /// Follows `velocity`, rad/s. Returns position, rad, and velocity, rad/s.
    pub(crate) fn follow(&mut self, velocity: f64) -> Result<[f64; 2], Error> {
        match self.session.protocol {
            Protocol::Mit => {
                let velocity = velocity as f32;
                let impedance = Impedance { velocity, kd: self.kd, ..Impedance::default() };
                let mit::State { position, velocity, .. } = self.session.mit().control(impedance)?;
                Ok([position, velocity].map(f64::from))
            }
            Protocol::Gim => {
                let speed = Finite::new(velocity as f32 * RPM).unwrap_or_default();
                let State { position, velocity, .. } = self.session.native().speed(speed, LASTS)?;
                Ok([position, velocity].map(f64::from))
            }
        }
    }

    /// The motor's id.
    pub(crate) fn id(&self) -> u8 {
        self.session.id
    }

    /// Stops the motor.
    pub(crate) fn stop(&mut self) -> Result<(), Error> {
        match self.session.protocol {
            Protocol::Mit => self.session.mit().stop().map(drop),
            Protocol::Gim => self.session.native().stop(),
        }
    }
}
