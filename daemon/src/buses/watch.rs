//! The buses that must be opened again, as the events of the cycle report them.

use motord_shared::BusCondition;
use std::sync::mpsc::Sender;

/// Reports broken buses to the reconnector.
pub struct BusWatch {
    broken: Sender<usize>,
    /// The buses that are off since the last [`report_off`](Self::report_off).
    off: Vec<usize>,
}

impl BusWatch {
    /// Reports to `broken`.
    #[must_use]
    pub const fn new(broken: Sender<usize>) -> Self {
        Self { broken, off: Vec::new() }
    }

    /// Takes in the condition of a bus. One that is gone is reported now.
    pub fn record(&mut self, bus: usize, condition: BusCondition) {
        self.off.retain(|off| *off != bus);
        match condition {
            BusCondition::Gone => self.report(bus),
            BusCondition::Off => self.off.push(bus),
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
}
