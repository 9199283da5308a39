//! `motorctl zero --bus`: sets the zero of a motor without a daemon.

use crate::failure::DirectFailure;
use crate::output::{Confirm, print_line};
use crate::target::{Protocol, Session, Target};
use motord_protocol::gim::{ConfigurationItem, Indicator, Value};
use std::f64::consts::TAU;

/// Steps per turn of the shaft, in zero and power-off position (GIM document 3.2.3).
const TURN: f64 = 65536.0;
/// Largest error of the new position, rad.
pub(crate) const TOLERANCE: f64 = 0.02;

/// The options of `motorctl zero` on a bus.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Arguments {
    /// With --bus or --config: the position to report for the present pose, rad.
    #[arg(long, value_name = "RAD", default_value_t = 0.0, value_parser = super::motion::finite, allow_hyphen_values = true)]
    pub at: f64,
    /// With --config: set the zero even if the joint is outside its limits afterwards.
    #[arg(long)]
    pub force: bool,
}

/// `motorctl zero --bus`.
pub fn run(target: &Target, arguments: Arguments, confirm: Confirm) -> Result<(), DirectFailure> {
    let Arguments { at, force } = arguments;
    if at.abs() > TAU / 2.0 {
        return Err(DirectFailure::Usage(
            "a motor restores its zero within half a turn: --at is -3.14 to 3.14".into(),
        ));
    }
    let mut session = target.open()?;
    if session.protocol != Protocol::Gim && at != 0.0 {
        return Err(session.unfit("with its protocol the present position can only become 0: leave --at out"));
    }
    let before = position(&mut session)?;
    let range = check_limits(&session, at, force)?;
    let name = session.name();
    let stores = if session.protocol == Protocol::ODrive { "sets" } else { "permanently stores" };
    confirm.ask(&format!(
        "This {stores} a new zero in {name}: it will report {at:.3} rad where it reports {before:.3} rad now.{range}"
    ))?;
    let after = set(&mut session, at)?;
    print_line(&format!("{name}: reports {after:.3} rad now"))?;
    note(session.protocol).map_or(Ok(()), print_line)
}

/// Returns what a person must know about the new zero, in words.
pub(crate) const fn note(protocol: Protocol) -> Option<&'static str> {
    match protocol {
        Protocol::CanSimple => Some(POWER_CYCLE),
        Protocol::MyActuator => Some(RESTARTED),
        Protocol::ODrive => Some(UNTIL_POWER_OFF),
        Protocol::Mit | Protocol::Gim | Protocol::RobStride => None,
    }
}

/// The zero of a CANSimple driver after a loss of power. Source: five motors that a user measured.
const POWER_CYCLE: &str = "After a power cycle its zero may differ by 6.4° (0.11 rad) at the output shaft. Power it off and on in a known \
     pose, and compare the position, before each use";

/// The zero of a MyActuator motor. Source: protocol document V4.2, command 0x64.
const RESTARTED: &str = "It was restarted (0x76): the zero acts after a restart only";

/// The zero of an ODrive. Source: its manual, Set_Absolute_Position.
const UNTIL_POWER_OFF: &str =
    "It is lost with the power: for a lasting zero, set up an absolute encoder with odrivetool";

/// Makes the motor report `at`, rad, in its present pose; 0 in MIT mode. Returns the position that it
/// then reports, rad.
///
/// # Errors
///
/// The motor does not answer, or reports another position.
pub(crate) fn set(session: &mut Session, at: f64) -> Result<f64, DirectFailure> {
    let before = position(session)?;
    match session.protocol {
        Protocol::Mit => session.mit().set_zero().map(drop)?,
        Protocol::Gim => move_zero(session, before, at)?,
        Protocol::RobStride => session.private().set_zero().map(drop)?,
        Protocol::CanSimple => session.axis().set_zero().map(drop)?,
        Protocol::MyActuator => session.rmd().set_zero().map(drop)?,
        Protocol::ODrive => session.odrive().set_zero()?,
    }
    let after = position(session)?;
    if off_by(after, at) <= TOLERANCE {
        return Ok(after);
    }
    let reason = format!(
        "it reports {after:.3} rad after its zero was set, not {at:.3} rad: hold it still, and set its zero again"
    );
    Err(session.unfit(&reason))
}

/// Stops the motor. Returns the position that it reports, rad.
pub(crate) fn position(session: &mut Session) -> Result<f64, DirectFailure> {
    let position = match session.protocol {
        Protocol::Mit => session.mit().stop()?.position,
        Protocol::RobStride => {
            let scales = session.wide_scales();
            let [position, ..] = session.private().stop()?.scaled(&scales);
            position
        }
        Protocol::CanSimple => {
            let ratio = session.gear_ratio();
            let mut motor = session.axis();
            motor.stop()?;
            let [position, _] = motor.estimates()?.at_output(ratio);
            position
        }
        Protocol::MyActuator => {
            session.rmd().stop()?;
            session.rmd().angle()?
        }
        Protocol::ODrive => {
            session.odrive().stop()?;
            let [position, _] = session.odrive().estimates()?;
            position
        }
        Protocol::Gim => {
            let mut motor = session.gim();
            motor.stop()?;
            motor.indicator(Indicator::SHAFT_ANGLE)?
        }
    };
    Ok(f64::from(position))
}

/// Returns how far a position, rad, is from `at`, rad, in whichever turn the motor reports it.
pub(crate) fn off_by(position: f64, at: f64) -> f64 {
    ((position - at + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0).abs()
}

/// Rejects a position outside the joint's limits, unless `force`. Returns a sentence about the
/// position and the limits.
fn check_limits(session: &Session, at: f64, force: bool) -> Result<String, DirectFailure> {
    let Some(settings) = &session.settings else { return Ok(String::new()) };
    let joint = settings.transmission.position_to_joint(at as f32);
    let [low, high] = settings.limits.position;
    if !(low..=high).contains(&joint) && !force {
        let reason = format!(
            "the joint would be at {joint:.3} rad, outside of its limits {low:.3} to {high:.3} rad: move it first, use --at, or use --force"
        );
        return Err(session.unfit(&reason));
    }
    Ok(format!("\nThe joint will be at {joint:.3} rad; its limits are {low:.3} to {high:.3} rad."))
}

/// Stores a new zero, which is an encoder position within one turn.
fn move_zero(session: &mut Session, before: f64, at: f64) -> Result<(), DirectFailure> {
    let id = session.id;
    let mut motor = session.gim();
    let key = ConfigurationItem::ZERO_POSITION;
    let (Value::Integer(old), Some(item)) = (motor.configuration(key)?, key.item()) else {
        return Err(DirectFailure::Unfit { id, reason: "its zero position is no integer".to_owned() });
    };
    let steps = ((before - at) * TURN / TAU).round();
    let zero = (f64::from(old & 0xFFFF) + steps).rem_euclid(TURN) as i32;
    motor.store_configuration(item, Value::Integer(zero))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_counts_in_any_turn() {
        assert!(off_by(TAU + 0.01, 0.0) < TOLERANCE && off_by(-TAU, 0.0) < TOLERANCE);
        assert!(off_by(TAU / 2.0, 0.0) > TOLERANCE);
    }
}
