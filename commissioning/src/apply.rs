//! Writing a configuration, item by item.

use crate::error::Error;
use crate::link::Wire;
use crate::native::{Confirmation, Native, same};
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
    /// All items are written; the motor applies them next (GIM document 3.2.2).
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

/// The host id first, so that the motor can be told from others; then its id; then its protocol and its bit rate, which end the
/// conversation over CAN.
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

impl Apply<'_> {
    /// Checks that the changes can be written over this wire.
    ///
    /// # Errors
    ///
    /// [`Error::Protocol`]: over CAN a motor that changed its protocol cannot be told its bit rate, and the other way round.
    pub fn check(&self, motor: &mut Native<'_>) -> Result<(), Error> {
        let has = |name: &str| self.changes.iter().any(|change| change.item.name == name);
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
        self.check(motor).map_err(failed(0))?;
        let plain = self.changes.iter().take_while(|change| rank(change.item) == 0).count();
        for (written, change) in self.changes.iter().enumerate() {
            if written == plain && plain > 0 {
                Self::refresh(motor, journal)?.map_err(failed(written))?;
            }
            journal(Event::Writing(*change)).map_err(Failed::Journal)?;
            let confirmation = motor.set_configuration(change.item, change.to).map_err(failed(written))?;
            journal(Event::Written(*change, confirmation)).map_err(Failed::Journal)?;
        }
        if plain == count && plain > 0 {
            Self::refresh(motor, journal)?.map_err(failed(count))?;
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
