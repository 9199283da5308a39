//! `motorctl id` and `motorctl protocol`: the address of a motor.

mod one_id;

use crate::failure::DirectFailure;
use crate::memory::{outcome_of, text};
use crate::output::{Confirm, print_line};
use crate::target::{Protocol, Session, Target, parse_host_id, parse_id};
use motord_bus::FrameId;
use motord_protocol::commissioning::{Apply, Change, Error, Event, Failed, Wire, bitrate_unit, changes};
use motord_protocol::gim::{ConfigurationItem, Value};
use one_id::{Address, OneId, Wanted};

/// Names of the items of the address.
pub(crate) const CAN_ID: &str = "can-id";
pub(crate) const HOST_ID: &str = "host-id";
pub(crate) const BAUD: &str = "can-baud-rate";
pub(crate) const PROTOCOL: &str = "can-protocol";

/// The options of `motorctl id`.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    target: Target,
    /// The new id, 1 to 254.
    #[arg(long, value_name = "ID", value_parser = parse_id)]
    set_id: Option<u8>,
    /// The new host id: the CAN id of the motor's answers. It must be unique on its bus; motord
    /// expects 0x100 + id.
    #[arg(long, value_name = "ID", value_parser = parse_host_id)]
    set_host_id: Option<FrameId>,
    /// The new CAN bit rate, bit/s. No document gives the unit of the stored number: the command
    /// infers it from the present one.
    #[arg(long, value_name = "BIT/S", value_parser = clap::value_parser!(u32).range(10_000..=1_000_000))]
    set_bitrate: Option<u32>,
    /// The new protocol over CAN. There is no way back from MIT over CAN.
    #[arg(long, value_name = "PROTOCOL")]
    set_protocol: Option<Protocol>,
    #[command(flatten)]
    confirm: Confirm,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    fn changes_nothing(&self) -> bool {
        self.set_id.is_none()
            && self.set_host_id.is_none()
            && self.set_bitrate.is_none()
            && self.set_protocol.is_none()
    }
}

/// `motorctl id`: shows or changes the address of a motor.
pub(crate) fn run(arguments: &Arguments) -> Result<(), DirectFailure> {
    if let (Some(id), Some(host_id)) = (arguments.set_id, arguments.set_host_id)
        && host_id.byte() == Some(id)
    {
        let usage = "id and host id must differ: two nodes would send frames with one id".to_owned();
        return Err(DirectFailure::Usage(usage));
    }
    let mut session = arguments.target.open()?;
    let has_others = arguments.set_host_id.is_some() || arguments.set_bitrate.is_some();
    let address = Wanted { id: arguments.set_id, protocol: arguments.set_protocol, has_others };
    match session.protocol {
        Protocol::ODrive => return Err(session.unfit(ODRIVE)),
        protocol => {
            if let Some(family) = one_id(protocol) {
                return family.run(&mut session, &address, arguments.confirm, arguments.json);
            }
        }
    }
    let mut session = session.require_gim()?;
    if !matches!(arguments.set_protocol, None | Some(Protocol::Mit | Protocol::Gim)) {
        return Err(session.unfit("its driver does not speak this protocol"));
    }
    let present = read(&mut session)?;
    if arguments.changes_nothing() {
        return show(&session, &present, arguments.json);
    }
    let wanted = wanted(&session, &present, arguments)?;
    write(&mut session, &changes(&present, &wanted), arguments.confirm)
}

/// `motorctl protocol`: changes the protocol over CAN.
pub(crate) fn protocol(target: &Target, to: Protocol, confirm: Confirm) -> Result<(), DirectFailure> {
    let mut session = target.open()?;
    if session.protocol == to && session.line.link.wire() == Wire::Can {
        return print_line(&format!("{}: speaks this protocol already", session.name()));
    }
    match (session.protocol, to) {
        (Protocol::RobStride, Protocol::Mit) => return one_id::change_to_mit(&mut session, confirm),
        (Protocol::Mit, Protocol::RobStride) => return one_id::change_from_mit(&mut session, confirm),
        (Protocol::Mit, Protocol::Gim) => {
            let reason = "a motor in MIT mode cannot be changed over CAN: use its serial port (`motorctl protocol gim --bus /dev/ttyUSB0`)";
            return Err(session.unfit(reason));
        }
        (Protocol::Gim, Protocol::Mit | Protocol::Gim) => {}
        _ => return Err(session.unfit("no motor speaks both protocols")),
    }
    let present = read(&mut session)?;
    let wanted = with(&present, PROTOCOL, protocol_number(to));
    write(&mut session, &changes(&present, &wanted), confirm)
}

const ODRIVE: &str = "the address of an ODrive is set with odrivetool: odrv0.axis0.config.can.node_id";

/// Gives a motor whose address is one id another one that is free, and finds it there. The session keeps the
/// former one.
///
/// # Errors
///
/// Another motor has the id, the motor does not keep it, or its address has other parts.
pub(crate) fn change_id(session: &mut Session, id: u8) -> Result<(), DirectFailure> {
    match one_id(session.protocol) {
        Some(family) => (family.change)(session, id),
        None if session.protocol == Protocol::ODrive => Err(session.unfit(ODRIVE)),
        None => Err(session.unfit("its address also has a host id")),
    }
}

/// Returns the address of the motors with this protocol, where it is one id that motorctl sets.
const fn one_id(protocol: Protocol) -> Option<&'static OneId> {
    match protocol {
        Protocol::CanSimple => Some(&one_id::NODE),
        Protocol::RobStride => Some(&one_id::PRIVATE),
        Protocol::MyActuator => Some(&one_id::RMD),
        Protocol::Gim | Protocol::Mit | Protocol::ODrive => None,
    }
}

/// Items of a motor and their values.
pub(crate) type Values = Vec<(&'static ConfigurationItem, Value)>;

/// Reads the items of the address: id, host id, protocol and bit rate.
///
/// # Errors
///
/// The motor does not answer, or refuses.
pub(crate) fn read(session: &mut Session) -> Result<Values, Error> {
    let items = [CAN_ID, HOST_ID, PROTOCOL, BAUD].into_iter().filter_map(ConfigurationItem::by_name);
    let mut motor = session.gim();
    items.map(|item| Ok((item, motor.configuration(item.key())?))).collect()
}

/// Returns the integer of this name; 0 without one.
pub(crate) fn integer(values: &Values, name: &str) -> i32 {
    let found = values.iter().find(|(item, _)| item.name == name);
    found.map_or(0, |(_, value)| if let Value::Integer(value) = value { *value } else { 0 })
}

/// Returns `values` with another integer of this name.
pub(crate) fn with(values: &Values, name: &str, new: i32) -> Values {
    let replaced = |&(item, value): &(&'static ConfigurationItem, Value)| {
        (item, if item.name == name { Value::Integer(new) } else { value })
    };
    values.iter().map(replaced).collect()
}

/// Returns the number of a protocol that a SteadyWin motor stores.
pub(crate) const fn protocol_number(protocol: Protocol) -> i32 {
    match protocol {
        Protocol::Mit => 1,
        Protocol::Gim
        | Protocol::RobStride
        | Protocol::CanSimple
        | Protocol::MyActuator
        | Protocol::ODrive => 0,
    }
}

fn wanted(session: &Session, present: &Values, arguments: &Arguments) -> Result<Values, DirectFailure> {
    let mut wanted = present.clone();
    if let Some(id) = arguments.set_id {
        wanted = with(&wanted, CAN_ID, id.into());
    }
    if let Some(host_id) = arguments.set_host_id {
        wanted = with(&wanted, HOST_ID, i32::try_from(host_id.raw()).unwrap_or(i32::MAX));
    }
    if let Some(protocol) = arguments.set_protocol {
        wanted = with(&wanted, PROTOCOL, protocol_number(protocol));
    }
    if let Some(rate) = arguments.set_bitrate {
        let code = rate_code(integer(present, BAUD), session.line.bitrate, rate)
            .map_err(|why| session.unfit(&why))?;
        wanted = with(&wanted, BAUD, code);
    }
    Ok(wanted)
}

/// Returns the stored number for `rate`, in the unit inferred from the present number.
///
/// # Errors
///
/// The reason for which it has none.
pub(crate) fn rate_code(present: i32, bus: Option<u32>, rate: u32) -> Result<i32, String> {
    let unit = bitrate_unit(present)
        .ok_or_else(|| format!("its bit rate is stored as {present}, whose unit cannot be inferred"))?;
    let present_rate = present.unsigned_abs() * unit;
    if bus.is_some_and(|bus| bus.abs_diff(present_rate) > bus / 100) {
        return Err(format!(
            "its bit rate is stored as {present}, which does not fit to the {} bit/s of this bus",
            bus.unwrap_or(0)
        ));
    }
    if !rate.is_multiple_of(unit) {
        return Err(format!(
            "its bit rate is stored in units of {unit} bit/s, which {rate} is no multiple of"
        ));
    }
    i32::try_from(rate / unit).map_err(|error| error.to_string())
}

fn show(session: &Session, present: &Values, as_json: bool) -> Result<(), DirectFailure> {
    let can_protocol = if integer(present, PROTOCOL) == 0 { "gim" } else { "mit" };
    let [id, host_id, can_baud_rate] = [CAN_ID, HOST_ID, BAUD].map(|name| integer(present, name));
    let text = format!(
        "{}: id {id}, host id {host_id:#05X}, {can_protocol} over CAN, bit rate stored as {can_baud_rate}",
        session.name()
    );
    Address { id, host_id: Some(host_id), can_protocol, can_baud_rate: Some(can_baud_rate) }
        .show(as_json, &text)
}

fn write(session: &mut Session, changes: &[Change], confirm: Confirm) -> Result<(), DirectFailure> {
    let (name, wire) = (session.name(), session.line.link.wire());
    if changes.is_empty() {
        return print_line(&format!("{name}: nothing differs"));
    }
    let apply = Apply { changes };
    apply.check(&mut session.gim())?;
    let described: Vec<String> = changes
        .iter()
        .map(|change| format!("{} from {} to {}", change.item.name, text(change.from), text(change.to)))
        .collect();
    let to_mit = changes.iter().any(|change| change.item.name == PROTOCOL && change.to == Value::Integer(1));
    let reversal = match (to_mit, wire) {
        (true, _) => "\nIt cannot be changed back over CAN, only by its serial port (RS485, RS232).",
        (false, _) => "",
    };
    confirm.ask(&format!(
        "This permanently changes {} of {name}. Connect it alone: every motor with this id would change.{reversal}",
        described.join(", ")
    ))?;
    let written = apply.run(&mut session.gim(), &mut |event| {
        if let Event::Written(change, confirmation) = event {
            print_line(&format!(
                "{name}: {} was {}, {}",
                change.item.name,
                text(change.from),
                outcome_of(confirmation)
            ))?;
        }
        Ok::<(), DirectFailure>(())
    });
    written.map_err(|failed| match failed {
        Failed::Motor { source, .. } => DirectFailure::Motor(source),
        Failed::Journal(failure) => failure,
    })
}

#[cfg(test)]
mod tests {
    use super::rate_code;

    #[test]
    fn bit_rate_unit_is_inferred_or_nothing_written() {
        assert_eq!(rate_code(10, None, 500_000), Ok(5));
        assert_eq!(rate_code(500, Some(500_000), 1_000_000), Ok(1000));
        assert_eq!(rate_code(1_000_000, Some(1_000_000), 500_000), Ok(500_000));
        for (present, bus, rate) in [
            (0, None, 500_000),
            (11, None, 500_000),
            (10, Some(500_000), 500_000),
            (10, None, 250_000),
            (-5, None, 500_000),
        ] {
            assert!(rate_code(present, bus, rate).is_err(), "{present} {bus:?} {rate}");
        }
    }
}
