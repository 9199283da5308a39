//! `motorctl parameter` and `motorctl config get|set|list`: single stored items of a motor.

use crate::failure::DirectFailure;
use crate::output::{Confirm, print_line};
use crate::target::{Target, number};
use motord_protocol::commissioning::{Apply, Change, Confirmation, Error, MotorRefusal, Native, check_value};
use motord_protocol::gim::{
    Access, CONFIGURATION, ConfigurationItem, Effective, Finite, PARAMETERS, Parameter, Value, ValueType,
};
use motord_terminal::{Cell, Palette, Table, json};
use serde::Serialize;
use std::io;

/// Reads a parameter's name or number.
pub(crate) fn parse_parameter(text: &str) -> Result<&'static Parameter, String> {
    let by_number = || u8::try_from(number(text)?).ok().and_then(Parameter::by_id);
    let unknown = || expected_one_of(PARAMETERS.iter().map(|parameter| parameter.name));
    Parameter::by_name(text).or_else(by_number).ok_or_else(unknown)
}

/// Reads a configuration item's name.
pub(crate) fn parse_item(text: &str) -> Result<&'static ConfigurationItem, String> {
    ConfigurationItem::by_name(text)
        .ok_or_else(|| expected_one_of(CONFIGURATION.iter().map(|item| item.name)))
}

/// Returns the error text for a name that is not in `names`.
pub(crate) fn expected_one_of<'a>(names: impl Iterator<Item = &'a str>) -> String {
    format!("expected one of {}", names.collect::<Vec<_>>().join(", "))
}

/// Reads the value of an item: an integer, decimal or with 0x, or a float.
pub(crate) fn parse_value(item: &ConfigurationItem, text: &str) -> Result<Value, String> {
    let name = item.name;
    let value = match item.value_type {
        ValueType::Integer => {
            let hex = || i32::try_from(number(text).filter(|_| text.starts_with("0x"))?).ok();
            let value = text.parse().ok().or_else(hex).map(Value::Integer);
            value.ok_or_else(|| format!("{name} is an integer of 32 bits, not `{text}`"))
        }
        ValueType::Float => {
            let value = text.parse().ok().and_then(Finite::new).map(Value::Float);
            value.ok_or_else(|| format!("{name} is a finite number, not `{text}`"))
        }
    }?;
    check_value(item, value)?;
    Ok(value)
}

/// Formats a value. The text of a float reads back as the same float.
pub(crate) fn text(value: Value) -> String {
    match value {
        Value::Integer(value) => value.to_string(),
        Value::Float(value) => value.get().to_string(),
    }
}

/// `motorctl parameter get`: one, or all.
pub(crate) fn get_parameter(
    target: &Target,
    parameter: Option<&'static Parameter>,
    as_json: bool,
) -> Result<(), DirectFailure> {
    #[derive(Serialize)]
    struct Stored {
        name: &'static str,
        value: u32,
    }
    let mut session = target.open_gim()?;
    let mut motor = session.gim();
    let wanted = PARAMETERS.iter().filter(|row| parameter.is_none_or(|parameter| parameter.id == row.id));
    let read = wanted.map(|row| Ok(Stored { name: row.name, value: motor.parameter(row.id)? }));
    let stored = read.collect::<Result<Vec<_>, Error>>()?;
    let out = &mut io::stdout().lock();
    if as_json {
        return Ok(json::write_line(out, &stored)?);
    }
    let mut table = Table::new(&["parameter", "value"]);
    stored.iter().for_each(|row| table.row(vec![Cell::plain(row.name), Cell::plain(row.value)]));
    Ok(table.write(out, Palette::of_stdout())?)
}

/// `motorctl parameter set`.
pub(crate) fn set_parameter(
    target: &Target,
    parameter: &'static Parameter,
    value: u32,
    confirm: Confirm,
) -> Result<(), DirectFailure> {
    let mut session = target.open_gim()?;
    let name = session.name();
    let mut motor = session.gim();
    let before = motor.parameter(parameter.id)?;
    confirm.ask(&format!(
        "This changes {} of {name} from {before} to {value}, immediately, until it is powered off. A gain that is too high makes the motor oscillate.",
        parameter.name
    ))?;
    motor.set_parameter(parameter.id, value)?;
    print_line(&format!("{name}: {} was {before}, reads {value} now", parameter.name))
}

/// A value in JSON. A float has all its digits.
#[derive(Serialize)]
#[serde(untagged)]
enum Number {
    Integer(i32),
    Float(f32),
}

#[derive(Serialize)]
struct ItemRow {
    name: &'static str,
    value: Option<Number>,
    #[serde(skip)]
    text: String,
    refused: Option<String>,
    unit: &'static str,
    r#type: &'static str,
    access: &'static str,
    effective: &'static str,
}

impl ItemRow {
    fn new(item: &'static ConfigurationItem, read: Result<Value, MotorRefusal>) -> Self {
        Self {
            name: item.name,
            value: read.ok().map(|value| match value {
                Value::Integer(value) => Number::Integer(value),
                Value::Float(value) => Number::Float(value.get()),
            }),
            text: read.map_or_else(|refusal| refusal.to_string(), text),
            refused: read.err().map(|refusal| refusal.to_string()),
            unit: item.unit,
            r#type: if item.value_type == ValueType::Integer { "integer" } else { "float" },
            access: if item.access == Access::ReadWrite { "read, write" } else { "read" },
            effective: effective(item),
        }
    }
}

/// Reads an item. A refusal of the motor is a normal answer here.
pub(crate) fn read(
    motor: &mut Native<'_>,
    item: &'static ConfigurationItem,
) -> Result<Result<Value, MotorRefusal>, Error> {
    match motor.configuration(item.key()) {
        Ok(value) => Ok(Ok(value)),
        Err(Error::Refused { refusal, .. }) => Ok(Err(refusal)),
        Err(error) => Err(error),
    }
}

/// `motorctl config get` and `list`.
pub(crate) fn get(
    target: &Target,
    item: Option<&'static ConfigurationItem>,
    as_json: bool,
) -> Result<(), DirectFailure> {
    let mut session = target.open_gim()?;
    let mut motor = session.gim();
    let mut rows = Vec::new();
    for row in CONFIGURATION.iter().filter(|row| item.is_none_or(|item| item.key() == row.key())) {
        rows.push(ItemRow::new(row, read(&mut motor, row)?));
    }
    let out = &mut io::stdout().lock();
    match (as_json, item) {
        (true, Some(_)) => Ok(json::write_line(out, &rows.first())?),
        (true, None) => Ok(json::write_line(out, &rows)?),
        (false, _) => {
            let mut table = Table::new(&["item", "value", "unit", "type", "access", "effective"]);
            for row in rows {
                let cells = [
                    row.name.to_owned(),
                    row.text,
                    row.unit.into(),
                    row.r#type.into(),
                    row.access.into(),
                    row.effective.into(),
                ];
                table.row(cells.map(Cell::plain).into());
            }
            Ok(table.write(out, Palette::of_stdout())?)
        }
    }
}

/// `motorctl config set`.
pub(crate) fn set(
    target: &Target,
    item: &'static ConfigurationItem,
    value: &str,
    confirm: Confirm,
) -> Result<(), DirectFailure> {
    let value = parse_value(item, value).map_err(DirectFailure::Usage)?;
    if item.access == Access::ReadOnly {
        let usage = format!("{} can only be read (GIM document, Table 7)", item.name);
        return Err(DirectFailure::Usage(usage));
    }
    let mut session = target.open_gim()?;
    let name = session.name();
    let mut motor = session.gim();
    let before = motor.configuration(item.key())?;
    Apply { changes: &[Change { item, from: before, to: value }] }.check(&mut motor)?;
    confirm.ask(&format!(
        "This permanently changes {} of {name} from {} to {} {}.{}",
        item.name,
        text(before),
        text(value),
        item.unit,
        warning(item)
    ))?;
    let confirmation = motor.store_configuration(item, value)?;
    print_line(&format!(
        "{name}: {} was {}, {}{}",
        item.name,
        text(before),
        outcome_of(confirmation),
        when(item)
    ))
}

/// Returns a warning for an item whose change has further effects.
fn warning(item: &ConfigurationItem) -> &'static str {
    match item.name {
        "can-id" | "host-id" => {
            "\nThe motor then answers under the new id: no other motor of the bus may have it."
        }
        "can-baud-rate" => {
            "\nIt is unreachable over CAN until the bus has the new rate. No document gives the unit."
        }
        "can-protocol" => "\nIt cannot be changed back over CAN, only by its serial port (RS485, RS232).",
        "zero-position" => {
            "\nThe motor then reports another position. `motorctl zero` checks it; this command does not."
        }
        _ => "",
    }
}

/// Describes the confirmation of a write, as the end of a sentence.
pub(crate) fn outcome_of(confirmation: Confirmation) -> String {
    match confirmation {
        Confirmation::ReadBack(value) => format!("reads {} now", text(value)),
        Confirmation::AnswersInMit => "the motor answers in MIT now".to_owned(),
        Confirmation::Unreachable => {
            "written; the motor is unreachable until this bus has its bit rate: read the item back then"
                .to_owned()
        }
    }
}

/// Describes when a write takes effect, for a table.
pub(crate) fn effective(item: &ConfigurationItem) -> &'static str {
    match item.effective {
        Effective::Immediately => "at once",
        Effective::AfterReboot => "after a reboot",
    }
}

/// Describes when a write takes effect, as the end of a sentence.
pub(crate) fn when(item: &ConfigurationItem) -> &'static str {
    match item.effective {
        Effective::Immediately => "",
        Effective::AfterReboot => "; effective after the motor was powered off and on",
    }
}
