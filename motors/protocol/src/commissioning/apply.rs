//! Writes a configuration, item by item.

use crate::commissioning::scan::is_taken;
use crate::gim::commissioning::{Confirmation, Native, same};
use crate::gim::{Access, CONFIGURATION, ConfigurationItem, Value};
use crate::link::Error;
use crate::link::Wire;

/// An item to change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    /// The item.
    pub item: &'static ConfigurationItem,
    /// Its present value.
    pub from: Value,
    /// Its new value.
    pub to: Value,
}

/// A step of an application, reported before and after it, for a journal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event {
    /// The item is written next.
    Writing(Change),
    /// The item was written and confirmed.
    Written(Change, Confirmation),
    /// The motor stores the items written so far next (GIM document 3.2.2).
    Refreshing,
}

/// Returns the items of `wanted` that differ from `present`, in the order in which they are
/// written. Read-only items are left out. Items that may end the connection to the motor are last.
#[must_use]
pub fn changes(
    present: &[(&'static ConfigurationItem, Value)],
    wanted: &[(&'static ConfigurationItem, Value)],
) -> Vec<Change> {
    let mut changes: Vec<Change> = CONFIGURATION
        .iter()
        .filter(|item| item.access == Access::ReadWrite)
        .filter_map(|item| {
            let value = |values: &[(&'static ConfigurationItem, Value)]| {
                values.iter().find(|(other, _)| other.key() == item.key()).map(|(_, value)| *value)
            };
            let (from, to) = (value(present)?, value(wanted)?);
            (!same(item.key(), from, to)).then_some(Change { item, from, to })
        })
        .collect();
    changes.sort_by_key(|change| rank(change.item));
    changes
}

/// Returns the position of an item in the order. The items of the link are last: the host id, which
/// distinguishes the motor from others, then its id. Protocol and bit rate follow, which end the
/// connection over CAN.
fn rank(item: &ConfigurationItem) -> usize {
    const LINK: [&str; 4] = ["host-id", "can-id", "can-protocol", "can-baud-rate"];
    LINK.iter().position(|name| *name == item.name).map_or(0, |index| index + 1)
}

/// Reason for which a configuration was not written completely.
#[derive(Debug, thiserror::Error)]
pub enum Failed<E> {
    /// The motor refused, did not reply, or did not keep a value. Nothing was written after it.
    #[error("{source}; {} of {count} items were written before it, none after", .written)]
    Motor {
        /// The error.
        source: Error,
        /// Number of items written before it.
        written: usize,
        /// Number of items to write.
        count: usize,
    },
    /// The journal could not be written, so the next item was not written.
    #[error("the journal cannot be written: {0}")]
    Journal(E),
}

/// Changes to write.
#[derive(Debug, Clone, Copy)]
pub struct Apply<'c> {
    /// The changes, in this order.
    pub changes: &'c [Change],
}

/// Checks that a value can be written at all. With a wrong id, host id or protocol, the motor could
/// not be reached any more.
///
/// # Errors
///
/// The values that the item may have, as a text.
pub fn check_value(item: &ConfigurationItem, value: Value) -> Result<(), &'static str> {
    let (allowed, expected) = match item.name {
        "can-id" => (1..=0xFE, "can-id is 1 to 254"),
        "host-id" => (0..=0x7FF, "host-id is 0 to 0x7FF"),
        "can-protocol" => (0..=1, "can-protocol is 0 (native) or 1 (MIT)"),
        _ => return Ok(()),
    };
    if matches!(value, Value::Integer(value) if allowed.contains(&value)) { Ok(()) } else { Err(expected) }
}

/// Powers of ten between a value and one of another unit: from micro to mega.
const UNITS: [f64; 12] = [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6];
/// Largest factor between two values of one unit.
const FACTOR_MAX: f64 = 10.0;

/// Checks that a motor may have the new value. Where the motor stores an implausible one at
/// present, its firmware has another unit than the document: then the new one must be of the same
/// size.
///
/// # Errors
///
/// The nearest value that may have been meant, if there is one.
fn check_plausible(change: &Change) -> Result<(), Option<f64>> {
    let Change { item, from, to } = change;
    let (from, to) = (from.as_f64(), to.as_f64());
    let is_as_documented = item.is_plausible(from);
    let is_similar = |value: f64| {
        let factor = value / from;
        (1.0 / FACTOR_MAX..=FACTOR_MAX).contains(&factor)
    };
    let may_be = |value: f64| if is_as_documented { item.is_plausible(value) } else { is_similar(value) };
    if may_be(to) || item.plausible.is_none() {
        return Ok(());
    }
    let distance = |value: f64| (value / from).abs().ln().abs();
    let meant = UNITS.iter().map(|unit| to * unit).filter(|value| may_be(*value));
    Err(meant.min_by(|one, other| distance(*one).total_cmp(&distance(*other))))
}

/// Returns the unit of `can-baud-rate`, bit/s, inferred from the stored number. No document
/// specifies it.
#[must_use]
pub fn bitrate_unit(stored: i32) -> Option<u32> {
    match stored {
        1..=10 => Some(100_000),
        100..=1000 => Some(1000),
        100_000..=1_000_000 => Some(1),
        _ => None,
    }
}

impl Apply<'_> {
    /// Checks that every motor stays reachable. Each value must be one that its item and a motor
    /// may have. No other motor of the bus may answer to the new id or host id, and the bit rate
    /// must keep its unit. Sends requests on the bus; writes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Protocol`], [`Error::Implausible`], [`Error::Taken`], [`Error::Bus`].
    pub fn check(&self, motor: &mut Native<'_>) -> Result<(), Error> {
        self.check_wire(motor)?;
        let (id, host_id) = (motor.address().id, motor.address().host_id);
        let refused = |reason| Err(Error::Protocol { id, reason });
        for change in self.changes {
            check_value(change.item, change.to).or_else(refused)?;
            let ConfigurationItem { name: item, unit, plausible: range, .. } = *change.item;
            let value = change.to.as_f64();
            check_plausible(change).map_err(|meant| Error::Implausible {
                id,
                item,
                unit,
                range,
                value,
                meant,
            })?;
        }
        if let Some(change) = self.change("can-baud-rate")
            && let (Value::Integer(from), Value::Integer(to)) = (change.from, change.to)
            && bitrate_unit(from).is_some_and(|unit| bitrate_unit(to) != Some(unit))
        {
            return refused("its new bit rate and its present one have different units");
        }
        let new_id = self.integer("can-id");
        let new_host_id = self.integer("host-id").filter(|_| motor.link().wire() == Wire::Can);
        let known =
            host_id.filter(|_| motor.link().wire() == Wire::Can).and_then(|id| i32::try_from(id.raw()).ok());
        if (new_id.is_some() || new_host_id.is_some())
            && new_host_id.or(known) == Some(new_id.unwrap_or(id.into()))
        {
            return refused(
                "its id and its host id would be equal: two nodes would send frames with one id; give it another host id",
            );
        }
        let others = [new_id, new_host_id].into_iter().flatten().filter_map(|new| u8::try_from(new).ok());
        for taken in others.filter(|&other| other != id && (1..=0xFE).contains(&other)) {
            if is_taken(motor.link(), taken)? {
                return Err(Error::Taken { id, taken });
            }
        }
        Ok(())
    }

    fn change(&self, name: &str) -> Option<&Change> {
        self.changes.iter().find(|change| change.item.name == name)
    }

    fn integer(&self, name: &str) -> Option<i32> {
        match self.change(name)?.to {
            Value::Integer(value) => Some(value),
            Value::Float(_) => None,
        }
    }

    /// Over CAN, a motor whose protocol was changed cannot receive its bit rate, and the reverse.
    fn check_wire(&self, motor: &mut Native<'_>) -> Result<(), Error> {
        let has = |name| self.change(name).is_some();
        if motor.link().wire() == Wire::Can && has("can-protocol") && has("can-baud-rate") {
            let reason =
                "protocol and bit rate cannot both be changed over CAN: use its serial port, or two files";
            return Err(Error::Protocol { id: motor.address().id, reason });
        }
        Ok(())
    }

    /// Writes each change and reads it back. Calls `journal` before and after each write. Writes
    /// nothing after an error.
    ///
    /// # Errors
    ///
    /// The first refusal, with the number of items written before it; the first failure of the
    /// journal.
    pub fn run<E>(
        &self,
        motor: &mut Native<'_>,
        journal: &mut dyn FnMut(Event) -> Result<(), E>,
    ) -> Result<(), Failed<E>> {
        let count = self.changes.len();
        let failed = |written| move |source| Failed::Motor { source, written, count };
        self.check_wire(motor).map_err(failed(0))?;
        let plain = self.changes.iter().take_while(|change| rank(change.item) == 0).count();
        for (written, change) in self.changes.iter().enumerate() {
            journal(Event::Writing(*change)).map_err(Failed::Journal)?;
            let confirmation = motor.set_configuration(change.item, change.to).map_err(failed(written))?;
            journal(Event::Written(*change, confirmation)).map_err(Failed::Journal)?;
            // The last of those that can be stored together, and each that changes how the motor is
            // reached.
            if written + 1 >= plain && confirmation.is_read_back() {
                Self::refresh(motor, journal)?.map_err(failed(written + 1))?;
            }
        }
        Ok(())
    }

    fn refresh<E>(
        motor: &mut Native<'_>,
        journal: &mut dyn FnMut(Event) -> Result<(), E>,
    ) -> Result<Result<(), Error>, Failed<E>> {
        journal(Event::Refreshing).map_err(Failed::Journal)?;
        Ok(motor.refresh())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gim::Finite;

    fn change(name: &str, from: f32, to: f32) -> Change {
        let item = ConfigurationItem::by_name(name).unwrap();
        let value = |value: f32| match item.value_type {
            crate::gim::ValueType::Integer => Value::Integer(value as i32),
            crate::gim::ValueType::Float => Value::Float(Finite::new(value).unwrap()),
        };
        Change { item, from: value(from), to: value(to) }
    }

    /// 5200 for an over-voltage of 52.00 V switched the protection off.
    #[test]
    fn value_of_another_unit_names_the_meant_one() {
        let meant =
            |name, from, to| check_plausible(&change(name, from, to)).map_err(Option::unwrap_or_default);
        assert_eq!(meant("over-voltage", 56.0, 52.0), Ok(()));
        assert_eq!(meant("over-voltage", 56.0, 5200.0), Err(52.0));
        assert_eq!(meant("over-voltage", 56.0, 52_000.0), Err(52.0));
        assert_eq!(meant("over-voltage", 56.0, 0.0), Err(0.0), "no power of ten makes a voltage of 0");
        assert!((meant("torque-constant", 0.125, 125.0).unwrap_err() - 0.125).abs() < 1e-6);
        assert_eq!(meant("current-kp", 100.0, 1e6), Ok(()), "it has no documented scale");
        // A firmware that stores centivolts.
        assert_eq!(meant("over-voltage", 5600.0, 5200.0), Ok(()));
        assert_eq!(meant("over-voltage", 5600.0, 52.0), Err(5200.0));
    }
}
