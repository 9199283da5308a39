//! Reads and writes the values of one motor that is set up: for the guide and for `motorctl replace`.

use crate::address::{self, BAUD, CAN_ID, HOST_ID, PROTOCOL};
use crate::failure::DirectFailure;
use crate::target::{Protocol, Session};
use motord_bus::FrameId;
use motord_protocol::Faults;
use motord_protocol::commissioning::{
    Apply, Axis, Change, Error, Failed, Family, Found, Link, LinkEvent, Native, Private, Registers, Rmd,
    Wire, changes, identify, is_taken,
};
use motord_protocol::gim::{Command, ConfigurationItem, Indicator, Value};
use motord_protocol::profile::STEADYWIN;
use motord_protocol::register;
use motord_protocol::robstride::parameter;
use motord_settings::settings::MotorSettings;
use motord_shared::Fault;
use std::convert::Infallible;
use std::ops::RangeInclusive;

/// Supplies that a motor may have, V. Beyond them the wiring is wrong, or the firmware has another
/// unit.
const VOLTAGES: RangeInclusive<f32> = 8.0..=70.0;
/// Temperatures at which a motor may be set up, °C.
const TEMPERATURES: RangeInclusive<f32> = -20.0..=70.0;

/// The state that a motor reports.
pub(crate) struct Health {
    /// Its version, in the vendor's notation, where the motor reports it.
    pub(crate) firmware: Option<String>,
    /// Supply, V, where the motor reports it.
    pub(crate) voltage: Option<f32>,
    /// The highest temperature, °C, where the motor reports one.
    pub(crate) temperature: Option<f32>,
    faults: Faults,
}

impl Health {
    /// Stops the motor, and reads its state.
    ///
    /// # Errors
    ///
    /// The motor does not answer.
    pub(crate) fn read(session: &mut Session) -> Result<Self, Error> {
        match session.protocol {
            Protocol::Gim => Self::native(&mut session.gim()),
            Protocol::RobStride => Self::private(&mut session.private()),
            Protocol::CanSimple => Self::axis(&mut session.axis()),
            Protocol::MyActuator => Self::rmd(&mut session.rmd()),
            Protocol::ODrive => {
                session.odrive().stop()?;
                let faults = session.odrive().fault()?;
                Ok(Self { firmware: None, voltage: None, temperature: None, faults })
            }
            Protocol::Mit => {
                let state = session.mit().stop()?;
                let faults = session.mit().fault()?;
                Ok(Self { firmware: None, voltage: None, temperature: highest(state.temperatures), faults })
            }
        }
    }

    fn native(motor: &mut Native<'_>) -> Result<Self, Error> {
        let faults = motor.fault()?.faults();
        if !faults.is_none() {
            return Ok(Self { firmware: None, voltage: None, temperature: None, faults });
        }
        let firmware = Some(format!("{:#010X}", motor.version()?));
        let mut value = |name| Indicator::by_name(name).map(|row| motor.indicator(row.id)).transpose();
        let (voltage, board, winding) =
            (value("bus-voltage")?, value("board-temperature")?, value("motor-temperature")?);
        Ok(Self { firmware, voltage, temperature: highest([board, winding]), faults })
    }

    fn private(motor: &mut Private<'_>) -> Result<Self, Error> {
        let temperature = Some(motor.stop()?.celsius());
        let faults = motor.fault()?;
        let firmware = motor.version()?.map(|[a, b, c, d]| format!("{a}.{b}.{c}.{d}"));
        let voltage = motor.read(parameter::SUPPLY_VOLTAGE)?.map(f32::from_le_bytes);
        Ok(Self { firmware, voltage, temperature, faults })
    }

    fn axis(motor: &mut Axis<'_>) -> Result<Self, Error> {
        motor.stop()?;
        let faults = motor.fault()?;
        let voltage = motor.supply()?.map(|[volts, _]| volts);
        Ok(Self { firmware: None, voltage, temperature: None, faults })
    }

    fn rmd(motor: &mut Rmd<'_>) -> Result<Self, Error> {
        motor.stop()?;
        let status = motor.status()?;
        let firmware = match motor.version() {
            Ok(date) => Some(format!("of {date}")),
            Err(Error::Silent { .. }) => None,
            Err(error) => return Err(error),
        };
        let voltage = Some(status.volts());
        Ok(Self { firmware, voltage, temperature: Some(status.celsius.into()), faults: status.faults() })
    }

    /// Describes it in words.
    pub(crate) fn describe(&self) -> String {
        let firmware =
            self.firmware.as_ref().map_or_else(String::new, |version| format!("firmware {version}, "));
        let voltage = self.voltage.map_or("supply not reported".to_owned(), |volts| format!("{volts:.1} V"));
        let temperature = self
            .temperature
            .map_or("temperature not reported".to_owned(), |celsius| format!("{celsius:.0} °C"));
        format!("{firmware}{voltage}, {temperature}")
    }

    /// Returns what must be cured before the motor is set up, in words.
    pub(crate) fn problem(&self) -> Option<String> {
        if !self.faults.is_none() {
            let named =
                Fault::of_bits(self.faults.0).map(|fault| format!("{}: {}", fault.name(), fault.sentence()));
            return Some(format!("it reports a fault: {}", named.collect::<Vec<_>>().join("; ")));
        }
        let is_beyond = |value: &f32, range: &RangeInclusive<f32>| !range.contains(value);
        if let Some(volts) = self.voltage.filter(|volts| is_beyond(volts, &VOLTAGES)) {
            return Some(format!(
                "its supply reads {volts:.1} V, not 8 V to 70 V: check the supply and its wires"
            ));
        }
        let celsius = self.temperature.filter(|celsius| is_beyond(celsius, &TEMPERATURES))?;
        Some(format!(
            "its temperature reads {celsius:.0} °C, not -20 °C to 70 °C: let it cool, or check its sensor"
        ))
    }
}

fn highest(temperatures: [Option<f32>; 2]) -> Option<f32> {
    temperatures.into_iter().flatten().reduce(f32::max)
}

/// Clears the fault of a motor. It returns while its cause remains.
pub(crate) fn clear_fault(session: &mut Session) -> Result<(), Error> {
    match session.protocol {
        Protocol::Gim => session.gim().acknowledge_fault(),
        Protocol::Mit => session.mit().clear_fault(),
        Protocol::RobStride => session.private().clear_fault(),
        Protocol::CanSimple => session.axis().clear_fault(),
        Protocol::MyActuator => session.rmd().clear_fault(),
        Protocol::ODrive => session.odrive().clear_fault(),
    }
}

/// Gives the motor another id and host id, and reads them back. The session follows it.
///
/// # Errors
///
/// Another motor has the former or the new id, the motor does not keep it, or its protocol has no
/// such command.
pub(crate) fn set_address(session: &mut Session, id: u8, host_id: FrameId) -> Result<(), DirectFailure> {
    must_be_alone(session)?;
    if session.protocol.has_one_id() {
        address::change_id(session, id)?;
        session.id = id;
        return Ok(());
    }
    let has_registers = session.settings.as_ref().is_some_and(|motor| motor.profile.has_registers);
    match (session.protocol, session.host_id) {
        (Protocol::Gim, _) => {
            let raw = i32::try_from(host_id.raw()).unwrap_or(i32::MAX);
            write(session, &[(CAN_ID, id.into()), (HOST_ID, raw)])?;
        }
        (Protocol::Mit, Some(before)) if has_registers => {
            must_be_free(session, id, host_id)?;
            Registers::new(&mut session.line.link, session.id, before).set_address(id, host_id)?;
        }
        _ => {
            let reason = format!(
                "its id cannot be changed over CAN in MIT mode: set id {id} and host id {:#05X} with the vendor's tool",
                host_id.raw()
            );
            return Err(session.unfit(&reason));
        }
    }
    (session.id, session.host_id) = (id, Some(host_id));
    Ok(())
}

/// The vendor of a motor whose answers show only that it is in MIT mode and has no registers.
const UNNAMED: &str = "another vendor";

/// Returns the name of its vendor's profile, as far as its answers show it. Asks a motor in MIT mode
/// for a register: Damiao's have registers.
///
/// # Errors
///
/// The bus accepts no frame.
pub(crate) fn vendor(link: &mut Link, found: &Found) -> Result<&'static str, Error> {
    // A damaged answer on a serial line looks like one of MIT, which no motor speaks there.
    let (Family::OtherMit { .. }, Some(host_id), Wire::Can) = (found.family, found.host_id, link.wire())
    else {
        return Ok(match found.family {
            Family::RobStride { .. } => "robstride",
            Family::MyActuator => "myactuator",
            Family::Unknown { .. } => "unknown",
            _ => "steadywin",
        });
    };
    let has_registers = Registers::new(link, found.id, host_id).read(register::ID)?.is_some();
    Ok(if has_registers { "damiao" } else { UNNAMED })
}

/// Returns why a motor of this vendor and family cannot be that of `joint`, in words.
pub(crate) fn mismatch(vendor: &str, family: Family, joint: &MotorSettings) -> Option<String> {
    let MotorSettings { name, model, profile, protocol, .. } = joint;
    let may_be_unnamed = !profile.has_registers && profile.name != STEADYWIN.name;
    if vendor != profile.name && !(vendor == UNNAMED && may_be_unnamed) {
        return Some(format!(
            "{name} has the model {model} ({}) in the configuration, and this motor answers like one of {vendor}: take another joint, or \
             correct the model",
            profile.name
        ));
    }
    let (spoken, wanted) = (Protocol::of(family).name(), protocol.name());
    let changes_to_mit = family == Family::Native && wanted == Protocol::Mit.name();
    if spoken == wanted || changes_to_mit {
        return None;
    }
    let remedy = match wanted == Protocol::Gim.name() {
        true => "only its serial port can change that",
        false => {
            "`motorctl protocol` changes it in motors that know both; otherwise take another motor, or correct the configuration"
        }
    };
    Some(format!(
        "{name} has the protocol {wanted} in the configuration, and this motor speaks {spoken}: {remedy}"
    ))
}

/// Returns whether one motor answers. Several new ones send the same bytes, except for what they
/// measure: a scan has received the angle of motors in MIT mode, not of native ones.
///
/// # Errors
///
/// The bus accepts no frame.
pub(crate) fn is_alone(link: &mut Link, found: &Found) -> Result<bool, Error> {
    if found.family != Family::Native {
        return Ok(true);
    }
    let request = Native::request(&Command::RetrieveIndicator { ind_id: Indicator::SHAFT_ANGLE });
    let (mut answers, window) = (0, link.timeout());
    let _end = link.ask(found.id, request, window, |event| {
        answers += match event {
            LinkEvent::Frame(_) => 1,
            LinkEvent::Collision => 2,
            LinkEvent::NotRead => 0,
        };
        None::<()>
    })?;
    Ok(answers == 1)
}

/// Checks that no second motor has got power since this one was found: it would get the same values.
///
/// # Errors
///
/// Several motors answer, or none.
pub(crate) fn must_be_alone(session: &mut Session) -> Result<(), DirectFailure> {
    let is_alone = match session.protocol {
        Protocol::RobStride => session.private().is_alone()?,
        // Both count estimates at the rate of the factory, and send nothing.
        Protocol::CanSimple | Protocol::ODrive => session.axis().is_alone()?,
        Protocol::MyActuator => session.rmd().is_alone()?,
        Protocol::Gim | Protocol::Mit => return one_must_answer(session),
    };
    if is_alone {
        Ok(())
    } else {
        Err(session
            .unfit("not exactly one motor answers with its id: check its power, and take that of others"))
    }
}

fn one_must_answer(session: &mut Session) -> Result<(), DirectFailure> {
    let (id, link) = (session.id, &mut session.line.link);
    let Some(found) = identify(link, id)? else {
        return Err(DirectFailure::NoMotor { id, bus: session.line.name.clone() });
    };
    let is_native = found.family == Family::Native;
    let is_it = is_native == (session.protocol == Protocol::Gim)
        && (found.host_id.is_none() || session.host_id.is_none() || found.host_id == session.host_id);
    if is_it && is_alone(link, &found)? {
        return Ok(());
    }
    Err(session.unfit("several motors answer with its id: take the power from all but one"))
}

/// Checks that no other motor on the bus has the new id or host id of a motor with registers.
fn must_be_free(session: &mut Session, id: u8, host_id: FrameId) -> Result<(), DirectFailure> {
    if host_id.byte() == Some(id) {
        let reason = "its id and its host id would be equal: two nodes would send frames with one id; give it another host id";
        return Err(session.unfit(reason));
    }
    session.mit().stop()?;
    let is_new = |other: &u8| *other != session.id && (1..=0xFE).contains(other);
    let host_id = host_id.byte().filter(|_| session.host_id != Some(host_id));
    for taken in [Some(id), host_id].into_iter().flatten().filter(is_new) {
        if is_taken(&mut session.line.link, taken)? {
            return Err(Error::Taken { id: session.id, taken }.into());
        }
    }
    Ok(())
}

/// Gives a motor in native mode another bit rate. It then leaves this bus.
///
/// # Errors
///
/// The stored number has no known unit, or the motor refuses.
pub(crate) fn set_bit_rate(session: &mut Session, rate: u32) -> Result<(), DirectFailure> {
    let present = address::integer(&address::read(session)?, BAUD);
    let code = address::rate_code(present, session.line.bitrate, rate).map_err(|why| session.unfit(&why))?;
    write(session, &[(BAUD, code)])
}

/// Changes a motor in native mode to MIT.
///
/// # Errors
///
/// The motor refuses.
pub(crate) fn set_mit(session: &mut Session) -> Result<(), DirectFailure> {
    write(session, &[(PROTOCOL, address::protocol_number(Protocol::Mit))])?;
    session.protocol = Protocol::Mit;
    Ok(())
}

/// Writes items of the address into a motor in native mode, and reads them back.
fn write(session: &mut Session, items: &[(&str, i32)]) -> Result<(), DirectFailure> {
    let present = address::read(session)?;
    let wanted =
        items.iter().fold(present.clone(), |wanted, (name, value)| address::with(&wanted, name, *value));
    write_items(session, &changes(&present, &wanted))
}

/// Writes items into a motor in native mode, and reads each back.
///
/// # Errors
///
/// The motor does not answer, refuses an item, or does not keep it.
pub(crate) fn write_items(session: &mut Session, changes: &[Change]) -> Result<(), DirectFailure> {
    let apply = Apply { changes };
    apply.check(&mut session.gim())?;
    apply.run(&mut session.gim(), &mut |_| Ok::<(), Infallible>(())).map_err(|failed| match failed {
        Failed::Motor { source, .. } => source.into(),
        Failed::Journal(never) => match never {},
    })
}

/// Returns the stored zero position of a motor in native mode.
///
/// # Errors
///
/// The motor does not answer.
pub(crate) fn stored_zero(session: &mut Session) -> Result<Option<i32>, Error> {
    if session.protocol == Protocol::Mit {
        return Ok(None);
    }
    match session.gim().configuration(ConfigurationItem::ZERO_POSITION)? {
        Value::Integer(zero) => Ok(Some(zero)),
        Value::Float(_) => Ok(None),
    }
}

/// Restores the stored zero position of a motor in native mode.
///
/// # Errors
///
/// The motor does not keep it.
pub(crate) fn restore_zero(session: &mut Session, zero: i32) -> Result<(), Error> {
    let key = ConfigurationItem::ZERO_POSITION;
    let Some(item) = key.item() else { return Ok(()) };
    session.gim().store_configuration(item, Value::Integer(zero)).map(drop)
}
