//! `motorctl zero --bus`: the zero of a motor, on the wire.

use crate::confirm::Confirm;
use crate::failure::DirectFailure;
use crate::output::print_line;
use crate::target::{Protocol, Session, Target};
use motord_protocol::gim::{ConfigurationItem, Indicator, Value};
use std::f64::consts::TAU;

/// Zero and power-off position count a turn of the shaft in so many steps (GIM document 3.2.3).
const TURN: f64 = 65536.0;
/// A new position is as wanted within this, rad.
const TOLERANCE: f64 = 0.02;

/// How to set a zero on the wire.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Arguments {
    /// With --bus or --config: the position that the motor is to report where it stands now, rad.
    #[arg(long, value_name = "RAD", default_value_t = 0.0, value_parser = super::motion::finite, allow_hyphen_values = true)]
    pub at: f64,
    /// With --config: do it even if the joint is outside of its limits afterwards.
    #[arg(long)]
    pub force: bool,
}

/// `motorctl zero --bus`.
pub fn run(target: &Target, arguments: Arguments, confirm: Confirm) -> Result<(), DirectFailure> {
    let Arguments { at, force } = arguments;
    if at.abs() > TAU / 2.0 {
        return Err(DirectFailure::Usage(
            "a motor finds its zero again within half a turn: --at is -3.14 to 3.14".into(),
        ));
    }
    let mut session = target.open()?;
    if session.protocol == Protocol::Mit && at != 0.0 {
        return Err(session.unfit("in MIT the present position can only become 0: leave --at out"));
    }
    let before = position(&mut session)?;
    let range = check_limits(&session, at, force)?;
    let name = session.name();
    confirm.ask(&format!(
        "This permanently stores a new zero in {name}: where it reports {before:.3} rad now, it reports {at:.3} rad then.{range}"
    ))?;
    match session.protocol {
        Protocol::Mit => session.mit().set_zero().map(drop)?,
        Protocol::Gim => move_zero(&mut session, before, at)?,
    }
    let after = position(&mut session)?;
    let off = (after - at + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
    if off.abs() > TOLERANCE {
        let reason = format!(
            "it reports {after:.3} rad afterwards, not {at:.3} rad: do not start it before this is understood"
        );
        return Err(session.unfit(&reason));
    }
    print_line(&format!("{name}: reports {after:.3} rad now"))
}

/// Stops the motor. Returns the position that it reports, rad.
fn position(session: &mut Session) -> Result<f64, DirectFailure> {
    let position = match session.protocol {
        Protocol::Mit => session.mit().stop()?.position,
        Protocol::Gim => {
            let mut motor = session.gim();
            motor.stop()?;
            motor.indicator(Indicator::SHAFT_ANGLE)?
        }
    };
    Ok(f64::from(position))
}

/// Refuses a position outside of the joint's limits, unless `force`. Returns a sentence about the position and the limits.
fn check_limits(session: &Session, at: f64, force: bool) -> Result<String, DirectFailure> {
    let Some(settings) = &session.settings else { return Ok(String::new()) };
    let joint = settings.transmission.position_to_joint(at as f32);
    let [low, high] = settings.limits.position;
    if !(low..=high).contains(&joint) && !force {
        let reason = format!(
            "the joint would be at {joint:.3} rad, outside of its limits {low:.3} to {high:.3} rad: move it first, use --at, or \
             insist with --force"
        );
        return Err(session.unfit(&reason));
    }
    Ok(format!("\nThe joint is at {joint:.3} rad then; its limits are {low:.3} to {high:.3} rad."))
}

/// The stored zero is a place of the encoder within one turn: it moves by as much as the position is to change.
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
