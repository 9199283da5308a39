//! Writing a configuration, item by item.

use crate::error::Error;
use crate::link::Wire;
use crate::native::{Confirmation, Native, same};
use crate::scan::is_taken;
use motord_protocol::gim::{Access, CONFIGURATION, ConfigurationItem, Value};

/// An item that is to change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    /// The item.
    pub item: &'static ConfigurationItem,
    /// Its value now.
    pub from: Value,
    /// Its value afterwards.
    pub to: Value,
}

/// A step of an application, told before and after it: for a journal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event {
    /// The item is written next.
    Writing(Change),
    /// The item was written, and is confirmed.
    Written(Change, Confirmation),
    /// The motor stores the items written so far next (GIM document 3.2.2).
    Refreshing,
}

/// The items of `wanted` that differ from `present`, in the order in which they are written: those that end the conversation
/// with the motor last. Items that can only be read are left out.
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

/// The place of an item in the order. The items of the link come last: the host id, by which the motor can be told from others;
/// then its id; then its protocol and its bit rate, which end the conversation over CAN.
fn rank(item: &ConfigurationItem) -> usize {
    const LINK: [&str; 4] = ["host-id", "can-id", "can-protocol", "can-baud-rate"];
    LINK.iter().position(|name| *name == item.name).map_or(0, |place| place + 1)
}

/// Why a configuration was not written to its end.
#[derive(Debug, thiserror::Error)]
pub enum Failed<E> {
    /// The motor refused, is silent, or did not keep a value. Nothing was written after it.
    #[error("{source}; {} of {count} items were written before it, none after", .written)]
    Motor {
        /// Why.
        source: Error,
        /// Items that were written before.
        written: usize,
        /// Items that were to be written.
        count: usize,
    },
    /// The journal could not be written, so the next item was not.
    #[error("the journal cannot be written: {0}")]
    Journal(E),
}

/// Writes changes.
#[derive(Debug, Clone, Copy)]
pub struct Apply<'c> {
    /// In this order.
    pub changes: &'c [Change],
}

/// Checks that a value can be written at all: with a wrong id, host id or protocol nobody would reach the motor any more.
///
/// # Errors
///
/// The values that the item may have, in words.
pub fn check_value(item: &ConfigurationItem, value: Value) -> Result<(), &'static str> {
    let (allowed, expected) = match item.name {
        "can-id" => (1..=0xFE, "can-id is 1 to 254"),
        "host-id" => (0..=0x7FF, "host-id is 0 to 0x7FF"),
        "can-protocol" => (0..=1, "can-protocol is 0 (native) or 1 (MIT)"),
        _ => return Ok(()),
    };
    if matches!(value, Value::Integer(value) if allowed.contains(&value)) { Ok(()) } else { Err(expected) }
}

/// The unit of `can-baud-rate`, bit/s, inferred from the stored number: no document gives it.
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
    /// Checks that the changes lose no motor: each value is one that its item may have, no other motor of the bus answers to the
    /// new id or host id, and the bit rate keeps its unit. Asks on the bus; writes nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Protocol`], [`Error::Taken`], [`Error::Bus`].
    pub fn check(&self, motor: &mut Native<'_>) -> Result<(), Error> {
        self.check_wire(motor)?;
        let (id, host_id) = (motor.address().id, motor.address().host_id);
        let refused = |reason| Err(Error::Protocol { id, reason });
        for change in self.changes {
            check_value(change.item, change.to).or_else(refused)?;
        }
        if let Some(change) = self.change("can-baud-rate")
            && let (Value::Integer(from), Value::Integer(to)) = (change.from, change.to)
            && bitrate_unit(from).is_some_and(|unit| bitrate_unit(to) != Some(unit))
        {
            return refused("its new bit rate is not in the unit of the present one");
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

    /// Over CAN a motor that changed its protocol cannot be sent its bit rate, and the other way round.
    fn check_wire(&self, motor: &mut Native<'_>) -> Result<(), Error> {
        let has = |name| self.change(name).is_some();
        if motor.link().wire() == Wire::Can && has("can-protocol") && has("can-baud-rate") {
            let reason =
                "protocol and bit rate cannot both be changed over CAN: use its serial port, or two files";
            return Err(Error::Protocol { id: motor.address().id, reason });
        }
        Ok(())
    }

    /// Writes each change and reads it back. `journal` is told before and after each write; nothing is written after an error.
    ///
    /// # Errors
    ///
    /// The first refusal, with how much was written before it; the first failure of the journal.
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
            // The last of those that can be stored together, and each that changes how the motor is reached.
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
