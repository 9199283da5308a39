//! The mirrors that want records of each cycle.

use crate::admission::Refused;
use crate::frame::nanos;
use motord_shared::limits::RECORDERS_MAX;
use std::time::Duration;

/// A mirror that has sent no want for longer records no more.
const WANTED: Duration = Duration::from_secs(1);

/// The mirrors that want records, each with the time of its last want, ns.
#[derive(Debug, Default)]
pub(super) struct Readers(Vec<(u64, u64)>);

impl Readers {
    /// Notes that the mirror with `session` wants records.
    pub(super) fn want(&mut self, session: u64, now_ns: u64) -> Result<(), Refused> {
        self.remove_silent(now_ns);
        if let Some((_, wanted_ns)) = self.0.iter_mut().find(|(known, _)| *known == session) {
            *wanted_ns = now_ns;
        } else if self.0.len() < RECORDERS_MAX {
            self.0.push((session, now_ns));
        } else {
            return Err(Refused::Full);
        }
        Ok(())
    }

    /// Returns the sessions of the mirrors that want records.
    pub(super) fn current(&mut self, now_ns: u64) -> Vec<u64> {
        self.remove_silent(now_ns);
        self.0.iter().map(|(session, _)| *session).collect()
    }

    fn remove_silent(&mut self, now_ns: u64) {
        self.0.retain(|(_, wanted_ns)| now_ns.saturating_sub(*wanted_ns) <= nanos(WANTED));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn mirror_without_wants_gets_no_records() {
        let mut readers = Readers::default();
        readers.want(5, 0).unwrap();
        assert_eq!(readers.current(nanos(WANTED)), [5]);
        readers.want(5, 900 * MS).unwrap();
        assert_eq!(readers.current(1500 * MS), [5]);
        assert!(readers.current(1901 * MS).is_empty());
    }

    #[test]
    fn at_most_two_mirrors_record() {
        let mut readers = Readers::default();
        assert!((1..=RECORDERS_MAX as u64).all(|session| readers.want(session, 0).is_ok()));
        assert_eq!(readers.want(9, 500 * MS), Err(Refused::Full));
        assert!(readers.want(1, 500 * MS).is_ok());
        assert!(readers.want(9, 1001 * MS).is_ok(), "the second has left");
        assert_eq!(readers.current(1001 * MS), [1, 9]);
    }
}
