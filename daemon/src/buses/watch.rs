//! The buses that must be opened again, as the events of the cycle report them.

use motord_shared::BusCondition;
use std::sync::mpsc::Sender;

/// Reports broken buses to the reconnector.
pub struct BusWatch {
    broken: Sender<usize>,
    /// The buses that are off since the last [`report_off`](Self::report_off).
    off: Vec<usize>,
    /// The buses whose interfaces are down.
    down: Vec<usize>,
}

impl BusWatch {
    /// Reports to `broken`.
    #[must_use]
    pub const fn new(broken: Sender<usize>) -> Self {
        Self { broken, off: Vec::new(), down: Vec::new() }
    }

    /// Takes in the condition of a bus. Reports one that is gone, and one that was down and is up again: it may have another bit
    /// rate, or be in listen-only mode, which opening it checks.
    pub fn record(&mut self, bus: usize, condition: BusCondition) {
        self.off.retain(|off| *off != bus);
        let was_down = self.down.contains(&bus);
        self.down.retain(|down| *down != bus);
        match condition {
            BusCondition::Gone => self.report(bus),
            BusCondition::Down => self.down.push(bus),
            BusCondition::Off => {
                // A controller may return by itself, and is checked then.
                self.off.push(bus);
                self.down.extend(was_down.then_some(bus));
            }
            _ if was_down => self.report(bus),
            _ => {}
        }
    }

    /// Reports the buses that are still off. A controller that left its bus returns by itself where `restart-ms` is set.
    pub fn report_off(&mut self) {
        std::mem::take(&mut self.off).into_iter().for_each(|bus| self.report(bus));
    }

    fn report(&self, bus: usize) {
        let _ended = self.broken.send(bus);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    #[test]
    fn bus_that_recovers_is_not_reported() {
        let (broken, reports) = channel();
        let mut watch = BusWatch::new(broken);
        watch.record(0, BusCondition::Off);
        watch.record(1, BusCondition::Off);
        watch.record(2, BusCondition::Gone);
        assert_eq!(reports.try_iter().collect::<Vec<_>>(), [2]);
        watch.record(0, BusCondition::Active);
        watch.report_off();
        watch.report_off();
        assert_eq!(reports.try_iter().collect::<Vec<_>>(), [1]);
    }

    #[test]
    fn interface_that_was_down_is_checked_again() {
        let (broken, reports) = channel();
        let mut watch = BusWatch::new(broken);
        watch.record(0, BusCondition::Down);
        watch.record(0, BusCondition::Down);
        assert_eq!(reports.try_iter().count(), 0);
        watch.record(1, BusCondition::Active);
        watch.record(0, BusCondition::Off);
        assert_eq!(reports.try_iter().count(), 0);
        watch.record(0, BusCondition::Active);
        watch.record(0, BusCondition::Warning);
        assert_eq!(reports.try_iter().collect::<Vec<_>>(), [0]);
    }
}
